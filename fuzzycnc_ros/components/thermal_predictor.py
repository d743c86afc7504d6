# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Component `thermal_predictor`: temperatures in, thermal error per axis out.

What it predicts rests on three things that it never guesses: a model, the temperatures of the
thermal reference, and the history since then.  Where one is missing it says so and publishes an
invalid error.
"""

from collections import deque
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from fuzzycnc_ros.components.component import (
    LATCHED,
    Answer,
    Component,
    Emission,
    Health,
    Input,
    Level,
    Output,
)
from fuzzycnc_ros.components.records import (
    SECOND,
    Displacement,
    Floats,
    PredictorState,
    Reason,
    Record,
    SensorSelection,
    Status,
    Temperatures,
    ThermalError,
    ThermalReference,
    nanoseconds,
)
from fuzzycnc_ros.components.substitution import RiseSource
from fuzzycnc_ros.core.config import Config, param
from fuzzycnc_ros.core.text_hash import text_hash
from fuzzycnc_ros.core.thermal import ThermalModel
from fuzzycnc_ros.core.thermal.mate_vote import MateVote

RECENT = 10
"""Samples kept for a reference that arrives after them."""


@dataclass(frozen=True, kw_only=True)
class ThermalPredictorConfig(Config):
    """Parameters of `thermal_predictor`."""

    model: str = param('', '-', 'Model file made by fuzzycnc train; empty waits for training')
    gap_max: float = param(
        1200.0, 's', 'Longest gap in the samples that is bridged', low=0.0, high=86400.0, live=True
    )
    settle_time: float = param(
        14400.0,
        's',
        'Time after which a history that was lost no longer matters',
        low=0.0,
        high=604800.0,
        live=True,
    )
    domain_margin: float = param(
        3.0,
        '-',
        'Distance from the training data, in units of its own extent, that still is in domain',
        low=1.0,
        high=1000.0,
        live=True,
    )
    mate_limit: float = param(
        0.8, 'K', 'Difference to all cluster mates that is never a fault', low=0.0, high=100.0
    )
    mate_tolerance: float = param(
        0.2, '-', 'What that limit grows by with the largest rise', low=0.0, high=10.0
    )
    mate_persistence: float = param(
        1200.0,
        's',
        'Time after which a sensor that all mates contradict is substituted; 0 is never',
        low=0.0,
        high=86400.0,
    )


class ThermalPredictor(Component):
    """Step the model with each sample; keep a checkpoint; stand in for lost sensors."""

    NAME = 'thermal_predictor'
    SUMMARY = 'Predicts the thermal error of each axis, with deviation, domain flag, checkpoint.'
    CONFIG = ThermalPredictorConfig
    INPUTS = (
        Input('sensor_selection', SensorSelection, LATCHED),
        Input('thermal_reference', ThermalReference, LATCHED),
        Input('displacement', Displacement, max_age=3600.0),
        Input('temperatures', Temperatures, driving=True),
    )
    OUTPUTS = (
        Output('thermal_error', ThermalError),
        Output('predictor_state', PredictorState, LATCHED, persistent=True),
    )
    _config: ThermalPredictorConfig

    def __init__(self, config: ThermalPredictorConfig | None = None) -> None:
        super().__init__(config)
        self._model: ThermalModel | None = None
        self._text = ''
        self._hash = ''
        self._label = ''
        self._reference: ThermalReference | None = None
        self._checkpoint: PredictorState | None = None
        self._recent: deque[Temperatures] = deque(maxlen=RECENT)
        self._source: RiseSource | None
        self._reason = Reason.NO_MODEL
        self._detail = 'no model; set the parameter model or call train_thermal_model'
        self._forget()

    def _forget(self) -> None:
        """Drop the history of the model."""
        self._stream = self._model.start() if self._model is not None else None
        self._stepped_at: int | None = None
        self._unknown_since: int | None = None
        self._rise: Floats | None = None
        self._source = None
        self._vote = None if self._model is None else mate_vote(self._model, self._config)

    @property
    def model(self) -> ThermalModel | None:
        """The model in use."""
        return self._model

    @property
    def model_text(self) -> str:
        """Text of the model file in use."""
        return self._text

    def use_model(self, text: str) -> None:
        """Take a model from the text of its file.

        Raises
        ------
        ModelFileError
            If it is no model file or damaged; the model in use stays.
        """
        model = ThermalModel.from_json(text)
        self._model, self._text = model, text
        self._hash = text_hash(text)
        self._label = f'{"/".join(dict.fromkeys(model.default))} {self._hash[:12]}'
        self._forget()
        self._reason, self._detail = Reason.NO_REFERENCE, 'waiting for temperatures'

    def on_request(self, name: str, arguments: Mapping[str, Any], stamp: int) -> Answer:
        """`use_model`: go on with another model, from the history that is still at hand."""
        if name != 'use_model':
            return super().on_request(name, arguments, stamp)
        try:
            self.use_model(str(arguments['model']))
        except ValueError as error:
            return Answer(False, str(error))
        if self._reference is not None:
            self._begin(self._reference)
        return Answer(True, f'using {self._label}')

    def restore(self, output: str, record: Record) -> None:
        """Take back the checkpoint of an earlier life."""
        if isinstance(record, PredictorState):
            self._checkpoint = record

    def on_sensor_selection(self, selection: SensorSelection) -> None:
        """Take the substitutes of a new selection."""
        self._source = None

    def on_thermal_reference(self, reference: ThermalReference) -> None:
        """Start a new history at a new reference."""
        known = self._reference
        if known is not None and known.stamp == reference.stamp:
            return
        self._reference = reference
        self._begin(reference)

    def on_temperatures(self, sample: Temperatures) -> Iterator[Emission]:
        """Predict from one sample."""
        self._recent.append(sample)
        error = self._take(sample)
        model = self._model
        lost = self._reason is not Reason.NONE
        if error is None or model is None or self._rise is None or lost:
            yield Emission('thermal_error', self._invalid(sample))
            return
        distance = float(model.domain.distance(self._rise)) / model.domain.limit
        assert self._source is not None
        yield Emission(
            'thermal_error',
            ThermalError(
                stamp=sample.stamp,
                frame_id=self.frame('workpiece'),
                axis=model.axis,
                channel=model.channel,
                error=error,
                standard_deviation=model.standard_deviation(self._rise),
                valid=True,
                reason=int(Reason.NONE),
                in_domain=distance <= self._config.domain_margin,
                model=self._label,
                substituted=self._source.substituted,
                substitute=self._source.substitute,
            ),
        )
        yield Emission('predictor_state', self._state(sample.stamp))

    def health(self) -> list[Health]:
        """Report why there is no prediction, and which sensors are substituted."""
        if self._reason is Reason.NONE:
            items = [Health('prediction', Level.OK, f'predicting with {self._label}')]
        else:
            items = [Health('prediction', Level.ERROR, self._detail)]
        if self._source is not None and self._source.substituted:
            pairs = zip(self._source.substituted, self._source.substitute, strict=True)
            text = ', '.join(f'{lost} by {mate}' for lost, mate in pairs)
            if self._source.voted_out:
                drifting = ', '.join(self._source.voted_out)
                text += f'; {drifting} drifted away from all of its cluster mates'
            items.append(Health('substitution', Level.WARN, f'substituted: {text}'))
        return items

    def _take(self, sample: Temperatures) -> Floats | None:
        """Step the model to a sample; return the error [m], or None and set the reason."""
        rise = self._rise_of(sample)
        if rise is None or self._model is None or self._stream is None:
            return None
        self._resume(sample)
        interval = nanoseconds(self._model.interval)
        steps = 1
        if self._stepped_at is not None:
            elapsed = sample.stamp - self._stepped_at
            steps = round(elapsed / interval)
            if steps == 0 or abs(elapsed - steps * interval) > 0.1 * elapsed:
                self._refuse(
                    Reason.NO_MODEL,
                    f'the model was trained on samples every {self._model.interval:g} s but they '
                    f'come after {elapsed / SECOND:g} s; set interval of temperature_acquisition',
                )
                return None
            if elapsed > nanoseconds(self._config.gap_max) + interval:
                self._unknown_since = sample.stamp
                steps = 1
        error = self._advance(rise, steps)
        self._stepped_at = sample.stamp
        self._rise = rise
        self._judge_history(sample)
        return error

    def _advance(self, rise: Floats, steps: int) -> Floats:
        """Step the model, along a straight line over missing samples."""
        assert self._stream is not None
        if steps > 1 and self._rise is not None:
            for number in range(1, steps):
                self._stream.step(self._rise + (rise - self._rise) * (number / steps))
        return self._stream.step(rise)

    def _judge_history(self, sample: Temperatures) -> None:
        """Say whether the history that the model rests on is known."""
        if self._unknown_since is not None:
            known_for = sample.stamp - self._unknown_since
            if known_for < nanoseconds(self._config.settle_time):
                left = self._config.settle_time - known_for / SECOND
                self._refuse(
                    Reason.STATE_LOST,
                    f'history lost; valid again after {left:.0f} s or a new thermal reference',
                )
                return
            self._unknown_since = None
        self._reason, self._detail = Reason.NONE, ''

    def _resume(self, sample: Temperatures) -> None:
        """Decide at the first sample where the history comes from."""
        if self._stepped_at is not None or self._unknown_since is not None:
            return
        assert self._reference is not None
        assert self._model is not None
        assert self._stream is not None
        saved = self._checkpoint
        if (
            saved is not None
            and saved.reference_stamp == self._reference.stamp
            and saved.model_hash == self._hash
            and saved.input == self._model.inputs
            and saved.stamp < sample.stamp
        ):
            self._stream.state = saved.state
            self._stepped_at = saved.stamp
            self._rise = saved.last_rise
        elif sample.stamp - self._reference.stamp > nanoseconds(2.0 * self._model.interval):
            # The machine has been warming up unseen since its reference.
            self._unknown_since = sample.stamp

    def _begin(self, reference: ThermalReference) -> None:
        """Start the history at a reference, from the samples since the cold start."""
        self._forget()
        for sample in self._recent:
            # A reference set long ago says nothing about the samples at hand.
            if reference.cold_since < sample.stamp <= reference.stamp:
                self._take(sample)

    def _rise_of(self, sample: Temperatures) -> Floats | None:
        """Return the rises of the model's inputs, or None and set the reason."""
        if self._model is None:
            return None
        if self._reference is None:
            self._refuse(Reason.NO_REFERENCE, 'no thermal reference (topic thermal_reference)')
            return None
        if self._source is None or self._source.sensor != sample.sensor:
            selection = self._newest.get('sensor_selection')
            try:
                self._source = RiseSource(
                    self._model,
                    sample.sensor,
                    self._reference,
                    selection if isinstance(selection, SensorSelection) else None,
                    self._vote,
                )
            except ValueError as error:
                self._source = None
                self._refuse(Reason.NO_MODEL, str(error))
                return None
        rise = self._source.rise(sample.temperature, sample.status == Status.OK)
        if rise is None:
            lost = ', '.join(self._source.lost)
            self._refuse(Reason.SENSOR_LOST, f'no good reading of {lost} nor of any mate')
        return rise

    def _refuse(self, reason: Reason, detail: str) -> None:
        self._reason, self._detail = reason, detail

    def _invalid(self, sample: Temperatures) -> ThermalError:
        """Return an error that says it must not be used."""
        axes = self._model.axis if self._model is not None else ()
        nothing = np.full(len(axes), np.nan)
        return ThermalError(
            stamp=sample.stamp,
            frame_id=self.frame('workpiece'),
            axis=axes,
            channel=self._model.channel if self._model is not None else (),
            error=nothing,
            standard_deviation=nothing.copy(),
            valid=False,
            reason=int(self._reason),
            in_domain=False,
            model=self._label,
            substituted=(),
            substitute=(),
        )

    def _state(self, stamp: int) -> PredictorState:
        assert self._model is not None
        assert self._reference is not None
        assert self._rise is not None
        assert self._stream is not None
        return PredictorState(
            stamp=stamp,
            frame_id=self.frame('machine'),
            model_hash=self._hash,
            reference_stamp=self._reference.stamp,
            input=self._model.inputs,
            last_rise=self._rise,
            state=self._stream.state,
        )


def mate_vote(model: ThermalModel, config: ThermalPredictorConfig) -> MateVote:
    """Return the watch over slow sensor faults that a predictor keeps on a model's inputs."""
    return MateVote(
        len(model.inputs),
        limit=config.mate_limit,
        tolerance=config.mate_tolerance,
        persistence=config.mate_persistence,
    )

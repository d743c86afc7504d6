# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Component `thermal_predictor`: temperatures in, thermal error per axis out.

What it predicts rests on three things that it never guesses: a model, the temperatures of the
thermal reference, and the history since then.  Where one is missing it says so and publishes an
invalid error.
"""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from fuzzycnc_ros.components.thermal.control_drives import drives_told
from fuzzycnc_ros.components.thermal.fade import Fade
from fuzzycnc_ros.components.thermal.predictor_stream import (
    OWN,
    STATE,
    PredictorStream,
    StreamSample,
    speed_told,
)
from fuzzycnc_ros.components.thermal.thermal_history import ModelHistory, Prediction, losses_of
from fuzzycnc_ros.components.thermal.thermal_predictor_config import ThermalPredictorConfig
from fuzzycnc_ros.core.thermal.model import ModelMismatchError, ThermalModel
from fuzzycnc_ros.core.thermal.places import BEND_LARGEST, channel_spans, read_places
from fuzzycnc_ros.runtime.component import (
    LATCHED,
    Answer,
    Component,
    Emission,
    Health,
    Input,
    Level,
    Output,
)
from fuzzycnc_ros.runtime.enums import ForgetMode, Reason
from fuzzycnc_ros.runtime.records import (
    SECOND,
    CompensationApplied,
    Displacement,
    Floats,
    MachineState,
    Names,
    PredictorState,
    ProbeEvidence,
    ProbeStatus,
    Record,
    SensorSelection,
    SpindleSpeed,
    Stamp,
    Temperatures,
    ThermalError,
    ThermalPosterior,
    ThermalReference,
)


class ModelSwap:
    """The model in use and those that are to follow, in this order."""

    def __init__(self) -> None:
        self._models: list[ModelHistory] = []
        self._weight: Fade | None = None
        """Share of the second model; None while it does not speak yet."""
        self._difference: Floats = np.zeros(0)
        """Second model minus the first during a fade, as last known, shape (c,) [m]."""
        self._worked_at: Stamp | None = None

    @property
    def models(self) -> tuple[ModelHistory, ...]:
        """All models that see the samples."""
        return tuple(self._models)

    @property
    def in_use(self) -> ModelHistory | None:
        """The model that speaks, or spoke before the fade under way."""
        return self._models[0] if self._models else None

    @property
    def wanted(self) -> ModelHistory | None:
        """The model that speaks once all swaps are over."""
        return self._models[-1] if self._models else None

    def add(self, model: ModelHistory) -> str:
        """Let a model take over as soon as it can; return how it will, in words.

        It takes the place of a model that waits, and waits itself while two others fade.
        """
        first = self.in_use
        if first is None or (first.prediction is None and not _pauses(first, model)):
            self._models = [model]
            self._weight = None
            return f'using {model.label}'
        del self._models[1 if self._weight is None else 2 :]
        self._models.append(model)
        if self._weight is not None:
            return f'{model.label} takes over when the fade to {self._models[1].label} is over'
        if model.prediction is None:
            return f'{model.label} takes over from {first.label} when it can: {model.detail}'
        self._start_fade()
        return f'fading from {first.label} to {model.label}'

    def keep(self, text: str) -> str:
        """Stay with a model that is in use or on its way already; return so, '' if none is.

        Parameters
        ----------
        text : str
            Text of its file.  What was to follow it is dropped.
        """
        # A fade under way leaves the first model: to come back to it is another swap.
        for number in range(0 if self._weight is None else 1, len(self._models)):
            if self._models[number].text == text:
                del self._models[number + 1 :]
                state = 'in use' if number == 0 else 'on its way'
                return f'{self._models[number].label} is {state} already'
        return ''

    def begin(self) -> None:
        """Begin at a new thermal reference, where the error of every model is zero."""
        if self._weight is not None:
            self._promote()
        for model in self._models:
            model.begin()

    def take(self, heard: StreamSample) -> Prediction | None:
        """Step all models to a sample; return what to publish, None if nothing is valid."""
        stamp = heard.sample.stamp
        for model in self._models:
            model.take(heard)
        elapsed = 0.0 if self._worked_at is None else (stamp - self._worked_at) / SECOND
        self._worked_at = stamp
        if len(self._models) > 1:
            self._move(elapsed)
        first = self.in_use
        if first is None or first.prediction is None:
            return None
        if self._weight is not None:
            return self._blend(first.prediction, float(self._weight.value[0]))
        return first.prediction

    def state(self, stamp: Stamp, frame_id: str) -> PredictorState:
        """Return a checkpoint; that of a fade goes on to the new model."""
        if self._weight is None or self._models[1].prediction is None:
            return self._models[0].state(stamp, frame_id)
        return self._models[1].state(stamp, frame_id, self._remainder(self._weight))

    def health(self) -> list[Health]:
        """Report a swap that is under way."""
        if len(self._models) < 2:
            return []
        first, second = self._models[:2]
        if self._weight is not None:
            share = 100.0 * float(self._weight.value[0])
            text = f'fading from {first.label} to {second.label}: {share:.0f} %'
            return [Health('swap', Level.OK, text)]
        text = f'{second.label} takes over from {first.label} when it can: {second.detail}'
        level = Level.ERROR if second.reason is Reason.NO_MODEL else Level.WARN
        return [Health('swap', level, text)]

    def _start_fade(self) -> None:
        self._weight = Fade(np.zeros(1))
        self._weight.to(np.ones(1), self._models[1].config.swap_time)
        self._note_difference()

    def _move(self, elapsed: float) -> None:
        """Move the fade on, and end it where one model has nothing more to say."""
        first, second = self._models[:2]
        if self._weight is None:
            if second.prediction is not None:
                if first.prediction is None:
                    self._promote()
                else:
                    self._start_fade()
            return
        self._weight.advance(elapsed)
        self._note_difference()
        if second.prediction is None:
            if self._weight.target[0] > 0.0:
                self._weight.to(np.zeros(1), second.config.swap_time)
            return
        if first.prediction is None:
            # The rest of the way goes from what was last known of the difference.
            second.inherit(self._remainder(self._weight))
            self._promote()
        elif self._weight.value[0] >= 1.0:
            self._promote()
        elif self._weight.target[0] < 1.0:
            self._weight.to(np.ones(1), second.config.swap_time)

    def _promote(self) -> None:
        """Put the second model into use."""
        del self._models[0]
        self._weight = None

    def _note_difference(self) -> None:
        first, second = self._models[:2]
        if first.prediction is not None and second.prediction is not None:
            old = _as_channels(second, first, first.prediction.error)
            self._difference = second.prediction.error - old

    def _remainder(self, weight: Fade) -> Fade:
        """Return what the published error is apart from the second model's own, going to zero."""
        own = self._models[1].remainder.value
        left = Fade(own + (weight.value[0] - 1.0) * self._difference)
        left.to(np.zeros(len(own)), weight.remaining or self._models[1].config.swap_time)
        return left

    def _blend(self, before: Prediction, share: float) -> Prediction:
        """Return the first model's prediction, `share` of the way to the second's."""
        first, second = self._models[:2]
        error = _as_channels(second, first, before.error) + share * self._difference
        deviation = _as_channels(second, first, before.deviation, fill=np.nan)
        after = second.prediction
        if after is None:
            after = replace(before, error=error, deviation=deviation)
        mates = dict(zip(before.substituted, before.substitute, strict=True))
        mates |= dict(zip(after.substituted, after.substitute, strict=True))
        return Prediction(
            axis=second.model.axis,
            channel=second.model.channel,
            label=f'{first.label} to {second.label} {100.0 * share:.0f} %',
            error=error,
            deviation=(1.0 - share) * deviation + share * after.deviation,
            outside=before.outside or after.outside,
            substituted=tuple(mates),
            substitute=tuple(mates.values()),
        )


def _pauses(first: ModelHistory, second: ModelHistory) -> bool:
    """Return True if a model that predicts nothing now is still the one to wait for."""
    return second.prediction is None and first.reason is Reason.SENSOR_LOST


def _as_channels(
    wanted: ModelHistory, given: ModelHistory, values: Floats, fill: float = 0.0
) -> Floats:
    """Return values of one model's channels in the order of another's, `fill` where it has none.

    An error that nobody predicted yet is zero: so it fades in.
    """
    known = dict(zip(given.model.channel, values.tolist(), strict=True))
    return np.array([known.get(name, fill) for name in wanted.model.channel])


NO_MODEL = 'no model; set the parameter model or call train_thermal_model'


class ThermalPredictor(Component[ThermalPredictorConfig]):
    """Step the model with each sample; correct it by probes; let a new one take over softly."""

    NAME = 'thermal_predictor'
    SUMMARY = 'Predicts the thermal error of each axis, with deviation, domain flag, checkpoint.'
    CONFIG = ThermalPredictorConfig
    INPUTS = (
        Input('sensor_selection', SensorSelection, LATCHED),
        Input('thermal_reference', ThermalReference, LATCHED),
        # How long the last known speed is held is a parameter, gap_max.
        Input(STATE, MachineState, quiet=True, sole=True),
        Input(OWN, SpindleSpeed, quiet=True),
        Input('compensation_applied', CompensationApplied, quiet=True, sole=True),
        Input('displacement', Displacement, quiet=True, paced=False),
        Input('temperatures', Temperatures, driving=True, sole=True),
    )
    OUTPUTS = (
        Output('thermal_error', ThermalError),
        Output('predictor_state', PredictorState, LATCHED, persistent=True),
        Output('thermal_posterior', ThermalPosterior, LATCHED, persistent=True),
        Output('probe_evidence', ProbeEvidence, LATCHED, persistent=True),
        Output('probe_status', ProbeStatus, LATCHED),
    )

    def __init__(self, config: ThermalPredictorConfig | None = None) -> None:
        super().__init__(config)
        read_places(self._config.learn_places, self._config.learn_axes, 'learn_places')
        self._swap = ModelSwap()
        self._stream = PredictorStream(self._config)
        self._named = False
        """True if a model was asked for; else all of the error is learnt."""

    @property
    def model(self) -> ThermalModel | None:
        """The model in use."""
        return self._swap.in_use.model if self._swap.in_use is not None else None

    @property
    def model_text(self) -> str:
        """Text of the model file that was asked for last; empty where there is none."""
        return self._swap.wanted.text if self._swap.wanted is not None and self._named else ''

    def reconfigure(self, config: ThermalPredictorConfig) -> None:
        """Take live parameters; they act from the next sample on."""
        super().reconfigure(config)
        self._stream.reconfigure(self._config)

    def use_model(self, text: str) -> str:
        """Take a model from the text of its file; return how it comes into use, in words.

        It begins with the samples at hand.  While another model predicts, it takes over when its
        own history is known, and then within `swap_time`.

        Raises
        ------
        ModelFileError
            If it is no model file or damaged; the model in use stays.
        ModelMismatchError
            If another model predicts from the stream and this one cannot, or if this one is worse
            than no compensation and `force` is false; the model in use stays.
        """
        kept = self._swap.keep(text)
        if kept:
            return kept
        history = ModelHistory(text, self._stream)
        if history.model.losing and not self._config.force:
            raise ModelMismatchError(refusal_of(history.model))
        in_use, newest = self._swap.in_use, self._stream.newest
        if newest is not None and in_use is not None and in_use.reason is Reason.NONE:
            history.model.check_stream(newest.sample.sensor, in_use.model.interval)
        history.begin()
        self._named = True
        return self._swap.add(history)

    def prepare(self, model: str, run_reader: Callable[..., Any]) -> None:
        """Put the model to use that the run begins with."""
        if model:
            self.use_model(model)

    def on_request(self, name: str, arguments: Mapping[str, Any], stamp: int) -> Answer:
        """Go on with another model by `use_model`, know less by `forget`."""
        if name == 'forget':
            return self._forget(arguments, stamp)
        if name != 'use_model':
            return super().on_request(name, arguments, stamp)
        try:
            return Answer(True, self.use_model(str(arguments['model'])))
        except ValueError as error:
            return Answer(False, str(error))

    def _forget(self, arguments: Mapping[str, Any], stamp: int) -> Answer:
        history = self._swap.in_use
        try:
            if history is None:
                raise ValueError(NO_MODEL)
            text = history.learning.forget(ForgetMode(arguments['mode']))
        except ValueError as error:
            return Answer(False, str(error))
        newest = self._stream.newest
        learnt = history.learnt(newest.sample.stamp if newest else stamp, self.frame('machine'))
        if learnt is None:
            return Answer(True, text)
        return Answer(True, text, tuple(self._learnt(learnt)))

    def _learnt(self, posterior: ThermalPosterior) -> Iterator[Emission]:
        """Keep what was learnt, and tell it; what others need of it is small, and comes first."""
        before = self._stream.memory
        self._stream.keep(posterior)
        if before is None or not np.array_equal(before.evidence, posterior.evidence):
            evidence = ProbeEvidence(
                stamp=posterior.stamp,
                frame_id=posterior.frame_id,
                axis=posterior.axis,
                channel=posterior.channel,
                evidence=posterior.evidence,
            )
            yield Emission('probe_evidence', evidence)
        yield Emission('thermal_posterior', posterior)

    def renewed(self, step: int) -> 'tuple[ThermalPredictor, list[Emission]]':
        """Begin with the same model; the history goes on once the same reference comes anew."""
        fresh = self._afresh()
        fresh._stream = self._stream.renewed(step)
        if self.model_text:
            fresh.use_model(self.model_text)
        return fresh, []

    def restore(self, output: str, record: Record) -> None:
        """Take back the checkpoint of an earlier life, and what it has learnt.

        Of another machine's memory all counts but that its probes are right.
        """
        if isinstance(record, ThermalPosterior) and record.frame_id != self.frame('machine'):
            record = replace(record, evidence=np.zeros_like(record.evidence))
        if isinstance(record, PredictorState | ThermalPosterior):
            self._stream.keep(record)

    def on_sensor_selection(self, selection: SensorSelection) -> None:
        """Take the substitutes of a new selection."""
        self._stream.select(selection)
        for history in self._swap.models:
            history.select()

    def on_thermal_reference(self, reference: ThermalReference) -> None:
        """Start a new history at a new reference."""
        if self._stream.begin(reference):
            self._swap.begin()

    def on_machine_state(self, state: MachineState) -> None:
        """Note the spindle speed that the controller reports, and what else it tells of heat."""
        self._stream.speeds.note(STATE, state.stamp, speed_told(STATE, state))
        if (told := drives_told(state)) is not None:
            self._stream.drives.note(state.stamp, *told)

    def on_spindle_speed(self, speed: SpindleSpeed) -> None:
        """Note the spindle speed that a source of its own tells."""
        self._stream.speeds.note(OWN, speed.stamp, speed_told(OWN, speed))

    def on_compensation_applied(self, applied: CompensationApplied) -> None:
        """Note what probes of this time include."""
        if self._stream.probes is not None:
            self._stream.probes.add_read_back(applied)

    def on_displacement(self, probe: Displacement) -> None:
        """Note a probe; without probing a displacement is for training only."""
        if self._stream.probes is not None:
            self._stream.probes.add(probe)

    def on_temperatures(self, sample: Temperatures) -> Iterator[Emission]:
        """Predict from one sample."""
        heard = self._stream.hear(sample)
        if self._config.learn and self._swap.in_use is None:
            self._begin_with_nothing()
            found = self._swap.in_use.prediction if self._swap.in_use is not None else None
        else:
            found = self._swap.take(heard)
        yield Emission('thermal_error', self._error(sample.stamp, found))
        if found is None:
            return
        state = self._swap.state(sample.stamp, self.frame('machine'))
        self._stream.keep(state)
        yield Emission('predictor_state', state)
        if self._swap.in_use is not None:
            learnt = self._swap.in_use.learnt(sample.stamp, self.frame('machine'))
            if learnt is not None:
                yield from self._learnt(learnt)
            status = self._swap.in_use.learning.status(sample.stamp, self.frame('machine'))
            if status is not None:
                yield Emission('probe_status', status)

    def _begin_with_nothing(self) -> None:
        """Begin to learn all of the error, once sensors and sampling interval are known."""
        learnt = self._stream.from_nothing()
        if learnt is not None:
            history = ModelHistory(learnt.to_json(), self._stream)
            history.begin()
            self._swap.add(history)

    def health(self) -> list[Health]:
        """Report what is predicted with, which sensors are substituted, what probes say."""
        history = self._swap.in_use
        if history is None:
            if not self._config.learn:
                return [Health('prediction', Level.ERROR, NO_MODEL)]
            return [Health('prediction', Level.ERROR, self._stream.awaited)]
        if history.reason is not Reason.NONE:
            items = [Health('prediction', Level.ERROR, history.detail)]
        else:
            values = {'distance [-]': f'{history.distance:.3g}'}
            items = [Health('prediction', Level.OK, f'predicting with {history.label}', values)]
        items += history.health()
        if history.prediction is not None and history.prediction.outside:
            items.append(Health('domain', Level.WARN, history.prediction.outside))
        items += self._swap.health()
        told = self._stream.speeds.newest is not None
        if history.model.needs_speed or (history.learning.active and told):
            items.append(self._stream.speeds.health())
        if history.substitutions:
            items.append(Health('substitution', Level.WARN, history.substitutions))
        items += history.learning.health()
        if self._stream.probes is not None and self._stream.probes.trouble:
            items.append(Health('probe', Level.WARN, self._stream.probes.trouble))
        return items

    def _error(self, stamp: Stamp, found: Prediction | None) -> ThermalError:
        """Return what is published for a sample; without a prediction, that it is of no use."""
        valid, reason = found is not None, Reason.NONE
        if found is None:
            history = self._swap.in_use
            axis, channel = (history.model.axis, history.model.channel) if history else ((), ())
            nothing = np.full(len(axis), np.nan)
            reason = history.reason if history else Reason.NO_MODEL
            label = history.label if history else ''
            found = Prediction(axis, channel, label, nothing, nothing.copy(), 'unknown', (), ())
        offset, along = along_travel(found.channel, found.error, found.deviation)
        return ThermalError(
            stamp=stamp,
            frame_id=self.frame('workpiece'),
            axis=tuple(found.axis[number] for number in offset),
            channel=tuple(found.channel[number] for number in offset),
            error=found.error[offset],
            standard_deviation=found.deviation[offset],
            **along,
            valid=valid,
            reason=int(reason),
            in_domain=not found.outside,
            model=found.label,
            substituted=found.substituted,
            substitute=found.substitute,
        )


def along_travel(
    channel: Names, error: Floats, deviation: Floats
) -> tuple[list[int], dict[str, Floats]]:
    """Return which channels are offsets, and the fields that tell how these errors slope.

    Parameters
    ----------
    channel : tuple of str, length c
        Channels of a model.
    error, deviation : ndarray, shape (c,)
        What it predicts and the standard deviations of that [m].
    """
    spans = channel_spans(channel)
    rest = {column for item in spans for column in item.columns[1:]}
    offset = [number for number in range(len(channel)) if number not in rest]
    names = ('slope', 'slope_deviation', 'reference_position', 'line_deviation')
    found = {name: np.full(len(offset), np.nan) for name in names}
    for item in spans:
        at, half = offset.index(item.columns[0]), item.span.half
        found['slope'][at] = error[item.columns[1]] / half
        found['slope_deviation'][at] = deviation[item.columns[1]] / half
        found['reference_position'][at] = item.span.middle
        for column in item.columns[2:]:
            left = np.hypot(error[column], deviation[column])
            found['line_deviation'][at] = BEND_LARGEST * left
    return offset, found


def refusal_of(model: ThermalModel) -> str:
    """Return why a model that is worse than none is not used, and what to do."""
    return (
        f'expected less to be left than without compensation, but found {losses_of(model)}; '
        f'train with the model auto, which leaves {", ".join(model.losing)} uncompensated '
        '(`fuzzycnc train --model auto`), or use it all the same with the parameter force '
        '(`fuzzycnc up --force-model`)'
    )

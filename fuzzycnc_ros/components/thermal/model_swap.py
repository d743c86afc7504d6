# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Which model speaks for the machine, and how one takes over from another without a step.

A model that is to take over sees the same samples as the one in use.  As soon as its own history
is known the published error fades linearly from the one to the other within `swap_time`; until
then the model in use stays.
"""

from dataclasses import dataclass, replace

import numpy as np

from fuzzycnc_ros.components.thermal.sample_memory import Heard, SampleMemory
from fuzzycnc_ros.components.thermal.thermal_history import ModelHistory, Prediction
from fuzzycnc_ros.core.thermal.fade import Fade
from fuzzycnc_ros.runtime.component import Health, Level
from fuzzycnc_ros.runtime.enums import Reason
from fuzzycnc_ros.runtime.records import (
    SECOND,
    Floats,
    Names,
    PredictorState,
    Stamp,
    ThermalReference,
)


@dataclass(frozen=True, eq=False)
class Published:
    """What is published for a sample; arrays of shape (c,)."""

    axis: Names
    channel: Names
    label: str
    prediction: Prediction


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

    def begin(
        self, reference: ThermalReference, memory: SampleMemory, saved: PredictorState | None
    ) -> None:
        """Begin at a new thermal reference, where the error of every model is zero."""
        if self._weight is not None:
            self._promote()
        for model in self._models:
            model.begin(reference, memory.since(reference.cold_since), saved)

    def take(self, heard: Heard) -> Published | None:
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
        return Published(first.model.axis, first.model.channel, first.label, first.prediction)

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

    def _blend(self, before: Prediction, share: float) -> Published:
        """Return the first model's prediction, `share` of the way to the second's."""
        first, second = self._models[:2]
        error = _as_channels(second, first, before.error) + share * self._difference
        deviation = _as_channels(second, first, before.deviation, fill=np.nan)
        after = second.prediction
        if after is None:
            after = replace(before, error=error, deviation=deviation)
        mates = dict(zip(before.substituted, before.substitute, strict=True))
        mates |= dict(zip(after.substituted, after.substitute, strict=True))
        return Published(
            axis=second.model.axis,
            channel=second.model.channel,
            label=f'{first.label} to {second.label} {100.0 * share:.0f} %',
            prediction=Prediction(
                error=error,
                deviation=(1.0 - share) * deviation + share * after.deviation,
                outside=before.outside or after.outside,
                substituted=tuple(mates),
                substitute=tuple(mates.values()),
            ),
        )


def _pauses(first: ModelHistory, second: ModelHistory) -> bool:
    """Whether a model that predicts nothing now is still the one to wait for."""
    return second.prediction is None and first.reason is Reason.SENSOR_LOST


def _as_channels(
    wanted: ModelHistory, given: ModelHistory, values: Floats, fill: float = 0.0
) -> Floats:
    """Return values of one model's channels in the order of another's, `fill` where it has none.

    An error that nobody predicted yet is zero: so it fades in.
    """
    known = dict(zip(given.model.channel, values.tolist(), strict=True))
    return np.array([known.get(name, fill) for name in wanted.model.channel])

# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""One model on its way along the stream: what it has seen since the reference, what it says now.

`thermal_predictor` keeps one of these for the model in use, and another for a model that is to
take over.  Both see the same samples, so that either can be published at any time.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from fuzzycnc_ros.components.thermal.fade import Fade
from fuzzycnc_ros.components.thermal.predictor_stream import PredictorStream, StreamSample
from fuzzycnc_ros.components.thermal.probe_learning import ProbeLearning
from fuzzycnc_ros.components.thermal.sensor_substitution import RiseSource
from fuzzycnc_ros.components.thermal.thermal_predictor_config import ThermalPredictorConfig
from fuzzycnc_ros.core.names import text_hash
from fuzzycnc_ros.core.thermal.blank import LABEL
from fuzzycnc_ros.core.thermal.domain import DOMAIN_MARGIN, SPEED_MARGIN
from fuzzycnc_ros.core.thermal.model import ThermalModel
from fuzzycnc_ros.core.thermal.run import GAP_MAX
from fuzzycnc_ros.core.thermal.sensor_watch import SensorWatch
from fuzzycnc_ros.runtime.component import Health, Level
from fuzzycnc_ros.runtime.enums import Reason, Status
from fuzzycnc_ros.runtime.records import (
    SECOND,
    Floats,
    Names,
    PredictorState,
    Stamp,
    Temperatures,
    ThermalPosterior,
    nanoseconds,
)

BLOCKS = {'remainder': 6, 'watch': 7, 'lags': 8, 'jump': 9}
"""Codes of the blocks; 1 to 5 were those of offsets and gains that probes gave."""


def write_blocks(recursion: Floats, blocks: Mapping[str, Floats]) -> Floats:
    """Return all numbers of a checkpoint as one flat array."""
    parts = [recursion]
    for name, values in blocks.items():
        parts += [np.array([BLOCKS[name], len(values)], dtype=np.float64), values]
    return np.concatenate(parts)


def read_blocks(state: Floats, size: int) -> tuple[Floats, dict[str, Floats]]:
    """Return the first `size` numbers of a checkpoint and its blocks by name.

    Raises
    ------
    ValueError
        If the array ends within a part of it, or holds a length that is none.
    """
    if len(state) < size:
        raise ValueError(f'state: expected {size} numbers or more, but found {len(state)}')
    names = {code: name for name, code in BLOCKS.items()}
    blocks = {}
    at = size
    while at < len(state):
        head = state[at : at + 2]
        length = int(head[1]) if len(head) == 2 and np.isfinite(head).all() else -1
        if length < 0 or at + 2 + length > len(state):
            raise ValueError(f'state: expected a whole block at {at}, but found {state[at:]}')
        name = names.get(int(head[0]))
        if name is not None:
            blocks[name] = state[at + 2 : at + 2 + length]
        at += 2 + length
    return state[:size], blocks


@dataclass(frozen=True, eq=False)
class Prediction:
    """Prediction of a model, or a fade of two, at one sample, with probes; arrays of shape (c,).

    `outside` says why the sample is out of domain; it is empty if it is not.
    """

    axis: Names
    channel: Names
    label: str
    error: Floats
    deviation: Floats
    outside: str
    substituted: Names
    substitute: Names


class ModelHistory:
    """A model, the history that it rests on, and its prediction for the newest sample.

    Parameters
    ----------
    text : str
        Text of a model file.
    stream : PredictorStream
        What it rests on; the model begins if there is a thermal reference.

    Raises
    ------
    ModelFileError
        If it is no model file or damaged.
    """

    def __init__(self, text: str, stream: PredictorStream) -> None:
        self.text, self._stream = text, stream
        self.model = ThermalModel.from_json(text)
        self.hash = text_hash(text)
        name = '/'.join(dict.fromkeys(self.model.default)) if self.model.runs else LABEL
        self.label = f'{name} {self.hash[:12]}'
        self.learning = ProbeLearning(self.model, self.config)
        self._begun = False
        self._warm: dict[str, float] = {}
        """Inputs that were warm when the reference was taken, by how much [K]."""
        self._forget()
        self.refuse(Reason.NO_REFERENCE, 'waiting for temperatures')

    @property
    def config(self) -> ThermalPredictorConfig:
        """Parameters of the predictor, as they are now."""
        return self._stream.config

    def _forget(self) -> None:
        """Drop the history."""
        self.prediction: Prediction | None = None
        self.distance = float('nan')
        """Distance of the newest sample from the training, 1 at the border of the domain [-]."""
        self.remainder = Fade(np.zeros(len(self.model.channel)))
        """Remainder of a model from which this one has taken over [m]; fades to zero."""
        self._recursion = self.model.start()
        self._stepped_at: Stamp | None = None
        self._heard_at: Stamp | None = None
        self._predicted_at: Stamp | None = None
        self._unknown_since: Stamp | None = None
        self._vector: Floats | None = None
        self._source: RiseSource | None = None
        self._watch = sensor_watch(self.model, self.config)

    def begin(self) -> None:
        """Start the history at the reference, from the samples since its cold start.

        A reference set long ago says nothing about samples from before.  The checkpoint is used
        if it belongs to this model; what belongs to a run, only if the reference is the same.
        """
        reference = self._stream.reference
        if reference is None:
            return
        self._forget()
        memory = None if self._begun else self._memory()
        self._begun = True
        known = dict(zip(reference.sensor, reference.temperature.tolist(), strict=True))
        start = [known.get(name, np.nan) for name in self.model.inputs]
        self._warm = self.model.warmth(start)
        self.learning.begin(reference.stamp, memory)
        for item in self._stream.since(reference.cold_since):
            self.take(item)

    def select(self) -> None:
        """Take the substitutes of another selection."""
        self._source = None

    def take(self, heard: StreamSample) -> None:
        """Step the model to a sample; sets `prediction`, or None with `reason` and `detail`."""
        self.prediction = None
        error = self._step(heard)
        if error is None or self._vector is None:
            self.learning.pause()
            return
        stamp = heard.sample.stamp
        self.distance = float(self.model.distance(self._vector))
        error, deviation = self.learning.apply(
            stamp, error, self.model.standard_deviation(self._vector), heard.probes
        )
        if self.remainder.remaining and self._predicted_at is not None:
            error = error + self.remainder.advance((stamp - self._predicted_at) / SECOND)
        self._predicted_at = stamp
        if not self._usable(error, deviation):
            return
        assert self._source is not None
        self.prediction = Prediction(
            axis=self.model.axis,
            channel=self.model.channel,
            label=self.label,
            error=error,
            deviation=deviation,
            outside=self._outside(heard),
            substituted=self._source.substituted,
            substitute=self._source.substitute,
        )

    def inherit(self, remainder: Fade) -> None:
        """Take over from another model: publish what is left of it too, less and less."""
        assert self.prediction is not None
        shift = remainder.value - self.remainder.value
        self.prediction = replace(self.prediction, error=self.prediction.error + shift)
        self.remainder = remainder

    def refuse(self, reason: Reason, detail: str) -> None:
        """Say why there is no prediction."""
        self.reason, self.detail = reason, detail

    @property
    def substitutions(self) -> str:
        """Which inputs a mate stands in for, in words; empty if none."""
        if self._source is None or not self._source.substituted:
            return ''
        pairs = zip(self._source.substituted, self._source.substitute, strict=True)
        text = 'substituted: ' + ', '.join(f'{lost} by {mate}' for lost, mate in pairs)
        if self._source.voted_out:
            drifting = ', '.join(self._source.voted_out)
            text += f'; {drifting} drifted away from its mates'
        return text

    def health(self) -> list[Health]:
        """Report what of the model, or of its reference, an operator has to know."""
        items = []
        if self.model.uncompensated and not self.learning.active:
            text = f'{", ".join(self.model.uncompensated)}: no model was better beyond chance'
            items.append(Health('uncompensated', Level.OK, text))
        if self.model.losing:
            items.append(Health('forced', Level.WARN, losses_of(self.model)))
        if self._warm:
            sensors = ', '.join(f'{name} {kelvin:+.1f} K' for name, kelvin in self._warm.items())
            text = f'the machine was warm when the reference was taken: {sensors}'
            items.append(Health('reference', Level.WARN, text))
        return items

    def state(self, stamp: Stamp, frame_id: str, remainder: Fade | None = None) -> PredictorState:
        """Return a checkpoint from which `begin` resumes.

        Parameters
        ----------
        stamp : int
            Stamp of the newest sample [ns].
        frame_id : str
            Frame of the machine.
        remainder : Fade, optional
            What the published error is apart from this model's, if not its own `remainder`.
        """
        assert self._stream.reference is not None
        assert self._vector is not None
        blocks = self.learning.blocks
        left = self.remainder if remainder is None else remainder
        if left.remaining:
            blocks['remainder'] = left.state
        if self._watch is not None and self._watch.faulty.any():
            blocks['watch'] = self._watch.state
        sensors = len(self.model.inputs)
        recursion = np.concatenate([self._recursion.state, self._vector[sensors:]])
        return PredictorState(
            stamp=stamp,
            frame_id=frame_id,
            model_hash=self.hash,
            reference_stamp=self._stream.reference.stamp,
            input=self.model.inputs,
            last_rise=self._vector[:sensors],
            state=write_blocks(recursion, blocks),
        )

    def learnt(self, stamp: Stamp, frame_id: str) -> ThermalPosterior | None:
        """Return what was learnt, None if nothing was since the last time.

        Parameters
        ----------
        stamp : int
            Stamp of the newest sample [ns].
        frame_id : str
            Frame of the machine.
        """
        if not self.learning.news or self._stream.reference is None:
            return None
        return self.learning.record(stamp, self.hash, frame_id)

    def _step(self, heard: StreamSample) -> Floats | None:
        """Step the model; return the error [m], or None and set the reason."""
        stamp = heard.sample.stamp
        before, self._heard_at = self._heard_at or self._stepped_at, stamp
        # Before the sample is read: the checkpoint knows which sensors were voted out.
        if self._stepped_at is None and self._unknown_since is None:
            self._take_checkpoint(stamp)
        vector = self._vector_of(heard)
        if vector is None:
            return None
        self._resume(stamp)
        interval = nanoseconds(self.model.interval)
        steps = 1
        if self._stepped_at is not None:
            elapsed = stamp - self._stepped_at
            steps = round(elapsed / interval)
            if steps == 0 or abs(elapsed - steps * interval) > 0.1 * elapsed:
                assert before is not None
                self.refuse(
                    Reason.NO_MODEL,
                    f'the model takes samples every {self.model.interval:g} s but they '
                    f'come after {(stamp - before) / SECOND:g} s; set interval of '
                    'temperature_acquisition',
                )
                return None
            if elapsed > nanoseconds(self.config.gap_max) + interval:
                self._unknown_since = stamp
                steps = 1
        error = self._advance(vector, steps, heard)
        self._stepped_at = stamp
        self._vector = vector
        return error if self._usable(error) and self._history_is_known(stamp) else None

    def _usable(self, *values: Floats) -> bool:
        """Return whether what would be published is finite; if not, say so."""
        if all(np.isfinite(value).all() for value in values):
            return True
        self.refuse(
            Reason.NO_MODEL,
            f'expected a finite error and deviation but {self.label} gives '
            f'{" and ".join(str(value) for value in values)}; train the model anew',
        )
        return False

    def _advance(self, vector: Floats, steps: int, heard: StreamSample) -> Floats:
        """Step the model, along a straight line over missing samples."""
        sensors, stamp = len(self.model.inputs), heard.sample.stamp
        interval = nanoseconds(self.model.interval)
        if steps > 1 and self._vector is not None:
            for number in range(1, steps):
                between = self._vector + (vector - self._vector) * (number / steps)
                self._recursion.step(between)
                at = stamp - (steps - number) * interval
                self.learning.step(between[:sensors], heard.spindle_speed, at, heard.drives)
        self.learning.step(vector[:sensors], heard.spindle_speed, stamp, heard.drives)
        return self._recursion.step(vector)

    def _history_is_known(self, stamp: Stamp) -> bool:
        """Say whether the history that the model rests on is known."""
        if self._unknown_since is not None:
            known_for = stamp - self._unknown_since
            if known_for < nanoseconds(self.config.settle_time):
                left = self.config.settle_time - known_for / SECOND
                self.refuse(
                    Reason.STATE_LOST,
                    f'history lost; valid again after {left:.0f} s or a new thermal reference',
                )
                return False
            self._unknown_since = None
        self.refuse(Reason.NONE, '')
        return True

    def _resume(self, stamp: Stamp) -> None:
        """Decide at the first sample, without a checkpoint, whether its history is known."""
        if self._stepped_at is not None or self._unknown_since is not None:
            return
        assert self._stream.reference is not None
        if stamp - self._stream.reference.stamp > nanoseconds(2.0 * self.model.interval):
            # The machine has been warming up unseen since its reference.
            self._unknown_since = stamp

    def _take_checkpoint(self, stamp: Stamp) -> None:
        """Go on from the state of an earlier life if it was one of this history."""
        saved, reference = self._stream.checkpoint, self._stream.reference
        if saved is None or reference is None or saved.reference_stamp != reference.stamp:
            return
        if not self._owns(saved) or saved.stamp >= stamp:
            return
        try:
            recursion, drive, blocks = self._parts(saved)
            self.learning.resume(saved.stamp, saved.last_rise, blocks)
            if 'remainder' in blocks:
                self.remainder.state = blocks['remainder']
            if self._watch is not None and 'watch' in blocks:
                self._watch.state = blocks['watch']
            newest = np.concatenate([saved.last_rise, drive])
            if len(saved.last_rise) != len(self.model.inputs) or not np.isfinite(newest).all():
                raise ValueError(f'last_rise: expected finite rises, but found {newest}')
            self._recursion.state = recursion
        except ValueError:
            # A damaged checkpoint is as good as none: the history is lost, which is said aloud.
            self.learning = ProbeLearning(self.model, self.config)
            self.learning.begin(reference.stamp, self._memory())
            self.remainder = Fade(np.zeros(len(self.model.channel)))
            self._watch = sensor_watch(self.model, self.config)
            self._source = None
            return
        self._stepped_at = self._predicted_at = saved.stamp
        self._vector = newest

    def _memory(self) -> ThermalPosterior | None:
        """Return what an earlier life has learnt of this model's rest."""
        memory = self._stream.memory
        return memory if memory is not None and self._owns(memory) else None

    def _owns(self, kept: PredictorState | ThermalPosterior) -> bool:
        """Return True if a checkpoint, or what was learnt, is of this model."""
        return kept.model_hash == self.hash and kept.input == self.model.inputs

    def _parts(self, checkpoint: PredictorState) -> tuple[Floats, Floats, dict[str, Floats]]:
        """Return the state of the recursion, the newest drivers and the blocks."""
        size = len(self._recursion.state)
        numbers, blocks = read_blocks(checkpoint.state, size + len(self.model.drivers))
        return numbers[:size], numbers[size:], blocks

    def _vector_of(self, heard: StreamSample) -> Floats | None:
        """Return what the model steps with, or None and set the reason."""
        rise = self._rise_of(heard.sample)
        if rise is None:
            return None
        if self.model.needs_speed and not np.isfinite(heard.spindle_speed):
            self.refuse(
                Reason.SENSOR_LOST,
                'the model reads the spindle speed but neither machine_state nor spindle_speed '
                f'has told one for more than gap_max = {self.config.gap_max:g} s',
            )
            return None
        lost = [name for name in self._drive_limits if name not in heard.drives]
        if lost:
            self.refuse(
                Reason.SENSOR_LOST,
                f'the model reads {", ".join(lost)}, which machine_state has not told for more '
                f'than {GAP_MAX:g} s',
            )
            return None
        # Whether such a speed is real or not, its heat in the state would outlast it by hours.
        speed = min(heard.spindle_speed, self._speed_limit)
        drives = {name: min(heard.drives[name], top) for name, top in self._drive_limits.items()}
        return np.concatenate([rise, self.model.drive(speed, drives)])

    @property
    def _speed_limit(self) -> float:
        """Largest spindle speed that is in domain [rad/s]."""
        return SPEED_MARGIN * self.model.speed_max

    @property
    def _drive_limits(self) -> dict[str, float]:
        """Largest of each drive that is in domain; as with the speed, in squares."""
        most = SPEED_MARGIN * SPEED_MARGIN
        return {name: most * largest for name, largest in self.model.drives_max.items()}

    def _outside(self, heard: StreamSample) -> str:
        """Say why the newest sample is out of domain, '' if it is not."""
        assert self._vector is not None
        distance = float(self.model.distance(self._vector[: len(self.model.inputs)]))
        if self._warm and not self.config.warm_reference:
            return (
                'rises are meant against a warm reference; set it anew while the machine is cold, '
                'or accept it with warm_reference'
            )
        if not distance <= DOMAIN_MARGIN:
            return (
                f'temperatures are {distance:.1f} times as far away as the training data reach, '
                f'where {DOMAIN_MARGIN:g} times is the most; train with such temperatures'
            )
        beyond = [name for name, top in self._drive_limits.items() if heard.drives[name] > top]
        if beyond:
            return (
                f'{", ".join(beyond)} beyond {SPEED_MARGIN * SPEED_MARGIN:.2g} times the largest '
                'trained; train with it, or see whether it is true'
            )
        if heard.spindle_speed > self._speed_limit:
            return (
                f'spindle speed {heard.spindle_speed:.4g} rad/s is beyond {SPEED_MARGIN:g} times '
                f'the largest trained, {self.model.speed_max:.4g} rad/s; train with it, or see '
                'whether it is true'
            )
        return ''

    def _rise_of(self, sample: Temperatures) -> Floats | None:
        """Return the rises of the model's inputs, or None and set the reason."""
        stream = self._stream
        if stream.reference is None:
            self.refuse(Reason.NO_REFERENCE, 'no thermal reference (topic thermal_reference)')
            return None
        if self._source is None or self._source.sensor != sample.sensor:
            try:
                self._source = RiseSource(
                    self.model, sample.sensor, stream.reference, stream.selection, self._watch
                )
            except ValueError as error:
                self._source = None
                self.refuse(Reason.NO_MODEL, str(error))
                return None
        rise = self._source.rise(sample.temperature, sample.status == Status.OK)
        if rise is None:
            lost = ', '.join(self._source.lost)
            self.refuse(Reason.SENSOR_LOST, f'no good reading of {lost} nor of any mate')
        return rise


def losses_of(model: ThermalModel) -> str:
    """Return where a model left more than no compensation on held-out samples, and how much."""
    return ', '.join(
        f'{channel} worse than without: {1e6 * left:.4g} µm of {1e6 * bare:.4g} µm'
        for channel, (left, bare) in model.losing.items()
    )


def sensor_watch(model: ThermalModel, config: ThermalPredictorConfig) -> SensorWatch | None:
    """Return the watch that a predictor keeps on a model's inputs; none for an old model file."""
    if model.watch is None:
        return None
    return SensorWatch(
        model.watch,
        limit=config.mate_limit,
        tolerance=config.mate_tolerance,
        persistence=config.mate_persistence,
    )

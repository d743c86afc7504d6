# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Inputs received by the predictor: samples for a new model, probed errors, spindle speed.

A probe counts as what the bare machine would have shown: where compensation was active, what the
machine applied at that moment is taken off again, and where that is not known to within the
probe's own noise the probe is refused.

The spindle speed may be told by two sources, one rule for predictors and recordings.  A
controller reports it in `machine_state`; a device beside the controller may report it on
`spindle_speed`.  A speed that is not finite, or whose status is not OK, is not known and leaves
the last one that was.
"""

from collections import deque
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from math import pi
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fuzzycnc_ros.components.thermal.control_drives import ControlDrives
from fuzzycnc_ros.components.thermal.kept_samples import KeptSamples
from fuzzycnc_ros.components.thermal.thermal_predictor_config import ThermalPredictorConfig
from fuzzycnc_ros.core.thermal.blank import blank_model
from fuzzycnc_ros.core.thermal.model import ThermalModel
from fuzzycnc_ros.core.thermal.places import (
    channel_spans,
    read_places,
    sloping_channels,
    told_of_channels,
)
from fuzzycnc_ros.core.thermal.run import DISPLACEMENT_MAX
from fuzzycnc_ros.runtime.component import Health, Level
from fuzzycnc_ros.runtime.enums import SpeedStatus
from fuzzycnc_ros.runtime.records import (
    SECOND,
    CompensationApplied,
    Displacement,
    Floats,
    MachineState,
    Names,
    PredictorState,
    Record,
    SensorSelection,
    SpindleSpeed,
    Stamp,
    Temperatures,
    ThermalPosterior,
    ThermalReference,
    nanoseconds,
)

STATE, OWN = 'machine_state', 'spindle_speed'
TOPICS: dict[str, type[Record]] = {STATE: MachineState, OWN: SpindleSpeed}
"""Topics that tell the speed; the first has precedence."""

LEAD_MAX = 60.0
"""Time [s] by which `spindle_speed` may be ahead of `machine_state` before that one counts as
silent: longer than the usual pause between two of its messages, short beside the time in which
a spindle warms up."""

HEALTH = 'speed source'
"""Name of the line of health; that of a topic is the host's."""

APART_SHARE, APART_LEAST = 0.1, 10.0
"""Difference between the two that is none: a share of the larger, and what stands for noise
[rad/s].  What is looked for is a wrong unit or ratio, not a slow filter."""


class SpeedReading(NamedTuple):
    """A speed that is known: its source, its stamp [ns] and its value [rad/s]."""

    source: str
    stamp: Stamp
    speed: float


def speed_told(topic: str, message: Any) -> float:
    """Return the speed [rad/s] that a record or message of a topic tells, NaN if none."""
    if topic == STATE:
        return float(message.spindle_speed)
    return float(message.speed) if message.status == SpeedStatus.OK else np.nan


class SpeedSources:
    """Newest spindle speed of each source, in the order of their stamps."""

    def __init__(self) -> None:
        self._told: dict[str, SpeedReading] = {}
        self._apart_since: Stamp | None = None
        self._apart = False

    def note(self, topic: str, stamp: Stamp, speed: float) -> None:
        """Take what a topic tells, as `speed_told` returns it."""
        if not np.isfinite(speed):
            return
        self._told[topic] = SpeedReading(topic, stamp, speed)
        self._compare(stamp)

    @property
    def newest(self) -> SpeedReading | None:
        """The speed that counts: that of `machine_state` unless it has been silent."""
        state, own = self._told.get(STATE), self._told.get(OWN)
        if state is None or own is None:
            return state or own
        return own if own.stamp - state.stamp > nanoseconds(LEAD_MAX) else state

    def health(self) -> Health:
        """Say which source is used, and whether the two contradict each other."""
        told = self.newest
        if told is None:
            return Health(HEALTH, Level.WARN, f'told neither by {STATE} nor by {OWN}')
        used = f'{_in_words(told.speed)} from {told.source}'
        if not self._apart:
            return Health(HEALTH, Level.OK, used)
        text = (
            f'{used}, but {OWN} tells {_in_words(self._told[OWN].speed)}; mend unit or scale of '
            'the wrong one, or take it out'
        )
        return Health(HEALTH, Level.WARN, text)

    def _compare(self, stamp: Stamp) -> None:
        """Note whether the sources have differed for longer than one may lag behind."""
        state, own = self._told.get(STATE), self._told.get(OWN)
        if state is None or own is None:
            return
        one, other = abs(state.speed), abs(own.speed)
        differ = abs(one - other) > max(APART_SHARE * max(one, other), APART_LEAST)
        if not differ or abs(state.stamp - own.stamp) > nanoseconds(LEAD_MAX):
            self._apart_since, self._apart = None, False
            return
        if self._apart_since is None:
            self._apart_since = stamp
        self._apart = stamp - self._apart_since >= nanoseconds(LEAD_MAX)


def speeds_at(
    stamps: NDArray[np.int64], told: Iterable[tuple[str, Stamp, float]]
) -> Floats | None:
    """Return the speed that a predictor would have known at each stamp.

    Parameters
    ----------
    stamps : ndarray of int, shape (n,)
        Machine times [ns], increasing.
    told : iterable of (topic, stamp, speed)
        What the topics told, in any order; see `speed_told`.

    Returns
    -------
    ndarray, shape (n,), or None
        Speed [rad/s], NaN before the first that is known; None if none ever is.
    """
    known = sorted((item for item in told if np.isfinite(item[2])), key=lambda item: item[1])
    if not known:
        return None
    sources, at, speeds = SpeedSources(), 0, np.full(len(stamps), np.nan)
    for row, stamp in enumerate(stamps):
        while at < len(known) and known[at][1] <= stamp:
            sources.note(*known[at])
            at += 1
        newest = sources.newest
        if newest is not None:
            speeds[row] = newest.speed
    return speeds


def _in_words(speed: float) -> str:
    return f'{speed:.4g} rad/s ({speed * 60.0 / (2.0 * pi):.0f} rpm)'


READ_BACK_AGE_MAX = 60.0
"""Age [s] beyond which two read-backs do not tell what was applied between them."""

SPACINGS = 5
"""Times between samples whose median is the interval where nothing else tells it."""

WAITING_MAX = 1000
"""Probes and read-backs that are kept for a sample that does not come."""


@dataclass(frozen=True, eq=False)
class ProbedError:
    """Probed error of the bare machine.

    Attributes
    ----------
    stamp : int
        When it was measured, machine time [ns].
    channel, axis : tuple of str
        Measuring channel and ISO 841 axis of each value.
    error : ndarray
        Thermal error [m]; NaN where nothing usable was measured.
    deviation : ndarray
        Standard deviation of each value [m].
    offset : ndarray
        Offset that was in force and is taken off the error [m].
    position : ndarray
        Where each value was measured [m]; NaN where that is not told.
    """

    stamp: Stamp
    channel: Names
    axis: Names
    error: Floats
    deviation: Floats
    offset: Floats
    position: Floats

    def of_channels(
        self, channel: Names, axis: Names, mean: Floats, deviation: Floats
    ) -> tuple[Floats, Floats, Floats]:
        """Return error, deviation and offset of a model's channels, NaN if it was not probed.

        A value belongs to the channel of its name; where the names differ, to the only channel of
        its axis.  Of an axis along which the error slopes, values at places tell of offset,
        slope and bend together.

        Parameters
        ----------
        channel, axis : tuple of str, length c
            The channels and their axes.
        mean, deviation : ndarray, shape (c,)
            What is expected of them, and how well [m].
        """
        found = np.full((3, len(channel)), np.nan)
        along: set[str] = set()
        for item in channel_spans(channel):
            if set(item.span.channels[1:]) & set(self.channel):
                continue
            along.add(item.span.axis)
            at = np.array([name == item.span.axis for name in self.axis]) & np.isfinite(self.error)
            columns = list(item.columns)
            if at.any():
                found[:, columns] = told_of_channels(
                    item.span.shares(self.position[at]),
                    self.error[at],
                    self.deviation[at],
                    self.offset[at],
                    mean[columns],
                    deviation[columns],
                )
        rows = zip(self.channel, self.axis, self.error, self.deviation, self.offset, strict=True)
        taken: dict[int, list[Floats]] = {}
        for name, moved, *values in rows:
            if moved in along:
                continue
            if name in channel:
                column = channel.index(name)
            elif axis.count(moved) == 1 and channel[axis.index(moved)] not in self.channel:
                column = axis.index(moved)
            else:
                continue
            taken.setdefault(column, []).append(np.array(values))
        for column, told in taken.items():
            # Several places of an axis of which one error is expected tell their mean.
            known = [item for item in told if np.isfinite(item[0])] or told[:1]
            found[:, column] = sum(known[1:], known[0]) / len(known)
        return found[0], found[1], found[2]


class ProbeSource:
    """Collect probes and read-backs between two samples.

    Parameters
    ----------
    config : ThermalPredictorConfig
        Least interval and least noise of probes.
    """

    def __init__(self, config: ThermalPredictorConfig) -> None:
        self._interval = nanoseconds(config.probe_interval_min)
        self._noise = config.probe_noise
        self._waiting: deque[Displacement] = deque(maxlen=WAITING_MAX)
        self._applied: deque[CompensationApplied] = deque(maxlen=WAITING_MAX)
        self._used_at: dict[str, Stamp] = {}
        self.trouble = ''
        """Why the newest refused probe was refused; empty once another one is usable."""

    def add(self, probe: Displacement) -> None:
        """Take a measured displacement."""
        self._waiting.append(probe)

    def add_read_back(self, applied: CompensationApplied) -> None:
        """Take what the machine applies."""
        self._applied.append(applied)

    def take(self, stamp: Stamp, since: Stamp) -> tuple[ProbedError, ...]:
        """Return the usable probes up to the sample of `stamp`, oldest first.

        Parameters
        ----------
        stamp : int
            Stamp of the sample [ns].
        since : int
            Thermal reference [ns]; a displacement from before it is meant against another zero.
        """
        usable = [self._probe(item) for item in self._waiting if since < item.stamp <= stamp]
        self._waiting.clear()
        while len(self._applied) > 1 and self._applied[1].stamp <= stamp:
            self._applied.popleft()
        return tuple(probe for probe in usable if probe is not None)

    def _probe(self, record: Displacement) -> ProbedError | None:
        """Return what a record says of the bare machine, None if nothing."""
        due = [
            record.stamp - self._used_at.get(name, -self._interval) >= self._interval
            for name in record.channel
        ]
        # A value that may be off by more than any error can be says nothing.
        vague = record.standard_deviation > DISPLACEMENT_MAX
        usable = np.isfinite(record.displacement) & np.array(due, dtype=np.bool_) & ~vague
        if not usable.any():
            return None
        error = np.where(usable, record.displacement, np.nan)
        offset = np.zeros_like(error)
        if record.includes_compensation:
            try:
                offset = self._offsets(record)
                error = error - offset
            except ValueError as refusal:
                self.trouble = f'probe at {record.stamp / SECOND:.3f} s refused: {refusal}'
                return None
        usable = np.isfinite(error)
        if not usable.any():
            self.trouble = (
                f'probe at {record.stamp / SECOND:.3f} s refused: expected a read-back of finite '
                'offsets (compensation_applied) but found none; see the bridge of the machine'
            )
            return None
        if np.nanmax(np.abs(error)) > DISPLACEMENT_MAX:
            self.trouble = (
                f'probe at {record.stamp / SECOND:.3f} s refused: expected errors within '
                f'{1e6 * DISPLACEMENT_MAX:g} µm but found {1e6 * np.nanmax(np.abs(error)):g} µm; '
                'are displacements in m?'
            )
            return None
        for name in np.array(record.channel)[usable]:
            self._used_at[str(name)] = record.stamp
        self.trouble = ''
        # A probe of unknown deviation gets the least one.
        deviation = np.fmax(record.standard_deviation, self._noise)
        return ProbedError(
            record.stamp, record.channel, record.axis, error, deviation, offset, record.position
        )

    def _offsets(self, record: Displacement) -> Floats:
        """Return what was applied at the time of a probe, per value [m].

        Raises
        ------
        ValueError
            If it is not known to within the noise of a probe.
        """
        before = [item for item in self._applied if item.stamp <= record.stamp][-1:]
        after = [item for item in self._applied if item.stamp >= record.stamp][:1]
        if not before or not after:
            raise ValueError(
                'compensation was active but no read-back (compensation_applied) tells how much '
                'before and after it; probe with compensation inactive, or publish the read-back'
            )
        span = after[0].stamp - before[0].stamp
        if span > nanoseconds(READ_BACK_AGE_MAX):
            raise ValueError(
                f'compensation was active but read-backs are {span / SECOND:g} s apart, more than '
                f'{READ_BACK_AGE_MAX:g} s; publish compensation_applied more often'
            )
        share = (record.stamp - before[0].stamp) / span if span else 0.0
        offsets = []
        for axis, place in zip(record.axis, record.position.tolist(), strict=True):
            first, second = (item.offset_at(axis, place) for item in (before[0], after[0]))
            if abs(second - first) > self._noise:
                raise ValueError(
                    f'compensation of {axis} moved by {1e6 * abs(second - first):.1f} µm between '
                    'two read-backs; probe while it is at rest'
                )
            offsets.append(first + share * (second - first))
        return np.array(offsets)


@dataclass(frozen=True, eq=False)
class StreamSample:
    """A sample with what else the stream said up to it.

    Attributes
    ----------
    sample : Temperatures
        Temperatures of all sensors.
    spindle_speed : float
        Size of the spindle speed [rad/s]; NaN if it is not known.
    probes : tuple of ProbedError
        Probes since the sample before.
    drives : mapping of str to float
        What else the control told of heat, its means since the sample before; see `ThermalRun`.
    """

    sample: Temperatures
    spindle_speed: float = np.nan
    probes: tuple[ProbedError, ...] = ()
    drives: Mapping[str, float] = field(default_factory=dict)


class PredictorStream:
    """All that the models of a predictor rest on, held once: zero, checkpoint, samples, probes.

    Its attributes are read by others, and set by its own methods alone.

    Parameters
    ----------
    config : ThermalPredictorConfig
        Parameters of the predictor.

    Attributes
    ----------
    config : ThermalPredictorConfig
        Parameters, as they are now.
    reference : ThermalReference or None
        What rises are meant against.
    checkpoint : PredictorState or None
        Newest state, of an earlier life at first.
    memory : ThermalPosterior or None
        What was learnt of the machine, by an earlier life at first.
    selection : SensorSelection or None
        Newest selection; it names substitutes.
    awaited : str
        What is missing to learn from nothing.
    speeds : SpeedSources
        What was told of the spindle.
    drives : ControlDrives
        What else the control told.
    probes : ProbeSource or None
        Probes that wait for a sample; None where they have no effect.
    """

    def __init__(self, config: ThermalPredictorConfig) -> None:
        self.config = config
        self.reference: ThermalReference | None = None
        self.checkpoint: PredictorState | None = None
        self.memory: ThermalPosterior | None = None
        self.selection: SensorSelection | None = None
        self.awaited = 'waiting for temperatures'
        self.speeds, self.drives = SpeedSources(), ControlDrives()
        self.probes = ProbeSource(config) if config.learn else None
        self._heard = KeptSamples[StreamSample](lambda heard: heard.sample)
        self._former: ThermalReference | None = None
        """Reference of the checkpoint of before a step of the clock."""

    def reconfigure(self, config: ThermalPredictorConfig) -> None:
        """Take live parameters."""
        self.config = config

    def select(self, selection: SensorSelection) -> None:
        """Take another selection."""
        self.selection = selection

    def keep(self, record: PredictorState | ThermalPosterior) -> None:
        """Keep the newest state, or what was learnt."""
        if isinstance(record, PredictorState):
            self.checkpoint = record
        else:
            self.memory = record

    def begin(self, reference: ThermalReference) -> bool:
        """Take a thermal reference; return whether it is a new one.

        One that was told before a step of the clock comes anew with another stamp: what is kept
        goes on with it.
        """
        known, former = self.reference, self._former
        if known is not None and known.stamp == reference.stamp:
            return False
        if former is not None and _same(former, reference):
            for kept in (self.checkpoint, self.memory):
                if kept is not None and kept.reference_stamp == former.stamp:
                    self.keep(replace(kept, reference_stamp=reference.stamp))
        self.reference, self._former = reference, None
        return True

    def renewed(self, step: int) -> 'PredictorStream':
        """Return a stream after a step of the clock [ns]: all but reference, samples, probes."""
        fresh = PredictorStream(self.config)
        fresh.selection, fresh._former = self.selection, self.reference
        for kept in (self.checkpoint, self.memory):
            if kept is not None:
                fresh.keep(replace(kept, stamp=max(0, kept.stamp + step)))
        return fresh

    def hear(self, sample: Temperatures) -> StreamSample:
        """Return a sample with what else is known of its time; keep it as long as it matters.

        That is `settle_time`, for a model that is to begin then.  A speed that has been unknown
        for longer than `gap_max` is none.
        """
        stamp, told = sample.stamp, self.speeds.newest
        known = told is not None and stamp - told.stamp <= nanoseconds(self.config.gap_max)
        since = self.reference.stamp if self.reference is not None else stamp
        heard = StreamSample(
            sample,
            abs(told.speed) if told is not None and known else np.nan,
            self.probes.take(stamp, since) if self.probes is not None else (),
            self.drives.take(stamp),
        )
        self._heard.add(heard)
        # One sample from before that time proves that the history is long enough.
        self._heard.drop_before(stamp - nanoseconds(self.config.settle_time))
        return heard

    def since(self, stamp: Stamp) -> Iterator[StreamSample]:
        """Yield the samples after a stamp [ns], oldest first."""
        kept, newest = list(self._heard), self._heard.newest
        if newest is not None and newest is not kept[-1]:
            kept.append(newest)
        return (item for item in kept if item.sample.stamp > stamp)

    def from_nothing(self) -> ThermalModel | None:
        """Return the model that predicts nothing of this stream; None while that is unknown.

        It has the sensors and interval of what an earlier life has learnt from nothing, else all
        sensors that have a reference, or those that a selection has chosen.
        """
        memory = self.memory
        if memory is not None:
            known = blank_model(memory.input, memory.channel, memory.interval)
            if known.hash == memory.model_hash:
                return known
        stamps = [item.sample.stamp for item in self._heard][-SPACINGS - 1 :]
        if self.reference is None or self.newest is None or len(stamps) <= SPACINGS:
            self.awaited = (
                f'learning from nothing: {len(stamps)} of {SPACINGS + 1} samples'
                if self.reference is not None
                else 'no thermal reference (topic thermal_reference)'
            )
            return None
        spacing = sorted(np.diff(stamps).tolist())[SPACINGS // 2]
        wanted = self.newest.sample.sensor
        if self.selection is not None:
            chosen = {item.chosen for item in self.selection.cluster}
            wanted = tuple(name for name in wanted if name in chosen) or wanted
        zero = dict(zip(self.reference.sensor, self.reference.temperature.tolist(), strict=True))
        inputs = [name for name in wanted if np.isfinite(zero.get(name, np.nan))]
        try:
            interval = round(spacing / SECOND, 3)
            axes = self.config.learn_axes
            spans = read_places(self.config.learn_places, axes, 'learn_places')
            model = blank_model(inputs, sloping_channels(axes, spans), interval)
            model.learner()  # it refuses more inputs than can be learnt from
            return model
        except ValueError as error:
            self.awaited = f'learning from nothing: {error}'
            return None

    @property
    def newest(self) -> StreamSample | None:
        """The newest sample."""
        return self._heard.newest


def _same(one: ThermalReference, other: ThermalReference) -> bool:
    """Return True if two references are one, with stamps of two series."""
    return one.sensor == other.sensor and np.array_equal(
        one.temperature, other.temperature, equal_nan=True
    )

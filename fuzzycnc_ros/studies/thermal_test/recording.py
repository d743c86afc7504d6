# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Recording of a thermal test: displacements, offsets, temperatures, speed, marks."""

import json
import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fuzzycnc_ros.bags.errors import RunError
from fuzzycnc_ros.bags.reader import BagReader
from fuzzycnc_ros.bags.runs import (
    DISPLACEMENT_TYPE,
    TEMPERATURES_TYPE,
    Displacements,
    SampleCollector,
    TopicSeries,
    find_topic,
    speed_topics,
)
from fuzzycnc_ros.components.thermal.predictor_stream import speed_told, speeds_at
from fuzzycnc_ros.core.names import visible
from fuzzycnc_ros.runtime.convert import stamp_of
from fuzzycnc_ros.runtime.host import NodeEvent
from fuzzycnc_ros.runtime.records import SECOND, CompensationApplied
from fuzzycnc_ros.studies.page.recorded import recorded_zone

Floats = NDArray[np.float64]

MARK = 'mark'
"""Name of the event by which a person says that a phase begins."""

HELD_SHARE = 2.5
"""Validity of an offset when no read-back follows, in usual spacings of the read-backs."""


class PhaseMark(NamedTuple):
    """Entry by a person: its time [s], the phase that begins, and the author."""

    time: float
    phase: str
    by: str


class TimeSeries(NamedTuple):
    """Values over time [s], one column for each name."""

    time: Floats
    names: tuple[str, ...]
    values: Floats


@dataclass(frozen=True, eq=False)
class TestRecording:
    """A recording of a thermal test; time counts from its first displacement.

    Parameters
    ----------
    name, machine : str
        Name of the bag, and namespace of the machine; empty if it has none.
    start : int
        Stamp of the first displacement [ns].
    time : ndarray, shape (n,)
        When displacements were measured [s], increasing.
    channel, axis : tuple of str, length c
        Channels, and where each points.
    position : ndarray, shape (c,)
        Where on its axis each channel is measured [m]; NaN where that is not told.
    measured : ndarray, shape (n, c)
        Displacements [m]; NaN where one was not measured.
    deviation : ndarray, shape (n, c)
        Standard deviation of each [m]; NaN where the bag has none.
    includes : ndarray of bool, shape (n,)
        Whether compensation was in force in them.
    offset : ndarray, shape (n, c), or None
        Offset in force along the axis of each channel [m], NaN where it is not known; None if the
        bag holds no read-back.
    temperatures : TimeSeries or None
        Temperatures [degC]; NaN where a reading is not good.
    speed : ndarray, shape (n,), or None
        Spindle speed [rad/s], NaN where no topic told one; None if none ever did.
    marks : tuple of Mark
        What people marked, in order.
    zone : str
        Zone of its clock, where the bag says it.
    """

    __test__ = False  # no test, whatever pytest makes of the name

    name: str
    machine: str
    start: int
    time: Floats
    channel: tuple[str, ...]
    axis: tuple[str, ...]
    position: Floats
    measured: Floats
    deviation: Floats
    includes: NDArray[np.bool_]
    offset: Floats | None
    temperatures: TimeSeries | None
    speed: Floats | None
    marks: tuple[PhaseMark, ...]
    zone: str = ''

    @property
    def spacing(self) -> float:
        """Usual time between two displacements [s]; NaN of one alone."""
        return float(np.median(np.diff(self.time))) if len(self.time) > 1 else float('nan')

    @property
    def bare(self) -> Floats:
        """Displacements without compensation, shape (n, c) [m]; NaN where they are not known.

        A displacement that includes compensation is the error of the machine plus the offset.
        """
        offset = np.nan if self.offset is None else self.offset
        return np.where(self.includes[:, np.newaxis], self.measured - offset, self.measured)

    @property
    def compensated(self) -> Floats:
        """Displacements with compensation, shape (n, c) [m]; NaN where they are not known."""
        offset = np.nan if self.offset is None else self.offset
        return np.where(self.includes[:, np.newaxis], self.measured, self.measured + offset)


def read_test(path: str | os.PathLike[str], machine: str | None = None) -> TestRecording:
    """Read a thermal test out of a bag.

    Parameters
    ----------
    path : path
        The bag.
    machine : str, optional
        Namespace of the machine, where the bag holds several.

    Raises
    ------
    BagTopicError
        If the bag has no displacements, or those of several machines and none is named.
    RunError
        If none of them is a number, names change within the bag, stamps do not increase, or a
        mark cannot be read.
    BagError
        If the bag cannot be read.
    """
    source = Path(path)
    with BagReader(source) as reader:
        zone = recorded_zone(reader)
        moved_topic = find_topic(reader, 'displacement', DISPLACEMENT_TYPE, machine)
        space = moved_topic.rpartition('/')[0]
        moved = Displacements(source, moved_topic)
        deviation = Displacements(source, moved_topic)
        applied_topic = _found(reader, f'{space}/compensation_applied', CompensationApplied.TYPE)
        applied, slope, place = (
            SampleCollector(source, applied_topic, ('axis',), 'axis') for _ in '123'
        )
        warm_topic = _found(reader, f'{space}/temperatures', TEMPERATURES_TYPE)
        warm = SampleCollector(source, warm_topic, ('sensor',), 'sensor')
        event_topic = _found(reader, f'{space}/node_event', NodeEvent.TYPE)
        speeds = speed_topics(reader, space)
        includes: list[bool] = []
        told: list[tuple[str, int, float]] = []
        marks: list[tuple[int, str, str]] = []
        wanted = [moved_topic, *speeds]
        wanted += [name for name in (applied_topic, warm_topic, event_topic) if name]
        for topic, _, _, message in reader.messages(wanted):  # one pass
            stamp = stamp_of(message.header.stamp)
            if topic == moved_topic:
                moved.take(message)
                deviation.take(message, message.standard_deviation)
                includes.append(bool(message.includes_compensation))
            elif topic == applied_topic:
                applied.add(message, message.offset)
                slope.add(message, message.slope)
                place.add(message, message.position)
            elif topic == warm_topic:
                warm.add(message, message.temperature, message.status == 0)
            elif topic == event_topic:
                if message.name == MARK:
                    marks.append((stamp, *_mark(source, stamp, message.request)))
            else:
                told.append((speeds[topic], stamp, speed_told(speeds[topic], message)))
    series = moved.series()
    if not np.isfinite(series.values).any():
        raise RunError(
            f'{source}: {moved_topic}: expected displacements but all '
            f'{len(series.stamp)} samples are NaN; look whether the probes are connected'
        )
    start = int(series.stamp[0])
    axis, channel = series.names
    return TestRecording(
        name=source.name,
        machine=space.strip('/'),
        start=start,
        time=_since(start, series.stamp),
        channel=channel,
        axis=axis,
        position=moved.position,
        measured=series.values,
        deviation=deviation.series().values,
        includes=np.array(includes),
        offset=_offsets(
            series.stamp,
            axis,
            moved.position,
            *(item.series() for item in (applied, slope, place)),
        )
        if applied_topic
        else None,
        temperatures=_course(start, warm.series()) if warm_topic else None,
        speed=_speeds(series.stamp, told),
        # Each part of a bag begins with the newest events, which so come again.
        marks=tuple(PhaseMark((at - start) / SECOND, *said) for at, *said in sorted(set(marks))),
        zone=zone,
    )


def _speeds(stamps: NDArray[np.int64], told: Sequence[tuple[str, int, float]]) -> Floats | None:
    """Return the speed at each stamp (n,), unknown while the newest of every topic is none.

    A predictor goes on with the last speed that it knew; a report must not make one up.
    """
    speed = speeds_at(stamps, told)
    if speed is None:
        return None
    known = np.zeros(len(stamps), dtype=bool)
    for topic in {name for name, _, _ in told}:
        own = sorted(item[1:] for item in told if item[0] == topic)
        at, values = np.array([stamp for stamp, _ in own]), np.array([one for _, one in own])
        row = np.searchsorted(at, stamps, side='right') - 1
        known |= (row >= 0) & np.isfinite(values[np.maximum(row, 0)])
    return np.where(known, speed, np.nan)


def _found(reader: BagReader, topic: str, type_name: str) -> str:
    """Return a topic if the bag has messages of it, else nothing."""
    connection = reader.connections.get(topic)
    there = connection is not None and connection.message_count and connection.type == type_name
    return topic if there else ''


def _mark(source: Path, stamp: int, request: str) -> tuple[str, str]:
    """Return the phase of a mark, and who made it."""
    try:
        document = json.loads(request)
        return visible(str(document['phase'])), visible(str(document.get('by', '')))
    except (ValueError, TypeError, KeyError, AttributeError) as error:
        raise RunError(
            f'{source}: mark at stamp {stamp / SECOND:.9g} s: expected a phase as '
            f'`fuzzycnc operate mark` writes it but found {request!r}; name the phases by --phase'
        ) from error


def _offsets(
    stamp: NDArray[np.int64],
    axis: tuple[str, ...],
    position: Floats,
    applied: TopicSeries,
    slope: TopicSeries,
    place: TopicSeries,
) -> Floats:
    """Return the newest offset in force at each stamp, NaN where it is too old or not told.

    It is that at the position (c,) of each column, where both that and the axis' own are told.
    """
    usual = np.median(np.diff(applied.stamp)) if len(applied.stamp) > 1 else np.inf
    row = np.searchsorted(applied.stamp, stamp, side='right') - 1
    fresh = (row >= 0) & (stamp - applied.stamp[np.maximum(row, 0)] <= HELD_SHARE * usual)
    (names,) = applied.names
    column = np.array([names.index(name) if name in names else -1 for name in axis])
    pick = np.ix_(np.maximum(row, 0), column)
    told, steep, where = (
        np.column_stack([item.values, np.full(len(item.values), np.nan)])[pick]
        for item in (applied, slope, place)
    )
    told = told + np.nan_to_num(steep * (position - where))
    return np.where(fresh[:, np.newaxis], told, np.nan)


def _course(start: int, series: TopicSeries) -> TimeSeries:
    return TimeSeries(_since(start, series.stamp), series.names[0], series.values)


def _since(start: int, stamp: NDArray[np.int64]) -> Floats:
    """Return stamps in seconds since a start."""
    return (stamp - start) / SECOND

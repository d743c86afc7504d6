# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Scheduling of part programs: a feed for each block, and the time that it all takes."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, fields, replace
from math import inf, isfinite, nan, sqrt
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fuzzycnc_ros.core import portable
from fuzzycnc_ros.core.arrays import Array
from fuzzycnc_ros.core.feedrate.gcode.blocks import Block, Program, Role
from fuzzycnc_ros.core.feedrate.gcode.segments import (
    DwellSegment,
    LineSegment,
    NurbsSegment,
    Segment,
)
from fuzzycnc_ros.core.feedrate.motion.limits import MotionLimits
from fuzzycnc_ros.core.feedrate.motion.stream import MotionPart, MotionStream
from fuzzycnc_ros.core.feedrate.path.nodes import own_curvature, with_ramps
from fuzzycnc_ros.core.feedrate.path.path_geometry import PathGeometry
from fuzzycnc_ros.core.feedrate.path.reference_path import ReferencePath
from fuzzycnc_ros.core.feedrate.path.sampled_path import SampledPath
from fuzzycnc_ros.core.feedrate.schedule.program_run import (
    BlockReader,
    Observer,
    ProgramRun,
    ScheduledPath,
)
from fuzzycnc_ros.core.feedrate.schedule.program_settings import AXIS_COUNT, ProgramSettings
from fuzzycnc_ros.core.feedrate.schedule.tolerance_feed import APPROACH

_GATHERED = 4096
"""Pieces, or motions that are not scheduled, that are gathered: each call of numpy costs time."""

_STRAIGHT = 1e-6
"""Turn of a piece up to which it is straight [rad]; rounding of doubles stays below."""


class _ProgramMotion:
    """Time of the motion along paths that arrive in parts, at rest before and after each run.

    Parameters
    ----------
    settings : ProgramSettings
        Limits, rest at stops and the machine constant.

    Attributes
    ----------
    duration : float
        Time of what is over [s]; all of it after `finish`.
    acceleration : float
        Largest acceleration across the path, curvature times squared speed, with what braking
        before a bend adds and speeding up out of it takes away [m/s^2].  The contour error is no
        more than the machine constant times this: in bends that are over before the axes react
        less.
    """

    def __init__(self, settings: ProgramSettings) -> None:
        self._settings = settings
        velocity, rise, _ = settings.limits.table(AXIS_COUNT)
        self._speed_max = min(float(velocity[0]), portable.norm(velocity[1:]))
        self._ramp = float(rise.min())
        self._stream: MotionStream | None = None
        self._running = 0.0  # time of the stream
        self._place = 0.0
        self._kept: list[tuple[ReferencePath, Array]] = []
        self._pieces = 0
        self.duration = 0.0
        self.acceleration = 0.0

    def push(self, path: ReferencePath, speed: Array) -> None:
        """Take the next part, with the speeds wanted at both ends of its pieces, (m, 2) [m/s]."""
        speed = np.minimum(speed, self._speed_max)
        self.duration += self._settings.settle * int(path.stop[1:].sum())
        if not self._settings.limits.limits_jerk:
            path, speed = self._without_lines(path, speed)
            if not len(speed):
                return
        self._kept.append((path, speed))
        self._pieces += len(speed)
        if self._pieces >= _GATHERED:
            self._drive()

    def push_lines(self, way: Array, speed: Array) -> None:
        """Take lines from rest to rest, ways (k, 3) [m] and speeds wanted (k,) [m/s]."""
        time = straight_time(way, np.minimum(speed, self._speed_max), self._settings.limits)
        self.duration += self._settings.settle * len(way) + float(time.sum())

    def finish(self) -> None:
        """Come to rest."""
        self._drive()
        if self._stream is not None:
            self._take(self._stream.finish())
            self.duration += self._running + self._stream.window
            self._stream = None

    def _without_lines(self, path: ReferencePath, speed: Array) -> tuple[ReferencePath, Array]:
        """Count lines of one feed between stops, whose times are a formula; return the rest."""
        geometry = path.geometry
        fence = np.flatnonzero(path.stop)
        if len(fence) < 2:
            return path, speed
        first, last = fence[:-1], fence[1:] - 1
        turn = own_curvature(geometry).max(axis=1) * np.diff(geometry.node)
        ends = np.append(first, fence[-1])  # the last one only closes the span before it
        bent, low, high = (
            choose.reduceat(np.append(values, values[-1:]), ends)[:-1]
            for choose, values in (
                (np.maximum, turn),
                (np.minimum, speed.min(axis=1)),
                (np.maximum, speed.max(axis=1)),
            )
        )
        alone = (bent < _STRAIGHT) & (low == high)
        if alone.any():
            way = geometry.coefficient[last[alone], -1] - geometry.coefficient[first[alone], 0]
            time = straight_time(way, low[alone], self._settings.limits)
            self.duration += float(time.sum())
        rest = np.ones(len(speed), bool)
        rest[first[0] : fence[-1]] = ~np.repeat(alone, fence[1:] - fence[:-1])
        if not rest.any():
            return path, speed[:0]
        return _chosen(path, rest), speed[rest]

    def _drive(self) -> None:
        if not self._kept:
            return
        path, speed = _joined(self._kept, self._place)
        self._kept, self._pieces = [], 0
        self._place += path.geometry.length
        if self._stream is None:
            self._stream = MotionStream(
                self._settings.limits,
                AXIS_COUNT,
                feed_max=self._speed_max,
                window=self._settings.window,
            )
        self._take(self._stream.push(*with_ramps(path, speed, self._ramp)))

    def _take(self, parts: list[MotionPart]) -> None:
        for part in parts:
            self._running = float(part.time[-1])
            node = part.place + part.geometry.node
            moving = np.append(np.diff(part.arc_length) > 0.0, True)
            square = np.interp(
                node, part.arc_length[moving], part.speed[moving] * part.speed[moving]
            )
            speed = np.sqrt(square)
            bend = own_curvature(part.geometry)
            across = square * self._approach(node, speed)
            most = self._turned(speed)
            for column, nodes in ((0, slice(None, -1)), (1, slice(1, None))):
                sharp = np.minimum(bend[:, column] * across[nodes], most[nodes])
                self.acceleration = max(self.acceleration, float(sharp.max()))

    def _turned(self, speed: Array) -> Array:
        """Return the acceleration whose error no bend exceeds, however sharp it is [m/s^2].

        Where the path turns back on the spot, axes with a position gain Kv stay v/Kv behind;
        C is about 1/(2 Kv^2).
        """
        return np.asarray(speed * sqrt(2.0 / self._settings.machine_constant))

    def _approach(self, node: Array, speed: Array) -> Array:
        """Return what the approach to each node adds to its contour error, as a factor."""
        behind = node - APPROACH * sqrt(self._settings.machine_constant) * speed
        before = np.interp(behind, node, speed)
        moving = speed > 0.0
        return np.where(moving, 0.5 + 0.5 * before / np.where(moving, speed, 1.0), 1.0)


def rest_to_rest(way: ArrayLike, limits: MotionLimits) -> Array:
    """Return the least times of straight rapids from rest to rest within the limits of the axes.

    Parameters
    ----------
    way : array_like, shape (k, 3)
        From start to end of each [m].
    limits : MotionLimits
        Those of the axes count; of a quantity that has none of these, that of the path.

    Returns
    -------
    ndarray, shape (k,)
        Times [s]; 0 for no way, NaN if an end is unknown.

    Examples
    --------
    >>> limits = MotionLimits(velocity=(0.25, 0.25, 0.1), acceleration=(4.0, 4.0, 2.0))
    >>> rest_to_rest([[0.3, 0.0, -0.1], [0.0, 0.0, 0.0]], limits).tolist()
    [1.2625, 0.0]
    """
    way = np.asarray(way, dtype=float)
    time: Array = np.linalg.norm(way, axis=1)
    moves = np.isfinite(time) & (time > 0.0)
    own: dict[str, Any] = {
        f'path_{name}': np.inf
        for name in ('velocity', 'acceleration', 'jerk')
        if np.isfinite(getattr(limits, name) or (np.inf,)).all()
    }
    free = np.full(int(moves.sum()), np.inf)
    time[moves] = straight_time(way[moves], free, replace(limits, **own))
    return time


def straight_time(way: Array, speed: Array, limits: MotionLimits) -> Array:
    """Return the least times of straight ways from rest to rest.

    Parameters
    ----------
    way : ndarray, shape (k, d)
        From start to end [m], not zero.
    speed : ndarray, shape (k,)
        Largest speeds [m/s]; infinite for those of the limits.
    limits : MotionLimits
        Kept by the path and by every axis, jerk included.

    Returns
    -------
    ndarray, shape (k,)
        Times [s].
    """
    length = np.linalg.norm(way, axis=1)
    share = np.column_stack([np.ones(len(way)), np.abs(way) / length[:, np.newaxis]])
    with np.errstate(divide='ignore'):
        velocity, rise, jolt = ((row / share).min(axis=1) for row in limits.table(way.shape[1]))
    top = np.minimum(speed, velocity)
    build = rise / jolt  # time in which acceleration is there; 0 without a limit of jerk
    with np.errstate(invalid='ignore'):
        # To full speed and back to rest, in units of the mean speed
        ramp = np.where(top < rise * build, 2.0 * np.sqrt(top / jolt), top / rise + build)
        short = np.where(
            length >= 2.0 * rise * (build * build),
            build + np.sqrt(build * build + 4.0 * length / rise),
            4.0 * portable.cube_root(0.5 * length / jolt),
        )
    return np.asarray(np.where(length >= top * ramp, length / top + ramp, short))


def _chosen(path: ReferencePath, pieces: NDArray[np.bool_]) -> ReferencePath:
    """Return a path without some pieces that lie between stops; arc length closes up."""
    if pieces.all():
        return path
    length = np.diff(path.geometry.node)[pieces]
    nodes = np.append(pieces, False)
    last = int(np.flatnonzero(pieces)[-1]) + 1
    nodes[last] = True
    nodes[last + 1 :] = False
    # Where pieces are left out, the node before them is the same stop as the one behind.
    stop = path.stop[nodes]
    inner = stop.copy()
    inner[[0, -1]] = False
    return ReferencePath(
        PathGeometry(path.geometry.coefficient[pieces], np.append(0.0, np.cumsum(length)), inner),
        0.0,
        path.curvature[nodes],
        path.owner[pieces],
        path.blend[pieces],
        path.feed[pieces],
        stop,
        path.rest[nodes],
    )


def _joined(parts: list[tuple[ReferencePath, Array]], place: float) -> tuple[ReferencePath, Array]:
    """Return parts as one path from an arc length on; runs are put end to end."""
    paths = [path for path, _ in parts]
    length = np.concatenate([np.diff(path.geometry.node) for path in paths])

    def nodes(name: str) -> Any:
        first = [getattr(paths[0], name)[:1]]
        return np.concatenate(first + [getattr(path, name)[1:] for path in paths])

    def pieces(name: str) -> Any:
        return np.concatenate([getattr(path, name) for path in paths])

    stop = nodes('stop')
    inner = stop.copy()
    inner[[0, -1]] = False
    geometry = PathGeometry(
        np.concatenate([path.geometry.coefficient for path in paths]),
        np.append(0.0, np.cumsum(length)),
        inner,
    )
    return ReferencePath(
        geometry,
        place,
        nodes('curvature'),
        pieces('owner'),
        pieces('blend'),
        pieces('feed'),
        stop,
        nodes('rest'),
    ), np.concatenate([speed for _, speed in parts])


@dataclass
class ProgramTimes:
    """Duration of a program within the limits, once all of it has been scheduled.

    Attributes
    ----------
    duration, programmed : float
        All that has a known time, with the chosen feeds and with those of the program [s].
    error, programmed_error : float
        Bound of the contour error where feeds are chosen [m]: machine constant times the
        largest acceleration across the path that the feed words ask for, those of corners that
        are rounded included.  In bends shorter than the axes react it is far above the error.
        At exact stops the error depends on acceleration and rest, not on the feed, and is left
        out.
    length : float
        Way of the blocks whose feeds are chosen [m].
    rapid, dwell, kept : float
        Rapids, waits, and blocks that keep their feed: parts of both times [s].
    blocks, chosen, curves, stops, untimed : int
        Lines; blocks whose feeds are chosen, and NURBS curves among them; exact stops at their
        ends; motions, cycles and calls of unknown time, which are in neither time.
    """

    duration: float = 0.0
    programmed: float = 0.0
    error: float = 0.0
    programmed_error: float = 0.0
    length: float = 0.0
    rapid: float = 0.0
    dwell: float = 0.0
    kept: float = 0.0
    blocks: int = 0
    chosen: int = 0
    curves: int = 0
    stops: int = 0
    untimed: int = 0

    def add_fixed(self, kind: str, time: float) -> None:
        """Count a motion or a wait that no schedule changes [s]; NaN is an unknown time."""
        if not isfinite(time):
            self.untimed += 1
            return
        setattr(self, kind, getattr(self, kind) + time)
        self.duration += time
        self.programmed += time

    def document(self) -> dict[str, float]:
        """Return all figures by name."""
        return {item.name: getattr(self, item.name) for item in fields(self)}


class _FixedMotions:
    """Counts rapids, waits and blocks that keep their feed, many at once.

    One way takes numpy as long as hundreds do, and some programs are rapids for the most part.
    """

    def __init__(self, settings: ProgramSettings, times: ProgramTimes) -> None:
        self._settings = settings
        self._times = times
        self._gathered: list[tuple[Segment, float | None]] = []

    def take(self, block: Block) -> None:
        segment = block.segment
        if segment is None:
            self._times.untimed += block.role in (Role.RAPID, Role.KEPT, Role.SEALED)
            return
        self._gathered.append((segment, block.feed if segment.feed is None else segment.feed))
        if len(self._gathered) == _GATHERED:
            self.count()

    def count(self) -> None:
        """Count what was gathered."""
        segments, self._gathered = self._gathered, []
        if not segments:
            return
        settle = self._settings.settle
        way = np.array([one.way for one, _ in segments])
        least = rest_to_rest(way, self._settings.limits).tolist()
        for (segment, feed), time in zip(segments, least, strict=True):
            if isinstance(segment, DwellSegment):
                self._times.add_fixed('dwell', segment.duration)
            elif segment.rapid:
                self._times.add_fixed('rapid', time + (settle if time > 0.0 else 0.0))
            elif segment.length > 0.0 or segment.turning:
                own = inf
                if feed is not None and segment.length > 0.0:
                    own = segment.length / feed
                self._times.add_fixed('kept', max(own, time) + settle)


_SHORTEST = 1e-7
"""Length from which a line surely is a piece of a path [m]."""

_FEEDS_MOST = 1000
"""Programmed feeds whose answers are kept."""


class _LoneLines:
    """Schedules lines that are runs of their own, between rapids or waits, without a path.

    Nothing bends, so that the feed is one for all lines with the same feed of the program.  The
    path of a single line takes as long to make as that of hundreds.
    """

    def __init__(
        self, settings: ProgramSettings, times: ProgramTimes, motions: tuple[_ProgramMotion, ...]
    ) -> None:
        self._settings = settings
        self._times = times
        self._motions = motions
        self._plain = settings.scheduler.reach.bounded and not settings.limits.limits_jerk
        self._wanted: dict[float, float] = {}
        self._gathered: list[tuple[LineSegment, float]] = []

    def next_of(self, source: BlockReader) -> LineSegment | None:
        """Return the line that comes next, None if it is none, or a path has to be made of it."""
        line = source.lone_line if self._plain else None
        return None if line is None or line.length < _SHORTEST else line

    def feed(self, line: LineSegment) -> float:
        """Return the feed of a line [m/s], and count it."""
        length = line.length
        tangent = np.abs(np.subtract(line.end, line.start)) / length
        reachable = float(self._settings.reachable(tangent[np.newaxis])[0])
        feed = min(self._wanted_at(line.feed or nan), reachable)
        self._gathered.append((line, feed))
        self._times.chosen += 1
        self._times.stops += 1
        self._times.length += length
        if len(self._gathered) == _GATHERED:
            self.count()
        return feed

    def count(self) -> None:
        """Count the times of what was gathered."""
        gathered, self._gathered = self._gathered, []
        if not gathered:
            return
        way = np.subtract([one.end for one, _ in gathered], [one.start for one, _ in gathered])
        speeds = [feed for _, feed in gathered], [one.feed for one, _ in gathered]
        for motion, speed in zip(self._motions, speeds, strict=True):
            motion.push_lines(way, np.array(speed))

    def _wanted_at(self, programmed: float) -> float:
        """Return the feed of a straight path without limits of the axes [m/s]."""
        found = self._wanted.get(programmed)
        if found is None:
            settings = self._settings
            bound = settings.bound(np.full(2, programmed))
            path = SampledPath(np.array([0.0, 1.0]), np.zeros(2), programmed=bound)
            ratio = settings.scheduler.bounded_ratio(path)
            found = float(settings.wanted(ratio, bound).min())
            if len(self._wanted) == _FEEDS_MOST:
                self._wanted.clear()
            self._wanted[programmed] = found
        return found


@dataclass(frozen=True, eq=False)
class ProgramSchedule:
    """A scheduled program.

    Attributes
    ----------
    feeds : ndarray, shape (m,)
        Feed of each of the program's segments [m/s]; NaN where it keeps its own.
    times : ProgramTimes
        What it takes.
    paths : tuple of ScheduledPath
        The paths of all runs with their feeds, in parts.
    """

    feeds: Array
    times: ProgramTimes
    paths: tuple[ScheduledPath, ...]

    @property
    def duration(self) -> float:
        """Time of the program with its new feeds [s]."""
        return self.times.duration


class ProgramScheduler:
    r"""Schedules a part program as a stream of blocks.

    Parameters
    ----------
    settings : ProgramSettings
        How.
    observe : callable, optional
        Told of every stretch of path when its feeds are settled, in order.

    Attributes
    ----------
    times : ProgramTimes
        Complete once all blocks have been yielded.
    corners : set of float
        How far corners were rounded off by the program's own words [m].

    Notes
    -----
    The feed of a block is the smallest one along it, blends and the reach of neighbours left
    aside where they are no more than its ends.  It is the feed asked for, never above the
    velocity limits; starts, stops and braking for what follows are the controller's matter.  The
    times are those of a motion that keeps all limits, rests at exact stops and before and after
    whatever is no scheduled motion.  Memory depends on how far scheduler and limits look ahead;
    rules that link the whole path (`Scheduler.reach`) hold a whole run.

    Examples
    --------
    >>> from fuzzycnc_ros.core.feedrate.motion.limits import MotionLimits
    >>> from fuzzycnc_ros.core.feedrate.gcode.reader import ProgramReader
    >>> from fuzzycnc_ros.core.feedrate.schedule.scheduler import ConstantNormalAcceleration
    >>> scheduler = ProgramScheduler(
    ...     ProgramSettings(
    ...         scheduler=ConstantNormalAcceleration(feed_max=0.2, normal_acceleration=0.05),
    ...         limits=MotionLimits(path_velocity=0.25, path_acceleration=1.5),
    ...     )
    ... )
    >>> lines = ['G1 X30 F6000\n', 'G2 X40 I5\n', 'G1 X70\n']
    >>> for block, feed in scheduler.schedule(ProgramReader().blocks(lines)):
    ...     print(block.text.strip(), f'{60e3 * feed:.0f} mm/min')
    G1 X30 F6000 6000 mm/min
    G2 X40 I5 949 mm/min
    G1 X70 6000 mm/min
    """

    def __init__(self, settings: ProgramSettings, observe: Observer | None = None) -> None:
        self._settings = settings
        self._observe = observe
        self._motion = _ProgramMotion(settings)
        self._own_motion = _ProgramMotion(settings)
        self.times = ProgramTimes()
        self.corners: set[float] = set()
        self._fixed = _FixedMotions(settings, self.times)
        self._lines = _LoneLines(settings, self.times, (self._motion, self._own_motion))

    def schedule(self, blocks: Iterable[Block]) -> Iterator[tuple[Block, float | None]]:
        """Yield the blocks of a program, each with its feed.

        Parameters
        ----------
        blocks : iterable of Block
            All blocks in order, as `ProgramReader` yields them.

        Yields
        ------
        tuple of Block and float or None
            In the same order, for `write_blocks`: the feed [m/s], None where the program's own
            one stays.

        Raises
        ------
        ValueError
            If the blocks make no path.
        """
        source, times, own = BlockReader(blocks), self.times, self._settings.own_corners
        while (block := source.next) is not None:
            if block.segment is None or not block.segment.schedulable:
                source.take()
                times.blocks += 1
                self._fixed.take(block)
                yield block, None
                continue
            # Who observes is told of paths.
            line = self._lines.next_of(source) if self._observe is None else None
            if line is not None:
                times.blocks += 1
                yield source.take(), self._lines.feed(line)
                continue
            for item in ProgramRun(self._settings, source, self._drive).schedule():
                times.blocks += 1
                times.chosen += item[1] is not None
                if own and item[0].rounding is not None and item[1] is not None:
                    self.corners.add(item[0].rounding)
                if item[0].segment is None:
                    self._fixed.take(item[0])
                times.curves += isinstance(item[0].segment, NurbsSegment)
                yield item
        self._fixed.count()
        self._lines.count()
        for motion in (self._motion, self._own_motion):
            motion.finish()
        constant = self._settings.machine_constant
        times.duration += self._motion.duration
        times.programmed += self._own_motion.duration
        times.error = constant * self._motion.acceleration
        times.programmed_error = constant * self._own_motion.acceleration

    def _drive(self, scheduled: ScheduledPath) -> None:
        """Count the time of a stretch of path."""
        path = scheduled.path
        self.times.length += path.geometry.length
        self.times.stops += int(path.stop[1:].sum())
        self._motion.push(path, scheduled.feed)
        self._own_motion.push(path, scheduled.programmed)
        if self._observe is not None:
            self._observe(scheduled)


def schedule_program(program: Program, settings: ProgramSettings) -> ProgramSchedule:
    """Return the feeds of a whole program.

    Parameters
    ----------
    program : Program
        The program as read.
    settings : ProgramSettings
        How.

    Returns
    -------
    ProgramSchedule
        Feeds for `write_program`, times, and the paths with their feeds.

    Raises
    ------
    ValueError
        If the segments make no path.
    """
    paths: list[ScheduledPath] = []
    scheduler = ProgramScheduler(settings, paths.append)
    feeds = [
        nan if feed is None else feed
        for block, feed in scheduler.schedule(program.blocks)
        if block.segment is not None
    ]
    return ProgramSchedule(np.array(feeds), scheduler.times, tuple(paths))

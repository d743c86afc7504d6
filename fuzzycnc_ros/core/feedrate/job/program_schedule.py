# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Scheduling of part programs: a feed for each block, and the time that it all takes."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, fields
from math import inf, isfinite, nan

import numpy as np

from fuzzycnc_ros.core.arrays import Array
from fuzzycnc_ros.core.feedrate.job.program_motion import ProgramMotion, rest_to_rest
from fuzzycnc_ros.core.feedrate.job.program_run import Observer, ProgramRun, ScheduledPath, Source
from fuzzycnc_ros.core.feedrate.job.settings import ProgramSettings
from fuzzycnc_ros.core.feedrate.program.blocks import Block, Program
from fuzzycnc_ros.core.feedrate.program.segments import DwellSegment, NurbsSegment, Segment

__all__ = [
    'Observer',
    'ProgramSchedule',
    'ProgramScheduler',
    'ProgramSettings',
    'ProgramTimes',
    'ScheduledPath',
    'schedule_program',
]


@dataclass
class ProgramTimes:
    """What a program takes within the limits, once all of it has been scheduled.

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
        ends; motions of unknown time.
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
        Of what has been scheduled so far.

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
    >>> from fuzzycnc_ros.core.feedrate.program.reader import ProgramReader
    >>> from fuzzycnc_ros.core.feedrate.schedulers.plain import ConstantNormalAcceleration
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
        self._motion = ProgramMotion(settings)
        self._own_motion = ProgramMotion(settings)
        self.times = ProgramTimes()

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
        source, times = Source(blocks), self.times
        while (block := source.next) is not None:
            if block.segment is None or not block.segment.schedulable:
                source.take()
                times.blocks += 1
                if block.segment is not None:
                    self._count_fixed(block.segment)
                yield block, None
                continue
            for item in ProgramRun(self._settings, source, self._drive).schedule():
                times.blocks += 1
                times.chosen += item[1] is not None
                times.curves += isinstance(item[0].segment, NurbsSegment)
                yield item
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

    def _count_fixed(self, segment: Segment) -> None:
        """Count the time of what is not scheduled."""
        limits, settle = self._settings.limits, self._settings.settle
        if isinstance(segment, DwellSegment):
            self.times.add_fixed('dwell', segment.duration)
        elif segment.rapid:
            time = rest_to_rest(segment.start, segment.end, limits)
            self.times.add_fixed('rapid', time + (settle if time > 0.0 else 0.0))
        elif segment.length > 0.0 or segment.turning:
            known = segment.feed is not None and segment.length > 0.0
            time = inf
            if segment.feed is not None and known:
                time = max(
                    segment.length / segment.feed,
                    rest_to_rest(segment.start, segment.end, limits),
                )
            self.times.add_fixed('kept', time + settle)


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

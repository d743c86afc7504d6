# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Planning of a trajectory while its path arrives and its settings change."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from fuzzycnc_ros.core.arrays import Array
from fuzzycnc_ros.core.feedrate.motion.axis_limits import acceleration_bands
from fuzzycnc_ros.core.feedrate.motion.limits import MotionLimits
from fuzzycnc_ros.core.feedrate.motion.pieces import Pieces
from fuzzycnc_ros.core.feedrate.motion.stream import (
    MotionEntry,
    MotionPart,
    MotionStream,
    default_window,
    timed,
)
from fuzzycnc_ros.core.feedrate.motion.sweeps import Braking
from fuzzycnc_ros.core.feedrate.motion.trajectory import MotionSamples, PathMotion
from fuzzycnc_ros.core.feedrate.schedule.feeds import FeedPlan
from fuzzycnc_ros.core.feedrate.schedule.scheduler import Scheduler

if TYPE_CHECKING:
    from fuzzycnc_ros.core.feedrate.path.reference_path import ReferencePath

_REMAINDER_MIN = 1e-6
"""Pieces are not cut closer to their ends [m], where positions would not tell their bend."""

_GROUP = 64


def _strongest_braking(
    pieces: Pieces, square: float, plan_place: Array, plan: Array, limits: Array
) -> Braking:
    """Return the fastest way to rest from the beginning of some pieces.

    It never goes faster than a plan, which leads to rest as well: where the limits leave no
    stronger braking than planned, the plan is what remains possible.

    Parameters
    ----------
    pieces : Pieces
        Pieces ahead, m or more than the plan leads along.
    square : float
        Squared speed at their beginning [m^2/s^2].
    plan_place, plan : array, shape (l,)
        Squared speeds planned, to rest at the last place [m, m^2/s^2].
    limits : array, shape (3, d + 1) or (m,)
        Limits as `MotionLimits.table` gives them, for motion that is averaged the largest change
        of speed in each piece [m/s^2].
    """
    place, found = [float(pieces.place[0])], [square]
    planned = np.interp(pieces.place, plan_place, plan, right=0.0)
    for begin in range(0, len(pieces), _GROUP):
        some = pieces.part(begin, min(begin + _GROUP, len(pieces)))
        length = some.length
        bands = acceleration_bands(some.geometry, limits) if limits.ndim == 2 else None
        for k in range(len(some)):
            if found[-1] <= 0.0:
                return Braking(np.array(place), np.array(found), plan_place, plan)
            if bands is None:
                least = found[-1] - 2.0 * float(limits[begin + k]) * float(length[k])
            else:
                least = float((-bands.width[k] - bands.slope[k] * found[-1]).max())
            share = 1.0 if least >= 0.0 else found[-1] / (found[-1] - least)
            if (1.0 - share) * length[k] < _REMAINDER_MIN:
                share = 1.0
            place.append(
                float(some.place[k] + share * length[k])
                if share < 1.0
                else float(some.place[k + 1])
            )
            found.append(
                float(np.clip(least, 0.0, planned[begin + k + 1])) if share == 1.0 else 0.0
            )
    found[-1] = 0.0
    return Braking(np.array(place), np.array(found), plan_place, plan)


@dataclass(frozen=True, eq=False)
class _Cut:
    """State of motion before averaging, from which it may go on otherwise.

    Attributes
    ----------
    motion : PathMotion
        The motion up to here and, as planned, behind.
    time, rest : float
        When this is, and how long the motion rests here from then on [s].
    behind, ahead : Pieces
        The path before and after.
    rise : array, shape (m,)
        Largest change of speed that each piece ahead leaves, for motion that is averaged [m/s^2].
    place, square : array, shape (k,)
        Squared speeds planned ahead, to rest at the last place [m, m^2/s^2].
    """

    motion: PathMotion
    time: float
    rest: float
    behind: Pieces
    ahead: Pieces
    rise: Array
    place: Array
    square: Array

    def braking(self, table: Array) -> Braking:
        """Return the fastest way to rest, within a table of limits if motion is not averaged."""
        limits = self.rise if self.motion.window else table
        entry = float(self.square[0])
        return _strongest_braking(self.ahead, entry, self.place, self.square, limits)

    def ended(self) -> PathMotion:
        """Return the motion up to here."""
        pieces = self.behind if len(self.behind) else self.ahead.part(0, 1)
        rows = self.motion.until(self.time, float(self.square[0]))
        return PathMotion(pieces, np.zeros(len(pieces)), *rows, self.motion.window)

    def braked(self, braking: Braking) -> PathMotion:
        """Return the motion up to here and to rest."""
        place = braking.place
        rows = self.motion.until(self.time, float(self.square[0]))
        if len(place) > 1:
            length = np.diff(place)
            more = timed(place, length, braking.lowest, np.zeros(len(length)), self.time)
            joined = [np.append(one[:-1], two) for one, two in zip(rows, more, strict=True)]
            rows = (joined[0], joined[1], joined[2], joined[3])
        end = max(int(np.searchsorted(self.ahead.place, place[-1])), 1)
        pieces = Pieces.join([self.behind, self.ahead.part(0, min(end, len(self.ahead)))])
        rise = np.append(np.zeros(len(self.behind)), self.rise[:end])
        return PathMotion(pieces, rise, *rows, self.motion.window)

    def entry(self, braking: Braking, feeds: FeedPlan) -> MotionEntry:
        """Return how motion within other limits or feeds takes over."""
        return MotionEntry(self.time, braking, self.rest, *self._lookback(feeds))

    def _lookback(self, feeds: FeedPlan) -> tuple[Pieces | None, Array | None]:
        """Return the pieces that the average still mixes in, and when they were passed."""
        window, pieces = self.motion.window, self.behind
        if not window or not len(pieces) or self.ahead.stop[0]:
            return None, None
        passed = self.motion.passed(pieces.place)
        passed[-1] = self.time
        stops = np.flatnonzero(pieces.stop[:-1])
        recent = int(np.searchsorted(passed[1:], self.time - window, 'right'))
        first = max(int(stops[-1]) if len(stops) else 0, recent)
        last = len(pieces) - int(pieces.length[-1] < _REMAINDER_MIN)
        if first >= last:
            return None, None
        pieces = pieces.part(first, last)
        low, high = pieces.place[:-1], pieces.place[1:]
        if feeds.piece(low, high)[-1] < feeds.ready:
            pieces = pieces.with_square(feeds.square(low, high))
        return pieces, np.append(passed[first:last], self.time)


@dataclass(frozen=True, eq=False)
class _Outlook:
    """All that is known of motion to come.

    Attributes
    ----------
    motion : PathMotion
        Motion that is final.
    stream : MotionStream or None
        What plans the motion behind it; nothing while the feed is held.
    entry : MotionEntry or None
        Motion that the stream took over, None at the path's start.
    pending : Pieces
        Pieces behind those of the stream.
    begin : float
        Place of the path's start [m].
    dwell : float
        Rest at stops within the path, besides the programmed one [s].
    resting : tuple of float or None
        When motion was cut last, and until when it rests there [s].
    """

    motion: PathMotion
    stream: MotionStream | None
    entry: MotionEntry | None
    pending: Pieces
    begin: float
    dwell: float
    resting: tuple[float, float] | None

    def cut(self, time: float) -> _Cut:
        """Return the state of the motion at a time, or soon behind."""
        motion = self.motion
        place, speed, rest = motion.state(time)
        pieces, rises, at_place, square = self._ahead()
        at = int(np.clip(np.searchsorted(pieces.place, place, 'right') - 1, 0, len(pieces) - 1))
        left = float(pieces.place[at + 1]) - place
        if place > pieces.place[at] and speed > 0.0 and left < _REMAINDER_MIN:
            # On to the end of the piece, as planned
            place = float(pieces.place[at + 1])
            fast = float(np.sqrt(np.interp(place, at_place, square, right=0.0)))
            time += 2.0 * max(left, 0.0) / (speed + fast)
            behind, front = pieces.divided(place)
            speed, rest = fast, self._rest_at(front)
        else:
            behind, front = pieces.divided(place)
            if speed > 0.0 and (not len(front) or front.stop[0]):
                speed, rest = 0.0, self._rest_at(front)  # arriving, all but for rounding
            elif speed == 0.0 and time >= motion.time[-1]:
                rest = self._rest_left(front, time)
        further = at_place > place
        return _Cut(
            motion,
            time,
            rest,
            behind,
            front,
            rises[len(pieces) - len(front) :],
            np.append(place, at_place[further]),
            np.append(speed * speed, square[further]),
        )

    def _ahead(self) -> tuple[Pieces, Array, Array, Array]:
        """Return all pieces, their largest changes of speed, and the plan to rest."""
        motion = self.motion
        pieces, rise = [motion.pieces], [motion.rise]
        place, square = motion.arc_length, motion.speed * motion.speed
        if self.stream is not None:
            pieces.append(self.stream.waiting)
            rise.append(np.zeros(len(pieces[-1])))
            more_place, more, more_rise = self.stream.to_rest()
            if more_rise is not None:
                rise[-1][: len(more_rise)] = more_rise
            place, square = np.append(place, more_place[1:]), np.append(square, more[1:])
            if square[-1] > 0.0 and self.entry is not None:
                # What the stream knows does not suffice, but when it began, a way to rest was.
                braking = self.entry.braking
                behind = braking.place > place[-1]
                place = np.append(place, braking.place[behind])
                square = np.append(square, braking.lowest[behind])
        pieces.append(self.pending)
        rise.append(np.zeros(len(self.pending)))
        following = [some for some in pieces[1:] if len(some)]
        if following and following[0].place[0] < motion.pieces.place[-1]:
            # Before any motion, the first piece is there to tell the position only.
            pieces, rise = pieces[1:], rise[1:]
        return Pieces.join(pieces), np.concatenate(rise), place, square

    def _rest_at(self, front: Pieces) -> float:
        """Return how long the motion rests at the beginning of some pieces [s]."""
        if not len(front) or not front.stop[0]:
            return 0.0
        if front.place[0] <= self.begin:
            return float(front.rest[0])
        return float(front.rest[0]) + self.dwell

    def _rest_left(self, front: Pieces, time: float) -> float:
        """Return how long the motion has to rest yet behind its last instant [s]."""
        arrived = float(self.motion.time[-1])
        if self.resting is not None and self.resting[0] == arrived:
            return max(self.resting[1] - time, 0.0)
        return max(arrived + self._rest_at(front) - time, 0.0)


@dataclass(frozen=True)
class PlannerSettings:
    """Settings of a planner.

    Attributes
    ----------
    scheduler : Scheduler
        Feed along the path; one that can take a path in parts.
    limits : MotionLimits
        Limits of path and axes.
    override : float
        Feed override, 0 or more; 0 holds the feed.
    period : float
        Time between two samples [s].
    window : float or None
        Length of the average [s]; None for what suits the limits, `default_window`.
    settle : float
        Rest at every exact stop within the path besides the programmed one [s].

    Raises
    ------
    ValueError
        If a number is out of its range or the scheduler needs the whole path.
    """

    scheduler: Scheduler
    limits: MotionLimits
    override: float = 1.0
    period: float = 1e-3
    window: float | None = None
    settle: float = 0.0

    def __post_init__(self) -> None:
        for name, unit in (('override', ''), ('settle', ' s')):
            value = getattr(self, name)
            if not 0.0 <= value < np.inf:
                raise ValueError(f'{name}: expected 0{unit} or more, but found {value}')
        for name in ('period', 'window'):
            value = getattr(self, name)
            if value is not None and not 0.0 < value < np.inf:
                raise ValueError(f'{name}: expected a positive number of s, but found {value}')
        self.scheduler.check_streamable()


_ROUNDING = 1e-9
"""Share of a period by which the path's end may come late for a sample."""
_PAST = 1e-12
"""Time behind the end at which rounding of times leaves nothing but rest [s]."""


@dataclass(frozen=True, eq=False)
class PlannedFeed:
    """Feed along a stretch: arrays over the nodes of the reference path there, each (k,).

    `feed` is the desired one, override included, `speed` what the limits leave of it [m/s];
    `arc_length` [m], `curvature` [1/m]; `owner` counts the segments pushed from 0.
    """

    arc_length: Array
    curvature: Array
    feed: Array
    speed: Array
    owner: NDArray[np.intp]


def _feed_limit(scheduler: Scheduler, override: float) -> float:
    """Return the feed that no desired one exceeds [m/s]."""
    return scheduler.feed_max * (override if scheduler.relative else min(override, 1.0))


class Planner:
    """Samples of the motion along a path that arrives in parts, within limits that may change.

    Scheduler, override, limits, average and sampling follow each other.  What is kept is bounded
    by the reach of the scheduler, the stopping distance and the window of the average.

    Parameters
    ----------
    settings : PlannerSettings
        Settings at the start.
    axes : int
        Number of axes.

    Raises
    ------
    ValueError
        If the limits do not fit the axes.

    Notes
    -----
    A change of settings holds from the last sample taken on, anywhere on the path.  Where the
    motion is too fast for new limits or feeds, it brakes with the larger of the old and the new
    acceleration until it is not; averaged motion brakes with the old.

    Examples
    --------
    From points of a curve to samples of the motion along it, one period apart:

    >>> from fuzzycnc_ros.core.feedrate.path.path_geometry import PathGeometry
    >>> from fuzzycnc_ros.core.feedrate.path.reference_path import PathBuilder, ReferencePath
    >>> from fuzzycnc_ros.core.feedrate.schedule.tolerance_feed import ToleranceFeed
    >>> settings = PlannerSettings(
    ...     ToleranceFeed(feed_max=0.1, tolerance=2e-5, machine_constant=2e-4, curvature_max=1e4),
    ...     MotionLimits(path_velocity=0.2, path_acceleration=1.5),
    ... )
    >>> turn = np.linspace(0.0, np.pi, 200)
    >>> arc = PathGeometry.from_samples(0.01 * np.column_stack([np.cos(turn), np.sin(turn)]))
    >>> planner = Planner(settings, axes=2)
    >>> planner.push(ReferencePath.of_geometry(arc))
    >>> planner.finish()
    >>> samples = planner.take(10_000)  # or as many as there are
    >>> f'{samples.time[-1]:.3f} s, at most {1e3 * samples.speed.max():.1f} mm/s'
    '1.039 s, at most 30.9 mm/s'

    From a part program that arrives line by line to the speed at each of its segments:

    >>> from fuzzycnc_ros.core.feedrate.gcode.reader import ProgramReader
    >>> planner, builder = Planner(settings, axes=3), PathBuilder(blend=1e-5)
    >>> for block in ProgramReader().blocks(['G1 X20 F6000', 'G2 X30 Y-10 J-10', 'G1 Y-30']):
    ...     path = builder.push([block.segment])
    ...     if path is not None:
    ...         planner.push(path)
    >>> planner.push(builder.finish())
    >>> planner.finish()
    >>> found = planner.schedule(0.0, 1.0)
    >>> for k in range(3):
    ...     print(f'up to {1e3 * found.speed[found.owner == k].max():.0f} mm/s')
    up to 100 mm/s
    up to 31 mm/s
    up to 100 mm/s
    """

    def __init__(self, settings: PlannerSettings, axes: int) -> None:
        self._settings, self._axes = settings, axes
        self._window = settings.window or default_window(
            settings.limits, axes, settings.scheduler.feed_max
        )
        self._feeds = FeedPlan(settings.scheduler, settings.override)
        self._stream = self._new_stream(settings)
        self._pending = Pieces.none(axes)  # pieces that are not in the stream yet
        self._motion: PathMotion | None = None  # none before the first part of the path
        self._finished = False  # the whole path is here
        self._complete = False  # and all of its motion final
        self._entry: MotionEntry | None = None  # of the stream, and None at the path's start
        self._rest: tuple[float, float] | None = None  # when cut last, and how long at rest then
        self._begin = 0.0  # place of the path's start
        self._taken = 0
        self._keep = 0  # first sample of the last ones taken

    @property
    def settings(self) -> PlannerSettings:
        """Settings in force."""
        return self._settings

    @property
    def known(self) -> float:
        """Time up to which samples can be taken [s].

        Infinite while the feed is held, minus infinity before the path has begun.
        """
        if self._motion is None:
            return -np.inf
        if self._complete:
            return (self._count - 1) * self._settings.period
        return np.inf if self._stream is None else float(self._motion.time[-1])

    @property
    def exhausted(self) -> bool:
        """True if the last sample of the path has been taken."""
        return self._complete and self._taken >= self._count

    @property
    def taken(self) -> int:
        """Number of samples taken."""
        return self._taken

    @property
    def finished(self) -> bool:
        """True if the whole path is here."""
        return self._finished

    @property
    def held(self) -> bool:
        """True if the motion has come to rest for a feed hold, or will."""
        return self._stream is None and not self._complete

    @property
    def kept(self) -> int:
        """Number of pieces held in memory, ahead and behind."""
        pieces = 0 if self._motion is None else len(self._motion.pieces)
        waiting = 0 if self._stream is None else len(self._stream.waiting)
        return pieces + waiting + len(self._pending) + len(self._feeds.place)

    def push(self, path: ReferencePath) -> None:
        """Take the next part of the path.

        Raises
        ------
        ValueError
            If it has other axes, does not begin where the one before ended, or the path has been
            finished.  Nothing is taken then.
        """
        if self._finished:
            raise ValueError('expected no more of the path, for it has been finished')
        if path.geometry.axes != self._axes:
            raise ValueError(f'path: expected {self._axes} axes, but found {path.geometry.axes}')
        if len(self._feeds.place) and abs(self._feeds.place[-1] - path.place) > 1e-9:
            raise ValueError(
                f'path: expected it to go on at {self._feeds.place[-1]} m, where the last part '
                f'ended, but found {path.place} m'
            )
        pieces = Pieces.of_path(path, np.zeros((len(path.geometry.coefficient), 2)))
        if self._motion is None:
            pieces.stop[0] = True
            self._motion = PathMotion.at_rest(pieces.part(0, 1), self._window)
            self._begin = float(pieces.place[0])
        self._feeds.append(path)
        self._pending = Pieces.join([self._pending, pieces])
        self._advance()

    def finish(self) -> None:
        """Plan the rest: the path ends here."""
        if not self._finished:
            self._finished = True
            self._feeds.finish()
            self._advance()

    def take(self, count: int) -> MotionSamples:
        """Return the next samples, fewer only at the path's end.

        Raises
        ------
        ValueError
            If fewer than `count` can be known before more of the path is here.
        """
        if count < 1:
            raise ValueError(f'count: expected 1 or more, but found {count}')
        last = self._taken + count - 1
        if self._complete:
            last = min(last, self._count - 1)
        elif self._time(last) > self.known:
            raise ValueError(
                f'count: expected samples up to {self.known} s, but found {count} up to '
                f'{self._time(last)} s; push more of the path first'
            )
        if self._motion is None or last < self._taken:
            return MotionSamples.join([], self._axes)
        self._drop()
        times = self._times(self._taken, last + 1)
        if self._complete and last == self._count - 1:
            times[-1] = max(times[-1], self._motion.duration + _PAST)
        found = self._motion.at(times)
        self._keep, self._taken = self._taken, last + 1
        return found

    def tail(self) -> MotionSamples:
        """Return the fastest way to rest from the last taken sample, at least one sample.

        The last one is at rest on the path.  The planner stays as it is.
        """
        if self._motion is None:
            return MotionSamples.join([], self._axes)
        cut = self._cut()
        braked = cut.braked(cut.braking(self._settings.limits.table(self._axes)))
        since = (braked.rests - self._time(self._taken - 1)) / self._settings.period
        times = self._times(self._taken, self._taken + max(int(np.ceil(since)), 1))
        times[-1] = max(times[-1], braked.rests + _PAST)
        return braked.at(times)

    def schedule(self, low: float, high: float) -> PlannedFeed:
        """Return the feed at the nodes from arc length `low` to `high` [m].

        Nodes before those of the last samples taken may be forgotten.
        """
        place, curvature, feed, owner = self._feeds.at_nodes(low, high)
        if self._motion is None:
            return PlannedFeed(place, curvature, feed, np.zeros(len(place)), owner)
        return PlannedFeed(place, curvature, feed, self._motion.speed_at(place), owner)

    def change(self, settings: PlannerSettings) -> None:
        """Go by other settings from the last sample taken on, without a step in velocity.

        Raises
        ------
        ValueError
            If the period or the length of the average differs, jerk is limited now and was not
            before, or the limits do not fit the axes.  Nothing changes then.
        """
        before = self._settings
        if settings.period != before.period:
            raise ValueError(
                f'period: expected {before.period} s as before, but found {settings.period} s; '
                'make another planner for the next path'
            )
        if settings.window not in (None, before.window, self._window):
            raise ValueError(
                f'window: expected {self._window} s as before, but found {settings.window} s; it '
                'can change between two paths'
            )
        if settings.limits.limits_jerk and not self._window:
            raise ValueError(
                'limits: expected none of jerk, as before, but found one; it can change between '
                'two paths, or give `window` at the start'
            )
        settings.limits.table(self._axes)
        settings.scheduler.check_streamable()
        self._feeds.change(settings.scheduler, settings.override)
        self._settings = settings
        if self._motion is None:
            self._stream = self._new_stream(settings)
        elif not self._complete or self._time(self._taken - 1) < self._motion.time[-1]:
            self._replan(before.limits)

    @property
    def _count(self) -> int:
        """Number of samples of the whole path, once all of its motion is final."""
        assert self._motion is not None
        return int(np.ceil(self._motion.duration / self._settings.period - _ROUNDING)) + 1

    def _time(self, sample: int) -> float:
        return self._settings.period * sample

    def _times(self, begin: int, end: int) -> Array:
        return np.asarray(self._settings.period * np.arange(begin, end), dtype=float)

    def _new_stream(
        self, settings: PlannerSettings, entry: MotionEntry | None = None
    ) -> MotionStream | None:
        """Return what plans the motion; nothing while the feed is held."""
        if settings.override == 0.0:
            return None
        return MotionStream(
            settings.limits,
            self._axes,
            feed_max=_feed_limit(settings.scheduler, settings.override),
            window=self._window or None,
            settle=settings.settle,
            entry=entry,
        )

    def _advance(self) -> None:
        """Plan the pieces whose feeds are known."""
        if self._stream is None or self._complete:
            return
        low, high = self._pending.place[:-1], self._pending.place[1:]
        count = 0
        if len(self._pending):
            count = int(np.searchsorted(self._feeds.piece(low, high), self._feeds.ready))
        if count:
            some = self._pending.part(0, count)
            some = some.with_square(self._feeds.square(low[:count], high[:count]))
            self._pending = self._pending.part(count, len(self._pending))
            self._note(self._stream.take(some))
        if self._finished and not len(self._pending):
            self._note(self._stream.finish())
            self._complete = True

    def _note(self, parts: list[MotionPart]) -> None:
        """Put final motion behind what is there."""
        if parts:
            assert self._motion is not None
            self._motion = self._motion.extended(parts)

    def _drop(self) -> None:
        """Forget what neither samples nor a change can come back to."""
        assert self._motion is not None
        motion = self._motion.since(self._time(self._keep) - 2.0 * self._window)
        if motion is not self._motion:
            self._motion = motion
            self._feeds.drop(float(motion.pieces.place[0]))

    def _cut(self) -> _Cut:
        """Return the state of the motion at the last sample taken, or soon behind."""
        assert self._motion is not None
        outlook = _Outlook(
            self._motion,
            self._stream,
            self._entry,
            self._pending,
            self._begin,
            self._settings.settle + self._window,
            self._rest,
        )
        return outlook.cut(max(self._time(self._taken - 1), 0.0))

    def _replan(self, before: MotionLimits) -> None:
        """Plan anew from the last sample taken, with the settings in force."""
        cut = self._cut()
        if not len(cut.ahead) and self._finished:
            self._complete = True  # nothing is left to plan
            return
        both = [limits.table(self._axes) for limits in (before, self._settings.limits)]
        braking = cut.braking(np.maximum(*both))
        self._rest = (cut.time, cut.time + cut.rest)
        self._complete = False
        if self._settings.override == 0.0:
            self._motion = cut.braked(braking)
            used = len(self._motion.pieces) - len(cut.behind)
            self._pending = cut.ahead.part(used, len(cut.ahead))
            self._stream = self._entry = None
            return
        self._entry = cut.entry(braking, self._feeds)
        self._motion = cut.ended()
        self._stream = self._new_stream(self._settings, self._entry)
        self._pending = cut.ahead
        self._advance()

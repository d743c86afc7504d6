# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Planning of a trajectory while its path arrives and its settings change."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from fuzzycnc_ros.core.arrays import Array
from fuzzycnc_ros.core.feedrate.motion.limits import MotionLimits
from fuzzycnc_ros.core.feedrate.motion.pieces import Pieces
from fuzzycnc_ros.core.feedrate.motion.stream import (
    MotionEntry,
    MotionPart,
    MotionStream,
    default_window,
)
from fuzzycnc_ros.core.feedrate.planner.cut import Cut, Outlook
from fuzzycnc_ros.core.feedrate.planner.feeds import FeedPlan, check_streamable, feed_limit
from fuzzycnc_ros.core.feedrate.planner.planned_motion import PlannedMotion, PlannedSamples
from fuzzycnc_ros.core.feedrate.planner.settings import PlannerSettings

if TYPE_CHECKING:
    from fuzzycnc_ros.core.feedrate.reference.reference_path import ReferencePath

__all__ = ['PlannedFeed', 'PlannedSamples', 'Planner', 'PlannerSettings']

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
    """

    def __init__(self, settings: PlannerSettings, axes: int) -> None:
        self._settings, self._axes = settings, axes
        self._window = settings.window or default_window(
            settings.limits, axes, settings.scheduler.feed_max
        )
        self._feeds = FeedPlan(settings.scheduler, settings.override)
        self._stream = self._new_stream(settings)
        self._pending = Pieces.none(axes)  # pieces that are not in the stream yet
        self._motion: PlannedMotion | None = None  # none before the first part of the path
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
        """Whether the last sample of the path has been taken."""
        return self._complete and self._taken >= self._count

    @property
    def taken(self) -> int:
        """Number of samples taken."""
        return self._taken

    @property
    def finished(self) -> bool:
        """Whether the whole path is here."""
        return self._finished

    @property
    def held(self) -> bool:
        """Whether the motion has come to rest for a feed hold, or will."""
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
            self._motion = PlannedMotion.at_rest(pieces.part(0, 1), self._window)
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

    def take(self, count: int) -> PlannedSamples:
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
            return PlannedSamples.join([], self._axes)
        self._drop()
        times = self._times(self._taken, last + 1)
        if self._complete and last == self._count - 1:
            times[-1] = max(times[-1], self._motion.end + _PAST)
        found = self._motion.sample(times)
        self._keep, self._taken = self._taken, last + 1
        return found

    def tail(self) -> PlannedSamples:
        """Return the fastest way to rest from the last taken sample, at least one sample.

        The last one is at rest on the path.  The planner stays as it is.
        """
        if self._motion is None:
            return PlannedSamples.join([], self._axes)
        cut = self._cut()
        braked = cut.braked(cut.braking(self._settings.limits.table(self._axes)))
        since = (braked.rests - self._time(self._taken - 1)) / self._settings.period
        times = self._times(self._taken, self._taken + max(int(np.ceil(since)), 1))
        times[-1] = max(times[-1], braked.rests + _PAST)
        return braked.sample(times)

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
        check_streamable(settings.scheduler)
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
        return int(np.ceil(self._motion.end / self._settings.period - _ROUNDING)) + 1

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
            feed_max=feed_limit(settings.scheduler, settings.override),
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

    def _cut(self) -> Cut:
        """Return the state of the motion at the last sample taken, or soon behind."""
        assert self._motion is not None
        outlook = Outlook(
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

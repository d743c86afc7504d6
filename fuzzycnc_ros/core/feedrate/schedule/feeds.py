# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Desired feeds along a reference path that arrives in parts, the same as along the whole."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fuzzycnc_ros.core.arrays import Array
from fuzzycnc_ros.core.feedrate.path.sampled_path import SampledPath
from fuzzycnc_ros.core.feedrate.schedule.scheduler import Scheduler

if TYPE_CHECKING:
    from fuzzycnc_ros.core.feedrate.path.reference_path import ReferencePath

_SPARE = 256
"""Nodes kept behind, for a scheduler that looks farther back than the present one."""


def desired_feed(
    scheduler: Scheduler, scheduled: ArrayLike, programmed: ArrayLike, override: float = 1.0
) -> Array:
    """Return the feed asked for.

    A scheduler that answers in absolute feeds keeps a tolerance by them: the override raises the
    programmed feed up to these, or lowers both.  One that answers in parts of the programmed feed
    scales it, and the override scales both.

    Parameters
    ----------
    scheduler : Scheduler
        Scheduler that gave the feeds.
    scheduled : array
        Its feeds [m/s].
    programmed : array
        Programmed feeds, infinite for rapids [m/s].
    override : float
        Feed override, 0 or more.

    Returns
    -------
    array
        Feeds in the common shape of `scheduled` and `programmed` [m/s].
    """
    wanted, given = np.asarray(scheduled, dtype=float), np.asarray(programmed, dtype=float)
    if scheduler.relative:
        feed_max = scheduler.feed_max
        return np.asarray(override * (wanted / feed_max) * np.minimum(given, feed_max))
    with np.errstate(invalid='ignore'):
        return np.asarray(min(override, 1.0) * np.minimum(wanted, max(override, 1.0) * given))


class FeedPlan:
    """Scheduled and desired feeds at the nodes of a reference path that arrives in parts.

    Parameters
    ----------
    scheduler : Scheduler
        Scheduler of finite reach.
    override : float
        Feed override, 0 or more.

    Raises
    ------
    ValueError
        If the scheduler needs the whole path.
    """

    def __init__(self, scheduler: Scheduler, override: float = 1.0) -> None:
        scheduler.check_streamable()
        self._scheduler, self._override = scheduler, override
        self.place = np.empty(0)
        self.curvature = np.empty(0)
        self.programmed = np.empty(0)
        self.owner: NDArray[np.intp] = np.empty(0, np.intp)
        self._scheduled = np.empty(0)  # of the first nodes, those whose reach has arrived
        self._finished = False

    @property
    def ready(self) -> int:
        """Number of pieces, of those kept, whose desired feeds are known."""
        return max(len(self._scheduled) - 1, 0)

    def append(self, path: ReferencePath) -> None:
        """Take the next part of the path."""
        place = path.place + path.geometry.node
        curvature = np.array(path.curvature, dtype=float)
        if len(self.place):
            curvature[0] = max(curvature[0], self.curvature[-1])
            place[0] = self.place[-1]
        self.place = np.concatenate([self.place[:-1], place])
        self.curvature = np.concatenate([self.curvature[:-1], curvature])
        self.programmed = np.append(self.programmed, path.feed)
        self.owner = np.append(self.owner, path.owner)
        self._schedule()

    def finish(self) -> None:
        """Schedule what waits: the path ends here."""
        self._finished = True
        self._schedule()

    def change(self, scheduler: Scheduler, override: float) -> None:
        """Schedule the nodes that are kept anew."""
        scheduler.check_streamable()
        self._scheduler, self._override = scheduler, override
        self._scheduled = np.empty(0)
        self._schedule()

    def square(self, low: Array, high: Array) -> Array:
        """Return squared desired speeds at both ends of pieces, shape (k, 2) [m^2/s^2].

        Parameters
        ----------
        low, high : array, shape (k,)
            Places of the ends [m], each pair within a piece of the path.
        """
        at = self.piece(low, high)
        ends = np.column_stack([self._scheduled[at], self._scheduled[at + 1]])
        programmed = self.programmed[at, np.newaxis]
        square = np.square(desired_feed(self._scheduler, ends, programmed, self._override))
        begin, length = self.place[at], np.diff(self.place)[at]
        share = np.column_stack([low - begin, high - begin]) / length[:, np.newaxis]
        change = square[:, 1:] - square[:, :1]
        return np.asarray(square[:, :1] + np.clip(share, 0.0, 1.0) * change)

    def piece(self, low: Array, high: Array) -> NDArray[np.intp]:
        """Return which of the pieces kept the pieces between two places are in."""
        at = np.searchsorted(self.place, 0.5 * (low + high), 'right') - 1
        return np.clip(at, 0, max(len(self.programmed) - 1, 0))

    def at_nodes(self, low: float, high: float) -> tuple[Array, Array, Array, NDArray[np.intp]]:
        """Return place, curvature, desired feed and owner at the nodes from `low` to `high`."""
        edge = 1e-12
        begin = int(np.searchsorted(self.place, low - edge))
        end = int(np.searchsorted(self.place, high + edge, 'right'))
        node = np.arange(begin, min(end, len(self._scheduled)))
        before, after = (np.clip(node - k, 0, len(self.programmed) - 1) for k in (1, 0))
        programmed = np.minimum(self.programmed[before], self.programmed[after])
        feed = desired_feed(self._scheduler, self._scheduled[node], programmed, self._override)
        return self.place[node], self.curvature[node], feed, self.owner[after]

    def drop(self, place: float) -> None:
        """Forget what no feed from `place` [m] on depends on."""
        done = len(self._scheduled)
        at = int(np.searchsorted(self.place, place, 'right')) - 1
        first = min(self._needed(at), self._needed(done)) - _SPARE
        if first > _SPARE:  # not for every node alone
            self.place, self.curvature = self.place[first:], self.curvature[first:]
            self.programmed, self.owner = self.programmed[first:], self.owner[first:]
            self._scheduled = self._scheduled[first:]

    def _needed(self, node: int) -> int:
        """Return the first node that the feed at a node depends on."""
        return self._scheduler.reach.first_needed(self.place, node)

    def _schedule(self) -> None:
        """Schedule the nodes whose reach has arrived."""
        if not len(self.place):
            return
        done, ready = len(self._scheduled), len(self.place)
        if not self._finished:
            # The last node belongs to the next piece too, which may bend more.
            ready = min(self._scheduler.reach.ready(self.place), ready - 1)
        if ready <= done:
            return
        first = self._needed(done)
        # At a node between two feeds the larger one: it may be come from there.
        programmed = np.maximum(
            np.append(self.programmed[:1], self.programmed),
            np.append(self.programmed, self.programmed[-1:]),
        )
        path = SampledPath(
            self.place[first:],
            self.curvature[first:],
            programmed=max(self._override, 1.0) * programmed[first:],
        )
        ratio = self._scheduler.bounded_ratio(path)[done - first : ready - first]
        self._scheduled = np.append(self._scheduled, self._scheduler.feed_max * ratio)

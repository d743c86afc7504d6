# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""One feed for each block: from the feeds along its pieces, and few different ones."""

from __future__ import annotations

from collections.abc import Callable
from math import inf, nan
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from fuzzycnc_ros.core.arrays import Array
from fuzzycnc_ros.core.feedrate.reference.nodes import NodePlan, near_neighbours, own_curvature

if TYPE_CHECKING:
    from fuzzycnc_ros.core.feedrate.reference.reference_path import ReferencePath

GROUP = 1024
"""Blocks that share a feed at most: so many are held back."""

_CORE, _EDGE, _BLEND = range(3)


class BlockFeeds:
    """The feed of each block of a run, from parts of its path.

    A block gets the smallest feed of its pieces.  Blends with its neighbours count only where
    they make up half of it or more: elsewhere the controller slows down for them by itself.  So
    it does where only a neighbour asks for less, near the ends of a block.

    Parameters
    ----------
    plan : NodePlan
        How far neighbours count.
    step : float
        Neighbouring blocks share the lowest of their feeds where the highest is no more than
        this share above it [-].
    own : callable
        Told the index of a block; returns the curvature that it has by itself all along [1/m],
        infinite where that varies.
    """

    def __init__(self, plan: NodePlan, step: float, own: Callable[[int], float]) -> None:
        self._plan = plan
        self._step = 1.0 + step
        self._own = own
        self._open: tuple[int, list[Array]] | None = None
        self._next = 0  # index of the next block to be settled
        self._group = 0  # blocks that share a feed so far, from `_low` to `_high`
        self._low, self._high = inf, -inf
        self._last = nan

    def take(self, path: ReferencePath, feed: Array) -> list[float]:
        """Take the feeds of a part's pieces, (m,) [m/s]; return those of the next blocks."""
        first = np.flatnonzero(np.diff(path.owner, prepend=-1))
        index = path.owner[first]
        sums = self._sums(path, feed, first)
        if self._open is not None:
            if self._open[0] == index[0]:
                before = self._open[1]
                for total, own, merge in zip(
                    sums, before, (np.minimum, np.add, np.maximum, np.maximum), strict=True
                ):
                    total[:, 0] = merge(total[:, 0], own)
            else:
                index = np.append(self._open[0], index)
                sums = [
                    np.column_stack([own, total])
                    for own, total in zip(self._open[1], sums, strict=True)
                ]
        self._open = int(index[-1]), [total[:, -1].copy() for total in sums]
        return self._settle(index[:-1], self._feeds(index[:-1], [one[:, :-1] for one in sums]))

    def finish(self, count: int) -> list[float]:
        """Return the feeds of the remaining ones of `count` blocks."""
        found: list[float] = []
        if self._open is not None:
            index = np.array([self._open[0]])
            sums = [total[:, np.newaxis] for total in self._open[1]]
            found += self._settle(index, self._feeds(index, sums))
            self._open = None
        rest = count - self._next
        if rest:  # too short for pieces of their own
            found += self._settle(np.array([count - 1]), np.array([self._last]))
        return found + self._merged()

    def _sums(self, path: ReferencePath, feed: Array, first: NDArray[np.intp]) -> list[Array]:
        """Return least feed, length, largest curvature and feed by kind of piece and block."""
        bend = own_curvature(path.geometry).max(axis=1)
        own = np.array([self._own(index) for index in path.owner[first].tolist()])
        count = np.diff(np.append(first, len(path.owner)))
        near = near_neighbours(path, np.repeat(own, count), bend, self._plan)
        length = np.diff(path.geometry.node)
        kind = np.where(path.blend, _BLEND, np.where(near, _EDGE, _CORE))
        chosen = kind == np.arange(3)[:, np.newaxis]
        return [
            np.minimum.reduceat(np.where(chosen, feed, inf), first, axis=1),
            np.add.reduceat(np.where(chosen, length, 0.0), first, axis=1),
            np.maximum.reduceat(np.where(chosen, bend, 0.0), first, axis=1),
            np.maximum.reduceat(np.where(chosen, feed, 0.0), first, axis=1),
        ]

    def _feeds(self, index: NDArray[np.intp], sums: list[Array]) -> Array:
        """Return the feed of each block, shape (k,) [m/s]."""
        feed, length, bend, top = sums
        plain = np.minimum(feed[_CORE], feed[_EDGE])
        # A block that is all near its neighbours, and bends alike all along: what is lower
        # somewhere is so because of them.
        alike = np.array([self._own(at) < inf for at in index.tolist()], dtype=bool)
        found = np.where(alike & (length[_EDGE] > 0.0), top[_EDGE], plain)
        found = np.where(length[_CORE] > 0.0, feed[_CORE], found)
        for row in np.flatnonzero(bend[_EDGE] > 1.001 * bend[_CORE]).tolist():
            if self._own(int(index[row])) == inf:  # sharpest at its ends, by itself
                found[row] = plain[row]
        blended = length[_BLEND] >= 0.5 * length.sum(axis=0)
        return np.asarray(np.where(blended, np.minimum(plain, feed[_BLEND]), found))

    def _settle(self, index: NDArray[np.intp], feeds: Array) -> list[float]:
        """Return the feeds that are final with those of some blocks, which rise in index."""
        final: list[float] = []
        for at, feed in zip(index.tolist(), feeds.tolist(), strict=True):
            while self._next <= at:  # blocks too short for pieces of their own go with the next
                low, high = min(self._low, feed), max(self._high, feed)
                if self._group == GROUP or (self._group and high > self._step * low):
                    final += self._merged()
                    low = high = feed
                self._low, self._high = low, high
                self._group += 1
                self._next += 1
            self._last = feed
        return final

    def _merged(self) -> list[float]:
        found = [self._low] * self._group
        self._group, self._low, self._high = 0, inf, -inf
        return found

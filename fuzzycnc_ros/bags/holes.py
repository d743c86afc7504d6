# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Holes in what is sampled evenly: steps that are longer than those before."""

from collections import deque
from collections.abc import Iterable
from statistics import median
from typing import NamedTuple

HOLE = 1.75
"""Length of a hole, in usual steps: nearly two are one lost sample, half a step more is jitter."""
_RECENT = 15
"""Steps whose median is the usual one: a source that becomes slower has holes for half of them."""
_KEPT = 10_000
"""Most holes that are kept of a topic; memory stays bounded."""


class Hole(NamedTuple):
    """A step that is too long.

    Parameters
    ----------
    start, stop : int
        Stamps of the samples before and after it [ns].
    usual : float
        Usual step [ns].
    """

    start: int
    stop: int
    usual: float


class HoleCounter:
    """Finds holes in the stamps of one topic as they come.

    Attributes
    ----------
    holes : list of Hole
        The first 10,000.

    Examples
    --------
    >>> counter = HoleCounter()
    >>> for stamp in (10, 20, 30, 80, 90):
    ...     counter.update(stamp)
    >>> [(hole.start, hole.stop) for hole in counter.holes]
    [(30, 80)]
    """

    def __init__(self) -> None:
        self.holes: list[Hole] = []
        self._last: int | None = None
        self._steps: deque[int] = deque(maxlen=_RECENT)

    def update(self, stamp: int) -> None:
        """Take the stamp of the next sample [ns]; one that goes back begins another run."""
        last, self._last = self._last, stamp
        if last is None or stamp <= last:
            return
        step = stamp - last
        usual = median(self._steps) if self._steps else step
        if step > HOLE * usual and len(self.holes) < _KEPT:
            self.holes.append(Hole(last, stamp, usual))
        self._steps.append(step)


def not_explained(holes: Iterable[Hole], jumps: Iterable[Hole]) -> list[Hole]:
    """Return the holes that stay when the jumps of time itself are taken out.

    Machine time jumps where the simulated machine goes from one day to the next.
    """
    known = list(jumps)
    return [
        hole
        for hole in holes
        if hole.stop
        - hole.start
        - sum(max(0, min(hole.stop, j.stop) - max(hole.start, j.start)) for j in known)
        > HOLE * hole.usual
    ]

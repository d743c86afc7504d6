# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The path of a program and its feeds, thinned out while it passes, for a drawing."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from fuzzycnc_ros.core.feedrate.schedule.program_run import ScheduledPath

MOST = 6000
"""Edges of a drawing at most."""

_STRAIGHT = 1e-6
"""Turn up to which a piece is straight [rad]."""


class PathTrace:
    """Edges of a path, of which every other node is left out as often as they are too many.

    Attributes
    ----------
    stride : int
        How many pieces of the path an edge stands for.
    """

    def __init__(self) -> None:
        self.stride = 1
        self._edges: list[NDArray[np.float64]] = []  # (k, 8): start, end, feed x length, length
        self._count = 0

    def add(self, scheduled: ScheduledPath) -> None:
        """Take the next stretch."""
        geometry, owner = scheduled.path.geometry, scheduled.path.owner
        length = np.diff(geometry.node)
        straight = _turn(geometry.coefficient) < _STRAIGHT
        # Pieces of one line make one edge.
        within = straight[1:] & straight[:-1] & (owner[1:] == owner[:-1])
        first = np.flatnonzero(np.append(True, ~within))[:: self.stride]
        last = np.append(first[1:], len(owner)) - 1
        weighted = np.add.reduceat(length * scheduled.feed.mean(axis=1), first)
        ends = geometry.coefficient[first, 0], geometry.coefficient[last, -1]
        edges = np.column_stack([*ends, weighted, np.add.reduceat(length, first)])
        self._edges.append(edges)
        self._count += len(edges)
        while self._count > MOST and any(len(edges) > 1 for edges in self._edges):
            self._edges = [_thinned(edges) for edges in self._edges]
            self._count = sum(map(len, self._edges))
            self.stride *= 2

    @property
    def edges(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Ends of the edges, shape (k, 2, 3) [m], and their feeds, (k,) [m/s]."""
        table = np.concatenate(self._edges) if self._edges else np.empty((0, 8))
        return table[:, :6].reshape(-1, 2, 3), table[:, 6] / table[:, 7]


def _thinned(edges: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return every two edges of a stretch as one."""
    first = np.arange(0, len(edges), 2)
    last = np.append(first[1:], len(edges)) - 1
    sums = np.add.reduceat(edges[:, 6:], first, axis=0)
    return np.column_stack([edges[first, :3], edges[last, 3:6], sums])


def _turn(coefficient: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return by how much pieces turn from their start to their end [rad], about."""
    head = coefficient[:, 1] - coefficient[:, 0]
    tail = coefficient[:, -1] - coefficient[:, -2]
    return np.asarray(
        np.linalg.norm(tail - head, axis=1) / np.maximum(np.linalg.norm(head, axis=1), 1e-15)
    )

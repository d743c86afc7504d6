# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Pieces of a path with what motion along them has to know: stops, rests, desired speeds."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fuzzycnc_ros.core import portable
from fuzzycnc_ros.core.arrays import Array
from fuzzycnc_ros.core.feedrate.path.path_geometry import PathGeometry

if TYPE_CHECKING:
    from fuzzycnc_ros.core.feedrate.path.reference_path import ReferencePath

_AT_STOPS = 8
"""Parts of a piece that ends at a stop: the motion gets going within the first of them."""
_PARTS_MAX = 64


@dataclass(frozen=True, eq=False)
class Pieces:
    """Pieces k = 0..m-1 of a path between its nodes 0..m, places from the start of the path.

    Attributes
    ----------
    geometry : PathGeometry
        The pieces; its own stops are not used.
    place : array, shape (m + 1,)
        Arc length of the nodes from the start of the whole path [m].
    stop : array of bool, shape (m + 1,)
        Nodes at which the motion rests, both ends included.
    rest : array, shape (m + 1,)
        How long at least [s].
    square : array, shape (m, 2)
        Squared desired speeds at both ends of each piece [m^2/s^2], linear in between.
    whole : array of bool, shape (m,)
        Pieces that have not been cut for the motion yet.
    """

    geometry: PathGeometry
    place: Array
    stop: NDArray[np.bool_]
    rest: Array
    square: Array
    whole: NDArray[np.bool_]

    @classmethod
    def of_path(cls, path: ReferencePath, square: Array) -> Pieces:
        """Return the pieces of a part of a path."""
        place = path.place + path.geometry.node
        whole = np.ones(len(square), bool)
        return cls(path.geometry, place, path.stop.copy(), path.rest, square, whole)

    @classmethod
    def of_geometry(cls, geometry: PathGeometry, square: Array) -> Pieces:
        """Return the pieces of a whole path, which starts and ends at stops."""
        stop = geometry.stop.copy()
        stop[[0, -1]] = True
        rest, whole = np.zeros(len(stop)), np.ones(len(square), bool)
        return cls(geometry, geometry.node, stop, rest, square, whole)

    @classmethod
    def none(cls, axes: int) -> Pieces:
        """Return no pieces."""
        none = np.zeros(1)
        geometry = PathGeometry(np.empty((0, 6, axes)), none, np.zeros(1, bool))
        return cls(geometry, none, none > 0.0, none, np.empty((0, 2)), np.empty(0, bool))

    @classmethod
    def join(cls, parts: Sequence[Pieces]) -> Pieces:
        """Return parts that follow each other as one."""
        parts = [part for part in parts if len(part)] or list(parts[:1])
        if len(parts) == 1:
            return parts[0]
        length = np.concatenate([np.diff(part.geometry.node) for part in parts])
        node = np.append(0.0, np.cumsum(length))
        geometry = PathGeometry(
            np.concatenate([part.geometry.coefficient for part in parts]),
            node,
            np.zeros(len(node), bool),
        )
        return cls(
            geometry,
            np.concatenate([parts[0].place[:1], *(part.place[1:] for part in parts)]),
            np.asarray(_shared([part.stop for part in parts], np.logical_or), dtype=bool),
            _shared([part.rest for part in parts], np.maximum),
            np.concatenate([part.square for part in parts]),
            np.concatenate([part.whole for part in parts]),
        )

    def __len__(self) -> int:
        return len(self.whole)

    @property
    def length(self) -> Array:
        """Lengths of the pieces, shape (m,) [m]."""
        return np.asarray(np.diff(self.geometry.node))

    def part(self, begin: int, end: int) -> Pieces:
        """Return the pieces from `begin` up to, without, `end`."""
        nodes, pieces = slice(begin, end + 1), slice(begin, end)
        node = self.geometry.node[nodes]
        geometry = PathGeometry(
            self.geometry.coefficient[pieces], node - node[0], np.zeros(len(node), bool)
        )
        return Pieces(
            geometry,
            self.place[nodes],
            self.stop[nodes].copy(),
            self.rest[nodes].copy(),
            self.square[pieces],
            self.whole[pieces],
        )

    def divided(self, place: float) -> tuple[Pieces, Pieces]:
        """Return the pieces before and behind a place within, cutting the one that it is in."""
        at = int(np.clip(np.searchsorted(self.place, place, 'right') - 1, 0, len(self) - 1))
        share = (place - self.place[at]) / self.length[at]
        if share <= 0.0 or share >= 1.0:
            at += int(share >= 1.0)
            return self.part(0, at), self.part(at, len(self))
        halves = _halves(self.geometry.coefficient[at], share)
        length = np.insert(self.length, at, share * self.length[at])
        length[at + 1] *= 1.0 - share
        coefficient = np.insert(self.geometry.coefficient, at, halves[0], axis=0)
        coefficient[at + 1] = halves[1]
        node = np.append(0.0, np.cumsum(length))
        middle = self.square[at, 0] + share * (self.square[at, 1] - self.square[at, 0])
        square = np.insert(self.square, at, [self.square[at, 0], middle], axis=0)
        square[at + 1, 0] = middle
        found = Pieces(
            PathGeometry(coefficient, node, np.zeros(len(node), bool)),
            np.insert(self.place, at + 1, place),
            np.insert(self.stop, at + 1, False),
            np.insert(self.rest, at + 1, 0.0),
            square,
            np.insert(self.whole, at, self.whole[at]),
        )
        return found.part(0, at + 1), found.part(at + 1, len(found))

    def with_square(self, square: Array) -> Pieces:
        """Return the same pieces with other desired speeds."""
        return replace(self, square=square)

    def fine(self, table: Array, feed_max: float, *, resting: bool = False) -> Pieces:
        """Return pieces short enough for a motion that is uniform in each.

        How a piece is cut depends on nothing but itself, so that parts of a path give the pieces
        of the whole.

        Parameters
        ----------
        table : array, shape (3, d + 1)
            Limits as `MotionLimits.table` gives them.
        feed_max : float
            No desired speed is above it [m/s].
        resting : bool
            Whether the motion starts from rest, stop or not.
        """
        if not len(self):
            return self
        fastest = min(feed_max, portable.norm(table[0, 1:]), table[0, 0])
        braking = fastest * fastest / (2.0 * min(table[1, 0], portable.norm(table[1, 1:])))
        count = np.clip(np.ceil(self.length / (0.1 * braking)), 1, _PARTS_MAX).astype(int)
        rests = self.stop.copy()
        rests[0] |= resting
        near = (rests[:-1] | rests[1:]) & self.whole
        count[near] = np.maximum(count[near], _AT_STOPS)
        between = rests[:-1] & rests[1:]  # one piece alone would never get going
        count[between] = np.maximum(count[between], 2)
        first = np.append(0, np.cumsum(count))
        geometry = self.geometry.split(count)
        owner = np.repeat(np.arange(len(self)), count)
        here = geometry.node - np.append(self.geometry.node[owner], self.geometry.node[-1])
        span = self.length[owner]
        share = np.column_stack([here[:-1], np.append(here[1:-1], span[-1])]) / span[:, np.newaxis]
        share[first[1:] - 1, 1] = 1.0
        square = self.square[owner]
        square = square[:, :1] + share * (square[:, 1:] - square[:, :1])
        place = np.append(self.place[owner], 0.0) + here
        place[first] = self.place
        stop, rest = np.zeros(len(place), bool), np.zeros(len(place))
        stop[first], rest[first] = self.stop, self.rest
        return Pieces(geometry, place, stop, rest, square, np.zeros(len(owner), bool))


def squares(speed: ArrayLike, count: int) -> Array:
    """Return squared desired speeds at both ends of each piece, shape (m, 2) [m^2/s^2].

    Parameters
    ----------
    speed : float or array, shape (m + 1,) or (m, 2)
        Desired speeds at the nodes, or at both ends of each piece where they jump [m/s].
    count : int
        Number m of pieces.

    Raises
    ------
    ValueError
        If the shape is another or a speed is not positive and finite.
    """
    wanted = np.asarray(speed, dtype=float)
    if wanted.shape != (count, 2):
        if wanted.shape not in ((), (count + 1,)):
            raise ValueError(
                f'speed: expected shape ({count + 1},), one at each node, or ({count}, 2), one at '
                f'each end of the pieces, but found {wanted.shape}'
            )
        nodes = np.broadcast_to(wanted, (count + 1,))
        _refuse(nodes)
        wanted = np.column_stack([nodes[:-1], nodes[1:]])
    _refuse(wanted)
    return np.asarray(wanted * wanted)


def _halves(coefficient: Array, share: float) -> tuple[Array, Array]:
    """Return Bernstein coefficients of both parts of a piece, after de Casteljau."""
    left, right = coefficient.copy(), coefficient.copy()
    for k in range(1, len(coefficient)):
        left[k:] = (1.0 - share) * left[k - 1 : -1] + share * left[k:]
    for k in range(1, len(coefficient)):
        right[:-k] = (1.0 - share) * right[:-k] + share * right[1 : len(right) - k + 1]
    return left, right


def _refuse(wanted: Array) -> None:
    good = (wanted > 0.0) & (wanted < np.inf)
    if not good.all():
        at = int(np.argmin(good))
        name = 'node' if wanted.ndim == 1 else 'end'
        raise ValueError(
            f'speed: expected more than 0 m/s, but found {wanted.flat[at]} at {name} {at}; '
            'corners of the path are stops by themselves'
        )


def _shared(parts: Sequence[NDArray[np.generic]], choose: np.ufunc) -> Array:
    """Return values at nodes as one row, neighbours agreeing on the nodes that they share."""
    found = [parts[0]]
    for part in parts[1:]:
        both = choose(found[-1][-1:], part[:1])
        found[-1] = found[-1][:-1]
        found += [both, part[1:]]
    return np.concatenate(found)

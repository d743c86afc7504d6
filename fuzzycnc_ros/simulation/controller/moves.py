# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Moves as a controller gets them: lines and arcs, each with its feed and its path mode."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import NDArray

from fuzzycnc_ros.core import portable
from fuzzycnc_ros.core.arrays import Array

_CHAIN_MAX = 100
"""Points that are merged into one line at most."""


@dataclass(frozen=True, eq=False)
class Moves:
    """Moves that follow each other, n of them.

    Attributes
    ----------
    start, end : ndarray, shape (n, 3)
        Where each starts and ends [m].
    centre, radial, across, rise : ndarray, shape (n, 3)
        Of arcs: centre at the height of the start, vector from there to the start, the same
        turned by a quarter in the sense of the motion, and the way along the axis [m]; zeros of
        lines.
    sweep, growth : ndarray, shape (n,)
        Of arcs: angle swept, above 0 [rad], and by how much the radius grows as a share of it
        [-]; zeros of lines.
    length : ndarray, shape (n,)
        [m]
    feed : ndarray, shape (n,)
        Feed asked for [m/s]; infinite for rapids.
    rapid, stop, first : ndarray of bool, shape (n,)
        Rapids; moves after which the program stands still; moves that begin a path, where the
        tool is wherever they start.
    rest : ndarray, shape (n,)
        Wait after the move [s].
    rounding, merging : ndarray, shape (n,)
        How far the controller may leave the corner at the end and merge lines [m], P and Q of
        G64; rounding is infinite for G64 without P and 0 for exact path (G61), NaN for exact
        stop (G61.1).
    flat : ndarray of bool, shape (n,)
        Arcs in the plane of X and Y.
    place : ndarray, shape (n, 2)
        Way along the programmed path at both ends [m].
    """

    start: Array
    end: Array
    centre: Array
    radial: Array
    across: Array
    rise: Array
    sweep: Array
    growth: Array
    length: Array
    feed: Array
    rapid: NDArray[np.bool_]
    stop: NDArray[np.bool_]
    first: NDArray[np.bool_]
    rest: Array
    rounding: Array
    merging: Array
    flat: NDArray[np.bool_]
    place: Array

    def __len__(self) -> int:
        """Return the number of moves."""
        return len(self.length)

    @property
    def arc(self) -> NDArray[np.bool_]:
        """Which moves are arcs."""
        return np.asarray(self.sweep > 0.0)

    def chosen(self, index: NDArray[np.intp]) -> Moves:
        """Return some of the moves, in the order of their indices."""
        return replace(
            self, **{item.name: getattr(self, item.name)[index] for item in fields(self)}
        )

    def radius(self) -> Array:
        """Return the radius of arcs at their starts, 0 of lines [m]."""
        return np.asarray(np.linalg.norm(self.radial, axis=1))

    def position(self, index: NDArray[np.intp], share: Array) -> Array:
        """Return points of moves at shares of their way, 0 to 1, shape (m, 3) [m]."""
        share = share[:, np.newaxis]
        found = self.start[index] + (self.end - self.start)[index] * share
        bent = self.arc[index]
        if bent.any():
            one, at = index[bent], share[bent]
            angle = self.sweep[one, np.newaxis] * at
            sine, cosine = portable.sin_cos(angle)
            turned = cosine * self.radial[one] + sine * self.across[one]
            grown = 1.0 + self.growth[one, np.newaxis] * at
            found[bent] = self.centre[one] + grown * turned + self.rise[one] * at
        return np.asarray(found)

    def tangent(self, index: NDArray[np.intp], share: Array) -> Array:
        """Return unit vectors along moves at shares of their way, shape (m, 3)."""
        along = (self.end - self.start)[index]
        bent = self.arc[index]
        if bent.any():
            one, at = index[bent], share[bent, np.newaxis]
            sweep, growth = self.sweep[one, np.newaxis], self.growth[one, np.newaxis]
            sine, cosine = portable.sin_cos(sweep * at)
            radial, across = self.radial[one], self.across[one]
            along[bent] = (
                growth * (cosine * radial + sine * across)
                + (1.0 + growth * at) * sweep * (cosine * across - sine * radial)
                + self.rise[one]
            )
        return np.asarray(along / np.maximum(np.linalg.norm(along, axis=1), 1e-15)[:, np.newaxis])


def merged(moves: Moves) -> Moves:
    """Return the moves that are left when lines within `merging` are taken for one.

    A chain goes on while all its points lie within `merging` of the line from its start to the
    next point; feed and path mode end it.  Small arcs in the plane of X and Y count as two
    lines.

    Parameters
    ----------
    moves : Moves
        As programmed.
    """
    tolerance = np.where(moves.rapid, 0.0, moves.merging)
    half = moves.radius() * (1.0 - portable.cos(0.5 * np.minimum(moves.sweep, 2.0 * np.pi)))
    small = moves.arc & moves.flat & (half < tolerance)
    if small.any():
        moves, tolerance = _halved(moves, small), np.repeat(tolerance, 1 + small)
    points = moves.end.tolist()
    begins = moves.start.tolist()
    slack = np.where(moves.arc, 0.0, tolerance).tolist()
    # what the interpreter passes on at once
    ends = np.append(
        (moves.feed[1:] != moves.feed[:-1])
        | (tolerance[1:] != tolerance[:-1])
        | moves.stop[:-1]
        | moves.first[1:],
        True,
    ).tolist()
    last: list[int] = []
    chain: list[list[float]] = []
    origin = begins[0] if begins else [0.0] * 3
    for index, point in enumerate(points):
        limit = slack[index]
        if chain and (limit == 0.0 or not _linkable(origin, chain, point, limit)):
            last.append(index - 1)
            chain = []
        if not chain:
            origin = begins[index]
        chain.append(point)
        if ends[index] or limit == 0.0:
            last.append(index)
            chain = []
    final = np.array(last, dtype=np.intp)
    head = np.append(0, final[:-1] + 1)
    found = moves.chosen(final)
    joined = head < final
    start = np.where(joined[:, np.newaxis], moves.start[head], found.start)
    length = np.where(joined, np.linalg.norm(found.end - start, axis=1), found.length)
    place = np.column_stack([moves.place[head, 0], found.place[:, 1]])
    found = replace(found, start=start, length=length, place=place, first=moves.first[head])
    return found.chosen(np.flatnonzero(found.length > 0.0))


def _linkable(
    origin: list[float], chain: list[list[float]], point: list[float], limit: float
) -> bool:
    """Return whether a chain's points lie near the line from its origin to a point."""
    if len(chain) > _CHAIN_MAX:
        return False
    x, y, z = origin
    a, b, c = point[0] - x, point[1] - y, point[2] - z
    square = a * a + b * b + c * c
    if square == 0.0:
        return False
    for one in reversed(chain):
        p, q, r = one[0] - x, one[1] - y, one[2] - z
        share = min(max((a * p + b * q + c * r) / square, 0.0), 1.0)
        p, q, r = p - share * a, q - share * b, r - share * c
        if p * p + q * q + r * r > limit * limit:
            return False
    return True


def _halved(moves: Moves, small: NDArray[np.bool_]) -> Moves:
    """Return the moves with some arcs taken for two lines."""
    index = np.flatnonzero(small)
    middle = moves.position(index, np.full(len(index), 0.5))
    twice = moves.chosen(np.repeat(np.arange(len(moves)), 1 + small))
    head = index + np.arange(len(index))
    start, end = twice.start.copy(), twice.end.copy()
    end[head], start[head + 1] = middle, middle
    place, half = twice.place.copy(), moves.place[index].mean(axis=1)
    place[head, 1], place[head + 1, 0] = half, half
    both = np.concatenate([head, head + 1])
    stop, first, rest, sweep = (
        getattr(twice, name).copy() for name in ('stop', 'first', 'rest', 'sweep')
    )
    stop[head], rest[head], first[head + 1], sweep[both] = False, 0.0, False, 0.0
    length = twice.length.copy()
    length[both] = np.linalg.norm(end[both] - start[both], axis=1)
    return replace(
        twice, start=start, end=end, place=place, stop=stop, first=first, rest=rest, sweep=sweep,
        length=length,
    )  # fmt: skip

# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Mamdani inference with two inputs and triangular sets [mamdani1975]."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from itertools import pairwise
from math import isfinite

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fuzzycnc_ros.core import portable
from fuzzycnc_ros.core.arrays import Array

# Pairs are worked off in blocks whose temporaries stay in the processor's cache.
_BLOCK = 8192

# Cells of the lookup table per axis: multiples of the five and four gaps between the sets, so
# that the kinks of the memberships fall on its nodes.
_CELLS = (300, 128)


def _half_area(height: Array) -> Array:
    """Return the area under one side of a unit triangle cut off at `height`."""
    return np.asarray(height - 0.5 * height * height)


def _half_moment(height: Array) -> Array:
    """Return the moment of that area about the triangle's peak."""
    return np.asarray(height * (0.5 + height * (height / 6.0 - 0.5)))


@dataclass(frozen=True)
class Mamdani:
    """Rules over two inputs: minimum, minimum, maximum, centroid, [lin2021] eq. (11).

    Each set is a triangle over its two neighbours' centres, so that neighbours cross at one
    half.  Inputs beyond the end centres count as the end centres.  The end sets of the output
    reach beyond their centres as far as they reach inwards: the output then attains them.

    Parameters
    ----------
    first, second : tuple of float
        Centres of the inputs' sets, increasing, at least two, in the inputs' units.
    output : tuple of float
        Centres of the output's sets, increasing, at least two, in the output's unit.
    rules : tuple of tuple of int
        Number of the output's set, from 0, for each set of `first` (rows) and `second` (columns).

    Raises
    ------
    ValueError
        If centres do not increase, or the rules do not fit the sets.

    Notes
    -----
    The source takes the centroid from samples of the output axis.  As no more than two sets
    overlap, it has a closed form, the limit of ever finer samples, and that is what is used.

    Examples
    --------
    >>> system = Mamdani((0.0, 1.0), (0.0, 1.0), (0.0, 0.5, 1.0), ((2, 1), (1, 0)))
    >>> system([0.0, 1.0, 0.5], [0.0, 1.0, 0.5]).round(12).tolist()
    [1.0, 0.0, 0.5]
    """

    first: tuple[float, ...]
    second: tuple[float, ...]
    output: tuple[float, ...]
    rules: tuple[tuple[int, ...], ...]

    def __post_init__(self) -> None:
        for name in ('first', 'second', 'output'):
            check_centres(f'Mamdani: {name}', getattr(self, name))
        shape = (len(self.first), len(self.second))
        found = (len(self.rules), *sorted({len(row) for row in self.rules}))
        if found != shape:
            raise ValueError(
                f'Mamdani: rules: expected {shape[0]} rows of {shape[1]}, one for each pair of '
                f'sets, but found {found[0]} rows of length {", ".join(map(str, found[1:]))}'
            )
        used = {level for row in self.rules for level in row}
        if not used <= set(range(len(self.output))):
            raise ValueError(
                f'Mamdani: rules: expected numbers of output sets 0 to {len(self.output) - 1}, '
                f'but found {min(used)} to {max(used)}'
            )

    def __call__(self, first: ArrayLike, second: ArrayLike) -> Array:
        """Return the inferred output.

        Parameters
        ----------
        first, second : array_like
            Inputs, finite; their shapes broadcast.

        Returns
        -------
        ndarray
            Centroids, between the output's end centres, in the shape of the inputs.
        """
        one, two = np.broadcast_arrays(
            np.asarray(first, dtype=np.float64), np.asarray(second, dtype=np.float64)
        )
        flat_one, flat_two = one.ravel(), two.ravel()
        result = np.empty(flat_one.shape)
        for start in range(0, len(result), _BLOCK):
            part = slice(start, start + _BLOCK)
            result[part] = self._infer(flat_one[part], flat_two[part])
        return result.reshape(one.shape)

    def _infer(self, first: Array, second: Array) -> Array:
        """Return the outputs of one block."""
        rows, columns = memberships(first, self.first), memberships(second, self.second)
        height = np.zeros((len(self.output), len(first)))
        for row, levels in zip(rows, self.rules, strict=True):
            for column, level in zip(columns, levels, strict=True):
                np.maximum(height[level], np.minimum(row, column), out=height[level])
        return self._centroid(height)

    def _centroid(self, height: Array) -> Array:
        """Return the centroid of the union of the sets cut off at `height`, shape (sets, n)."""
        centre, left, right = self._widths
        area = (left + right)[:, np.newaxis] * _half_area(height)
        moment = centre[:, np.newaxis] * area
        moment += (right * right - left * left)[:, np.newaxis] * _half_moment(height)
        # Neighbours share a trapezium about the middle between their centres: counted once.
        common = np.minimum(np.minimum(height[:-1], height[1:]), 0.5)
        shared = right[:-1, np.newaxis] * common * (1.0 - common)
        middle = 0.5 * (centre[:-1] + centre[1:])
        total = area.sum(axis=0) - shared.sum(axis=0)
        return np.asarray((moment.sum(axis=0) - portable.matmul(middle, shared)) / total)

    @cached_property
    def _widths(self) -> tuple[Array, Array, Array]:
        """Centres of the output's sets and their reach to the left and right."""
        centre = np.array(self.output)
        gap = np.diff(centre)
        return centre, np.insert(gap, 0, gap[0]), np.append(gap, gap[-1])


def check_centres(name: str, centres: Sequence[float]) -> None:
    """Refuse centres that do not increase.

    Raises
    ------
    ValueError
        If there are fewer than two, or one is not finite or not above the one before.
    """
    rising = all(b > a for a, b in pairwise(centres))
    if len(centres) < 2 or not rising or not all(map(isfinite, centres)):
        raise ValueError(
            f'{name}: expected at least two increasing centres, but found {tuple(centres)}'
        )


def memberships(values: Array, centres: Sequence[float]) -> Array:
    """Return how far values belong to triangular sets that cross at one half.

    Parameters
    ----------
    values : ndarray, shape (n,)
        Values; beyond the end centres they count as those.
    centres : sequence of float, length m
        Centres of the sets, increasing.

    Returns
    -------
    ndarray, shape (m, n)
        Degrees from 0 to 1; those of one value sum to 1.
    """
    gap = np.diff(centres)
    # Part of each gap between centres that lies below the value
    passed = (values - np.asarray(centres)[:-1, np.newaxis]) / gap[:, np.newaxis]
    passed = np.clip(passed, 0.0, 1.0)
    degree = np.ones((len(centres), len(values)))
    degree[1:] = passed
    degree[:-1] -= passed
    return degree


class MamdaniTable:
    """Bilinear lookup in a table of a Mamdani system, 301 by 129 nodes.

    Parameters
    ----------
    system : Mamdani
        System to tabulate between the end centres of its inputs.

    Attributes
    ----------
    nodes : ndarray, shape (301, 129)
        Outputs at the nodes, read-only.
    """

    def __init__(self, system: Mamdani):
        self.system = system
        ends = [(centres[0], centres[-1]) for centres in (system.first, system.second)]
        axes = [np.linspace(*end, cells + 1) for end, cells in zip(ends, _CELLS, strict=True)]
        self.nodes = system(axes[0][:, np.newaxis], axes[1])
        self.nodes.flags.writeable = False
        self._origin = [low for low, _ in ends]
        self._scale = [
            cells / (high - low) for (low, high), cells in zip(ends, _CELLS, strict=True)
        ]

    def __call__(self, first: Array, second: Array) -> Array:
        """Return the interpolated output.

        Parameters
        ----------
        first, second : ndarray, shape (n,)
            Inputs, finite.

        Returns
        -------
        ndarray, shape (n,)
            Outputs, between the output's end centres.
        """
        result = np.empty(len(first))
        for start in range(0, len(first), _BLOCK):
            part = slice(start, start + _BLOCK)
            result[part] = self._interpolate(first[part], second[part])
        return result

    def _interpolate(self, first: Array, second: Array) -> Array:
        """Return the outputs of one block."""
        table = self.nodes.ravel()
        row, along_rows = self._cell(first, 0)
        column, along_columns = self._cell(second, 1)
        corner = row * (_CELLS[1] + 1) + column
        near = table[corner]
        near += along_columns * (table[corner + 1] - near)
        corner += _CELLS[1] + 1
        far = table[corner]
        far += along_columns * (table[corner + 1] - far)
        return np.asarray(near + along_rows * (far - near))

    def _cell(self, values: Array, axis: int) -> tuple[NDArray[np.int64], Array]:
        """Return the number of the cell along an axis and the position within it."""
        position = (values - self._origin[axis]) * self._scale[axis]
        np.clip(position, 0.0, _CELLS[axis], out=position)
        cell = np.minimum(position.astype(np.int64), _CELLS[axis] - 1)
        position -= cell
        return cell, position


@lru_cache(maxsize=16)
def tabulated(system: Mamdani) -> MamdaniTable:
    """Return the table of a system, made once for equal systems."""
    return MamdaniTable(system)

# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Offsets along axes as lines K0 + slope (x - P0), and the travel along which they stand.

A line is guarded by its values at the two ends of the travel: if both stay within a size and move
no faster than a rate, the offset at any place between them does too.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import isfinite

import numpy as np
from numpy.typing import NDArray

from fuzzycnc_ros.core.arrays import Array


@dataclass(frozen=True, kw_only=True, eq=False)
class Lines:
    """One line per axis: offset + slope (x - reference_position)."""

    offset: Array
    """K0, at the reference position [m]."""
    slope: Array
    """Offset per length of travel [-]."""
    reference_position: Array
    """P0 [m]."""

    @classmethod
    def constant(cls, offset: Array) -> 'Lines':
        """Return lines that have an offset [m] everywhere."""
        zero = np.zeros_like(offset)
        return cls(offset=offset, slope=zero, reference_position=zero)

    def at(self, position: Array) -> Array:
        """Return the offsets at a position [m]; NaN where it is unknown and matters."""
        travel = np.where(self.slope == 0.0, 0.0, position - self.reference_position)
        return np.asarray(self.offset + self.slope * travel)


@dataclass(frozen=True, kw_only=True, eq=False)
class Travel:
    """The travel of each axis; both ends are the same where the control takes no slope."""

    low: Array
    """[m]"""
    high: Array
    """[m]"""

    @property
    def sloping(self) -> NDArray[np.bool_]:
        """True for each axis that takes a slope, shape (axes,)."""
        return np.asarray(self.high > self.low, bool)

    def ends(self, lines: Lines) -> Array:
        """Return the offsets at the lower ends, then those at the upper ends [m]."""
        return np.concatenate([self._at(lines, self.low), self._at(lines, self.high)])

    def lines(self, ends: Array, reference_position: Array) -> Lines:
        """Return the lines through offsets at the ends [m]."""
        low, high = np.split(ends, 2)
        span = np.where(self.sloping, self.high - self.low, 1.0)
        slope = np.where(self.sloping, (high - low) / span, 0.0)
        offset = low + slope * (reference_position - self.low)
        return Lines(offset=np.asarray(offset), slope=slope, reference_position=reference_position)

    def _at(self, lines: Lines, place: Array) -> Array:
        return lines.at(np.where(self.sloping, place, lines.reference_position))


def read_travel(texts: Sequence[str], axes: Sequence[str], name: str) -> Travel:
    """Return the travel of axes; one that is left out takes no slope.

    Parameters
    ----------
    texts : sequence of str
        Axis, low end and high end [m], as `Y:-0.5:0`.
    axes : sequence of str
        The axes, in the order of the arrays.
    name : str
        Parameter that holds the texts, for messages.

    Raises
    ------
    ValueError
        If one is malformed, of another axis, or there is one twice.

    Examples
    --------
    >>> read_travel(['Y:-0.5:0'], ['X', 'Y'], 'travel').sloping.tolist()
    [False, True]
    """
    low, high = np.zeros(len(axes)), np.zeros(len(axes))
    seen: set[str] = set()
    for text in texts:
        axis, *ends = text.split(':')
        try:
            first, last = (float(end) for end in ends)
        except ValueError:
            first = last = np.nan
        if axis not in axes or axis in seen or not (isfinite(first) and first < last < np.inf):
            raise ValueError(
                f'{name}: expected each of the axes {", ".join(axes)} at most once with both ends '
                f'of its travel in m, as {axes[0] if axes else "Y"}:-0.5:0, but found {text!r}'
            )
        seen.add(axis)
        low[axes.index(axis)], high[axes.index(axis)] = first, last
    return Travel(low=low, high=high)

# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Rules of the variable-universe controller: a table between the centres of triangular sets.

[long2014], table 2.  Product inference and the centre average over triangular sets that
cross at one half are bilinear interpolation of the table, to the last digits of a double.
"""

from __future__ import annotations

import warnings
from bisect import bisect_right
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from math import isfinite

import numpy as np
from numpy.typing import ArrayLike

from fuzzycnc_ros.core.arrays import Array
from fuzzycnc_ros.core.fuzzy.mamdani import check_centres

SETS = ('NB', 'NM', 'NS', 'PS', 'PM', 'PB')
"""Names of the published sets, in the order of their centres; none of them is zero."""

CENTRES = (-1.0, -0.67, -0.33, 0.33, 0.67, 1.0)
"""Centres of the published sets [-]."""

SETS_WITH_ZERO = ('NB', 'NM', 'NS', 'ZO', 'PS', 'PM', 'PB')
"""Names of seven sets, one of them about zero."""

CENTRES_WITH_ZERO = (-1.0, -2.0 / 3.0, -1.0 / 3.0, 0.0, 1.0 / 3.0, 2.0 / 3.0, 1.0)
"""Centres of seven sets [-]: six intervals of a third, as the source's own bound asks for."""

_ROUNDING = 1e-15
"""Constant of a cell below which it is zero."""


class RuleTableWarning(UserWarning):
    """A rule table that is allowed, but that a controller may not settle with."""


@dataclass(frozen=True)
class RuleTable:
    """Rule consequents over the sets of error (rows) and error rate (columns).

    Parameters
    ----------
    centres : tuple of float, length m
        Centres of the sets of both inputs [-], increasing.
    values : tuple of tuple of float, shape (m, m)
        Consequents [-], finite, at most 1 in magnitude.

    Raises
    ------
    ValueError
        If centres do not increase, or the values do not fit them or exceed 1.

    Warns
    -----
    RuleTableWarning
        If the table is not odd, or rises with the error anywhere.

    Examples
    --------
    >>> rules = published_rules()
    >>> rules(0.0, 0.0), round(rules(0.33, -0.33), 3)
    (0.0, -0.333)
    """

    centres: tuple[float, ...]
    values: tuple[tuple[float, ...], ...]

    def __post_init__(self) -> None:
        check_centres('RuleTable: centres', self.centres)
        size = len(self.centres)
        lengths = (len(self.values), *sorted({len(row) for row in self.values}))
        if lengths != (size, size):
            raise ValueError(
                f'RuleTable: values: expected {size} rows of {size}, one value for each pair of '
                f'sets, but found {lengths[0]} rows of length {", ".join(map(str, lengths[1:]))}'
            )
        for row in self.values:
            for value in row:
                if not (isfinite(value) and abs(value) <= 1.0):
                    raise ValueError(
                        f'RuleTable: values: expected numbers from -1 to 1, but found {value}'
                    )
        if not self.is_odd:
            warnings.warn(
                'RuleTable: expected values of opposite sign at opposite sets, but found a table '
                'that is not odd; both directions will move differently',
                RuleTableWarning,
                stacklevel=3,
            )
        if (np.diff(np.array(self.values), axis=0) > 0.0).any():
            raised = 'RuleTable: expected values that never rise with the error, but found some'
            warnings.warn(raised, RuleTableWarning, stacklevel=3)

    @property
    def is_odd(self) -> bool:
        """True if the surface is an odd function of both inputs."""
        values, centres = np.array(self.values), np.array(self.centres)
        return bool(
            np.allclose(values, -values[::-1, ::-1], rtol=0.0, atol=1e-12)
            and np.allclose(centres, -centres[::-1], rtol=0.0, atol=1e-12)
        )

    @property
    def slopes(self) -> tuple[float, float]:
        """Slopes -dF/dx and -dF/dy at the origin [-]."""
        cuts = self.centres[1:-1]
        _, error, rate, _ = self.cells[bisect_right(cuts, 0.0)][bisect_right(cuts, 0.0)]
        return -error, -rate

    @cached_property
    def cells(self) -> tuple[tuple[tuple[float, float, float, float], ...], ...]:
        """Coefficients a, b, c, d of a + b x + c y + d x y between neighbouring centres."""
        return tuple(
            tuple(self._cell(i, j) for j in range(len(self.centres) - 1))
            for i in range(len(self.centres) - 1)
        )

    def _cell(self, i: int, j: int) -> tuple[float, float, float, float]:
        """Return the coefficients of one cell."""
        (low, high), (left, right) = self.centres[i : i + 2], self.centres[j : j + 2]
        area = (high - low) * (right - left)
        a = b = c = d = 0.0
        for row, x, rising in ((i, high, -1.0), (i + 1, low, 1.0)):
            for column, y, growing in ((j, right, -1.0), (j + 1, left, 1.0)):
                # share of a corner is (x - other end)(y - other end) over the cell's area
                weight = rising * growing * self.values[row][column] / area
                a += weight * x * y
                b -= weight * y
                c -= weight * x
                d += weight
        # what rounding leaves of a zero would push an axis that rests on its target
        return (a if abs(a) > _ROUNDING else 0.0), b, c, d

    @cached_property
    def infer(self) -> Callable[[float, float], float]:
        """The surface as a function of two numbers between the end centres [-]."""
        cuts, cells = self.centres[1:-1], self.cells

        def surface(x: float, y: float) -> float:
            a, b, c, d = cells[bisect_right(cuts, x)][bisect_right(cuts, y)]
            return a + b * x + (c + d * x) * y

        return surface

    def __call__(self, x: float, y: float) -> float:
        """Return the surface at one point; beyond the end centres inputs count as those."""
        low, high = self.centres[0], self.centres[-1]
        return self.infer(min(max(x, low), high), min(max(y, low), high))

    def surface(self, x: ArrayLike, y: ArrayLike) -> Array:
        """Return the surface at many points.

        Parameters
        ----------
        x, y : array_like
            Inputs [-], finite; their shapes broadcast.

        Returns
        -------
        ndarray
            Interpolated consequents [-] in the shape of the inputs.
        """
        one, two = np.broadcast_arrays(
            np.asarray(x, dtype=np.float64), np.asarray(y, dtype=np.float64)
        )
        cells, low, high = np.array(self.cells), self.centres[0], self.centres[-1]
        one, two = np.clip(one, low, high), np.clip(two, low, high)
        cuts = self.centres[1:-1]
        at = cells[np.searchsorted(cuts, one, 'right'), np.searchsorted(cuts, two, 'right')]
        result = at[..., 0] + at[..., 1] * one + (at[..., 2] + at[..., 3] * one) * two
        return np.asarray(result)


def published_rules(medium: float = 0.67) -> RuleTable:
    """Return the 36 published rules [long2014], table 2.

    Parameters
    ----------
    medium : float
        Consequent of the medium sets [-].  The source prints 0.677 in its table and 0.67 as the
        centre and in its worked example; 2/3 was probably meant.

    Returns
    -------
    RuleTable
        Odd table of six sets.
    """
    full, small = 1.0, 0.333
    upper = (
        (full, full, full, full, medium, medium),
        (full, full, full, medium, medium, medium),
        (medium, medium, medium, small, small, small),
    )
    lower = tuple(tuple(-value for value in row[::-1]) for row in upper[::-1])
    return RuleTable(CENTRES, upper + lower)

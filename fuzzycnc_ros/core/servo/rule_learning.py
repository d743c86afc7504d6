# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Rules of the controller from recorded motion: Wang-Mendel and regularised least squares.

[long2014], table 1, and [wang1992].  What a recording does not cover is said, never made up in
silence: every cell tells where its value is from.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import lsq_linear

from fuzzycnc_ros.core.arrays import Array
from fuzzycnc_ros.core.fuzzy.mamdani import check_centres, memberships
from fuzzycnc_ros.core.servo.rule_table import CENTRES, RuleTable
from fuzzycnc_ros.core.servo.variable_universe import VariableUniverseController

_TIED = 1e-9
"""Memberships closer than this are a tie; a value between two sets then belongs to neither."""

_CUT = 0.999
"""Share of the largest duty from which on a duty counts as cut."""

_PASSES = 50
"""Fits at most, until the cut duties that still pull are the same as before."""

_METHODS = ('wm', 'lsq')
"""Wang-Mendel as published, and least squares."""

DATA, MIRRORED, FILLED, EMPTY = 'data', 'mirrored', 'filled', ''
"""Origin of a cell's consequent: records, the opposite cell, its neighbours, nowhere."""


@dataclass(frozen=True, eq=False)
class LearnedRules:
    """Learnt rules, and their coverage by the records.

    Attributes
    ----------
    values : ndarray, shape (m, m)
        Consequents [-], error by rows, rate by columns; NaN in cells without any.
    strength : ndarray, shape (m, m)
        Wang-Mendel: strength D of the winning record [-].  Least squares: sum of the records'
        firing strengths.  0 without data.
    count : ndarray of int, shape (m, m)
        Records whose strongest sets are these.
    conflicts : ndarray of int, shape (m, m)
        Those of them whose consequent is of another set than the cell's.
    winner : ndarray of int, shape (m, m)
        Row of the record that decided the cell; -1 without one, and with least squares.
    source : tuple of tuple of str, shape (m, m)
        `'data'`, `'mirrored'`, `'filled'`, or `''` for a cell without value.
    used : int
        Records that counted; those at rest on target do not.
    centres : tuple of float
        Centres of the sets [-].
    """

    values: Array
    strength: Array
    count: NDArray[np.int64]
    conflicts: NDArray[np.int64]
    winner: NDArray[np.int64]
    source: tuple[tuple[str, ...], ...]
    used: int
    centres: tuple[float, ...]

    @property
    def coverage(self) -> float:
        """Share of the cells that have data [-]."""
        return sum(row.count(DATA) for row in self.source) / self.values.size

    def complete(self) -> LearnedRules:
        """Return the rules with every cell filled, and say which are not from data.

        First by odd symmetry; a cell and its opposite that both have data and differ are meant to
        agree, so both get half their difference.  Then every cell without data takes the value of
        the nearest cell with data for errors of the same sign, of those equally near the mean.

        Raises
        ------
        ValueError
            If no cell has data.
        """
        known = np.isfinite(self.values)
        if not known.any():
            raise ValueError('complete: expected one cell with data or more but found none')
        source = np.array(self.source, dtype=object)
        opposite = -self.values[::-1, ::-1]
        both = known & np.isfinite(opposite)
        values = np.where(both, 0.5 * (self.values + opposite), self.values)
        mirrored = ~known & np.isfinite(opposite)
        values[mirrored], source[mirrored] = opposite[mirrored], MIRRORED
        have = np.argwhere(np.isfinite(values))
        side = 2 * have[:, 0] - (len(values) - 1)
        full = values.copy()
        for i, j in np.argwhere(~np.isfinite(values)):
            same = have[side * (2 * i - (len(values) - 1)) >= 0]
            apart = np.abs(same - (i, j)).sum(axis=1)
            near = same[apart == apart.min()]
            full[i, j] = values[near[:, 0], near[:, 1]].mean()
            source[i, j] = FILLED
        full = 0.5 * (full - full[::-1, ::-1])
        return LearnedRules(
            full,
            self.strength,
            self.count,
            self.conflicts,
            self.winner,
            tuple(tuple(row) for row in source.tolist()),
            self.used,
            self.centres,
        )

    def table(self) -> RuleTable:
        """Return the rules for a controller.

        Raises
        ------
        ValueError
            If cells are empty.
        """
        empty = int(np.isnan(self.values).sum())
        if empty:
            raise ValueError(
                f'table: expected a value in every cell but found {empty} empty ones; call '
                "'complete' first"
            )
        return RuleTable(self.centres, tuple(tuple(row) for row in self.values.tolist()))


def learn_rules(
    records: ArrayLike,
    method: str = 'wm',
    *,
    centres: tuple[float, ...] = CENTRES,
    smoothing: float = 0.005,
) -> LearnedRules:
    """Learn the consequents of the rules from records.

    Parameters
    ----------
    records : array_like, shape (n, 3) or (n, 4)
        Normalised error, error rate and duty [-]; beyond the end centres they count as those.
        Signs as in the rule table: positive duty drives to negative positions, and the rate is the
        derivative of the error.  Records that are zero throughout do not count.  A fourth column
        that is not zero says that the duty was cut, and so only that it was to be no smaller:
        `wm` takes such a duty for full, `lsq` for a lower bound.
    method : {'wm', 'lsq'}
        `wm`, Wang-Mendel as published: the strongest record of a cell decides it, by the set its
        duty belongs to most.  `lsq`: all consequents at once by least squares, smooth between
        neighbours, odd and at most 1; every cell within reach of the records gets a value.
    centres : tuple of float
        Centres of the sets of all three [-].
    smoothing : float
        Weight of the differences between neighbours against the records, `lsq` alone; above 0.

    Returns
    -------
    LearnedRules
        Consequents with coverage and conflicts.  `wm` leaves cells empty; `complete` fills them.

    Raises
    ------
    ValueError
        If the records are not n rows of three finite numbers, none counts, or the method is
        unknown.

    Examples
    --------
    >>> rules = learn_rules([(-0.932, 0.497, 1.0), (0.932, -0.497, -1.0)])
    >>> float(rules.values[0, 3]), round(float(rules.strength[0, 3]), 3), rules.used
    (1.0, 0.404, 2)
    """
    check_centres('centres', centres)
    if method not in _METHODS:
        raise ValueError(f'method: expected one of {", ".join(_METHODS)} but found {method!r}')
    rows = np.asarray(records, dtype=np.float64)
    if rows.ndim != 2 or rows.shape[1] not in (3, 4) or not np.isfinite(rows).all():
        raise ValueError(
            'records: expected rows of three or four finite numbers (error, rate, duty, cut) but '
            'found the '
            f'shape {rows.shape}' + ('' if np.isfinite(rows).all() else ' with NaN or infinity')
        )
    place = np.flatnonzero((rows[:, :3] != 0.0).any(axis=1))
    if not len(place):
        raise ValueError('records: expected one that is not zero throughout but found none')
    error, rate, duty = rows[place, :3].T
    cut = np.asarray(rows[place, 3:].any(axis=1))
    degrees = [memberships(error, centres), memberships(rate, centres)]
    if method == 'wm':
        degrees.append(memberships(np.where(cut, np.sign(duty), duty), centres))
        return _wang_mendel(degrees, place, centres)
    if not (np.isfinite(smoothing) and smoothing > 0.0):
        raise ValueError(f'smoothing: expected a positive number but found {smoothing}')
    degrees.append(memberships(duty, centres))
    return _least_squares(degrees, duty, cut, centres, smoothing)


def records_of_run(
    reference: ArrayLike,
    position: ArrayLike,
    duty: ArrayLike,
    controller: VariableUniverseController,
    *,
    velocity: ArrayLike | None = None,
    acceleration: ArrayLike | None = None,
) -> Array:
    """Return records for `learn_rules` from the recorded run of any controller.

    Parameters
    ----------
    reference, position, duty : array_like, shape (n,)
        Reference and reading [m] and duty [-], one per control period.
    controller : VariableUniverseController
        Controller that is to use the rules.  Errors and rates are those that it would have seen
        and on its contracted universes, duties are less the disturbance and the motion of the
        reference that it would have made up for, divided by its output gain, and signs are those
        of its table.
    velocity, acceleration : array_like, shape (n,), optional
        Derivatives of the reference [m/s, m/s^2]; by default it rests.

    Returns
    -------
    ndarray, shape (n - 1, 4)
        Contracted error and rate, output [-], and whether the duty was cut.

    Raises
    ------
    ValueError
        If the shapes differ or a number is not finite.
    """
    columns = [np.asarray(part, dtype=np.float64) for part in (reference, position, duty)]
    for motion in (velocity, acceleration):
        still = np.zeros(len(columns[0]))
        columns.append(still if motion is None else np.asarray(motion, dtype=np.float64))
    if len({column.shape for column in columns}) > 1 or columns[0].ndim != 1:
        raise ValueError(
            'records_of_run: expected one reference, position and duty per period but found the '
            f'shapes {", ".join(str(column.shape) for column in columns[:3])}'
        )
    if not np.isfinite(columns).all():
        raise ValueError('records_of_run: expected finite numbers only; cut the gaps out')
    target, reading, driven, speed, change = columns
    place, rate, disturbance = controller.estimates(reading, driven)
    x, y = controller.contracted(target - place, speed - rate)
    sign = -1.0 if controller.axis.gain > 0.0 else 1.0
    made_up = disturbance + controller.feedforward(speed, change)
    output = sign * (driven - made_up) / controller.params.output_gain
    cut = np.abs(driven) >= _CUT * controller.duty_max
    return np.column_stack([x, y, np.clip(output, -1.0, 1.0), cut])[1:]


def _wang_mendel(
    degrees: list[Array], place: NDArray[np.int64], centres: tuple[float, ...]
) -> LearnedRules:
    """Let the strongest record of every cell decide."""
    size = len(centres)
    best = [degree.argmax(axis=0) for degree in degrees]
    top = [degree.max(axis=0) for degree in degrees]
    second = [np.sort(degree, axis=0)[-2] for degree in degrees]
    # a value in the middle between two sets, zero above all, names none of them
    clear = np.all([high - low > _TIED for high, low in zip(top, second, strict=True)], axis=0)
    values = np.full((size, size), np.nan)
    strength = np.zeros((size, size))
    count, conflicts = np.zeros((2, size, size), dtype=np.int64)
    winner = np.full((size, size), -1, dtype=np.int64)
    product = top[0] * top[1] * top[2]
    for k in np.flatnonzero(clear):
        i, j = best[0][k], best[1][k]
        count[i, j] += 1
        if product[k] > strength[i, j]:
            strength[i, j], winner[i, j] = product[k], place[k]
            values[i, j] = centres[best[2][k]]
    for k in np.flatnonzero(clear):
        i, j = best[0][k], best[1][k]
        conflicts[i, j] += values[i, j] != centres[best[2][k]]
    source = _sources(count)
    return LearnedRules(
        values, strength, count, conflicts, winner, source, int(clear.sum()), centres
    )


def _least_squares(
    degrees: list[Array],
    duty: Array,
    cut: NDArray[np.bool_],
    centres: tuple[float, ...],
    smoothing: float,
) -> LearnedRules:
    """Fit all consequents at once, odd and smooth; cut duties pull from one side alone."""
    size = len(centres)
    firing = np.einsum('in,jn->nij', degrees[0], degrees[1]).reshape(len(duty), -1)
    half = size * size // 2
    # odd table: the second half is minus the first, read backwards
    design = firing[:, :half] - firing[:, ::-1][:, :half]
    between = _differences(size)
    smooth = between[:, :half] - between[:, ::-1][:, :half]
    weight = smoothing * np.sqrt(len(duty)) / size
    pulls = np.ones(len(duty), dtype=bool)
    for _ in range(_PASSES):
        matrix = np.vstack([design[pulls], weight * smooth])
        target = np.append(duty[pulls], np.zeros(len(smooth)))
        first = lsq_linear(matrix, target, (-1.0, 1.0)).x
        short = (duty - design @ first) * np.sign(duty) > 0.0
        before, pulls = pulls, ~cut | short
        if (before == pulls).all():
            break
    middle = np.zeros(size * size % 2)
    values = np.concatenate([first, middle, -first[::-1]]).reshape(size, size)
    best = [degree.argmax(axis=0) for degree in degrees]
    count, conflicts = np.zeros((2, size, size), dtype=np.int64)
    np.add.at(count, (best[0], best[1]), 1)
    nearest = np.abs(np.subtract.outer(values, np.array(centres))).argmin(axis=-1)
    np.add.at(conflicts, (best[0], best[1]), nearest[best[0], best[1]] != best[2])
    return LearnedRules(
        values,
        firing.sum(axis=0).reshape(size, size),
        count,
        conflicts,
        np.full((size, size), -1, dtype=np.int64),
        _sources(count, FILLED),
        len(duty),
        centres,
    )


def _sources(count: NDArray[np.int64], other: str = EMPTY) -> tuple[tuple[str, ...], ...]:
    """Return where the values of cells with a number of records are from."""
    return tuple(tuple(DATA if n else other for n in row) for row in count.tolist())


def _differences(size: int) -> Array:
    """Return the matrix of differences between neighbouring cells of a square table."""
    number = np.arange(size * size).reshape(size, size)
    pairs = np.concatenate(
        [
            np.column_stack([number[:-1].ravel(), number[1:].ravel()]),
            np.column_stack([number[:, :-1].ravel(), number[:, 1:].ravel()]),
        ]
    )
    matrix = np.zeros((len(pairs), size * size))
    matrix[np.arange(len(pairs)), pairs[:, 0]] = 1.0
    matrix[np.arange(len(pairs)), pairs[:, 1]] = -1.0
    return matrix

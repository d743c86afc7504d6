# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""One period of the observer as plain arithmetic, written out for the axes that there are.

numpy starts up anew for every product of a small matrix, and loops over its rows take five times
what the products take.  The axis is a chain, in which nothing acts on what lies ahead of it: its
dynamics are a lower triangle, and the sums over its rows can be written out.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from fuzzycnc_ros.core.arrays import Array

Predict = Callable[[tuple[float, ...], float, float], tuple[float, ...]]
"""Predictor of one period: states with the disturbance last, duty and reading in, states out."""


_Rows = list[list[float]]


def predictor(dynamics: Array, duty: Array, reading: Array, gain: Array) -> Predict:
    """Return x -> dynamics x + duty u + gain (y - reading x) as a function of tuples.

    Parameters
    ----------
    dynamics : ndarray, shape (n, n)
        Transition of one period; the disturbance is the last state.
    duty, reading, gain : ndarray, shape (n,)
        Entry of the duty, row that gives the reading, and what a difference between reading and
        prediction adds.

    Returns
    -------
    callable
        Written out for chains of 2 to 5 states that are read at their end; loops for others.

    Examples
    --------
    >>> dynamics = np.array([[0.9, 0.0, -0.1], [0.5, 1.0, 0.0], [0.0, 0.0, 1.0]])
    >>> duty, reading, gain = np.array([0.1, 0.0, 0.0]), np.eye(3)[1], np.array([0.0, 0.5, 0.0])
    >>> step = predictor(dynamics, duty, reading, gain)
    >>> step((1.0, 0.0, 2.0), 3.0, 4.0)
    (1.0, 2.5, 2.0)
    """
    size = len(dynamics) - 1
    unit = np.eye(size + 1)
    chain = (
        size in _CHAINS
        and not np.triu(dynamics[:-1, :-1], 1).any()
        and np.array_equal(dynamics[-1], unit[-1])
        and np.array_equal(reading, unit[-2])
        and not duty[-1]
    )
    if not chain:
        return _loops(dynamics, duty, reading, gain)
    # per row: what the states up to it, disturbance, duty and difference add
    columns = np.column_stack([dynamics[:-1, -1], duty[:-1], gain[:-1]]).tolist()
    rows = [[*dynamics[i, : i + 1].tolist(), *columns[i]] for i in range(size)]
    return _CHAINS[size](rows, float(gain[-1]))


def _loops(dynamics: Array, duty: Array, reading: Array, gain: Array) -> Predict:
    """Return the predictor of any model."""
    inner = dynamics - np.outer(gain, reading)
    rows = np.column_stack([inner, duty, gain]).tolist()

    def step(state: tuple[float, ...], u: float, y: float) -> tuple[float, ...]:
        known = (*state, u, y)
        return tuple(sum(k * x for k, x in zip(row, known, strict=True)) for row in rows)

    return step


def _chain_2(rows: _Rows, wander: float) -> Predict:
    a00, d0, u0, g0 = rows[0]
    a10, a11, d1, u1, g1 = rows[1]

    def step(state: tuple[float, ...], u: float, y: float) -> tuple[float, ...]:
        x0, x1, d = state
        s = y - x1
        return (
            a00 * x0 + d0 * d + u0 * u + g0 * s,
            a10 * x0 + a11 * x1 + d1 * d + u1 * u + g1 * s,
            d + wander * s,
        )

    return step


def _chain_3(rows: _Rows, wander: float) -> Predict:
    a00, d0, u0, g0 = rows[0]
    a10, a11, d1, u1, g1 = rows[1]
    a20, a21, a22, d2, u2, g2 = rows[2]

    def step(state: tuple[float, ...], u: float, y: float) -> tuple[float, ...]:
        x0, x1, x2, d = state
        s = y - x2
        return (
            a00 * x0 + d0 * d + u0 * u + g0 * s,
            a10 * x0 + a11 * x1 + d1 * d + u1 * u + g1 * s,
            a20 * x0 + a21 * x1 + a22 * x2 + d2 * d + u2 * u + g2 * s,
            d + wander * s,
        )

    return step


def _chain_4(rows: _Rows, wander: float) -> Predict:
    a00, d0, u0, g0 = rows[0]
    a10, a11, d1, u1, g1 = rows[1]
    a20, a21, a22, d2, u2, g2 = rows[2]
    a30, a31, a32, a33, d3, u3, g3 = rows[3]

    def step(state: tuple[float, ...], u: float, y: float) -> tuple[float, ...]:
        x0, x1, x2, x3, d = state
        s = y - x3
        return (
            a00 * x0 + d0 * d + u0 * u + g0 * s,
            a10 * x0 + a11 * x1 + d1 * d + u1 * u + g1 * s,
            a20 * x0 + a21 * x1 + a22 * x2 + d2 * d + u2 * u + g2 * s,
            a30 * x0 + a31 * x1 + a32 * x2 + a33 * x3 + d3 * d + u3 * u + g3 * s,
            d + wander * s,
        )

    return step


def _chain_5(rows: _Rows, wander: float) -> Predict:
    a00, d0, u0, g0 = rows[0]
    a10, a11, d1, u1, g1 = rows[1]
    a20, a21, a22, d2, u2, g2 = rows[2]
    a30, a31, a32, a33, d3, u3, g3 = rows[3]
    a40, a41, a42, a43, a44, d4, u4, g4 = rows[4]

    def step(state: tuple[float, ...], u: float, y: float) -> tuple[float, ...]:
        x0, x1, x2, x3, x4, d = state
        s = y - x4
        return (
            a00 * x0 + d0 * d + u0 * u + g0 * s,
            a10 * x0 + a11 * x1 + d1 * d + u1 * u + g1 * s,
            a20 * x0 + a21 * x1 + a22 * x2 + d2 * d + u2 * u + g2 * s,
            a30 * x0 + a31 * x1 + a32 * x2 + a33 * x3 + d3 * d + u3 * u + g3 * s,
            a40 * x0 + a41 * x1 + a42 * x2 + a43 * x3 + a44 * x4 + d4 * d + u4 * u + g4 * s,
            d + wander * s,
        )

    return step


_CHAINS: dict[int, Callable[[_Rows, float], Predict]] = {
    2: _chain_2,
    3: _chain_3,
    4: _chain_4,
    5: _chain_5,
}

# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Linear stages in front of a network: ridge regression, anchored at zero rise or not."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fuzzycnc_ros.core.arrays import Array
from fuzzycnc_ros.core.thermal.fit.linear import column_scale, ridge_solution
from fuzzycnc_ros.core.thermal.fit.tanh_network import SOLVERS, TanhNetwork
from fuzzycnc_ros.core.thermal.recursions.filters import DELAY_MAX, FilterNetworkRecursion

HEADROOM = 0.9
"""Part of the network's output range that the deformation may take up in training, 45 of 50 um;
nearer to the ends tanh hardly moves any more."""

WIDENED = 2.0
"""Output range that replaces one too narrow, as a multiple of the largest deformation [-].

A range that training fills to nine tenths has no room for a longer or hotter run: on a recorded
spindle the residuals of unseen cycles were up to 8 % larger than with twice the deformation."""


@dataclass(frozen=True, eq=False)
class LinearFilter:
    """One linear stage.

    Parameters
    ----------
    weight : ndarray, shape (q,)
        Weight of each column.
    offset : float
        Constant [m]; 0 if anchored.
    """

    weight: Array
    offset: float

    def __call__(self, columns: Array) -> Array:
        """Return the values (n,) [m] for columns (n, q)."""
        return np.asarray(columns @ self.weight + self.offset)


def fit_filter(columns: Array, target: Array, ridge: float, anchored: bool) -> LinearFilter:
    """Fit one linear stage by ridge regression.

    Parameters
    ----------
    columns : ndarray, shape (n, q)
        Regressors.
    target : ndarray, shape (n,)
        Measured deformation [m].
    ridge : float
        Penalty per sample on the weights of the scaled columns [-].
    anchored : bool
        True: no constant, columns divided by their root mean square about zero.  False: the
        constant is free, columns are centred and divided by their standard deviation.
    """
    if anchored:
        scale = np.sqrt((columns**2).mean(axis=0))
        scale = np.where(scale > 0.0, scale, 1.0)
        return LinearFilter(ridge_solution(columns / scale, target, ridge) / scale, 0.0)
    scale = column_scale(columns)
    center, level = columns.mean(axis=0), float(target.mean())
    weight = ridge_solution((columns - center) / scale, target - level, ridge) / scale
    return LinearFilter(weight, level - float(center @ weight))


@dataclass(frozen=True, eq=False)
class NetworkTraining:
    """Training data of all models of the family.

    Parameters
    ----------
    rise : ndarray, shape (n, p)
        Rises; those of sensors that stood still in training are zero [K].
    target : ndarray, shape (n,)
        Deformation, NaN where it was not measured [m].
    rows : list of slice
        Rows of each run.
    idle : ndarray of int
        Sensors that stood still in training.
    scale : float
        Output range 1 / C_Y of the network [m].
    """

    rise: Array
    target: Array
    rows: list[slice]
    idle: NDArray[np.int64]
    scale: float

    @property
    def measured(self) -> NDArray[np.bool_]:
        """Samples whose deformation was measured, shape (n,)."""
        return np.isfinite(self.target)


def network_training(
    rise: Array,
    values: Array,
    rows: list[slice],
    output_range: float,
    least: int,
) -> NetworkTraining:
    """Drop sensors that stood still and find the output range.

    Parameters
    ----------
    rise : ndarray, shape (n, p)
        Rises [K].
    values : ndarray, shape (n,)
        Deformation [m]; NaN where nothing was measured.
    rows : list of slice
        Rows of each run.
    output_range : float
        Wanted output range 1 / C_Y [m]; where the measured deformation takes up more than nine
        tenths of it, twice the largest deformation takes its place.
    least : int
        Fewest measured samples.

    Raises
    ------
    ValueError
        If there are too few measured samples, or the range is not positive.
    """
    if not (np.isfinite(output_range) and output_range > 0.0):
        raise ValueError(
            f'output_range: expected a positive number of m, but found {output_range}'
        )
    count = int(np.isfinite(values).sum())
    if count < least:
        raise ValueError(
            f'y: expected at least {least} measured samples for the delays and the '
            f'history of the model, but found {count} samples of {rise.shape[1]} feature(s); '
            'record longer'
        )
    idle = np.flatnonzero(np.ptp(rise, axis=0) == 0.0)
    if len(idle):
        rise = rise.copy()
        rise[:, idle] = 0.0
    largest = float(np.nanmax(np.abs(values)))
    scale = output_range if largest <= HEADROOM * output_range else WIDENED * largest
    return NetworkTraining(rise, values, rows, idle, scale)


def check_filter_ridge(ridge: float, columns: int, samples: int) -> None:
    """Refuse a penalty that is negative, or none where there are too few samples to go without.

    Raises
    ------
    ValueError
        The message names the remedy.
    """
    if not (np.isfinite(ridge) and ridge >= 0.0):
        raise ValueError(f'ridge: expected 0 or a positive number, but found {ridge}')
    if ridge == 0.0 and columns >= samples:
        raise ValueError(
            f'ridge: expected a positive number for {columns} columns and {samples} samples, '
            'but found 0; take 1e-3'
        )


def check_delays(delays: Sequence[int], least: int) -> NDArray[np.int64]:
    """Return delays in samples after refusing what is not whole, ascending and large enough."""
    values = np.asarray(delays, dtype=np.float64)
    whole = values.ndim == 1 and values.size > 0 and bool((values == np.rint(values)).all())
    if not whole or values[0] < least or values[-1] > DELAY_MAX or (np.diff(values) <= 0.0).any():
        raise ValueError(
            f'delays: expected ascending whole numbers of samples from {least} to {DELAY_MAX}, '
            f'but found {delays}'
        )
    return values.astype(np.int64)


def check_choices(hidden: int, solver: str) -> None:
    """Refuse a network without hidden nodes and a solver that there is not."""
    if not hidden >= 1:
        raise ValueError(f'hidden: expected 1 node or more, but found {hidden}')
    if solver not in SOLVERS:
        raise ValueError(f'solver: expected one of {", ".join(SOLVERS)}, but found {solver!r}')


def network_recursion(
    network: TanhNetwork,
    delay: NDArray[np.int64],
    weight: Array,
    constant: Array,
    scale: float,
    feedback: Array | None = None,
) -> FilterNetworkRecursion:
    """Return linear stages and network as one recursion of one channel.

    Parameters
    ----------
    network : TanhNetwork
        Network of i inputs and h hidden nodes.
    delay : ndarray of int, shape (m,)
        Delays of the rises [samples].
    weight : ndarray, shape (i, m p)
        Weight of each delayed rise in each input of the network [1/K].
    constant : ndarray, shape (i,)
        Constant of each input of the network [-].
    scale : float
        Output range 1 / C_Y [m].
    feedback : ndarray, shape (h, K), optional
        Weight of each past output in each hidden node [1/m]; none feeds back if absent.
    """
    hidden = len(network.bias)
    past_weight = np.zeros((hidden, 0)) if feedback is None else feedback
    return FilterNetworkRecursion(
        delay=delay.astype(np.int64),
        inner=(network.inner @ weight)[np.newaxis],
        feedback=past_weight[np.newaxis],
        bias=(network.bias + network.inner @ constant)[np.newaxis],
        outer=network.outer[np.newaxis],
        offset=np.array([network.offset]),
        scale=np.array([scale]),
    )


def samples_min(history: int, delays: NDArray[np.int64]) -> int:
    """Return the fewest measured samples, 3 (K + J) + 10.

    Parameters
    ----------
    history : int
        Number K of past outputs.
    delays : ndarray of int, shape (m,)
        Delays of the rises [samples]; J of them reach back.
    """
    return 3 * (history + int((delays > 0).sum())) + 10


def past(values: Array, rows: Sequence[slice], history: int) -> Array:
    """Return the last values of each run before each sample; before a run they are zero.

    Returns
    -------
    ndarray, shape (n, history)
        Values one sample ago, two samples ago, and so on.
    """
    found = np.zeros((len(values), history))
    for run in rows:
        for lag in range(1, min(history, run.stop - run.start) + 1):
            found[run.start + lag : run.stop, lag - 1] = values[run.start : run.stop - lag]
    return found

# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Stages of the hybrid filter network: LR and MA in front, AR behind them, then the network."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fuzzycnc_ros.core.arrays import Array
from fuzzycnc_ros.core.thermal.networks.filters import (
    LinearFilter,
    NetworkTraining,
    fit_filter,
    network_recursion,
)
from fuzzycnc_ros.core.thermal.networks.tanh_network import TanhNetwork
from fuzzycnc_ros.core.thermal.recursions.delayed import delayed_rises
from fuzzycnc_ros.core.thermal.recursions.filter_network import FilterNetworkRecursion


@dataclass(frozen=True, eq=False)
class Front:
    """LR and MA, with their outputs (n, N - 1) [m] on the training samples."""

    delays: NDArray[np.int64]
    filters: tuple[LinearFilter, ...]
    weight: Array
    offset: Array
    values: Array

    @staticmethod
    def fitted(
        data: NetworkTraining,
        delays: NDArray[np.int64],
        moving_average: str,
        ridge: float,
        anchored: bool,
    ) -> 'Front':
        """Fit LR on the present rises, MA on those of the past."""
        inputs = data.rise.shape[1]
        columns = delayed_rises(data.rise, data.rows, np.append(0, delays))
        cuts = [slice(0, inputs), slice(inputs, None)]
        if moving_average == 'per_lag':
            cuts = [slice(k * inputs, (k + 1) * inputs) for k in range(len(delays) + 1)]
        known = data.measured
        filters = tuple(
            fit_filter(columns[known, cut], data.target[known], ridge, anchored) for cut in cuts
        )
        weight = np.zeros((len(cuts), columns.shape[1]))
        for row, cut, item in zip(weight, cuts, filters, strict=True):
            row[cut] = item.weight
        offset = np.array([item.offset for item in filters])
        return Front(delays, filters, weight, offset, columns @ weight.T + offset)


@dataclass(frozen=True, eq=False)
class Feedback:
    """AR: weights of past outputs (K,) and of the other filters (N - 1,) [-], constant [m]."""

    past: Array
    front: Array
    offset: float

    def __call__(self, history: Array, front: Array) -> Array:
        """Return the values (n,) [m]."""
        return np.asarray(history @ self.past + front @ self.front + self.offset)

    @staticmethod
    def fitted(
        history: Array,
        front: Array,
        target: Array,
        ridge: float,
        anchored: bool,
        bound: float | None,
    ) -> 'Feedback':
        """Fit AR; with a bound its weights of the past are not negative, their sum below it."""
        lags = history.shape[1]
        both = fit_filter(np.hstack([history, front]), target, ridge, anchored)
        if bound is None:
            return Feedback(both.weight[:lags], both.weight[lags:], both.offset)
        weight = np.maximum(both.weight[:lags], 0.0)
        weight *= min(1.0, bound / max(float(weight.sum()), 1e-300))
        if np.array_equal(weight, both.weight[:lags]):
            return Feedback(weight, both.weight[lags:], both.offset)
        rest = fit_filter(front, target - history @ weight, ridge, anchored)
        return Feedback(weight, rest.weight, rest.offset)


@dataclass(frozen=True, eq=False)
class Fit:
    """A trained network with what it was made of, and its inputs (n, N) in free run [-]."""

    front: Front
    feedback: Array
    network: TanhNetwork
    recursion: FilterNetworkRecursion
    loop_gain: float
    inputs: Array


def hybrid_recursion(
    front: Front, back: Feedback, network: TanhNetwork, scale: float
) -> FilterNetworkRecursion:
    """Return filters and network as one: the product of linear maps is one."""
    rises = np.vstack([front.weight, back.front @ front.weight]) / scale
    constant = np.append(front.offset, back.front @ front.offset + back.offset) / scale
    return network_recursion(
        network,
        np.append(0, front.delays),
        rises,
        constant,
        scale,
        feedback=np.outer(network.inner[:, -1], back.past) / scale,
    )

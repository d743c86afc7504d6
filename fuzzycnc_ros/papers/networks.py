# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Rivals of the hybrid filter network: ARMA, plain networks, and LR with a network."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from fuzzycnc_ros.core.arrays import Array, Seed
from fuzzycnc_ros.core.thermal.fit.filters import (
    NetworkTraining,
    check_choices,
    check_delays,
    check_filter_ridge,
    fit_filter,
    network_recursion,
    network_training,
    past,
    samples_min,
)
from fuzzycnc_ros.core.thermal.fit.regressor import ThermalRegressor
from fuzzycnc_ros.core.thermal.fit.tanh_network import (
    WEIGHT_DECAY,
    TanhNetwork,
    train_network,
)
from fuzzycnc_ros.core.thermal.recursions.base import axes, clipped
from fuzzycnc_ros.core.thermal.recursions.filters import (
    DelayedRecursion,
    delayed_rises,
    own_history_columns,
)

EARLY_STOP = 1e-7
"""Fall of the cost, as a part of that of no output at all, at which L-BFGS ends [-].

With more weights than samples the last of the way only learns the noise of the training run."""

_PRESENT = np.array([0])


@dataclass(frozen=True, eq=False)
class MovingAverageRecursion(DelayedRecursion):
    """Autoregressive model with moving averages of the rises [kang2007].

    y(n) = drive x + feedback y(n-1..n-K) + offset, cut at the limit, where x holds the rises at
    all delays.  The cut output is what feeds back: nothing else bounds a recursion that is not
    stable.

    Parameters
    ----------
    delay : ndarray of int, shape (m,)
        Delays of the rises, ascending, 0 is the present sample [samples].
    drive : ndarray, shape (c, m p)
        Weight of each delayed rise [m/K].
    feedback : ndarray, shape (c, K)
        Weight of each past output [-].
    offset : ndarray, shape (c,)
        Constant [m].
    limit : ndarray, shape (c,)
        Largest output [m].
    """

    FORM: ClassVar[str] = 'moving_average'

    drive: Array = field(metadata=axes('c mp'))
    feedback: Array = field(metadata=axes('c k'))
    offset: Array = field(metadata=axes('c'))
    limit: Array = field(metadata=axes('c'))

    def _check(self) -> None:
        super()._check()
        if not (self.limit > 0.0).all():
            raise ValueError(f'limit: expected positive numbers, but found {self.limit}')

    def _linear(self) -> tuple[Array, Array]:
        past = own_history_columns(self.feedback[:, np.newaxis, :])
        return np.hstack([self.drive, past]), self.offset

    def _output(self, activation: Array) -> Array:
        return clipped(activation, self.limit)


@dataclass(kw_only=True, eq=False, repr=False)
class Arma(ThermalRegressor):
    """Autoregressive model with moving averages of the rises [kang2007].

    y(n) = c_0 + sum_k c_k y(n-k) + sum_j b_j x(n-j), fitted with the measured past outputs and
    run with its own.

    Parameters
    ----------
    delays : sequence of int
        Delays of the rises [samples], ascending, from 0 up.
    history : int
        Number K of past outputs, 1 or more.
    ridge : float
        Penalty on the weights of the scaled columns, per sample [-].
    output_range : float
        Where the output is cut [m]; twice the largest measured
        deformation if that takes up more than nine tenths of it.
    interval : float
        Sampling interval of the training samples [s].

    Attributes
    ----------
    feedback_ : ndarray, shape (K,)
        Weights c of the past outputs [-].
    coef_ : ndarray, shape (number of delays, p)
        Weights of the delayed rises [m/K].
    intercept_ : float
        Constant [m].
    problems_ : tuple of str
        Why the fit is not to be trusted; empty if it is.

    Examples
    --------
    >>> rise = np.linspace(0.0, 10.0, 60)[:, np.newaxis]
    >>> model = Arma(ridge=1e-9).fit(rise, 2e-6 * rise[:, 0])
    >>> print((model.predict(rise)[-1] * 1e6).round(1))
    20.0
    """

    delays: Sequence[int] = (1, 2, 3)
    history: int = 3
    ridge: float = 1e-3
    output_range: float = 50e-6
    interval: float = 60.0

    def _fit(self, rise: Array, target: Array, rows: list[slice]) -> None:
        delays = check_delays(self.delays, 0)
        if not self.history >= 1:
            raise ValueError(f'history: expected 1 or more, but found {self.history}')
        least = samples_min(self.history, delays)
        data = network_training(rise, target, rows, self.output_range, least)
        # Left out are samples whose deformation, or one of the K before it, is NaN.
        history = past(data.target, data.rows, self.history)
        known = data.measured & np.isfinite(history).all(axis=1)
        if known.sum() < least:
            raise ValueError(
                f'y: expected at least {least} samples measured together with the '
                f'{self.history} before them, but found {int(known.sum())}; probe every sample'
            )
        rises = delayed_rises(data.rise, data.rows, delays)
        columns = np.hstack([history, rises])[known]
        check_filter_ridge(self.ridge, columns.shape[1], len(columns))
        fitted = fit_filter(columns, data.target[known], self.ridge, anchored=False)
        self.feedback_: Array = fitted.weight[: self.history]
        self.coef_: Array = fitted.weight[self.history :].reshape(len(delays), -1)
        self.intercept_ = fitted.offset
        self.recursion_ = MovingAverageRecursion(
            delay=delays,
            drive=self.coef_.reshape(1, -1),
            feedback=self.feedback_[np.newaxis],
            offset=np.array([fitted.offset]),
            limit=np.array([data.scale]),
        )
        root = float(np.abs(np.roots(np.append(1.0, -self.feedback_))).max(initial=0.0))
        self.problems_: tuple[str, ...] = ()
        if root >= 1.0:
            self.problems_ = (
                f'a root of the recursion, {root:.3g}, is not below 1: it runs away until it '
                'is cut',
            )


class _PlainNetwork(ThermalRegressor):
    """Base of the networks without feedback: what differs is what their inputs are.

    Attributes
    ----------
    network_ : TanhNetwork
        The trained network.
    scale_ : float
        Output range 1 / C_Y in use [m].
    idle_ : ndarray of int
        Inputs that stood still in training and are ignored.
    problems_ : tuple of str
        Why the fit is not to be trusted; empty if it is.
    """

    hidden: int
    solver: str
    output_range: float
    random_state: Seed

    def _train(
        self, data: NetworkTraining, delay: NDArray[np.int64], weight: Array, constant: Array
    ) -> None:
        """Train on the delayed rises times `weight` (i, m p) plus `constant` (i,) [-]."""
        check_choices(self.hidden, self.solver)
        known = data.measured
        inputs = delayed_rises(data.rise, data.rows, delay)[known] @ weight.T + constant
        rng = np.random.default_rng(self.random_state)
        self.network_ = train_network(
            TanhNetwork.drawn(len(weight), self.hidden, rng),
            inputs,
            data.target[known] / data.scale,
            decay=WEIGHT_DECAY,
            mean=False,
            solver=self.solver,
            fall_min=EARLY_STOP,
        )
        self.recursion_ = network_recursion(self.network_, delay, weight, constant, data.scale)
        self.scale_, self.idle_ = data.scale, data.idle
        self.problems_: tuple[str, ...] = ()


@dataclass(kw_only=True, eq=False, repr=False)
class LinearNetwork(_PlainNetwork):
    """Linear regression whose output feeds a small network (LR/NN) [kang2007].

    Parameters
    ----------
    hidden : int
        Number of hidden nodes.
    ridge : float
        Penalty of the regression per sample [-].
    solver : {'lm', 'lbfgs'}
        Levenberg-Marquardt, or L-BFGS.
    output_range : float
        Output range 1 / C_Y of the network [m]; twice the largest measured
        deformation if that takes up more than nine tenths of it.
    interval : float
        Sampling interval of the training samples [s].
    random_state : int, numpy.random.Generator or None
        Seed of the network's first weights.

    Attributes
    ----------
    linear_ : LinearFilter
        The regression [m/K].
    """

    hidden: int = 30
    ridge: float = 1e-3
    solver: str = 'lm'
    output_range: float = 50e-6
    interval: float = 60.0
    random_state: Seed = 0

    def _fit(self, rise: Array, target: Array, rows: list[slice]) -> None:
        data = network_training(rise, target, rows, self.output_range, samples_min(0, _PRESENT))
        known = data.measured
        check_filter_ridge(self.ridge, data.rise.shape[1], int(known.sum()))
        self.linear_ = fit_filter(data.rise[known], data.target[known], self.ridge, False)
        weight = self.linear_.weight[np.newaxis] / data.scale
        self._train(data, _PRESENT, weight, np.array([self.linear_.offset / data.scale]))


@dataclass(kw_only=True, eq=False, repr=False)
class StaticNetwork(_PlainNetwork):
    """Network on the present rises (FNN) [kang2007].

    Parameters
    ----------
    hidden : int
        Number of hidden nodes.
    solver : {'lm', 'lbfgs'}
        Levenberg-Marquardt, or L-BFGS, which takes far less time with many inputs.
    output_range : float
        Output range 1 / C_Y of the network [m]; twice the largest measured
        deformation if that takes up more than nine tenths of it.
    interval : float
        Sampling interval of the training samples [s].
    random_state : int, numpy.random.Generator or None
        Seed of the network's first weights.

    Notes
    -----
    All rises are divided by one common maximum: a scale for each sensor would blow up those
    that hardly warm.
    """

    hidden: int = 30
    solver: str = 'lbfgs'
    output_range: float = 50e-6
    interval: float = 60.0
    random_state: Seed = 0

    def _fit(self, rise: Array, target: Array, rows: list[slice]) -> None:
        data = network_training(rise, target, rows, self.output_range, samples_min(0, _PRESENT))
        self._train(data, _PRESENT, *_common_scale(data, 1))


@dataclass(kw_only=True, eq=False, repr=False)
class DynamicNetwork(_PlainNetwork):
    """Network on the rises of the last samples [kang2007].

    Parameters
    ----------
    delays : sequence of int
        Delays of the rises [samples], ascending, from 0 up.
    hidden : int
        Number of hidden nodes.
    solver : {'lbfgs', 'lm'}
        L-BFGS, or Levenberg-Marquardt, which takes minutes with thousands of weights.
    output_range : float
        Output range 1 / C_Y of the network [m]; twice the largest measured
        deformation if that takes up more than nine tenths of it.
    interval : float
        Sampling interval of the training samples [s].
    random_state : int, numpy.random.Generator or None
        Seed of the network's first weights.

    Notes
    -----
    With ten times as many weights as samples it is the worst of the family off its training
    run; it is here to be compared.
    """

    delays: Sequence[int] = (0, 1, 2, 3)
    hidden: int = 30
    solver: str = 'lbfgs'
    output_range: float = 50e-6
    interval: float = 60.0
    random_state: Seed = 0

    def _fit(self, rise: Array, target: Array, rows: list[slice]) -> None:
        delays = check_delays(self.delays, 0)
        least = samples_min(0, delays)
        data = network_training(rise, target, rows, self.output_range, least)
        self._train(data, delays, *_common_scale(data, len(delays)))


def _common_scale(data: NetworkTraining, delays: int) -> tuple[Array, Array]:
    """Return the map that divides all delayed rises by the largest rise, and no constants.

    Sensors that stood still in training are left out: nothing would have trained their weights.
    """
    used = np.ones(data.rise.shape[1])
    used[data.idle] = 0.0
    largest = float(np.abs(data.rise[data.measured]).max()) or 1.0
    weight = np.diag(np.tile(used, delays)) / largest
    return weight, np.zeros(len(weight))

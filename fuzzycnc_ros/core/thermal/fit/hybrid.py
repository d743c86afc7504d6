# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The hybrid filter network: LR, MA and AR filters that feed a small network."""

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from fuzzycnc_ros.core.arrays import Array, Seed
from fuzzycnc_ros.core.thermal.fit.filters import (
    HEADROOM,
    LinearFilter,
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
from fuzzycnc_ros.core.thermal.recursions.filters import FilterNetworkRecursion, delayed_rises


@dataclass(frozen=True, eq=False)
class Front:
    """LR and MA, with their outputs (n, N - 1) [m] on the training samples."""

    delays: NDArray[np.int64]
    filters: tuple[LinearFilter, LinearFilter]
    weight: Array
    offset: Array
    values: Array

    @staticmethod
    def fitted(
        data: NetworkTraining,
        delays: NDArray[np.int64],
        ridge: float,
        anchored: bool,
    ) -> 'Front':
        """Fit LR on the present rises, MA on those of the past."""
        inputs = data.rise.shape[1]
        columns = delayed_rises(data.rise, data.rows, np.append(0, delays))
        cuts = [slice(0, inputs), slice(inputs, None)]
        known = data.measured
        linear, moving = (
            fit_filter(columns[known, cut], data.target[known], ridge, anchored) for cut in cuts
        )
        filters = linear, moving
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
class _Fit:
    """A trained network with what it was made of, and its inputs (n, N) in free run [-]."""

    front: Front
    feedback: Array
    network: TanhNetwork
    recursion: FilterNetworkRecursion
    loop_gain: float
    inputs: Array


def _hybrid_recursion(
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


class _OfTraining(FilterNetworkRecursion):
    """The recursion in the arithmetic of this processor, in a third of the time.

    What training finds is a file; its digits need not be those of another computer.
    """

    def _output(self, activation: Array) -> Array:
        return np.asarray(self.scale * np.tanh(np.tanh(activation) @ self._outer.T + self.offset))


MOVING_AVERAGES = ('sum', 'first')
"""Readings of the MA filter [kang2007]."""

_GAIN_MAX = 0.97
"""Loop gain that the guard keeps the recursion below [-]."""

GUARD_ROUNDS = 4
"""Attempts of the guard to lower the feedback's bound before it drops the feedback."""

GUARD_STEP = 0.8
"""Factor by which the guard lowers the bound of the feedback [-]."""


@dataclass(kw_only=True, eq=False, repr=False)
class HybridFilterNetwork(ThermalRegressor):
    """Three linear filters that feed a small tanh network [kang2007].

    LR sees the present rises, MA those of the last samples, AR the model's own last outputs and
    the other filters; the network blends them.

    Parameters
    ----------
    moving_average : {'sum', 'first'}
        One MA filter over all delays, or over the first one only.
    delays : sequence of int
        Delays of the MA filter [samples], ascending, from 1 up; (10, 20, 30) reaches further
        back and is better only where training covers what it will meet.
    history : int
        Number K of own past outputs in the AR filter, 1 or more.
    hidden : int
        Number of hidden nodes.
    ridge : float
        Penalty of the filters per sample [-].
    solver : {'lm', 'lbfgs'}
        Levenberg-Marquardt, or L-BFGS; both end at the same figures, the first in less time.
    refits : int
        How often AR and network are fitted again on the model's own past outputs, after the
        first fit on the measured ones ("teacher forcing"); 0 leaves it at that, as published.
    guard : bool
        Whether AR weights are kept positive and below `feedback_max` in sum, the loop gain
        below 0.97, and the network calm by a decay against the mean of the squared residuals.
    anchored : bool
        Whether the filters go without a constant, so that they give zero at zero rise.
    feedback_max : float
        Largest sum of the AR weights of past outputs under guard, in (0, 1) [-].
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
        The LR filter [m/K].
    moving_ : LinearFilter
        The MA filter [m/K].
    feedback_ : ndarray, shape (K,)
        AR weights c of the own past outputs [-].
    network_ : TanhNetwork
        The network, on the filters' outputs divided by `scale_`.
    loop_gain_ : float
        Largest gain from an own past output to the next one over the training samples [-].
    scale_ : float
        Output range 1 / C_Y in use [m].
    recursion_off_ : bool
        Whether the guard took the feedback out, since none kept the loop gain below 0.97; what
        is left is safe, a network without a memory of its own output.
    idle_ : ndarray of int
        Inputs that stood still in training and are ignored.
    problems_ : tuple of str
        Why the fit is not to be trusted; empty if it is.

    Notes
    -----
    As published (teacher forcing, constants in the filters, no guard) the recursion can be
    unstable, with only tanh to bound it.  Guard and anchoring are on unless switched off.
    Where the deformation was probed too rarely for teacher forcing, the output of LR stands in
    for the measured history.

    Examples
    --------
    >>> time = np.arange(300.0)
    >>> rise = np.column_stack([8.0 - 8.0 * np.exp(-time / 60.0), 0.01 * time])
    >>> target = 1e-6 * (rise[:, 0] - 2.0 * rise[:, 1])
    >>> model = HybridFilterNetwork().fit(rise, target)
    >>> bool(np.abs(model.predict(rise) - target).max() < 0.2e-6), model.problems_
    (True, ())
    """

    moving_average: str = 'sum'
    delays: Sequence[int] = (1, 2, 3)
    history: int = 1
    hidden: int = 30
    ridge: float = 1e-3
    solver: str = 'lm'
    refits: int = 1
    guard: bool = True
    anchored: bool = True
    feedback_max: float = 0.95
    output_range: float = 50e-6
    interval: float = 60.0
    random_state: Seed = 0

    def _fit(self, rise: Array, target: Array, rows: list[slice]) -> None:
        delays = self._checked()
        least = samples_min(self.history, delays)
        data = network_training(rise, target, rows, self.output_range, least)
        start = TanhNetwork.drawn(3, self.hidden, np.random.default_rng(self.random_state))
        columns = len(delays) * data.rise.shape[1]
        check_filter_ridge(self.ridge, columns, int(data.measured.sum()))
        fit, problems = self._fitted(data, delays, start)
        self.linear_, self.moving_ = fit.front.filters
        self.feedback_, self.network_ = fit.feedback, fit.network
        self.loop_gain_, self.scale_, self.idle_ = fit.loop_gain, data.scale, data.idle
        self.recursion_ = fit.recursion
        self.recursion_off_ = self.guard and not self.feedback_.any()
        self.problems_ = problems

    def _checked(self) -> NDArray[np.int64]:
        """Return the delays in use after refusing settings out of their range."""
        if self.moving_average not in MOVING_AVERAGES:
            raise ValueError(
                f'moving_average: expected one of {", ".join(MOVING_AVERAGES)}, but found '
                f'{self.moving_average!r}'
            )
        check_choices(self.hidden, self.solver)
        for name, value, least in (('history', self.history, 1), ('refits', self.refits, 0)):
            if not value >= least:
                raise ValueError(f'{name}: expected {least} or more, but found {value}')
        if not 0.0 < self.feedback_max < 1.0:
            raise ValueError(
                f'feedback_max: expected a number in (0, 1), but found {self.feedback_max}'
            )
        delays = check_delays(self.delays, 1)
        return delays[:1] if self.moving_average == 'first' else delays

    def _fitted(
        self, data: NetworkTraining, delays: NDArray[np.int64], start: TanhNetwork
    ) -> tuple[_Fit, tuple[str, ...]]:
        """Return the fit, with its problems."""
        front = Front.fitted(data, delays, self.ridge, self.anchored)
        bound = self.feedback_max if self.guard else None
        fit = self._trained(data, front, bound, start)
        problems = []
        if bound is not None:
            for _ in range(GUARD_ROUNDS):
                if fit.loop_gain < _GAIN_MAX:
                    break
                # A bound above what was fitted would change nothing.
                bound = GUARD_STEP * min(bound, float(fit.feedback.sum()))
                fit = self._trained(data, front, bound, start)
            if fit.loop_gain >= _GAIN_MAX:
                fit = self._trained(data, front, 0.0, start)
        elif fit.loop_gain >= _GAIN_MAX or fit.feedback.sum() >= 1.0:
            problems.append(
                f'the loop gain {fit.loop_gain:.3g} and the sum {fit.feedback.sum():.3g} of the '
                'feedback let the recursion run away: use the guard'
            )
        largest = float(np.abs(fit.inputs).max())
        if largest > HEADROOM:
            problems.append(
                f'a filter takes up {largest:.2f} of the output range in training: raise '
                'output_range or the ridge'
            )
        return fit, tuple(problems)

    def _trained(
        self,
        data: NetworkTraining,
        front: Front,
        bound: float | None,
        network: TanhNetwork,
    ) -> _Fit:
        """Fit AR and network on the measured history, then on the model's own."""
        source = data.target
        known = data.measured & np.isfinite(past(source, data.rows, self.history)).all(axis=1)
        if known.sum() < samples_min(self.history, front.delays):
            source = front.values[:, 0]
        for _ in range(self.refits + 1):
            history = past(source, data.rows, self.history)
            known = data.measured & np.isfinite(history).all(axis=1)
            back = Feedback.fitted(
                history[known],
                front.values[known],
                data.target[known],
                self.ridge,
                self.anchored,
                bound,
            )
            inputs = np.column_stack([front.values, back(history, front.values)]) / data.scale
            network = train_network(
                network,
                inputs[known],
                data.target[known] / data.scale,
                decay=WEIGHT_DECAY,
                mean=self.guard,
                solver=self.solver,
            )
            recursion = _hybrid_recursion(front, back, network, data.scale)
            quick = _OfTraining(
                **{item.name: getattr(recursion, item.name) for item in fields(recursion)}
            )
            source = np.concatenate([quick.run(data.rise[run])[:, 0] for run in data.rows])
        own = back(past(source, data.rows, self.history), front.values)
        inputs = np.column_stack([front.values, own]) / data.scale
        gain = float(np.abs(network.slopes(inputs)[:, -1]).max() * np.abs(back.past.sum()))
        return _Fit(front, back.past, network, recursion, gain, inputs)

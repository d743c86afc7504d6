# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""A network with one hidden layer of tanh nodes and its training by second-order methods."""

from dataclasses import dataclass

import numpy as np
from scipy.linalg import LinAlgError, cho_factor, cho_solve
from scipy.optimize import minimize

from fuzzycnc_ros.core.arrays import Array

SOLVERS = ('lm', 'lbfgs')
"""Methods of training: Levenberg-Marquardt, and L-BFGS where there are too many weights."""

START_RANGE = 0.5
"""Weights start uniformly within plus and minus this [kang2007]."""

FALL_MIN = 1e-4
"""Relative fall of the cost below which, three times in a row, Levenberg-Marquardt ends.

Going on to 1e-7 takes up to five times as long: the last of the
way leads along a valley where no root mean square residual changes by more than 0.01 um."""

FALLS = 3
"""Small falls in a row that end Levenberg-Marquardt; one may be a step held too short."""

LBFGS_FALL_MIN = 1e-11
"""Fall of the cost, as a part of that of no output at all, below which L-BFGS ends [-]."""

LM_ITERATIONS_MAX = 200
"""Most iterations of Levenberg-Marquardt."""

LBFGS_ITERATIONS_MAX = 1000
"""Most iterations of L-BFGS; 300 left it short at times."""

SAMPLES_MAX = 1000
"""Most samples that a network is trained on; of more, evenly spaced ones are taken.

Neighbours in time are nearly equal, and 151 weights do not need them all."""

_DAMPING_START = 1e-6  # relative to the trace of the curvature: the start is close already
_DAMPING_MAX = 1e12  # where a step has become too short to change anything
_GAIN_LONG = 1.3  # where a step fell so much more than promised that a longer one is tried
_STRETCH_MAX = 20.0
_TANH_MAX = 0.99  # outputs nearer to 1 have no finite activation to aim at


WEIGHT_DECAY = 1e-5
"""Penalty on the weights of the networks."""


@dataclass(frozen=True, eq=False)
class TanhNetwork:
    """u = tanh(outer tanh(inner x + bias) + offset) [kang2007] with gamma = 1.

    Parameters
    ----------
    inner : ndarray, shape (h, i)
        Weight of each input in each hidden node [-].
    bias : ndarray, shape (h,)
        Constant of each hidden node [-].
    outer : ndarray, shape (h,)
        Weight of each hidden node [-].
    offset : float
        Constant of the output node [-].
    """

    inner: Array
    bias: Array
    outer: Array
    offset: float

    @staticmethod
    def drawn(inputs: int, hidden: int, rng: np.random.Generator) -> 'TanhNetwork':
        """Return a network with random weights to start from."""
        flat = rng.uniform(-START_RANGE, START_RANGE, hidden * (inputs + 2) + 1)
        return TanhNetwork.of(flat, inputs, hidden)

    @staticmethod
    def of(flat: Array, inputs: int, hidden: int) -> 'TanhNetwork':
        """Return the network of all weights in a row, as `flat` gives them."""
        inner, bias, outer, offset = np.split(flat, np.cumsum([hidden * inputs, hidden, hidden]))
        return TanhNetwork(inner.reshape(hidden, inputs), bias, outer, float(offset[0]))

    @property
    def flat(self) -> Array:
        """All weights in a row, shape (h (i + 2) + 1,)."""
        return np.concatenate([self.inner.ravel(), self.bias, self.outer, [self.offset]])

    def values(self, inputs: Array) -> Array:
        """Return the outputs (n,) [-] of inputs (n, i) [-]."""
        hidden = np.tanh(inputs @ self.inner.T + self.bias)
        return np.asarray(np.tanh(hidden @ self.outer + self.offset))

    def slopes(self, inputs: Array) -> Array:
        """Return the derivative of each output with respect to each input, shape (n, i) [-]."""
        value, _, back = self._backwards(inputs)
        return np.asarray((1.0 - value**2)[:, np.newaxis] * (back @ self.inner))

    def jacobian(self, inputs: Array) -> tuple[Array, Array]:
        """Return the outputs (n,) and their derivatives with respect to all weights.

        Returns
        -------
        tuple of ndarray, shapes (n,) and (n, h (i + 2) + 1)
            Outputs [-], and derivatives in the order of `flat` [-].
        """
        value, hidden, back = self._backwards(inputs)
        slope = (1.0 - value**2)[:, np.newaxis]
        back = slope * back
        inner = (back[:, :, np.newaxis] * inputs[:, np.newaxis, :]).reshape(len(inputs), -1)
        return value, np.hstack([inner, back, slope * hidden, slope])

    def gradient(self, inputs: Array, target: Array) -> tuple[float, Array]:
        """Return the sum of squared residuals and its derivative with respect to all weights.

        Parameters
        ----------
        inputs : ndarray, shape (n, i)
            Inputs [-].
        target : ndarray, shape (n,)
            Wanted outputs [-].
        """
        value, hidden, back = self._backwards(inputs)
        residual = value - target
        pull = 2.0 * residual * (1.0 - value**2)
        back *= pull[:, np.newaxis]
        parts = [(back.T @ inputs).ravel(), back.sum(axis=0), pull @ hidden, [pull.sum()]]
        return float(residual @ residual), np.concatenate(parts)

    def _backwards(self, inputs: Array) -> tuple[Array, Array, Array]:
        """Return outputs (n,), hidden values (n, h) and what a hidden node moves (n, h)."""
        hidden = np.tanh(inputs @ self.inner.T + self.bias)
        value = np.tanh(hidden @ self.outer + self.offset)
        return value, hidden, self.outer * (1.0 - hidden**2)


def train_network(
    start: TanhNetwork,
    inputs: Array,
    target: Array,
    *,
    decay: float,
    mean: bool,
    solver: str = 'lm',
    fall_min: float = LBFGS_FALL_MIN,
    iterations_max: int | None = None,
) -> TanhNetwork:
    """Return the network that minimises the squared residuals plus decay |w|^2.

    Parameters
    ----------
    start : TanhNetwork
        Where training begins.
    inputs : ndarray, shape (n, i)
        Inputs, of order 1 at most [-].
    target : ndarray, shape (n,)
        Wanted outputs in (-1, 1) [-].
    decay : float
        Penalty on the squares of all weights [-].
    mean : bool
        Whether the mean of the squared residuals counts, or their sum: with the mean the same
        decay weighs n times as much, which is what makes a network calm against noise.
    solver : {'lm', 'lbfgs'}
        Levenberg-Marquardt with the analytic Jacobian, or L-BFGS.
    fall_min : float
        Where L-BFGS ends, see `LBFGS_FALL_MIN` [-].
    iterations_max : int, optional
        Most iterations; 200 of Levenberg-Marquardt and 1000 of L-BFGS if absent.

    Notes
    -----
    For given hidden nodes the output node is a linear problem, nearly.  Levenberg-Marquardt
    solves it before it begins, which takes less time than an iteration and saves dozens.
    L-BFGS begins with the drawn weights: where it has to stop early, because there are more
    weights than samples, small weights are what keeps the network calm.
    """
    share = 1.0 if mean else float(len(target))
    if len(target) > SAMPLES_MAX:
        taken = np.linspace(0, len(target) - 1, SAMPLES_MAX).round().astype(np.int64)
        inputs, target = inputs[taken], target[taken]
    share /= len(target)
    if solver == 'lm':
        start = _with_best_output(start, inputs, target, decay, share)
        most = LM_ITERATIONS_MAX if iterations_max is None else iterations_max
        return _levenberg_marquardt(start, inputs, target, decay, share, most)
    most = LBFGS_ITERATIONS_MAX if iterations_max is None else iterations_max
    size = start.inner.shape[1], start.inner.shape[0]

    # SciPy compares the fall with the cost or with 1, whichever is larger.
    unit = share * float(target @ target) or 1.0

    def cost(flat: Array) -> tuple[float, Array]:
        square, slope = TanhNetwork.of(flat, *size).gradient(inputs, target)
        value = share * square + decay * float(flat @ flat)
        return value / unit, (share * slope + 2.0 * decay * flat) / unit

    found = minimize(
        cost,
        start.flat,
        jac=True,
        method='L-BFGS-B',
        options={'maxiter': most, 'ftol': fall_min, 'gtol': 0.0},
    )
    return TanhNetwork.of(np.asarray(found.x), *size)


def _with_best_output(
    network: TanhNetwork, inputs: Array, target: Array, decay: float, share: float
) -> TanhNetwork:
    """Return the network with the output node that suits its hidden nodes best.

    The activations that would give the target are fitted, each weighted by how far the output
    moves with it.
    """
    hidden = np.tanh(inputs @ network.inner.T + network.bias)
    columns = np.column_stack([hidden, np.ones(len(hidden))])
    aim = np.clip(target, -_TANH_MAX, _TANH_MAX)
    moved = (1.0 - aim**2)[:, np.newaxis] * columns
    normal = share * (moved.T @ moved) + decay * np.eye(columns.shape[1])
    weight = np.linalg.solve(normal, share * (moved.T @ ((1.0 - aim**2) * np.arctanh(aim))))
    other = TanhNetwork(network.inner, network.bias, weight[:-1], float(weight[-1]))
    costs = [_cost(item, inputs, target, decay, share) for item in (network, other)]
    return other if costs[1] < costs[0] else network


def _cost(network: TanhNetwork, inputs: Array, target: Array, decay: float, share: float) -> float:
    residual, flat = network.values(inputs) - target, network.flat
    return share * float(residual @ residual) + decay * float(flat @ flat)


def _levenberg_marquardt(
    network: TanhNetwork,
    inputs: Array,
    target: Array,
    decay: float,
    share: float,
    iterations_max: int,
) -> TanhNetwork:
    hidden, width = network.inner.shape
    cost = _cost(network, inputs, target, decay, share)
    damping, growth, falls = 0.0, 2.0, 0
    for _ in range(iterations_max):
        flat = network.flat
        value, jacobian = network.jacobian(inputs)
        curvature = share * (jacobian.T @ jacobian)
        np.einsum('ii->i', curvature)[:] += decay
        slope = share * (jacobian.T @ (value - target)) + decay * flat
        damping = damping or _DAMPING_START * float(np.trace(curvature))
        while damping < _DAMPING_MAX:
            step = _damped_step(curvature, slope, damping)
            trial = TanhNetwork.of(flat + step, width, hidden)
            fallen = cost - _cost(trial, inputs, target, decay, share)
            if fallen > 0.0:
                break
            damping, growth = damping * growth, 2.0 * growth
        else:
            break
        # Nielsen's rule follows how much of what the quadratic model promised came true.
        gain = fallen / float(step @ (damping * step - slope))
        damping *= max(1.0 / 3.0, 1.0 - (2.0 * gain - 1.0) ** 3)
        growth = 2.0
        if gain > _GAIN_LONG:
            # Along the step the cost is a parabola whose bottom the gain gives away.
            stretch = min(1.0 / max(2.0 - gain, 1e-9), _STRETCH_MAX)
            other = TanhNetwork.of(flat + stretch * step, width, hidden)
            further = cost - _cost(other, inputs, target, decay, share)
            if further > fallen:
                trial, fallen = other, further
        network, cost = trial, cost - fallen
        falls = falls + 1 if fallen < FALL_MIN * cost else 0
        if falls == FALLS:
            break
    return network


def _damped_step(curvature: Array, slope: Array, damping: float) -> Array:
    """Return the step that solves (curvature + damping I) step = -slope."""
    system = curvature + damping * np.eye(len(slope))
    try:
        return np.asarray(cho_solve(cho_factor(system, check_finite=False), -slope))
    except LinAlgError:  # rounding took its last positive eigenvalue; a tiny step does no harm
        return np.asarray(-slope / (damping + float(np.trace(curvature))))

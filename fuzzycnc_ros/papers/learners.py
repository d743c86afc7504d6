# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Baselines out of scikit-learn: a Gaussian process and a multilayer perceptron.

Both map the rises of one sample to its thermal error and know nothing of what came before.
"""

import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import cholesky, solve_triangular

from fuzzycnc_ros.core.arrays import Array, Seed
from fuzzycnc_ros.core.estimator import check_features, check_fitted
from fuzzycnc_ros.core.thermal.fit.linear import check_ridge, column_scale
from fuzzycnc_ros.core.thermal.fit.regressor import (
    ThermalRegressor,
    check_sample_count,
)
from fuzzycnc_ros.core.thermal.recursions.base import Recursion, axes, check_interval

SAMPLES_AT_ONCE = 512
"""Samples of a run that are worked out together."""

POINTS_MAX = 4000
"""Most kept samples: the deviation needs a matrix of their square per channel."""


@dataclass(frozen=True, eq=False)
class KernelRecursion(Recursion):
    """Posterior of a Gaussian process with a linear, a squared-exponential and a white kernel.

    y = direct x + offset + sum_i weight_i exp(-|(x - point_i) / length|^2 / 2).  It is static:
    it has no state, and holds at any interval.

    Parameters
    ----------
    points : ndarray, shape (m, p)
        Rises of the kept training samples [K].
    center : ndarray, shape (p,)
        Rise about which the linear kernel is meant [K].
    weight : ndarray, shape (c, m)
        Weight of the bump around each point [m].
    direct : ndarray, shape (c, p)
        Slope of the linear part [m/K].
    offset : ndarray, shape (c,)
        Constant of the linear part [m].
    length : ndarray, shape (c, p)
        Length scale of the bumps, positive [K].
    amplitude, constant, noise : ndarray, shape (c,)
        Prior standard deviation of the bumps, of the constant and of the noise [m].
    slope : ndarray, shape (c, p)
        Prior standard deviation of the slopes [m/K].
    """

    FORM: ClassVar[str] = 'kernel'
    STATIC: ClassVar[bool] = True

    points: Array = field(metadata=axes('m p'))
    center: Array = field(metadata=axes('p'))
    weight: Array = field(metadata=axes('c m'))
    direct: Array = field(metadata=axes('c p'))
    offset: Array = field(metadata=axes('c'))
    length: Array = field(metadata=axes('c p'))
    amplitude: Array = field(metadata=axes('c'))
    constant: Array = field(metadata=axes('c'))
    noise: Array = field(metadata=axes('c'))
    slope: Array = field(metadata=axes('c p'))

    def _check(self) -> None:
        points = len(self.points)
        if points > POINTS_MAX:
            raise ValueError(f'points: expected at most {POINTS_MAX} samples, but found {points}')
        if not (self.length > 0.0).all():
            raise ValueError(f'length: expected positive lengths in K, but found {self.length}')
        if not (self.noise > 0.0).all():
            raise ValueError(f'noise: expected positive numbers of m, but found {self.noise}')

    @cached_property
    def _exponent(self) -> tuple[Array, Array, Array]:
        """Exponents of all bumps as a polynomial of the rise: product, level, square.

        -|(x - point) / length|^2 / 2 = product x + level - square x^2, all channels stacked;
        one product of a matrix with the rise is far cheaper than all the differences.
        """
        square = self.length**-2.0
        product = (self.points * square[:, np.newaxis]).reshape(-1, self.inputs)
        level = -0.5 * (self.points**2 @ square.T).T
        return product, level, 0.5 * square

    def step(self, rise: Array, state: Array) -> tuple[Array, Array]:
        """Return the thermal errors (c,) [m] and the empty state for one sample of rises (p,)."""
        product, level, square = self._exponent
        exponent = (product @ rise).reshape(level.shape)
        exponent += level
        exponent -= (square @ (rise * rise))[:, np.newaxis]
        bumps = np.exp(exponent, out=exponent)
        bumps *= self.weight
        return self.direct @ rise + self.offset + bumps.sum(axis=1), state

    def run(self, rise: Array) -> Array:
        """Return the thermal errors (n, c) [m] of a whole run of rises (n, p) [K]."""
        values = rise @ self.direct.T + self.offset
        for part in _blocks(len(rise)):
            values[part] += np.einsum('nci,ci->nc', self._bumps(rise[part]), self.weight)
        return np.asarray(values)

    def standard_deviation(self, rise: Array) -> Array:
        """Return how far a measured displacement lies from the prediction.

        Parameters
        ----------
        rise : ndarray, shape (..., p)
            Rises [K].

        Returns
        -------
        ndarray, shape (..., c)
            Standard deviation of the posterior, noise included [m].
        """
        samples = rise.reshape(-1, self.inputs)
        variance = np.empty((len(samples), self.channels))
        for part in _blocks(len(samples)):
            slopes = (samples[part] - self.center) ** 2 @ (self.slope**2).T
            prior = self.constant**2 + self.amplitude**2 + slopes
            across = self._covariance(samples[part]).transpose(1, 2, 0)
            explained = ((self._whitening @ across) ** 2).sum(axis=1).T
            variance[part] = np.maximum(prior - explained, 0.0) + self.noise**2
        return np.asarray(np.sqrt(variance).reshape(*rise.shape[:-1], self.channels))

    def _bumps(self, rise: Array) -> Array:
        """Return the bumps, shape (n, c, m), at rises (n, p)."""
        product, level, square = self._exponent
        exponent = (rise @ product.T).reshape(-1, *level.shape)
        exponent += level
        exponent -= ((rise * rise) @ square.T)[:, :, np.newaxis]
        return np.asarray(np.exp(exponent, out=exponent))

    def _covariance(self, rise: Array) -> Array:
        """Return the prior covariance (n, c, m) [m^2] of the errors at rises and at the points."""
        covariance = self._bumps(rise)
        covariance *= (self.amplitude**2)[:, np.newaxis]
        covariance += (self.constant**2)[:, np.newaxis]
        covariance += ((rise - self.center) @ self._linear.T).reshape(covariance.shape)
        return covariance

    @cached_property
    def _linear(self) -> Array:
        """Covariance of the linear part at the points, per kelvin elsewhere, (c m, p) [m^2/K]."""
        slope = (self.slope**2)[:, np.newaxis]
        return ((self.points - self.center) * slope).reshape(-1, self.inputs)

    @cached_property
    def _whitening(self) -> Array:
        """Inverse Cholesky factor of the points' covariance, shape (c, m, m), lower [1/m]."""
        unit = np.eye(len(self.points))
        inverse = []
        covariance = self._covariance(self.points).transpose(1, 0, 2)
        for one, noise in zip(covariance, self.noise, strict=True):
            factor = cholesky(one + noise**2 * unit, lower=True)
            inverse.append(solve_triangular(factor, unit, lower=True))
        return np.stack(inverse)


def _blocks(samples: int) -> list[slice]:
    """Return the rows that are worked out together; all bumps at once would fill the memory."""
    starts = range(0, samples, SAMPLES_AT_ONCE)
    return [slice(first, first + SAMPLES_AT_ONCE) for first in starts]


def _rectified(values: Array) -> Array:
    return np.maximum(values, 0.0)


ACTIVATIONS: dict[str, Callable[[Array], Array]] = {'tanh': np.tanh, 'relu': _rectified}
"""Activations of hidden nodes by name."""


@dataclass(frozen=True, eq=False)
class LayersRecursion(Recursion):
    """Dense network of each channel, its last layer linear; static, so it has no state.

    Parameters
    ----------
    weights : tuple of ndarray, shape (c, out, in) each
        Weights of each layer; those of the first take kelvin, those of the last give metres.
    biases : tuple of ndarray, shape (c, out) each
        Biases of each layer.
    activation : {'tanh', 'relu'}
        Activation of the hidden nodes.
    """

    FORM: ClassVar[str] = 'layers'
    STATIC: ClassVar[bool] = True

    weights: tuple[Array, ...]
    biases: tuple[Array, ...]
    activation: str

    def __post_init__(self) -> None:
        """Refuse layers that do not follow on one another."""
        if self.activation not in ACTIVATIONS:
            raise ValueError(
                f'activation: expected one of {", ".join(ACTIVATIONS)}, but found '
                f'{self.activation!r}'
            )
        if not self.weights or len(self.weights) != len(self.biases):
            raise ValueError(
                f'weights: expected as many layers as biases, but found {len(self.weights)} and '
                f'{len(self.biases)}'
            )
        channels, _, before = self.weights[0].shape
        for number, (weight, bias) in enumerate(zip(self.weights, self.biases, strict=True)):
            nodes = weight.shape[1]
            good = weight.shape == (channels, nodes, before) and bias.shape == (channels, nodes)
            if not (good and np.isfinite(weight).all() and np.isfinite(bias).all()):
                raise ValueError(
                    f'weights: expected finite numbers of {channels} channels and {before} inputs '
                    f'in layer {number}, but found shapes {weight.shape} and {bias.shape}'
                )
            before = nodes
        if before != 1:
            raise ValueError(f'weights: expected one output per channel, but found {before}')

    @property
    def inputs(self) -> int:
        """Number p of inputs."""
        return int(self.weights[0].shape[2])

    @property
    def channels(self) -> int:
        """Number c of channels."""
        return int(self.weights[0].shape[0])

    def step(self, rise: Array, state: Array) -> tuple[Array, Array]:
        """Return the thermal errors (c,) [m] and the empty state for one sample of rises (p,)."""
        activation = ACTIVATIONS[self.activation]
        values = self.weights[0] @ rise + self.biases[0]
        for weight, bias in zip(self.weights[1:], self.biases[1:], strict=True):
            values = (weight @ activation(values)[:, :, np.newaxis])[:, :, 0] + bias
        return values[:, 0], state

    def run(self, rise: Array) -> Array:
        """Return the thermal errors (n, c) [m] of a whole run of rises (n, p) [K]."""
        activation = ACTIVATIONS[self.activation]
        values = (
            np.matmul(rise, self.weights[0].transpose(0, 2, 1)) + self.biases[0][:, np.newaxis]
        )
        for weight, bias in zip(self.weights[1:], self.biases[1:], strict=True):
            values = activation(values) @ weight.transpose(0, 2, 1) + bias[:, np.newaxis]
        return np.asarray(values[:, :, 0].T)

    def channel(self, channel: int) -> 'LayersRecursion':
        """Return the recursion of one channel out of several."""
        one = slice(channel, channel + 1)
        return LayersRecursion(
            weights=tuple(weight[one] for weight in self.weights),
            biases=tuple(bias[one] for bias in self.biases),
            activation=self.activation,
        )

    @classmethod
    def merge(cls, items: Sequence['LayersRecursion']) -> 'LayersRecursion | None':
        """Return one recursion for all channels, None if the networks are built differently."""
        built = {
            (item.activation, *(weight.shape[1:] for weight in item.weights)) for item in items
        }
        if len(built) > 1:
            return None
        layers = range(len(items[0].weights))
        return LayersRecursion(
            weights=tuple(np.concatenate([item.weights[n] for item in items]) for n in layers),
            biases=tuple(np.concatenate([item.biases[n] for item in items]) for n in layers),
            activation=items[0].activation,
        )


@dataclass(kw_only=True, eq=False, repr=False)
class GaussianProcess(ThermalRegressor):
    """Gaussian process with a linear, a squared-exponential and a white kernel.

    Parameters
    ----------
    samples_max : int
        Most samples that are kept, evenly picked from the measured ones; time of the fit grows
        with the cube of their number.
    interval : float
        Sampling interval of the training samples [s].

    Attributes
    ----------
    length_ : float
        Length scale of the squared-exponential kernel, in standard deviations of the rises [-].
    noise_ : float
        Standard deviation of the noise that the fit found [m].
    problems_ : tuple of str
        Why the fit is not to be trusted; empty if it is.

    Notes
    -----
    Rises and target are standardised; the three variances and the one length scale are those of
    the largest marginal likelihood, from scikit-learn's own start, without restarts.  Neighbours
    in time are nearly equal, so that more than 200 samples of the duties of the simulated mill
    make the fit slower (0.4 s with 200, 2.1 s with 400 samples) and the held-out error not
    smaller (1.4 um rms in Y with 200, 1.8 um with 400); so do length scales of their own for
    each rise (1.7 um).

    Examples
    --------
    >>> rise = np.linspace(0.0, 10.0, 60)[:, np.newaxis]
    >>> model = GaussianProcess().fit(rise, 1e-6 * np.sin(rise[:, 0]))
    >>> print(round(model.predict([[1.5]])[0] * 1e6, 2))
    1.0
    """

    samples_max: int = 200
    interval: float = 60.0

    def _fit(self, rise: Array, target: Array, rows: list[slice]) -> None:
        check_sample_count(target, 1)
        check_interval(self.interval)
        if not self.samples_max >= 2:
            raise ValueError(f'samples_max: expected at least 2, but found {self.samples_max}')
        measured = np.flatnonzero(np.isfinite(target))
        count = min(self.samples_max, len(measured))
        kept = measured[np.rint(np.linspace(0, len(measured) - 1, count)).astype(int)]
        points, values = rise[kept], target[kept]
        center, scale = points.mean(axis=0), column_scale(points)
        level, unit = float(values.mean()), float(values.std()) or 1.0
        process, problems = _quiet(
            _process().fit, (points - center) / scale, (values - level) / unit
        )
        linear, bumps, noise = _kernels(process.kernel_)
        slope = linear['variance'] ** 0.5 * unit / scale
        dual = np.asarray(process.alpha_, dtype=np.float64)
        # The linear kernel is a plane: its sum over all samples is one slope and one constant.
        direct = slope**2 / unit * (dual @ (points - center))
        constant = linear['variance'] * linear['sigma_0'] ** 2 * unit * float(dual.sum())
        self.recursion_: KernelRecursion = KernelRecursion(
            points=points,
            center=center,
            weight=(bumps['variance'] * unit * dual)[np.newaxis],
            direct=direct[np.newaxis],
            offset=np.array([level + constant - float(center @ direct)]),
            length=(bumps['length'] * scale)[np.newaxis],
            amplitude=np.array([bumps['variance'] ** 0.5 * unit]),
            constant=np.array([linear['variance'] ** 0.5 * linear['sigma_0'] * unit]),
            noise=np.array([noise**0.5 * unit]),
            slope=slope[np.newaxis],
        )
        self.length_ = bumps['length']
        self.noise_ = float(self.recursion_.noise[0])
        self.problems_: tuple[str, ...] = problems

    def standard_deviation(self, X: ArrayLike) -> Array:  # noqa: N803
        """Return how far measured displacements lie from the prediction at rises (n, p) [K].

        Returns
        -------
        ndarray, shape (n,)
            Standard deviation of the posterior, noise included [m].
        """
        check_fitted(self, 'recursion_')
        return self.recursion_.standard_deviation(check_features(self, X, reset=False))[:, 0]


@dataclass(kw_only=True, eq=False, repr=False)
class Mlp(ThermalRegressor):
    """Multilayer perceptron, fitted by scikit-learn's L-BFGS.

    Parameters
    ----------
    hidden : tuple of int
        Number of nodes of each hidden layer.
    activation : {'tanh', 'relu'}
        Activation of the hidden nodes.
    ridge : float
        Penalty on the weights per sample, of standardised rises and target [-].
    iterations_max : int
        Most iterations of the solver; a fit that needs more is flagged.
    interval : float
        Sampling interval of the training samples [s].
    random_state : int, numpy.random.Generator or None
        Seed of the initial weights.

    Attributes
    ----------
    n_iter_ : int
        Iterations that the solver took.
    problems_ : tuple of str
        Why the fit is not to be trusted; empty if it is.

    Notes
    -----
    Thirty tanh nodes are the network of [kang2007].  L-BFGS is what scikit-learn advises
    for few samples.  The penalty is that of the linear models; with scikit-learn's own, 1e-4 over
    all samples, the held-out error on the duties of the simulated mill is 2.5 instead of 1.5 um
    rms in Y and 1.6 instead of 1.1 um in Z.

    Examples
    --------
    >>> rise = np.linspace(0.0, 10.0, 60)[:, np.newaxis]
    >>> model = Mlp(ridge=1e-5).fit(rise, 1e-6 * np.sin(rise[:, 0]))
    >>> print(round(model.predict([[1.5]])[0] * 1e6, 1))
    1.0
    """

    hidden: tuple[int, ...] = (30,)
    activation: str = 'tanh'
    ridge: float = 1e-3
    iterations_max: int = 2000
    interval: float = 60.0
    random_state: Seed = 0

    def _fit(self, rise: Array, target: Array, rows: list[slice]) -> None:
        check_sample_count(target, 1)
        self._check_parameters()
        measured = np.isfinite(target)
        samples, values = rise[measured], target[measured]
        center, scale = samples.mean(axis=0), column_scale(samples)
        level, unit = float(values.mean()), float(values.std()) or 1.0
        from sklearn.neural_network import MLPRegressor

        network = MLPRegressor(
            hidden_layer_sizes=self.hidden,
            activation=self.activation,
            solver='lbfgs',
            # scikit-learn divides its penalty by the number of samples.
            alpha=self.ridge * len(samples),
            max_iter=self.iterations_max,
            max_fun=100 * self.iterations_max,
            random_state=int(np.random.default_rng(self.random_state).integers(2**31)),
        )
        _, self.problems_ = _quiet(
            network.fit, (samples - center) / scale, (values - level) / unit
        )
        self.n_iter_ = int(network.n_iter_)
        # In the order of a model file, so that both multiply in the same order.
        weights = [np.ascontiguousarray(weight.T, dtype=np.float64) for weight in network.coefs_]
        biases = [np.asarray(bias, dtype=np.float64) for bias in network.intercepts_]
        weights[0] = weights[0] / scale
        biases[0] = biases[0] - weights[0] @ center
        weights[-1] = unit * weights[-1]
        biases[-1] = unit * biases[-1] + level
        self.recursion_ = LayersRecursion(
            weights=tuple(weight[np.newaxis] for weight in weights),
            biases=tuple(bias[np.newaxis] for bias in biases),
            activation=self.activation,
        )

    def _check_parameters(self) -> None:
        check_interval(self.interval)
        check_ridge(self.ridge)
        if self.activation not in ACTIVATIONS:
            raise ValueError(
                f'activation: expected one of {", ".join(ACTIVATIONS)}, but found '
                f'{self.activation!r}'
            )
        if not self.hidden or min(self.hidden) < 1:
            raise ValueError(
                f'hidden: expected one or more layers of one or more nodes, but found '
                f'{self.hidden}'
            )
        if not self.iterations_max >= 1:
            raise ValueError(
                f'iterations_max: expected at least 1, but found {self.iterations_max}'
            )


def _process() -> Any:
    """Return scikit-learn's regressor with the kernel of the baseline, on standardised values."""
    from sklearn.gaussian_process import GaussianProcessRegressor
    from sklearn.gaussian_process.kernels import RBF, ConstantKernel, DotProduct, WhiteKernel

    linear = ConstantKernel() * DotProduct()
    bumps = ConstantKernel() * RBF()
    return GaussianProcessRegressor(linear + bumps + WhiteKernel(1e-2))


def _kernels(kernel: Any) -> tuple[dict[str, float], dict[str, float], float]:
    """Return the fitted parameters of the linear and the bumps' kernel, and the noise."""
    linear, bumps = kernel.k1.k1, kernel.k1.k2
    return (
        {'variance': float(linear.k1.constant_value), 'sigma_0': float(linear.k2.sigma_0)},
        {'variance': float(bumps.k1.constant_value), 'length': float(bumps.k2.length_scale)},
        float(kernel.k2.noise_level),
    )


def _quiet(
    fit: Callable[[Array, Array], Any], samples: Array, target: Array
) -> tuple[Any, tuple[str, ...]]:
    """Fit, and return the result with what the solver complained about.

    A parameter at the end of its range is no complaint: it is a term that the data do not need.
    """
    from sklearn.exceptions import ConvergenceWarning

    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter('always', ConvergenceWarning)
        fitted = fit(samples, target)
    for item in caught:
        if not issubclass(item.category, ConvergenceWarning):
            warnings.warn_explicit(item.message, item.category, item.filename, item.lineno)
    stopped = [item for item in caught if 'failed to converge' in str(item.message)]
    problems = ('the solver stopped before it had converged',) if stopped else ()
    return fitted, problems

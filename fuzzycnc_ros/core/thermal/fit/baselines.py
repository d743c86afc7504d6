# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Baselines out of scikit-learn: a Gaussian process and a multilayer perceptron.

Both map the rises of one sample to its thermal error and know nothing of what came before.
scikit-learn is needed to fit them, not to run them.
"""

import warnings
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from fuzzycnc_ros.core.arrays import Array, Seed
from fuzzycnc_ros.core.estimator import check_features, check_fitted
from fuzzycnc_ros.core.thermal.fit.linear import check_ridge, column_scale
from fuzzycnc_ros.core.thermal.fit.regressor import (
    ThermalRegressor,
    check_sample_count,
)
from fuzzycnc_ros.core.thermal.recursions.base import check_interval
from fuzzycnc_ros.core.thermal.recursions.kernel import (
    ACTIVATIONS,
    KernelRecursion,
    LayersRecursion,
)


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
    in time are nearly equal, so that more than 200 samples of the duties of method sheet 001
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

    def __init__(self, *, samples_max: int = 200, interval: float = 60.0) -> None:
        self.samples_max = samples_max
        self.interval = interval

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
    Thirty tanh nodes are the network of method sheet 003.  L-BFGS is what scikit-learn advises
    for few samples.  The penalty is that of the linear models; with scikit-learn's own, 1e-4 over
    all samples, the held-out error on the duties of method sheet 001 is 2.5 instead of 1.5 um rms
    in Y and 1.6 instead of 1.1 um in Z.

    Examples
    --------
    >>> rise = np.linspace(0.0, 10.0, 60)[:, np.newaxis]
    >>> model = Mlp(ridge=1e-5).fit(rise, 1e-6 * np.sin(rise[:, 0]))
    >>> print(round(model.predict([[1.5]])[0] * 1e6, 1))
    1.0
    """

    def __init__(
        self,
        *,
        hidden: tuple[int, ...] = (30,),
        activation: str = 'tanh',
        ridge: float = 1e-3,
        iterations_max: int = 2000,
        interval: float = 60.0,
        random_state: Seed = 0,
    ) -> None:
        self.hidden = hidden
        self.activation = activation
        self.ridge = ridge
        self.iterations_max = iterations_max
        self.interval = interval
        self.random_state = random_state

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

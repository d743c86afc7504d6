# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""What stands behind the name of a candidate: an estimator, its inputs, its settings."""

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from fuzzycnc_ros.core.arrays import Array
from fuzzycnc_ros.core.thermal.candidate import SPEED_SUFFIX, Settings
from fuzzycnc_ros.core.thermal.fit.anfis import Anfis, GreyAnfis
from fuzzycnc_ros.core.thermal.fit.baselines import GaussianProcess, Mlp
from fuzzycnc_ros.core.thermal.fit.grey import GreyModel
from fuzzycnc_ros.core.thermal.fit.hybrid import HybridFilterNetwork
from fuzzycnc_ros.core.thermal.fit.linear import (
    LagRidge,
    LeastSquares,
    StaticRidge,
    linear_recursion,
    poles_of_lags,
)
from fuzzycnc_ros.core.thermal.fit.regressor import ThermalRegressor
from fuzzycnc_ros.core.thermal.fit.rivals import Arma, DynamicNetwork, LinearNetwork, StaticNetwork
from fuzzycnc_ros.core.thermal.fit.training_set import TrainingSet
from fuzzycnc_ros.core.thermal.recursions import (
    LinearRecursion,
    Recursion,
    SeriesRecursion,
    leading,
)

SPEED_LAGS = (1200.0, 3600.0, 14400.0)
"""Lags of the heat of the spindle [s]: its housing, the head, the column."""

GREY_KINDS = {
    'classical_grey': 'classical',
    'convolution_grey': 'convolution',
    'optimised_grey': 'optimised',
    'discrete_grey': 'discrete',
    'stable_grey': 'stable',
}
"""Form of the grey model behind a candidate."""

_ESTIMATORS: dict[str, Callable[..., ThermalRegressor]] = {
    'least_squares': LeastSquares,
    'static_ridge': StaticRidge,
    'lag_ridge': LagRidge,
    'anfis': Anfis,
    'grey_anfis': GreyAnfis,
    'arma': Arma,
    'static_network': StaticNetwork,
    'dynamic_network': DynamicNetwork,
    'linear_network': LinearNetwork,
    'hybrid_network': HybridFilterNetwork,
    'gaussian_process': GaussianProcess,
    'mlp': Mlp,
}


def fit_recursion(
    name: str,
    settings: Settings,
    data: TrainingSet,
    target: Array,
    use: NDArray[np.bool_] | None = None,
) -> tuple[Recursion, tuple[str, ...]]:
    """Fit a candidate to one channel.

    Parameters
    ----------
    name : str
        One of `CANDIDATES`.
    settings : dict
        Parameters of its estimator.
    data : TrainingSet
        Training samples.
    target : ndarray, shape (n,)
        Thermal error [m].
    use : ndarray of bool, shape (n,), optional
        Samples that are fitted; all if absent.

    Returns
    -------
    recursion : Recursion
        Reads rises and drivers, whether it needs the latter or not.
    problems : tuple of str
        Why the fit is not to be trusted; empty if it is.
    """
    inputs = data.rise.shape[1] + data.drive.shape[1]
    if name in GREY_KINDS:
        grey = GreyModel(GREY_KINDS[name], interval=data.interval)
        grey.fit(data.rise, target, runs=data.label, use=use)
        return leading(grey.recursion_, inputs), grey.problems_
    if use is not None:
        target = np.where(use, target, np.nan)
    kind = name.removesuffix(SPEED_SUFFIX)
    model = _ESTIMATORS[kind](interval=data.interval).set_params(**settings)
    if kind == name:
        model.fit(data.rise, target, runs=data.label)
        recursion = leading(model.recursion_, inputs)
    elif kind == 'lag_ridge':
        model.set_params(drivers=data.drive.shape[1], driver_lags=SPEED_LAGS)
        samples = np.hstack([data.rise, data.drive])
        recursion = model.fit(samples, target, runs=data.label).recursion_
    else:
        bank = speed_bank(data.rise.shape[1], data.drive.shape[1], data.interval)
        samples = run_all(bank, np.hstack([data.rise, data.drive]), data.rows)
        model.fit(samples, target, runs=data.label)
        recursion = SeriesRecursion(bank, model.recursion_)
    return recursion, tuple(getattr(model, 'problems_', ()))


def speed_bank(rises: int, drivers: int, interval: float) -> LinearRecursion:
    """Return the bank whose outputs are the rises, the drivers and the lags of the drivers."""
    pole = poles_of_lags(SPEED_LAGS, interval)
    inputs = rises + drivers
    lags = linear_recursion(np.ones(drivers * (1 + len(pole))), pole, True, 0.0)
    outputs = inputs + len(lags.pole)
    return LinearRecursion(
        pole=lags.pole,
        drive=np.pad(lags.drive, ((0, 0), (rises, 0))),
        readout=np.eye(outputs)[:, inputs:],
        direct=np.eye(outputs, inputs),
        offset=np.zeros(outputs),
    )


def run_all(recursion: Recursion, samples: Array, rows: Sequence[slice]) -> Array:
    """Return the outputs (n, c) of a recursion over stacked runs, each from its own start."""
    return np.concatenate([recursion.run(samples[run]) for run in rows])

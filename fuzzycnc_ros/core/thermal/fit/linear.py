# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Linear models of the thermal error: plain least squares, ridge, and ridge on lagged rises."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import block_diag

from fuzzycnc_ros.core.arrays import Array
from fuzzycnc_ros.core.thermal.fit.regressor import (
    ThermalRegressor,
    check_sample_count,
)
from fuzzycnc_ros.core.thermal.recursions.base import (
    LinearRecursion,
    check_interval,
    first_order_lags,
)


@dataclass(kw_only=True, eq=False, repr=False)
class LeastSquares(ThermalRegressor):
    """Static linear regression with intercept, the plain baseline.

    Attributes
    ----------
    coef_ : ndarray, shape (p,)
        Thermal error per kelvin of rise [m/K].
    intercept_ : float
        Constant [m].

    Examples
    --------
    >>> rise = [[0.0], [1.0], [2.0], [3.0]]
    >>> model = LeastSquares().fit(rise, [1e-6, 3e-6, 5e-6, 7e-6])
    >>> print(round(model.predict([[4.0]])[0] * 1e6, 6))
    9.0
    """

    interval: float = 60.0

    def _fit(self, rise: Array, target: Array, rows: list[slice]) -> None:
        check_sample_count(target, rise.shape[1] + 1)
        self.recursion_ = _static_recursion(rise, target, 0.0)
        self.coef_: Array = self.recursion_.direct[0]
        self.intercept_ = float(self.recursion_.offset[0])


@dataclass(kw_only=True, eq=False, repr=False)
class StaticRidge(ThermalRegressor):
    """Static linear ridge regression with intercept, the strong plain baseline.

    Parameters
    ----------
    ridge : float
        Penalty on the coefficients of the standardised rises, per sample [-].

    Attributes
    ----------
    coef_ : ndarray, shape (p,)
        Thermal error per kelvin of rise [m/K].
    intercept_ : float
        Constant [m].
    """

    ridge: float = 1e-3
    interval: float = 60.0

    def _fit(self, rise: Array, target: Array, rows: list[slice]) -> None:
        check_ridge(self.ridge)
        self.recursion_ = _static_recursion(rise, target, self.ridge)
        self.coef_: Array = self.recursion_.direct[0]
        self.intercept_ = float(self.recursion_.offset[0])


@dataclass(kw_only=True, eq=False, repr=False)
class LagRidge(ThermalRegressor):
    """Ridge regression on the rises and their first-order lags.

    Parameters
    ----------
    lags : sequence of float
        Time constants of the lags [s].
    ridge : float
        Penalty on the coefficients of the scaled features, per sample [-].
    interval : float
        Sampling interval of the training samples [s].
    fit_intercept : bool
        Whether a constant is added; without one the model is anchored at zero rise.
    drivers : int
        Number of last columns of the input that are no rises but heat sources, such as the
        squared spindle speed.
    driver_lags : sequence of float
        Time constants of the lags of these columns [s].

    Attributes
    ----------
    coef_ : ndarray, shape (1 + number of lags, p - drivers)
        Thermal error per kelvin of each rise, then of each of its lags [m/K].
    driver_coef_ : ndarray, shape (1 + number of driver lags, drivers)
        Thermal error per unit of each driver, then of each of its lags [m].

    Examples
    --------
    >>> rise = np.linspace(0.0, 10.0, 60)[:, np.newaxis]
    >>> model = LagRidge(ridge=1e-9).fit(rise, 2e-6 * rise[:, 0])
    >>> print(round(model.start().step([0.0]) * 1e6, 6), model.predict(rise)[-1].round(9))
    0.0 2e-05
    """

    lags: Sequence[float] = (1200.0, 3600.0)
    ridge: float = 1e-3
    interval: float = 60.0
    fit_intercept: bool = False
    drivers: int = 0
    driver_lags: Sequence[float] = (1200.0, 3600.0, 14400.0)

    def _fit(self, rise: Array, target: Array, rows: list[slice]) -> None:
        check_ridge(self.ridge)
        if not 0 <= self.drivers < rise.shape[1]:
            raise ValueError(
                f'drivers: expected 0 to {rise.shape[1] - 1} of {rise.shape[1]} columns, but '
                f'found {self.drivers}'
            )
        split = rise.shape[1] - self.drivers
        pole = poles_of_lags(self.lags, self.interval)
        driver_pole = poles_of_lags(self.driver_lags, self.interval)
        features = driven_features(rise, rows, split, pole, driver_pole)
        weight, offset = _solve_linear(features, target, self.ridge, self.fit_intercept)
        self.recursion_ = _driven_recursion(weight, split, pole, self.drivers, driver_pole, offset)
        coefficient = (1 + len(pole)) * split
        self.coef_: Array = weight[:coefficient].reshape(1 + len(pole), split)
        self.driver_coef_: Array = weight[coefficient:].reshape(1 + len(driver_pole), -1)


def check_ridge(ridge: float) -> None:
    """Refuse a penalty that is not a positive number."""
    if not (np.isfinite(ridge) and ridge > 0.0):
        raise ValueError(f'ridge: expected a positive number, but found {ridge}')


def poles_of_lags(lags: Sequence[float], interval: float) -> Array:
    """Return the pole exp(-interval / lag) of each lag [s].

    Raises
    ------
    ValueError
        If a lag or the interval is not positive.
    """
    check_interval(interval)
    times = np.asarray(lags, dtype=np.float64)
    if times.ndim != 1 or not (np.isfinite(times) & (times > 0.0)).all():
        raise ValueError(f'lags: expected positive time constants in s, but found {lags}')
    return np.asarray(np.exp(-interval / times))


def lag_features(rise: Array, rows: Sequence[slice], pole: Array, direct: bool = True) -> Array:
    """Return the rises and their lags side by side, each run from its own start.

    Returns
    -------
    ndarray, shape (n, p (direct + number of poles))
        The rises themselves if `direct`, then all lags of the first pole, and so on [K].
    """
    samples, inputs = rise.shape
    features = np.empty((samples, (direct + len(pole)) * inputs))
    if direct:
        features[:, :inputs] = rise
    for run in rows:
        drive = (1.0 - pole)[:, np.newaxis] * rise[run][:, np.newaxis, :]
        lagged = first_order_lags(pole[:, np.newaxis], drive)
        features[run, direct * inputs :] = lagged.reshape(len(lagged), -1)
    return features


def ridge_solution(features: Array, target: Array, ridge: float) -> Array:
    """Return the minimiser of mean((target - features theta)^2) + ridge |theta|^2.

    Parameters
    ----------
    features : ndarray, shape (n, q)
        Features, scaled to about 1.
    target : ndarray, shape (n,) or (n, c)
        Targets, scaled to about 1.
    ridge : float
        Penalty [-]; 0 is least squares of minimum norm.
    """
    if ridge == 0.0:
        return np.asarray(np.linalg.lstsq(features, target, rcond=None)[0], dtype=np.float64)
    samples, columns = features.shape
    normal = features.T @ features + ridge * samples * np.eye(columns)
    return np.asarray(np.linalg.solve(normal, features.T @ target))


def column_scale(values: Array) -> Array:
    """Return the standard deviation of each column, 1 for a constant one."""
    scale = values.std(axis=0)
    return np.where(scale > 0.0, scale, 1.0)


def _solve_linear(
    features: Array, target: Array, ridge: float, intercept: bool
) -> tuple[Array, float]:
    """Return the weights (q,) of features (n, q) and the constant that fit a target (n,).

    Features and target are scaled before solving: 1e-6 m beside 40 K is ill-conditioned.
    """
    measured = np.isfinite(target)
    columns, values = features[measured], target[measured]
    scale = column_scale(columns)
    columns = columns / scale
    center = columns.mean(axis=0) if intercept else np.zeros(len(scale))
    level = float(values.mean()) if intercept else 0.0
    unit = float(values.std()) or 1.0
    solution = unit * ridge_solution(columns - center, (values - level) / unit, ridge)
    return solution / scale, level - float(center @ solution)


def _static_recursion(rise: Array, target: Array, ridge: float) -> LinearRecursion:
    """Fit rises (n, p) to a target (n,) without lags."""
    weight, offset = _solve_linear(rise, target, ridge, True)
    return linear_recursion(weight, np.empty(0), True, offset)


def linear_recursion(weight: Array, pole: Array, direct: bool, offset: float) -> LinearRecursion:
    """Return the recursion of one channel from the weights of `lag_features` [m/K]."""
    inputs = len(weight) // (direct + len(pole))
    drive = np.repeat(1.0 - pole, inputs)[:, np.newaxis] * np.tile(np.eye(inputs), (len(pole), 1))
    return LinearRecursion(
        pole=np.repeat(pole, inputs),
        drive=drive,
        readout=weight[np.newaxis, direct * inputs :],
        direct=weight[np.newaxis, :inputs] if direct else np.zeros((1, inputs)),
        offset=np.array([offset]),
    )


def driven_features(
    inputs: Array, rows: Sequence[slice], rises: int, pole: Array, driver_pole: Array
) -> Array:
    """Return rises and drivers, each with its own lags; the first `rises` columns are rises."""
    features = lag_features(inputs[:, :rises], rows, pole)
    if inputs.shape[1] == rises:
        return features
    return np.hstack([features, lag_features(inputs[:, rises:], rows, driver_pole)])


def _driven_recursion(
    weight: Array, rises: int, pole: Array, drivers: int, driver_pole: Array, offset: float
) -> LinearRecursion:
    """Return the recursion of one channel from the weights of `driven_features`."""
    split = (1 + len(pole)) * rises
    own = linear_recursion(weight[:split], pole, True, offset)
    if not drivers:
        return own
    driven = linear_recursion(weight[split:], driver_pole, True, 0.0)
    return LinearRecursion(
        pole=np.concatenate([own.pole, driven.pole]),
        drive=block_diag(own.drive, driven.drive),
        readout=np.hstack([own.readout, driven.readout]),
        direct=np.hstack([own.direct, driven.direct]),
        offset=own.offset,
    )

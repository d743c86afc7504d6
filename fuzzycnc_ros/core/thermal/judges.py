# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""How candidates are judged: settings and predictions on samples that were not fitted."""

from collections.abc import Callable

import numpy as np

from fuzzycnc_ros.core.arrays import Array
from fuzzycnc_ros.core.thermal.candidate import Settings
from fuzzycnc_ros.core.thermal.catalogue import SPEED_LAGS, fit_recursion
from fuzzycnc_ros.core.thermal.grey import stable_poles
from fuzzycnc_ros.core.thermal.linear import driven_features, lag_features, poles_of_lags
from fuzzycnc_ros.core.thermal.moments import (
    Fold,
    Moments,
    mean_square_error,
    ridge_from_sums,
    spread,
    stable_grey_from_sums,
)
from fuzzycnc_ros.core.thermal.recursions import combine
from fuzzycnc_ros.core.thermal.training_set import TrainingSet

RIDGES = (1e-4, 1e-3, 1e-2, 1e-1)
"""Penalties that the ridge candidates try, around the 1e-3 of method sheet 001."""

LAG_SETS = ((1200.0,), (1200.0, 3600.0), (300.0, 1200.0))
"""Sets of lags [s] that LagRidge tries, around the 20 and 60 min of method sheet 001."""

STABLE_GREY_RIDGE = 1e-3
"""Penalty of the stable grey candidate, method sheet 001 section 3.2."""


def held_out_predictions(
    name: str, data: TrainingSet, step: Callable[[], None]
) -> tuple[Settings, list[Array]]:
    """Return the settings of a candidate and what it predicts on samples that it never saw.

    Parameters
    ----------
    name : str
        One of `CANDIDATES`.
    data : TrainingSet
        Training samples with their folds.
    step : callable
        Called after each fit.

    Returns
    -------
    settings : dict
        Chosen on the held-out samples where the candidate has a choice.
    predicted : list of ndarray, shape (tested, c)
        Predictions of each fold [m]; infinite where they diverged.

    Notes
    -----
    The linear models are fitted from sums of products; every other candidate is fitted anew for
    each fold and channel, with the settings of its estimator.
    """
    if name in _LINEAR:
        return _LINEAR[name](data)
    return {}, _refitted(name, data, step)


def _refitted(name: str, data: TrainingSet, step: Callable[[], None]) -> list[Array]:
    samples = np.hstack([data.rise, data.drive])
    predicted = []
    for fold in data.folds:
        use, tested = np.isin(data.block, fold.train), data.tested(fold)
        fits = []
        for target in data.displacement.T:
            fits.append(fit_recursion(name, {}, data, target, use)[0])
            step()
        recursion = combine(fits)
        values = np.full(data.displacement.shape, np.nan)
        for rows in data.rows:
            if tested[rows].any():
                values[rows] = recursion.run(samples[rows])
        # A prediction that diverged beyond numbers must count as such, not as absent.
        predicted.append(np.where(np.isnan(values), np.inf, values)[tested])
    return predicted


def _judge_least_squares(data: TrainingSet) -> tuple[Settings, list[Array]]:
    return {}, _Bank(data, data.rise, intercept=True).predictions(0.0)


def _judge_static_ridge(data: TrainingSet) -> tuple[Settings, list[Array]]:
    bank = _Bank(data, data.rise, intercept=True)
    ridge = RIDGES[int(np.argmin([bank.error(ridge) for ridge in RIDGES]))]
    return {'ridge': ridge}, bank.predictions(ridge)


def _judge_lag_ridge(data: TrainingSet, *, driven: bool) -> tuple[Settings, list[Array]]:
    rises = data.rise.shape[1]
    samples = np.hstack([data.rise, data.drive]) if driven else data.rise
    driver_pole = poles_of_lags(SPEED_LAGS, data.interval)
    banks = []
    for lags in LAG_SETS:
        pole = poles_of_lags(lags, data.interval)
        features = driven_features(samples, data.rows, rises, pole, driver_pole)
        banks.append(_Bank(data, features, intercept=False))
    errors = [[bank.error(ridge) for ridge in RIDGES] for bank in banks]
    chosen, column = np.unravel_index(int(np.argmin(errors)), (len(LAG_SETS), len(RIDGES)))
    settings: Settings = {'lags': LAG_SETS[chosen], 'ridge': RIDGES[column]}
    return settings, banks[chosen].predictions(RIDGES[column])


def _judge_stable_grey(data: TrainingSet) -> tuple[Settings, list[Array]]:
    poles = stable_poles(data.interval)
    inputs = data.rise.shape[1]
    lagged = lag_features(data.rise, data.rows, poles, direct=False)
    lagged = lagged.reshape(len(lagged), len(poles), inputs).transpose(1, 0, 2)
    target, unit = data.scaled_target()
    moments = Moments.of(lagged, target, data.block)
    drivers = Moments.of(data.rise, target, data.block)
    predicted = []
    for fold in data.folds:
        scale = spread(drivers.over(fold.train), slice(1, 1 + inputs))
        pole, weight = stable_grey_from_sums(moments, fold.train, scale, STABLE_GREY_RIDGE)
        tested = data.tested(fold)
        columns = [lagged[p, tested] @ weight[:, c] for c, p in enumerate(pole)]
        predicted.append(np.stack(columns, axis=1) * unit)
    return {'ridge': STABLE_GREY_RIDGE}, predicted


class _Bank:
    """Features of the training samples, ready for held-out fits of all channels.

    Errors are pooled over the channels.  All channels see the same heat flow, and pooling them
    leaves few settings to be chosen from many samples: choosing per channel from the few cycles
    of one recording was worse on cycles that the choice had not seen.
    """

    def __init__(self, data: TrainingSet, features: Array, *, intercept: bool) -> None:
        self._data = data
        self._intercept = intercept
        self._features = features
        target, self._unit = data.scaled_target()
        self._moments = Moments.of(self._features, target, data.block)

    def error(self, ridge: float) -> float:
        """Return the held-out mean square error relative to the channels' own variance."""
        errors = [
            mean_square_error(self._moments.over(fold.test), *self._fit(fold, ridge)).mean()
            for fold in self._data.folds
        ]
        return float(np.mean(errors))

    def predictions(self, ridge: float) -> list[Array]:
        """Return the held-out predictions (n, c) of each fold [m]."""
        predicted = []
        for fold in self._data.folds:
            weight, constant = self._fit(fold, ridge)
            values = self._features[self._data.tested(fold)] @ weight + constant
            predicted.append(values * self._unit)
        return predicted

    def _fit(self, fold: Fold, ridge: float) -> tuple[Array, Array]:
        sums = self._moments.over(fold.train)
        return ridge_from_sums(sums, self._moments.inputs, ridge, self._intercept)


_LINEAR: dict[str, Callable[[TrainingSet], tuple[Settings, list[Array]]]] = {
    'least_squares': _judge_least_squares,
    'static_ridge': _judge_static_ridge,
    'stable_grey': _judge_stable_grey,
    'lag_ridge': lambda data: _judge_lag_ridge(data, driven=False),
    'lag_ridge_speed': lambda data: _judge_lag_ridge(data, driven=True),
}

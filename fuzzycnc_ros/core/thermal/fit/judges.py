# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""How candidates are judged: settings and predictions on samples that were not fitted."""

from collections.abc import Callable, Sequence

import numpy as np

from fuzzycnc_ros.core.arrays import Array
from fuzzycnc_ros.core.thermal.candidate import Settings
from fuzzycnc_ros.core.thermal.chance import log_residual
from fuzzycnc_ros.core.thermal.fit.catalogue import SPEED_LAGS, fit_recursion
from fuzzycnc_ros.core.thermal.fit.folds import independent_folds
from fuzzycnc_ros.core.thermal.fit.grey import stable_poles
from fuzzycnc_ros.core.thermal.fit.linear import driven_features, lag_features, poles_of_lags
from fuzzycnc_ros.core.thermal.fit.training_set import TrainingSet
from fuzzycnc_ros.core.thermal.moments import (
    Moments,
    mean_square_error,
    ridge_from_sums,
    spread,
    stable_grey_from_sums,
)
from fuzzycnc_ros.core.thermal.recursions import combine

RIDGES = (1e-4, 1e-3, 1e-2, 1e-1)
"""Penalties that the ridge candidates try, around the 1e-3 that served the simulated mill."""

LAG_SETS = ((1200.0,), (1200.0, 3600.0), (300.0, 1200.0))
"""Sets of lags [s] of the rises that LagRidge tries; beside the speed also none."""

COMMON_WEIGHT = 6.0
"""How many folds of its own the channels together are worth to a channel's settings [-]."""

STABLE_GREY_RIDGE = 1e-3
"""Penalty of the stable grey candidate [-]."""


def held_out_predictions(
    name: str, data: TrainingSet, step: Callable[[], None]
) -> tuple[list[Settings], list[Array]]:
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
    settings : list of dict, length c
        Best over all held-out samples, where the candidate has a choice: of all channels
        together, unless others are better in a channel beyond chance.
    predicted : list of ndarray, shape (tested, c)
        Predictions of each fold [m], with settings that are best on the other folds; infinite
        where they diverged.

    Notes
    -----
    The linear models are fitted from sums of products; every other candidate is fitted anew for
    each fold and channel, with the settings of its estimator.
    """
    if name in _LINEAR:
        return _LINEAR[name](data)
    return [{}] * data.displacement.shape[1], _refitted(name, data, step)


def _refitted(name: str, data: TrainingSet, step: Callable[[], None]) -> list[Array]:
    predicted = []
    for number, fold in enumerate(data.folds):
        seen = data.seen_by(number)
        samples = np.hstack([seen.rise, seen.drive])
        use, tested = np.isin(data.block, fold.train), data.tested(fold)
        fits = []
        for target in data.displacement.T:
            fits.append(fit_recursion(name, {}, seen, target, use)[0])
            step()
        recursion = combine(fits)
        values = np.full(data.displacement.shape, np.nan)
        for rows in data.rows:
            if tested[rows].any():
                values[rows] = recursion.run(samples[rows])
        # A prediction that diverged beyond numbers must count as such, not as absent.
        predicted.append(np.where(np.isnan(values), np.inf, values)[tested])
    return predicted


def _judge_least_squares(data: TrainingSet) -> tuple[list[Settings], list[Array]]:
    return _judged(data, [({}, 0.0, _Bank(data, _rises, intercept=True))])


def _judge_static_ridge(data: TrainingSet) -> tuple[list[Settings], list[Array]]:
    bank = _Bank(data, _rises, intercept=True)
    return _judged(data, [({'ridge': ridge}, ridge, bank) for ridge in RIDGES])


def _judge_lag_ridge(data: TrainingSet, *, driven: bool) -> tuple[list[Settings], list[Array]]:
    driver_pole = poles_of_lags(SPEED_LAGS, data.interval)
    options: list[_Option] = []
    for lags in (*LAG_SETS, ()) if driven else LAG_SETS:
        pole = poles_of_lags(lags, data.interval)

        def features(seen: TrainingSet, pole: Array = pole) -> Array:
            rises = seen.rise.shape[1]
            samples = np.hstack([seen.rise, seen.drive]) if driven else seen.rise
            return driven_features(samples, seen.rows, rises, pole, driver_pole)

        bank = _Bank(data, features, intercept=False)
        options += [({'lags': lags, 'ridge': ridge}, ridge, bank) for ridge in RIDGES]
    return _judged(data, options)


def _judge_stable_grey(data: TrainingSet) -> tuple[list[Settings], list[Array]]:
    poles = stable_poles(data.interval)
    target, unit = data.scaled_target()
    groups = data.channel_groups()
    sums: dict[int, tuple[Array, list[Moments], list[Moments]]] = {}
    predicted = []
    for number, fold in enumerate(data.folds):
        seen = data.seen_by(number)
        if id(seen) not in sums:
            lagged = lag_features(seen.rise, seen.rows, poles, direct=False)
            lagged = lagged.reshape(len(lagged), len(poles), -1).transpose(1, 0, 2)
            sums[id(seen)] = (
                lagged,
                [Moments.of(lagged, target[:, group], data.block) for group in groups],
                [Moments.of(seen.rise, target[:, group], data.block) for group in groups],
            )
        lagged, of_lags, of_drivers = sums[id(seen)]
        tested = data.tested(fold)
        values = np.empty((int(tested.sum()), len(unit)))
        for group, lags, drivers in zip(groups, of_lags, of_drivers, strict=True):
            scale = spread(drivers.over(fold.train), slice(1, 1 + drivers.inputs))
            pole, weight = stable_grey_from_sums(lags, fold.train, scale, STABLE_GREY_RIDGE)
            for c, p in enumerate(pole):
                values[:, group[c]] = lagged[p, tested] @ weight[:, c]
        predicted.append(values * unit)
    return [{'ridge': STABLE_GREY_RIDGE}] * len(unit), predicted


def _rises(seen: TrainingSet) -> Array:
    return seen.rise


_Option = tuple[Settings, float, '_Bank']
"""Settings, their penalty, and the features that they ask for."""


def _judged(data: TrainingSet, options: list[_Option]) -> tuple[list[Settings], list[Array]]:
    """Return the best settings, and the predictions with those that are best elsewhere."""
    errors = np.array([bank.errors(ridge) for _, ridge, bank in options])
    predicted = []
    for fold in range(len(data.folds)):
        elsewhere = data.apart_from(fold)
        # Of a single fold nothing can be learnt that it has not seen: the middle of the list.
        chosen = (
            _best_of_channels(errors, data, elsewhere)
            if elsewhere
            else [len(options) // 2] * errors.shape[2]
        )
        values = {number: options[number] for number in chosen}
        every = {n: bank.prediction(fold, ridge) for n, (_, ridge, bank) in values.items()}
        columns = [every[number][:, c] for c, number in enumerate(chosen)]
        predicted.append(np.stack(columns, axis=1))
    best = _best_of_channels(errors, data, range(len(data.folds)))
    return [options[number][0] for number in best], predicted


def _best_of_channels(errors: Array, data: TrainingSet, folds: Sequence[int]) -> list[int]:
    """Return the best option of each channel, for which all channels together speak too.

    All channels see the same heat flow.  With few folds a channel alone would choose by luck;
    with many it knows better what it needs.
    """
    square = errors[:, list(folds)]
    independent = independent_folds([data.folds[fold] for fold in folds])
    together = 0.5 * np.log(np.nanmean(square, axis=(1, 2)))
    level = log_residual(square) + COMMON_WEIGHT / independent * together[:, np.newaxis]
    return [int(np.nanargmin(channel)) for channel in level.T]


class _Bank:
    """Features of the training samples, ready for held-out fits of all channels."""

    def __init__(
        self, data: TrainingSet, features: Callable[[TrainingSet], Array], *, intercept: bool
    ) -> None:
        self._data = data
        self._intercept = intercept
        target, self._unit = data.scaled_target()
        self._groups = data.channel_groups()
        sums: dict[int, tuple[Array, list[Moments]]] = {}
        self._of_fold = []
        for fold in range(len(data.folds)):
            seen = data.seen_by(fold)
            if id(seen) not in sums:
                values = features(seen)
                moments = [
                    Moments.of(values, target[:, group], data.block) for group in self._groups
                ]
                sums[id(seen)] = (values, moments)
            self._of_fold.append(sums[id(seen)])

    def errors(self, ridge: float) -> Array:
        """Return the mean square errors over the channels' own variance, (folds, c)."""
        errors = np.empty((len(self._data.folds), len(self._unit)))
        for number, fold in enumerate(self._data.folds):
            for group, moments in zip(self._groups, self._of_fold[number][1], strict=True):
                weights = self._fit(moments, number, ridge)
                errors[number, group] = mean_square_error(moments.over(fold.test), *weights)
        return errors

    def prediction(self, fold: int, ridge: float) -> Array:
        """Return the held-out prediction of a fold, shape (tested, c) [m]."""
        values, moments = self._of_fold[fold]
        tested = values[self._data.tested(self._data.folds[fold])]
        predicted = np.empty((len(tested), len(self._unit)))
        for group, sums in zip(self._groups, moments, strict=True):
            weight, constant = self._fit(sums, fold, ridge)
            predicted[:, group] = tested @ weight + constant
        return predicted * self._unit

    def _fit(self, moments: Moments, fold: int, ridge: float) -> tuple[Array, Array]:
        sums = moments.over(self._data.folds[fold].train)
        return ridge_from_sums(sums, moments.inputs, ridge, self._intercept)


_LINEAR: dict[str, Callable[[TrainingSet], tuple[list[Settings], list[Array]]]] = {
    'least_squares': _judge_least_squares,
    'static_ridge': _judge_static_ridge,
    'stable_grey': _judge_stable_grey,
    'lag_ridge': lambda data: _judge_lag_ridge(data, driven=False),
    'lag_ridge_speed': lambda data: _judge_lag_ridge(data, driven=True),
}

# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The models that compete for a machine, their settings chosen and judged on held-out samples."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fuzzycnc_ros.core.arrays import Array
from fuzzycnc_ros.core.thermal.candidate import Candidate, Settings
from fuzzycnc_ros.core.thermal.folds import run_rows, training_folds
from fuzzycnc_ros.core.thermal.grey import GreyModel, stable_poles
from fuzzycnc_ros.core.thermal.linear import (
    LagRidge,
    LeastSquares,
    StaticRidge,
    lag_features,
    poles_of_lags,
)
from fuzzycnc_ros.core.thermal.moments import (
    Fold,
    Moments,
    mean_square_error,
    ridge_from_sums,
    spread,
    stable_grey_from_sums,
)
from fuzzycnc_ros.core.thermal.recursions import combine
from fuzzycnc_ros.core.thermal.run import ThermalDataError, ThermalRun

RIDGES = (1e-4, 1e-3, 1e-2, 1e-1)
"""Penalties that the ridge candidates try, around the 1e-3 of method sheet 001."""

LAG_SETS = ((1200.0,), (1200.0, 3600.0), (300.0, 1200.0))
"""Sets of lags [s] that LagRidge tries, around the 20 and 60 min of method sheet 001."""

ELIGIBLE = ('least_squares', 'static_ridge', 'stable_grey', 'lag_ridge')
"""Candidates that 'auto' may choose; the classical grey model is there to be compared only."""

GREY_KINDS = {'classical_grey': 'classical', 'stable_grey': 'stable'}
"""Form of the grey model behind a candidate."""

STABLE_GREY_RIDGE = 1e-3
"""Penalty of the stable grey candidate, method sheet 001 section 3.2."""


@dataclass(frozen=True, eq=False)
class TrainingSet:
    """Stacked rises and displacements of the training runs.

    Parameters
    ----------
    rise : ndarray, shape (n, p)
        Rises of the inputs [K].
    displacement : ndarray, shape (n, c)
        Thermal error [m]; NaN where nothing was measured.
    label : ndarray, shape (n,)
        Number of the run of each sample.
    rows : list of slice
        Rows of each run.
    interval : float
        Sampling interval [s].
    block : ndarray, shape (n,)
        Number of the stretch of each sample.
    folds : list of Fold
        Stretches to train and to judge on.
    """

    rise: Array
    displacement: Array
    label: NDArray[np.int64]
    rows: list[slice]
    interval: float
    block: NDArray[np.int64]
    folds: list[Fold]

    @staticmethod
    def of(runs: Sequence[ThermalRun], inputs: Sequence[str]) -> 'TrainingSet':
        """Stack runs of the same channels and interval."""
        block, folds = training_folds(runs)
        rows = run_rows(runs)
        return TrainingSet(
            rise=np.concatenate([run.rise()[:, run.columns(inputs)] for run in runs]),
            displacement=np.concatenate([run.displacement for run in runs]),
            label=np.repeat(np.arange(len(runs)), [len(run.time) for run in runs]),
            rows=rows,
            interval=runs[0].interval,
            block=block,
            folds=folds,
        )

    def tested(self, fold: Fold) -> NDArray[np.bool_]:
        """Return which samples a fold judges on, shape (n,)."""
        return np.isin(self.block, fold.test)

    def scaled_target(self) -> tuple[Array, Array]:
        """Return the displacements (n, c) and the unit (c,) [m] that makes them of order 1."""
        unit = np.nanstd(self.displacement, axis=0)
        unit = np.where(unit > 0.0, unit, 1.0)
        return self.displacement / unit, unit


@dataclass(frozen=True, eq=False)
class JudgedCandidate:
    """A candidate with its held-out mean square error per fold, shape (folds, c) [m^2]."""

    candidate: Candidate
    fold_error: Array


def fit_candidate(name: str, data: TrainingSet) -> JudgedCandidate:
    """Choose a candidate's settings, judge it on held-out samples and fit it to all.

    Parameters
    ----------
    name : str
        One of `CANDIDATES`.
    data : TrainingSet
        Training samples.

    Raises
    ------
    ThermalDataError
        If the samples do not suffice for the candidate.
    """
    try:
        settings, predicted = _JUDGES[name](data)
        models = [_estimator(name, settings, data, target) for target in data.displacement.T]
    except ValueError as error:
        raise ThermalDataError(f'model {name!r}: {error}') from error
    residuals = [
        data.displacement[data.tested(fold)] - values
        for fold, values in zip(data.folds, predicted, strict=True)
    ]
    stacked = np.concatenate(residuals)
    with np.errstate(over='ignore'):
        fold_error = np.stack([mean_of_square(residual) for residual in residuals])
        rms = np.sqrt(mean_of_square(stacked))
    problems = dict.fromkeys(
        problem for model in models if isinstance(model, GreyModel) for problem in model.problems_
    )
    candidate = Candidate(
        name=name,
        settings=settings,
        recursion=combine([model.recursion_ for model in models]),
        problems=tuple(problems),
        held_out_rms=rms,
        held_out_max=np.asarray(np.nanmax(np.abs(stacked), axis=0)),
    )
    return JudgedCandidate(candidate, fold_error)


def mean_of_square(residual: Array) -> Array:
    """Return the mean square of each column (n, c) over what is not NaN, NaN if nothing is."""
    measured = ~np.isnan(residual)
    total = np.where(measured, residual, 0.0)
    count = measured.sum(axis=0)
    return np.where(count > 0, (total**2).sum(axis=0) / np.maximum(count, 1), np.nan)


def preferred(judged: Sequence[JudgedCandidate], unit: Array) -> tuple[str, ...]:
    """Return the candidate to use for each channel.

    Parameters
    ----------
    judged : sequence of JudgedCandidate
        Candidates to choose from.
    unit : ndarray, shape (c,)
        Spread of each channel [m], by which errors are made comparable.

    Returns
    -------
    tuple of str, length c
        The candidate that is best over all channels, unless another one is better in a channel
        by more than the standard error of the difference over the folds: less is chance.
    """
    errors = np.array([item.candidate.held_out_rms**2 for item in judged]) / unit**2
    best = judged[int(np.argmin(errors.mean(axis=1)))]
    names = []
    for channel in range(len(unit)):
        rival = judged[int(np.argmin(errors[:, channel]))]
        gain = best.fold_error[:, channel] - rival.fold_error[:, channel]
        gain = gain[np.isfinite(gain)]
        chance = gain.std(ddof=1) / np.sqrt(len(gain)) if len(gain) > 1 else np.inf
        names.append((rival if gain.sum() > chance * len(gain) else best).candidate.name)
    return tuple(names)


def _estimator(
    name: str,
    settings: Settings,
    data: TrainingSet,
    target: Array,
    use: NDArray[np.bool_] | None = None,
) -> LeastSquares | StaticRidge | LagRidge | GreyModel:
    """Fit the estimator of one channel to the training samples, or to those in `use`."""
    if name in GREY_KINDS:
        grey = GreyModel(GREY_KINDS[name], interval=data.interval)
        return grey.fit(data.rise, target, runs=data.label, use=use)
    linear: LeastSquares | StaticRidge | LagRidge
    if name == 'lag_ridge':
        linear = LagRidge(interval=data.interval)
    elif name == 'static_ridge':
        linear = StaticRidge(interval=data.interval)
    else:
        linear = LeastSquares(interval=data.interval)
    linear.set_params(**settings)
    return linear.fit(data.rise, target, runs=data.label)


def _judge_least_squares(data: TrainingSet) -> tuple[Settings, list[Array]]:
    return {}, _Bank(data, np.empty(0), intercept=True).predictions(0.0)


def _judge_static_ridge(data: TrainingSet) -> tuple[Settings, list[Array]]:
    bank = _Bank(data, np.empty(0), intercept=True)
    ridge = RIDGES[int(np.argmin([bank.error(ridge) for ridge in RIDGES]))]
    return {'ridge': ridge}, bank.predictions(ridge)


def _judge_lag_ridge(data: TrainingSet) -> tuple[Settings, list[Array]]:
    banks = [_Bank(data, poles_of_lags(lags, data.interval), intercept=False) for lags in LAG_SETS]
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


def _judge_classical_grey(data: TrainingSet) -> tuple[Settings, list[Array]]:
    predicted = []
    for fold in data.folds:
        use = np.isin(data.block, fold.train)
        recursion = combine(
            [
                _estimator('classical_grey', {}, data, target, use).recursion_
                for target in data.displacement.T
            ]
        )
        values = np.concatenate([recursion.run(data.rise[rows]) for rows in data.rows])
        # A prediction that diverged beyond numbers must count as such, not as absent.
        predicted.append(np.where(np.isnan(values), np.inf, values)[data.tested(fold)])
    return {}, predicted


_JUDGES: dict[str, Callable[[TrainingSet], tuple[Settings, list[Array]]]] = {
    'least_squares': _judge_least_squares,
    'static_ridge': _judge_static_ridge,
    'classical_grey': _judge_classical_grey,
    'stable_grey': _judge_stable_grey,
    'lag_ridge': _judge_lag_ridge,
}


class _Bank:
    """Rises and lags of the training samples, ready for held-out fits of all channels.

    Errors are pooled over the channels.  All channels see the same heat flow, and pooling them
    leaves few settings to be chosen from many samples: choosing per channel from the few cycles
    of one recording was worse on cycles that the choice had not seen.
    """

    def __init__(self, data: TrainingSet, pole: Array, *, intercept: bool) -> None:
        self._data = data
        self._intercept = intercept
        self._features = lag_features(data.rise, data.rows, pole)
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

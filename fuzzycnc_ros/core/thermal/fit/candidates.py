# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The models that compete for a machine, fitted and judged on held-out samples."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from fuzzycnc_ros.core.arrays import Array
from fuzzycnc_ros.core.thermal.band import better, log_residual, mean_of_square, worth_using
from fuzzycnc_ros.core.thermal.candidate import (
    DRIVES_SUFFIX,
    SPEED_SUFFIX,
    UNCOMPENSATED,
    Candidate,
    Settings,
)
from fuzzycnc_ros.core.thermal.fit.anfis import Anfis, GreyAnfis
from fuzzycnc_ros.core.thermal.fit.folds import independent_folds
from fuzzycnc_ros.core.thermal.fit.grey import GreyModel, stable_poles
from fuzzycnc_ros.core.thermal.fit.hybrid import HybridFilterNetwork
from fuzzycnc_ros.core.thermal.fit.linear import (
    LagRidge,
    LeastSquares,
    StaticRidge,
    driven_features,
    lag_features,
    linear_recursion,
    poles_of_lags,
)
from fuzzycnc_ros.core.thermal.fit.regressor import ThermalRegressor
from fuzzycnc_ros.core.thermal.fit.training_set import TrainingSet
from fuzzycnc_ros.core.thermal.moments import (
    Moments,
    mean_square_error,
    ridge_from_sums,
    spread,
    stable_grey_from_sums,
)
from fuzzycnc_ros.core.thermal.recursions.base import (
    LinearRecursion,
    Recursion,
    SeriesRecursion,
    combine,
)
from fuzzycnc_ros.core.thermal.run import ThermalDataError

SPEED_LAGS = (1200.0, 3600.0, 14400.0)
"""Lags of the heat of the spindle [s]: its housing, the head, the column."""


@dataclass(frozen=True)
class Contender:
    """Estimator of a candidate, and its part in a choice.

    Parameters
    ----------
    make : callable
        Returns the unfitted estimator for a sampling interval, a keyword [s].
    network : bool
        Whether it is not linear in its inputs: it is chosen only if it wins beyond chance.
    chosen : bool
        False for a published form that may diverge: it is fitted for tables, never chosen.
    held_out : callable, optional
        Returns settings and held-out predictions from sums of products; the estimator is fitted
        anew for each fold if absent.
    """

    make: Callable[..., ThermalRegressor]
    network: bool = False
    chosen: bool = True
    held_out: Callable[[TrainingSet], tuple[list[Settings], list[Array]]] | None = None


def _leading(recursion: Recursion, inputs: int) -> Recursion:
    """Return a recursion that reads the first of `inputs` inputs and ignores the others."""
    ignored = inputs - recursion.inputs
    if not ignored:
        return recursion
    if isinstance(recursion, LinearRecursion):
        return replace(
            recursion,
            drive=np.pad(recursion.drive, ((0, 0), (0, ignored))),
            direct=np.pad(recursion.direct, ((0, 0), (0, ignored))),
        )
    if isinstance(recursion, SeriesRecursion):
        bank = _leading(recursion.bank, inputs)
        assert isinstance(bank, LinearRecursion)
        return replace(recursion, bank=bank)
    bank = LinearRecursion(
        pole=np.empty(0),
        drive=np.empty((0, inputs)),
        readout=np.empty((recursion.inputs, 0)),
        direct=np.eye(recursion.inputs, inputs),
        offset=np.zeros(recursion.inputs),
    )
    return SeriesRecursion(bank, recursion)


def _fit_recursion(
    name: str,
    contender: Contender,
    settings: Settings,
    data: TrainingSet,
    target: Array,
    use: NDArray[np.bool_] | None = None,
) -> tuple[Recursion, tuple[str, ...]]:
    """Fit a candidate to one channel.

    Parameters
    ----------
    name : str
        Name of the candidate; its suffix says which drivers it reads.
    contender : Contender
        How it is fitted.
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
    model = contender.make(interval=data.interval)
    if isinstance(model, GreyModel):
        model.fit(data.rise, target, runs=data.label, use=use)
        return _leading(model.recursion_, inputs), model.problems_
    if use is not None:
        target = np.where(use, target, np.nan)
    kind = name.removesuffix(SPEED_SUFFIX).removesuffix(DRIVES_SUFFIX)
    model.set_params(**settings)
    if kind == name:
        model.fit(data.rise, target, runs=data.label)
        recursion = _leading(model.recursion_, inputs)
    elif kind == 'lag_ridge':
        model.set_params(drivers=data.drive.shape[1], driver_lags=SPEED_LAGS)
        samples = np.hstack([data.rise, data.drive])
        recursion = model.fit(samples, target, runs=data.label).recursion_
    else:
        bank = _speed_bank(data.rise.shape[1], data.drive.shape[1], data.interval)
        samples = _run_all(bank, np.hstack([data.rise, data.drive]), data.rows)
        model.fit(samples, target, runs=data.label)
        recursion = SeriesRecursion(bank, model.recursion_)
    return recursion, tuple(getattr(model, 'problems_', ()))


def _speed_bank(rises: int, drivers: int, interval: float) -> LinearRecursion:
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


def _run_all(recursion: Recursion, samples: Array, rows: Sequence[slice]) -> Array:
    """Return the outputs (n, c) of a recursion over stacked runs, each from its own start."""
    return np.concatenate([recursion.run(samples[run]) for run in rows])


_RIDGES = (1e-4, 1e-3, 1e-2, 1e-1)
"""Penalties that the ridge candidates try, around the 1e-3 that served the simulated mill."""

LAG_SETS = ((1200.0,), (1200.0, 3600.0), (300.0, 1200.0))
"""Sets of lags [s] of the rises that LagRidge tries; beside the speed also none."""

COMMON_WEIGHT = 6.0
"""Weight of all channels together in the settings of one, in folds of its own [-]."""

STABLE_GREY_RIDGE = 1e-3
"""Penalty of the stable grey candidate [-]."""


def _held_out_predictions(
    name: str, contender: Contender, data: TrainingSet, step: Callable[[], None]
) -> tuple[list[Settings], list[Array]]:
    """Return the settings of a candidate and what it predicts on samples that it never saw.

    Parameters
    ----------
    name : str
        Name of the candidate.
    contender : Contender
        How it is fitted.
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
    if contender.held_out is not None:
        return contender.held_out(data)
    return [{}] * data.displacement.shape[1], _refitted(name, contender, data, step)


def _refitted(
    name: str, contender: Contender, data: TrainingSet, step: Callable[[], None]
) -> list[Array]:
    predicted = []
    for number, fold in enumerate(data.folds):
        seen = data.seen_by(number)
        samples = np.hstack([seen.rise, seen.drive])
        use, tested = np.isin(data.block, fold.train), data.tested(fold)
        fits = []
        for target in data.displacement.T:
            fits.append(_fit_recursion(name, contender, {}, seen, target, use)[0])
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
    return _judged_options(data, [({}, 0.0, _Bank(data, _rises, intercept=True))])


def _judge_static_ridge(data: TrainingSet) -> tuple[list[Settings], list[Array]]:
    bank = _Bank(data, _rises, intercept=True)
    return _judged_options(data, [({'ridge': ridge}, ridge, bank) for ridge in _RIDGES])


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
        options += [({'lags': lags, 'ridge': ridge}, ridge, bank) for ridge in _RIDGES]
    return _judged_options(data, options)


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


def _judged_options(
    data: TrainingSet, options: list[_Option]
) -> tuple[list[Settings], list[Array]]:
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


CONTENDERS: Mapping[str, Contender] = MappingProxyType(
    {
        'least_squares': Contender(LeastSquares, held_out=_judge_least_squares),
        'static_ridge': Contender(StaticRidge, held_out=_judge_static_ridge),
        'lag_ridge': Contender(LagRidge, held_out=partial(_judge_lag_ridge, driven=False)),
        'lag_ridge_speed': Contender(LagRidge, held_out=partial(_judge_lag_ridge, driven=True)),
        'lag_ridge_drives': Contender(LagRidge, held_out=partial(_judge_lag_ridge, driven=True)),
        'classical_grey': Contender(partial(GreyModel, 'classical'), chosen=False),
        'stable_grey': Contender(partial(GreyModel, 'stable'), held_out=_judge_stable_grey),
        'anfis': Contender(Anfis, network=True),
        'grey_anfis': Contender(GreyAnfis, network=True),
        'hybrid_network': Contender(HybridFilterNetwork, network=True),
        'hybrid_network_speed': Contender(HybridFilterNetwork, network=True),
    }
)
"""Estimator and judgement of each of `CANDIDATES`, in the order of tables."""


RIDGE_FORMS = ('static_ridge', 'lag_ridge', 'lag_ridge_speed')
"""Candidates that are in use unless another form is better beyond chance."""

DIVERGED = 3.0
"""Held-out residual over the largest displacement from which a candidate is refused [-]."""


@dataclass(frozen=True, eq=False)
class JudgedCandidate:
    """A candidate with its held-out figures.

    Parameters
    ----------
    candidate : Candidate
        The candidate.
    fold_error : ndarray, shape (folds, c)
        Held-out mean square error of each fold [m^2].
    residual : list of ndarray, shape (tested, c)
        Measured minus predicted of the samples that each fold held out [m].
    contender : Contender, optional
        How it was fitted; none for the uncompensated machine.
    """

    candidate: Candidate
    fold_error: Array
    residual: list[Array]
    contender: Contender | None = None


def fit_candidate(
    name: str,
    contender: Contender,
    data: TrainingSet,
    step: Callable[[], None] = lambda: None,
    *,
    held_out: bool = True,
) -> JudgedCandidate:
    """Choose a candidate's settings, judge it on held-out samples and fit it to all.

    Parameters
    ----------
    name : str
        Name of the candidate.
    contender : Contender
        How it is fitted.
    data : TrainingSet
        Training samples.
    step : callable
        Called after each fit; an exception that it raises ends the training.
    held_out : bool
        Whether to judge it; if not, its held-out figures are NaN, its settings the first choice.

    Raises
    ------
    ThermalDataError
        If the samples do not suffice for the candidate.
    """
    whole, data = data, data.read_by(name)
    try:
        if held_out:
            settings, predicted = _held_out_predictions(name, contender, data, step)
        else:
            settings, predicted = [{}] * data.displacement.shape[1], []
        fits = []
        for own, target in zip(settings, data.displacement.T, strict=True):
            fits.append(_fit_recursion(name, contender, own, data, target))
            step()
    except ValueError as error:
        raise ThermalDataError(f'model {name!r}: {error}') from error
    except ImportError as error:
        raise ThermalDataError(
            f'model {name!r}: expected the library {error.name} but found none; install '
            'fuzzycnc_ros[ml], or leave the model out'
        ) from error
    problems = list(dict.fromkeys(problem for _, found in fits for problem in found))
    inputs = whole.rise.shape[1] + whole.drive.shape[1]
    recursion = combine([_leading(recursion, inputs) for recursion, _ in fits])
    if not held_out:
        unknown = np.full(data.displacement.shape[1], np.nan)
        candidate = Candidate(name, tuple(settings), recursion, tuple(problems), unknown, unknown)
        return JudgedCandidate(candidate, np.empty((0, len(unknown))), [], contender)
    return _judged(name, contender, settings, recursion, problems, data, predicted)


def uncompensated(data: TrainingSet) -> JudgedCandidate:
    """Return the candidate that predicts nothing, judged as all others are."""
    channels, inputs = data.displacement.shape[1], data.rise.shape[1] + data.drive.shape[1]
    nothing = LinearRecursion.of_nothing(channels, inputs)
    predicted = [np.zeros((int(data.tested(fold).sum()), channels)) for fold in data.folds]
    return _judged(UNCOMPENSATED, None, [{}] * channels, nothing, [], data, predicted)


def _judged(
    name: str,
    contender: Contender | None,
    settings: Sequence[Settings],
    recursion: Recursion,
    problems: list[str],
    data: TrainingSet,
    predicted: list[Array],
) -> JudgedCandidate:
    measured = [data.displacement[data.tested(fold)] for fold in data.folds]
    residuals = [m - p for m, p in zip(measured, predicted, strict=True)]
    stacked = np.concatenate(residuals)
    with np.errstate(over='ignore'):
        fold_error = np.stack([mean_of_square(residual) for residual in residuals])
        rms = np.sqrt(mean_of_square(stacked))
    largest = np.asarray(np.nanmax(np.abs(stacked), axis=0))
    bare = np.nanmax(np.abs(np.concatenate(measured)))
    if not (largest < DIVERGED * bare).all():
        problems = [
            *problems,
            f'on held-out samples it missed by more than {DIVERGED:g} times the largest '
            'displacement: it does not hold where it was not fitted',
        ]
    candidate = Candidate(
        name=name,
        settings=tuple(settings),
        recursion=recursion,
        problems=tuple(problems),
        held_out_rms=rms,
        held_out_max=largest,
    )
    return JudgedCandidate(candidate, fold_error, residuals, contender)


def preferred(
    judged: Sequence[JudgedCandidate], data: TrainingSet, folds: Sequence[int] | None = None
) -> tuple[str, ...]:
    """Return the candidate to use for each channel.

    Parameters
    ----------
    judged : sequence of JudgedCandidate
        Candidates to choose from; the uncompensated machine, if it is among them, competes too.
    data : TrainingSet
        What they were judged on.
    folds : sequence of int, optional
        Numbers of the folds that may speak; all if absent.

    Returns
    -------
    tuple of str, length c
        Ridge regression, with lags or without, with the spindle speed or without, whichever
        leaves least over all channels in the geometric mean, unless another model is better over
        all channels, or in a channel, by a tenth and beyond chance.  Where none was fitted, the
        best linear model stands in for it.  A channel that no model improves beyond chance stays
        uncompensated.
    """
    numbers = list(range(len(data.folds)) if folds is None else folds)
    independent = independent_folds([data.folds[number] for number in numbers])
    models = [item for item in judged if item.candidate.name != UNCOMPENSATED]
    none = [item.fold_error[numbers] for item in judged if item.candidate.name == UNCOMPENSATED]
    if not models:
        return tuple(UNCOMPENSATED for _ in data.displacement.T)
    names = [item.candidate.name for item in models]
    square = np.array([item.fold_error[numbers] for item in models])
    level = log_residual(square)
    rivals = max(1, len(models) - 1)
    overall = np.nanmean(level, axis=1)
    usual = [n for n, name in enumerate(names) if name in RIDGE_FORMS]
    linear = [
        n for n, item in enumerate(models) if not (item.contender and item.contender.network)
    ]
    best = min(usual or linear or range(len(names)), key=lambda n: float(overall[n]))
    rival = int(np.argmin(overall))
    if rival != best and better(square[rival], square[best], independent, rivals):
        best = rival
    chosen = []
    for channel in range(square.shape[2]):
        own, rival = best, int(np.argmin(level[:, channel]))
        each = square[:, :, [channel]]
        if rival != own and better(each[rival], each[own], independent, rivals):
            own = rival
        worth = [
            names[number]
            for number in (own, *np.argsort(level[:, channel]))
            if all(
                worth_using(square[number, :, channel], item[:, channel], independent)
                for item in none
            )
        ]
        chosen.append(worth[0] if worth else UNCOMPENSATED)
    return tuple(chosen)


def unseen_residual(
    judged: Sequence[JudgedCandidate],
    data: TrainingSet,
    default: Sequence[str],
    nested: TrainingSet | None = None,
) -> list[Array]:
    """Return what the choice leaves on samples that chose nothing.

    For each fold the model is chosen anew by the folds that share no sample with it; if there is
    none, by all.

    Parameters
    ----------
    judged : sequence of JudgedCandidate
        Candidates that there were to choose from.
    data : TrainingSet
        What they were judged on.
    default : sequence of str, length c
        What was chosen by all folds: a channel that stays uncompensated does so everywhere.
    nested : TrainingSet, optional
        The same samples, each fold with sensors that were chosen without it; absent where no
        sensors are chosen.

    Returns
    -------
    list of ndarray, shape (tested, c)
        Measured minus predicted of each fold [m].
    """
    models = [item for item in judged if item.candidate.name != UNCOMPENSATED]
    chosen = []
    for fold in range(len(data.folds)):
        names = preferred(models, data, data.apart_from(fold) or None) if models else default
        chosen.append(
            [
                UNCOMPENSATED if used == UNCOMPENSATED else name
                for name, used in zip(names, default, strict=True)
            ]
        )
    by_name = {item.candidate.name: item.residual for item in judged}
    if nested is not None:
        measured = [data.displacement[data.tested(fold)] for fold in data.folds]
        contenders = {item.candidate.name: item.contender for item in models}
        for name in {name for names in chosen for name in names} - {UNCOMPENSATED}:
            if (contender := contenders[name]) is None:
                continue
            seen = nested.read_by(name)
            _, predicted = _held_out_predictions(name, contender, seen, lambda: None)
            by_name[name] = [m - p for m, p in zip(measured, predicted, strict=True)]
    return [
        np.stack([by_name[name][fold][:, c] for c, name in enumerate(names)], axis=1)
        for fold, names in enumerate(chosen)
    ]

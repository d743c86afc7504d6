# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The models that compete for a machine, fitted and judged on held-out samples."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from fuzzycnc_ros.core.arrays import Array
from fuzzycnc_ros.core.thermal.candidate import NETWORKS, UNCOMPENSATED, Candidate, Settings
from fuzzycnc_ros.core.thermal.chance import better, log_residual, worth_using
from fuzzycnc_ros.core.thermal.fit.catalogue import fit_recursion
from fuzzycnc_ros.core.thermal.fit.folds import independent_folds
from fuzzycnc_ros.core.thermal.fit.judges import held_out_predictions
from fuzzycnc_ros.core.thermal.fit.training_set import TrainingSet
from fuzzycnc_ros.core.thermal.recursions import LinearRecursion, Recursion, combine
from fuzzycnc_ros.core.thermal.residuals import mean_of_square
from fuzzycnc_ros.core.thermal.run import ThermalDataError

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
    """

    candidate: Candidate
    fold_error: Array
    residual: list[Array]


def fit_candidate(
    name: str,
    data: TrainingSet,
    step: Callable[[], None] = lambda: None,
    *,
    held_out: bool = True,
) -> JudgedCandidate:
    """Choose a candidate's settings, judge it on held-out samples and fit it to all.

    Parameters
    ----------
    name : str
        One of `CANDIDATES`.
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
    try:
        if held_out:
            settings, predicted = held_out_predictions(name, data, step)
        else:
            settings, predicted = [{}] * data.displacement.shape[1], []
        fits = []
        for own, target in zip(settings, data.displacement.T, strict=True):
            fits.append(fit_recursion(name, own, data, target))
            step()
    except ValueError as error:
        raise ThermalDataError(f'model {name!r}: {error}') from error
    except ImportError as error:
        raise ThermalDataError(
            f'model {name!r}: expected the library {error.name} but found none; install '
            'fuzzycnc_ros[ml], or leave the model out'
        ) from error
    problems = list(dict.fromkeys(problem for _, found in fits for problem in found))
    recursion = combine([recursion for recursion, _ in fits])
    if not held_out:
        unknown = np.full(data.displacement.shape[1], np.nan)
        candidate = Candidate(name, tuple(settings), recursion, tuple(problems), unknown, unknown)
        return JudgedCandidate(candidate, np.empty((0, len(unknown))), [])
    return _judged(name, settings, recursion, problems, data, predicted)


def uncompensated(data: TrainingSet) -> JudgedCandidate:
    """Return the candidate that predicts nothing, judged as all others are."""
    channels, inputs = data.displacement.shape[1], data.rise.shape[1] + data.drive.shape[1]
    nothing = LinearRecursion(
        pole=np.empty(0),
        drive=np.empty((0, inputs)),
        readout=np.empty((channels, 0)),
        direct=np.zeros((channels, inputs)),
        offset=np.zeros(channels),
    )
    predicted = [np.zeros((int(data.tested(fold).sum()), channels)) for fold in data.folds]
    return _judged(UNCOMPENSATED, [{}] * channels, nothing, [], data, predicted)


def _judged(
    name: str,
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
    return JudgedCandidate(candidate, fold_error, residuals)


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
        The model with the least residual over all channels, in the geometric mean, unless
        another one is better in a channel by a tenth and beyond chance.  A network is best over
        all channels only if it beats the best linear model in the same way.  A channel that no
        model improves beyond chance stays uncompensated.
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
    linear = [n for n, name in enumerate(names) if name not in NETWORKS]
    best = min(linear or range(len(names)), key=lambda n: float(overall[n]))
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
        for name in {name for names in chosen for name in names} - {UNCOMPENSATED}:
            _, predicted = held_out_predictions(name, nested, lambda: None)
            by_name[name] = [m - p for m, p in zip(measured, predicted, strict=True)]
    return [
        np.stack([by_name[name][fold][:, c] for c, name in enumerate(names)], axis=1)
        for fold, names in enumerate(chosen)
    ]

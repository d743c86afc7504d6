# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The models that compete for a machine, fitted and judged on held-out samples."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from fuzzycnc_ros.core.arrays import Array
from fuzzycnc_ros.core.thermal.candidate import UNCOMPENSATED, Candidate, Settings
from fuzzycnc_ros.core.thermal.fit.catalogue import fit_recursion
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

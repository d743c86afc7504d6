# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The models that compete for a machine, judged on held-out samples, and the choice of one."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import stdtrit

from fuzzycnc_ros.core.arrays import Array
from fuzzycnc_ros.core.thermal.band import held_out_deviation
from fuzzycnc_ros.core.thermal.candidate import NETWORKS, Candidate
from fuzzycnc_ros.core.thermal.catalogue import fit_recursion
from fuzzycnc_ros.core.thermal.judges import held_out_predictions
from fuzzycnc_ros.core.thermal.recursions import combine
from fuzzycnc_ros.core.thermal.residuals import mean_of_square
from fuzzycnc_ros.core.thermal.run import ThermalDataError
from fuzzycnc_ros.core.thermal.training_set import TrainingSet

CONFIDENCE = 0.95
"""Confidence at which another candidate must win to be preferred [-]."""

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
    deviation : ndarray, shape (c,)
        Standard deviation that its held-out residuals speak for [m].
    """

    candidate: Candidate
    fold_error: Array
    deviation: Array


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
            settings, predicted = {}, []
        fits = []
        for target in data.displacement.T:
            fits.append(fit_recursion(name, settings, data, target))
            step()
    except ValueError as error:
        raise ThermalDataError(f'model {name!r}: {error}') from error
    except ImportError as error:
        raise ThermalDataError(
            f'model {name!r}: expected the library {error.name} but found none; install '
            'fuzzycnc_ros[ml], or leave the model out'
        ) from error
    problems = list(dict.fromkeys(problem for _, found in fits for problem in found))
    rms = largest = deviation = np.full(data.displacement.shape[1], np.nan)
    fold_error = np.empty((0, len(rms)))
    if held_out:
        measured = [data.displacement[data.tested(fold)] for fold in data.folds]
        residuals = [m - p for m, p in zip(measured, predicted, strict=True)]
        stacked = np.concatenate(residuals)
        with np.errstate(over='ignore'):
            fold_error = np.stack([mean_of_square(residual) for residual in residuals])
            rms = np.sqrt(mean_of_square(stacked))
        deviation = held_out_deviation(stacked)
        largest = np.asarray(np.nanmax(np.abs(stacked), axis=0))
        bare = np.nanmax(np.abs(np.concatenate(measured)))
        if not (largest < DIVERGED * bare).all():
            problems.append(
                f'on held-out samples it missed by more than {DIVERGED:g} times the largest '
                'displacement: it does not hold where it was not fitted'
            )
    candidate = Candidate(
        name=name,
        settings=settings,
        recursion=combine([recursion for recursion, _ in fits]),
        problems=tuple(problems),
        held_out_rms=rms,
        held_out_max=largest,
    )
    return JudgedCandidate(candidate, fold_error, deviation)


def preferred(judged: Sequence[JudgedCandidate], unit: Array, independent: int) -> tuple[str, ...]:
    """Return the candidate to use for each channel.

    Parameters
    ----------
    judged : sequence of JudgedCandidate
        Candidates to choose from.
    unit : ndarray, shape (c,)
        Spread of each channel [m], by which errors are made comparable.
    independent : int
        Number of folds that share no held-out sample; overlapping ones tell less than as many
        others would.

    Returns
    -------
    tuple of str, length c
        The candidate that is best over all channels, unless another one is better in a channel
        beyond chance: a one-sided t-test on the differences over the folds, at 95 %.  A network
        is best only if it beats the best linear model in the same way.

    Notes
    -----
    With a threshold of one standard error, channels changed to a model that was better on two
    or three folds by luck: on cycles that the choice had not seen it was up to 26 % worse than
    the model that is best over all channels, on the spindle recording of the documentation.
    """
    errors = np.array([item.fold_error / unit**2 for item in judged])
    pooled = np.array([_mean_of_finite(item) for item in errors])
    linear = [n for n, item in enumerate(judged) if item.candidate.name not in NETWORKS]
    everyone = range(len(judged))
    best = min(linear or everyone, key=lambda n: float(pooled[n]))
    rival = min(everyone, key=lambda n: float(pooled[n]))
    if _beats(errors[rival].mean(axis=1), errors[best].mean(axis=1), independent):
        best = rival
    names = []
    for channel in range(len(unit)):
        rms = [float(item.candidate.held_out_rms[channel]) for item in judged]
        rival = int(np.argmin(rms))
        won = _beats(errors[rival][:, channel], errors[best][:, channel], independent)
        names.append(judged[rival if won else best].candidate.name)
    return tuple(names)


def _mean_of_finite(errors: Array) -> float:
    """Return the mean of what was measured; infinity stays."""
    return float(np.mean(errors[~np.isnan(errors)]))


def _beats(error: Array, other: Array, independent: int) -> bool:
    """Return whether errors (folds,) are smaller than others by more than chance."""
    gain = other - error
    gain = gain[np.isfinite(gain)]
    count = min(len(gain), independent)
    if count < 2:
        return False
    # Folds are few: with two of them the gain must be six, with twelve two standard errors.
    quantile = float(stdtrit(count - 1, CONFIDENCE))
    return bool(gain.mean() > quantile * gain.std(ddof=1) / np.sqrt(count))

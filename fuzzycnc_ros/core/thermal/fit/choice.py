# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The choice among judged candidates, and what it leaves on samples that had no say in it."""

from collections.abc import Sequence

import numpy as np

from fuzzycnc_ros.core.arrays import Array
from fuzzycnc_ros.core.thermal.candidate import NETWORKS, UNCOMPENSATED
from fuzzycnc_ros.core.thermal.chance import better, log_residual, worth_using
from fuzzycnc_ros.core.thermal.fit.candidates import JudgedCandidate
from fuzzycnc_ros.core.thermal.fit.folds import independent_folds
from fuzzycnc_ros.core.thermal.fit.judges import held_out_predictions
from fuzzycnc_ros.core.thermal.fit.training_set import TrainingSet


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

# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""What is held out when models and sensors are judged: whole runs, or stretches of one run.

A random split of samples leaks: neighbours in time are nearly equal.
"""

from collections.abc import Sequence
from itertools import accumulate

import numpy as np
from numpy.typing import NDArray

from fuzzycnc_ros.core.thermal.moments import Fold
from fuzzycnc_ros.core.thermal.run import SAMPLES_MIN, ThermalDataError, ThermalRun

SELECTION_CUTS = (0.35, 0.5, 0.7)
"""Forward chaining of a single run: train up to a cut, judge up to the next."""

STRETCHES = 12
"""Stretches that a single run is cut into; they are held out in groups of contiguous ones."""

GROUPS = (3, 4, 6)
"""Numbers of contiguous groups that the stretches of a single run are held out in.

One length alone would favour the model whose memory happens to fit it: short stretches are
interpolated by anything, long ones leave little to train on."""


def run_rows(runs: Sequence[ThermalRun]) -> list[slice]:
    """Return the rows of each run when their samples are stacked."""
    ends = list(accumulate(len(run.time) for run in runs))
    return [slice(end - len(run.time), end) for end, run in zip(ends, runs, strict=True)]


def selection_folds(runs: Sequence[ThermalRun]) -> tuple[NDArray[np.int64], list[Fold]]:
    """Return the stretch of each stacked sample, and the folds for choosing sensors.

    Leave one run out; a single run is chained forward, method sheet 001 section 5.

    Raises
    ------
    ThermalDataError
        If no fold has measured displacements to train and to judge on.
    """
    if len(runs) > 1:
        return _measured(runs, *_leave_one_run_out(runs))
    samples = len(runs[0].time)
    cuts = np.rint(np.array(SELECTION_CUTS) * samples)
    block = np.searchsorted(cuts, np.arange(samples), side='right')
    folds = [Fold(tuple(range(last)), (last,)) for last in range(1, len(cuts) + 1)]
    return _measured(runs, block, folds)


def training_folds(runs: Sequence[ThermalRun]) -> tuple[NDArray[np.int64], list[Fold]]:
    """Return the stretch of each stacked sample, and the folds for choosing a model.

    Leave one run out; of a single run, leave contiguous stretches of three lengths out.

    Raises
    ------
    ThermalDataError
        If no fold has measured displacements to train and to judge on.
    """
    if len(runs) > 1:
        return _measured(runs, *_leave_one_run_out(runs))
    samples = len(runs[0].time)
    block = np.arange(samples) * STRETCHES // samples
    folds = []
    for groups in GROUPS:
        length = STRETCHES // groups
        for first in range(0, STRETCHES, length):
            test = tuple(range(first, first + length))
            folds.append(Fold(tuple(set(range(STRETCHES)) - set(test)), test))
    return _measured(runs, block, folds)


def _measured(
    runs: Sequence[ThermalRun], block: NDArray[np.int64], folds: list[Fold]
) -> tuple[NDArray[np.int64], list[Fold]]:
    """Keep the folds with measured displacements on both sides; probing may be sparse."""
    measured = np.concatenate([np.isfinite(run.displacement).all(axis=1) for run in runs])
    count = np.bincount(block[measured], minlength=int(block.max()) + 1)
    kept = [
        fold
        for fold in folds
        if count[list(fold.train)].sum() >= SAMPLES_MIN and count[list(fold.test)].sum() > 0
    ]
    if not kept:
        raise ThermalDataError(
            f'runs: expected {SAMPLES_MIN} samples measured in all channels to train on and '
            f'others to judge on, but found {int(measured.sum())} in all; probe more often'
        )
    return block, kept


def _leave_one_run_out(runs: Sequence[ThermalRun]) -> tuple[NDArray[np.int64], list[Fold]]:
    block = np.repeat(np.arange(len(runs)), [len(run.time) for run in runs])
    everyone = range(len(runs))
    return block, [
        Fold(tuple(other for other in everyone if other != run), (run,)) for run in everyone
    ]

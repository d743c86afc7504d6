# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Held-out parts by which models and sensors are judged: whole runs, or stretches of one run.

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


REST_MIN = 1800.0
"""Shortest standstill after which a start of the spindle begins a new thermal cycle [s]."""

CYCLES_MIN = 3
"""Fewest cycles of a single run that are held out one by one; two leave one to train on."""


def run_rows(runs: Sequence[ThermalRun]) -> list[slice]:
    """Return the rows of each run when their samples are stacked."""
    ends = list(accumulate(len(run.time) for run in runs))
    return [slice(end - len(run.time), end) for end, run in zip(ends, runs, strict=True)]


def selection_folds(runs: Sequence[ThermalRun]) -> tuple[NDArray[np.int64], list[Fold]]:
    """Return the stretch of each stacked sample, and the folds for choosing sensors.

    Leave one run out; a single run is chained forward, docs/explanation/methods/thermal.md.

    Raises
    ------
    ThermalDataError
        If no fold has measured displacements to train and to judge on.
    """
    if len(runs) > 1:
        return _measured(runs, *_leave_one_run_out(runs))
    place, samples = _places(runs[0])
    cuts = np.rint(np.array(SELECTION_CUTS) * samples)
    block = np.searchsorted(cuts, place, side='right')
    folds = [Fold(tuple(range(last)), (last,)) for last in range(1, len(cuts) + 1)]
    return _measured(runs, block, folds)


def training_folds(runs: Sequence[ThermalRun]) -> tuple[NDArray[np.int64], list[Fold]]:
    """Return the stretch of each stacked sample, and the folds for choosing a model.

    Leave one run out.  Of a single run leave one thermal cycle out, where the recorded spindle
    speed shows at least three; else leave contiguous stretches of three lengths out.

    Raises
    ------
    ThermalDataError
        If no fold has measured displacements to train and to judge on.
    """
    if len(runs) > 1:
        return _measured(runs, *_leave_one_run_out(runs))
    cycle = thermal_cycles(runs[0])
    if int(cycle.max()) + 1 >= CYCLES_MIN:
        try:
            return _measured(runs, cycle, _leave_one_out(int(cycle.max()) + 1))
        except ThermalDataError:
            pass  # probed in too few of the cycles; stretches may still do
    place, samples = _places(runs[0])
    block = place * STRETCHES // samples
    folds = []
    for groups in GROUPS:
        length = STRETCHES // groups
        for first in range(0, STRETCHES, length):
            test = tuple(range(first, first + length))
            folds.append(Fold(tuple(set(range(STRETCHES)) - set(test)), test))
    return _measured(runs, block, folds)


def _places(run: ThermalRun) -> tuple[NDArray[np.int64], int]:
    """Return the place of each sample between the first and last that count, and their number.

    What lies before a window only warms up lags: it belongs to the first stretch.
    """
    measured = np.flatnonzero(np.isfinite(run.displacement).any(axis=1))
    first, last = (measured[0], measured[-1]) if len(measured) else (0, len(run.time) - 1)
    samples = int(last - first) + 1
    return np.clip(np.arange(len(run.time)) - first, 0, samples - 1), samples


def independent_folds(folds: Sequence[Fold]) -> int:
    """Return how many folds share no held-out stretch: the number of folds over their overlap."""
    tested = [block for fold in folds for block in fold.test]
    return round(len(folds) * len(set(tested)) / max(1, len(tested)))


def _measured(
    runs: Sequence[ThermalRun], block: NDArray[np.int64], folds: list[Fold]
) -> tuple[NDArray[np.int64], list[Fold]]:
    """Keep the folds with measured displacements on both sides; probing may be sparse.

    All channels are trained in each fold; it judges those that were measured in its test.
    """
    measured = np.concatenate([np.isfinite(run.displacement) for run in runs])
    blocks = int(block.max()) + 1
    count = np.array([np.bincount(block[own], minlength=blocks) for own in measured.T])
    trained = np.array([count[:, list(fold.train)].sum(axis=1) for fold in folds])
    tested = np.array([count[:, list(fold.test)].sum(axis=1) for fold in folds])
    usable = (trained >= SAMPLES_MIN).all(axis=1) & tested.any(axis=1)
    # A fold of a few samples would weigh as much as the others and decide by chance.
    typical = np.array([np.median(own[own > 0]) if own.any() else 0.0 for own in tested.T])
    weak = (tested > 0) & (tested < 0.1 * typical)
    kept = usable & ~weak.any(axis=1)
    if not tested[kept].any(axis=0).all():
        kept = usable
    unjudged = np.flatnonzero(~tested[kept].any(axis=0))
    if len(unjudged):
        names = ', '.join(runs[0].channel[column] for column in unjudged)
        found = ', '.join(str(int(count[column].sum())) for column in unjudged)
        raise ThermalDataError(
            f'channel {names}: expected {SAMPLES_MIN} measured samples to train on and others to '
            f'judge on, in another run or stretch, but found {found} in all; probe more often, '
            'or in more runs'
        )
    return block, [folds[number] for number in np.flatnonzero(kept)]


def thermal_cycles(run: ThermalRun) -> NDArray[np.int64]:
    """Return the number of the thermal cycle of each sample, shape (n,).

    A cycle begins where the spindle starts after it stood still for half an hour; what comes
    before the first start belongs to the first cycle.  Without a recorded speed there is one.
    """
    cycle = np.zeros(len(run.time), dtype=np.int64)
    if run.spindle_speed is None:
        return cycle
    speed = np.nan_to_num(np.abs(run.spindle_speed))
    turning = speed > 0.01 * max(float(speed.max()), 1e-9)
    stopped_at, number = -np.inf, -1
    for k in range(len(turning)):
        if not turning[k]:
            if k and turning[k - 1]:
                stopped_at = run.time[k]
        elif not k or not turning[k - 1]:
            number += run.time[k] - stopped_at >= REST_MIN
        cycle[k] = max(number, 0)
    return cycle


def _leave_one_run_out(runs: Sequence[ThermalRun]) -> tuple[NDArray[np.int64], list[Fold]]:
    block = np.repeat(np.arange(len(runs)), [len(run.time) for run in runs])
    return block, _leave_one_out(len(runs))


def _leave_one_out(blocks: int) -> list[Fold]:
    everyone = range(blocks)
    return [
        Fold(tuple(other for other in everyone if other != left_out), (left_out,))
        for left_out in everyone
    ]

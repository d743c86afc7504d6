# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The samples that candidates are fitted to and judged on."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from fuzzycnc_ros.core.arrays import Array
from fuzzycnc_ros.core.thermal.candidate import DRIVES_SUFFIX
from fuzzycnc_ros.core.thermal.fit.folds import run_rows, training_folds
from fuzzycnc_ros.core.thermal.moments import Fold, measured_together
from fuzzycnc_ros.core.thermal.run import SPINDLE_SPEED, ThermalRun, drive_of

_SPARSE = 4.0
"""Time without a measurement that still belongs to the training, in usual steps of it [-]."""


def _observed(time: Array, displacement: Array) -> NDArray[np.bool_]:
    """Return which samples of a run were trained on, shape (n,).

    Those with a displacement, and those between two that are no further apart than usual: a
    touch probe measures once in many samples.

    Parameters
    ----------
    time : ndarray, shape (n,)
        Time of each sample [s].
    displacement : ndarray, shape (n, c)
        Thermal error [m]; NaN where nothing was measured.
    """
    at = np.flatnonzero(np.isfinite(displacement).any(axis=1))
    trained = np.zeros(len(time), dtype=np.bool_)
    trained[at] = True
    if len(at) < 2:
        return trained
    step = np.diff(time[at])
    near = step <= _SPARSE * float(np.median(step))
    for first, last in zip(at[:-1][near], at[1:][near], strict=True):
        trained[first:last] = True
    return trained


@dataclass(frozen=True, eq=False)
class TrainingSet:
    """Stacked rises and displacements of the training runs.

    Parameters
    ----------
    rise : ndarray, shape (n, p)
        Rises of the sensors [K].
    drive : ndarray, shape (n, d)
        Heat sources beyond the sensors, see `drive_of`; d is 0 where none was recorded.
    displacement : ndarray, shape (n, c)
        Thermal error [m]; NaN where nothing was measured.
    trained : ndarray of bool, shape (n,)
        Samples between measurements that are no further apart than usual.
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
    drivers : tuple of str, length d
        Names of these heat sources.
    of_fold : tuple of TrainingSet
        The same samples with the sensors that each fold chose without its own stretches; empty
        where no sensors are chosen.
    """

    rise: Array
    drive: Array
    displacement: Array
    trained: NDArray[np.bool_]
    label: NDArray[np.int64]
    rows: list[slice]
    interval: float
    block: NDArray[np.int64]
    folds: list[Fold]
    drivers: tuple[str, ...] = ()
    of_fold: tuple['TrainingSet', ...] = ()

    @staticmethod
    def of(
        runs: Sequence[ThermalRun], inputs: Sequence[str], drivers: Sequence[str] = ()
    ) -> 'TrainingSet':
        """Stack runs of the same channels and interval."""
        block, folds = training_folds(runs)
        rows = run_rows(runs)
        return TrainingSet(
            rise=_rise(runs, inputs),
            drive=np.concatenate([drive_of(run, drivers) for run in runs]),
            displacement=np.concatenate([run.displacement for run in runs]),
            trained=np.concatenate([_observed(run.time, run.displacement) for run in runs]),
            label=np.repeat(np.arange(len(runs)), [len(run.time) for run in runs]),
            rows=rows,
            interval=runs[0].interval,
            block=block,
            folds=folds,
            drivers=tuple(drivers),
        )

    def read_by(self, name: str) -> 'TrainingSet':
        """Return the samples as a candidate of a name has them: drives only if it reads them."""
        kept = int(SPINDLE_SPEED in self.drivers)
        if name.endswith(DRIVES_SUFFIX) or len(self.drivers) == kept:
            return self
        return replace(
            self,
            drive=self.drive[:, :kept],
            drivers=self.drivers[:kept],
            of_fold=tuple(item.read_by(name) for item in self.of_fold),
        )

    def nested(self, runs: Sequence[ThermalRun], inputs: Sequence[Sequence[str]]) -> 'TrainingSet':
        """Return the set in which each fold has the sensors that were chosen without it."""
        return replace(
            self, of_fold=tuple(replace(self, rise=_rise(runs, names)) for names in inputs)
        )

    def seen_by(self, fold: int) -> 'TrainingSet':
        """Return the samples as the fold of a number sees them."""
        return self.of_fold[fold] if self.of_fold else self

    def tested(self, fold: Fold) -> NDArray[np.bool_]:
        """Return which samples a fold judges on, shape (n,)."""
        return np.isin(self.block, fold.test)

    def apart_from(self, fold: int) -> list[int]:
        """Return the folds that judge on no sample of one of them; it may be none."""
        own = set(self.folds[fold].test)
        return [number for number, item in enumerate(self.folds) if not own & set(item.test)]

    def channel_groups(self) -> list[NDArray[np.int64]]:
        """Return the channels that were measured in the same samples, group by group."""
        return measured_together(self.displacement)

    def scaled_target(self) -> tuple[Array, Array]:
        """Return the displacements (n, c) and the unit (c,) [m] that makes them of order 1."""
        unit = np.nanstd(self.displacement, axis=0)
        unit = np.where(unit > 0.0, unit, 1.0)
        return self.displacement / unit, unit


def _rise(runs: Sequence[ThermalRun], inputs: Sequence[str]) -> Array:
    return np.concatenate([run.rise()[:, run.columns(inputs)] for run in runs])

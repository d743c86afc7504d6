# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Improve a choice of sensors on held-out samples.

It is step 4 of choosing sensors in docs/explanation/methods/thermal.md.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fuzzycnc_ros.core.arrays import Array
from fuzzycnc_ros.core.thermal.fit.folds import selection_folds
from fuzzycnc_ros.core.thermal.fit.grey import stable_poles
from fuzzycnc_ros.core.thermal.fit.linear import lag_features
from fuzzycnc_ros.core.thermal.moments import (
    Fold,
    Moments,
    mean_square_error,
    measured_together,
    spread,
    stable_grey_from_sums,
)
from fuzzycnc_ros.core.thermal.run import ThermalRun

Progress = Callable[[str, str, int, int], None]
"""Called with stage, candidate, steps done and steps in all; may raise to cancel."""

CANDIDATES_PER_CLUSTER = 6
"""Members of a cluster that the refinement tries, spread evenly over the ranking."""

REFINE_SWEEPS = 2
"""Sweeps of the coordinate descent over the clusters."""

REFINE_RIDGE = 1e-3
"""Penalty of the stable grey model that judges a choice of sensors."""


@dataclass(frozen=True, eq=False)
class TemperatureField:
    """Stacked rises of the usable sensors and displacements of all training runs."""

    sensor: tuple[str, ...]
    rise: Array
    displacement: Array
    dropped: tuple[str, ...]
    rows: list[slice]


def refined(
    field: TemperatureField,
    ranked: list[NDArray[np.int64]],
    runs: Sequence[ThermalRun],
    progress: Progress | None,
) -> list[int]:
    """Improve the best ranked members by coordinate descent on the held-out error."""
    candidates = []
    for members in ranked:
        count = min(CANDIDATES_PER_CLUSTER, len(members))
        positions = np.unique(np.rint(np.linspace(0, len(members) - 1, count)).astype(np.int64))
        candidates.append([int(members[position]) for position in positions])
    pool = sorted({sensor for options in candidates for sensor in options})
    judge = _Judge(field, pool, runs)
    chosen = [options[0] for options in candidates]
    best = judge.error(chosen)
    total = REFINE_SWEEPS * sum(len(options) for options in candidates)
    done = 0
    for _ in range(REFINE_SWEEPS):
        for cluster, options in enumerate(candidates):
            for sensor in options:
                trial = [*chosen[:cluster], sensor, *chosen[cluster + 1 :]]
                error = judge.error(trial)
                if error < best:
                    best, chosen = error, trial
                done += 1
                if progress is not None:
                    progress('select_sensors', field.sensor[sensor], done, total)
    return chosen


class _Judge:
    """Held-out error of the stable grey model for a choice of sensors."""

    def __init__(
        self, field: TemperatureField, pool: Sequence[int], runs: Sequence[ThermalRun]
    ) -> None:
        self._position = {sensor: index for index, sensor in enumerate(pool)}
        drivers = field.rise[:, pool]
        block, self._folds = selection_folds(runs)
        poles = stable_poles(runs[0].interval)
        # Each pole's lags as a leading axis: shape (poles, samples, sensors).
        lagged = lag_features(drivers, field.rows, poles, direct=False)
        lagged = lagged.reshape(len(drivers), len(poles), len(pool)).transpose(1, 0, 2)
        # Targets of order 1 keep the sums of products well scaled.
        target = field.displacement / np.nanmax(np.abs(field.displacement))
        self._moments = [
            (
                Moments.of(lagged, target[:, group], block),
                Moments.of(drivers, target[:, group], block),
            )
            for group in measured_together(target)
        ]
        self._known: dict[tuple[int, ...], float] = {}

    def error(self, sensors: Sequence[int]) -> float:
        """Return the sum over channels and folds of the held-out mean square error."""
        key = tuple(self._position[sensor] for sensor in sensors)
        if key not in self._known:
            picked = [(lags.pick(key), drivers.pick(key)) for lags, drivers in self._moments]
            self._known[key] = sum(
                _fold_error(lags, drivers, fold)
                for lags, drivers in picked
                for fold in self._folds
            )
        return self._known[key]


def _fold_error(lags: Moments, drivers: Moments, fold: Fold) -> float:
    """Return the sum over channels of the mean square error; what was not measured is 0."""
    scale = spread(drivers.over(fold.train), slice(1, 1 + drivers.inputs))
    pole, weight = stable_grey_from_sums(lags, fold.train, scale, REFINE_RIDGE)
    sums = lags.over(fold.test)
    total = 0.0
    for channel, chosen in enumerate(pole):
        error = mean_square_error(sums[chosen], weight, np.zeros(weight.shape[1]))
        total += float(np.nan_to_num(error[channel]))
    return total

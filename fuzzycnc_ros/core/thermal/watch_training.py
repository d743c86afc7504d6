# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Learn from training runs how well the sensors of a machine know each other."""

from collections.abc import Sequence

import numpy as np

from fuzzycnc_ros.core.arrays import Array
from fuzzycnc_ros.core.thermal.folds import training_folds
from fuzzycnc_ros.core.thermal.recursions import first_order_lags
from fuzzycnc_ros.core.thermal.run import ThermalRun
from fuzzycnc_ros.core.thermal.selected import SensorSelection
from fuzzycnc_ros.core.thermal.sensor_watch import (
    VOTERS,
    Indices,
    Leverage,
    SensorWatchModel,
    agreed,
    moment_of,
    voter_weights,
)

SMOOTHING = 300.0
"""Time constant of the smoothing of held-out residuals [s]: noise is not what the mates miss."""

DECIMALS = 6
"""Decimals of the moments [K^2] in a model file; a reading's noise is 0.01 K^2."""


def learn_watch(
    runs: Sequence[ThermalRun], selection: SensorSelection, interval: float
) -> SensorWatchModel:
    """Learn the sensors' common behaviour, and how well it tells of each chosen one.

    Parameters
    ----------
    runs : sequence of ThermalRun
        Training runs of one machine, checked and at one interval.
    selection : SensorSelection
        The chosen sensors; those that never warmed are no mates.
    interval : float
        Sampling interval [s].

    Returns
    -------
    SensorWatchModel
        Moments of all runs; misses and distances of runs that were held out, or of stretches
        of a single run.

    Raises
    ------
    ThermalDataError
        If no fold has measured displacements, as in the choice of a model.
    """
    sensor = tuple(name for name in runs[0].sensor if name not in selection.dropped)
    rise = np.concatenate([run.rise()[:, run.columns(sensor)] for run in runs])
    targets = np.array([sensor.index(name) for name in selection.chosen], dtype=np.int64)
    block, folds = training_folds(runs)
    moments = [moment_of(rise[block == number]) for number in range(int(block.max()) + 1)]
    sizes = np.bincount(block)
    share = min(1.0, interval / SMOOTHING)
    missed, leverage = np.zeros(len(targets)), np.zeros(len(targets))
    for fold in folds:
        train = list(fold.train)
        moment = np.sum([moments[number] for number in train], axis=0) / sizes[train].sum()
        held_out = rise[np.isin(block, fold.test)]
        residual, distance = _judged(moment, targets, held_out)
        smooth = first_order_lags(np.array(1.0 - share), share * residual)
        missed = np.maximum(missed, np.abs(agreed(smooth)).max(axis=0))
        leverage = np.maximum(leverage, distance.max(axis=0))
    return SensorWatchModel(
        sensor=sensor,
        input=selection.chosen,
        moment=np.round(np.sum(moments, axis=0) / len(rise), DECIMALS),
        missed=missed,
        leverage=leverage,
    )


def _judged(moment: Array, targets: Indices, rise: Array) -> tuple[Array, Array]:
    """Return what each voter misses of held-out rises, (n, voters, p) [K], and their leverage."""
    usable = np.arange(len(moment))
    weights = voter_weights(moment, targets, usable)
    expected = rise @ weights.reshape(VOTERS * len(targets), -1).T
    residual = rise[:, np.newaxis, targets] - expected.reshape(len(rise), VOTERS, -1)
    return np.nan_to_num(residual), Leverage(moment, targets, usable).of(rise)

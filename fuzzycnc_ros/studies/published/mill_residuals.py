# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Residuals of grey models and their rivals on the simulated mill [ding_zeng], by noise seed."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from fuzzycnc_ros.core.arrays import Array
from fuzzycnc_ros.core.thermal.fit import (
    GreyModel,
    LagRidge,
    LeastSquares,
    StaticRidge,
    select_sensors,
)
from fuzzycnc_ros.core.thermal.fit.anfis import Anfis, GreyAnfis
from fuzzycnc_ros.core.thermal.run import ThermalRun
from fuzzycnc_ros.papers.grey import GreyVariant
from fuzzycnc_ros.simulation.thermal.duties import record_runs

SEEDS = 12
"""Seeds of the noise whose median counts."""

MODELS: dict[str, Callable[..., Any]] = {
    'least_squares': LeastSquares,
    'static_ridge': StaticRidge,
    'lag_ridge': LagRidge,
    'classical': lambda interval: GreyModel('classical', interval=interval),
    'convolution': lambda interval: GreyVariant('convolution', interval=interval),
    'optimised': lambda interval: GreyVariant('optimised', interval=interval),
    'discrete': lambda interval: GreyVariant('discrete', interval=interval),
    'stable': lambda interval: GreyModel('stable', interval=interval),
    'anfis': Anfis,
    'grey_anfis': GreyAnfis,
}
"""Models by name: what makes one for a sampling interval [s]."""


class MillResiduals:
    """Largest residuals of models of the mill, trained anew for each noise seed.

    Parameters
    ----------
    recordings : sequence of dict of str to ThermalRun
        Runs of the duties by name, for each seed.
    training : sequence of str
        Duties that are trained on.
    every : int
        Rows of 1 min of which one counts; 10 of D0 alone are the published training, 21 samples.
    """

    def __init__(
        self, recordings: Sequence[dict[str, ThermalRun]], training: Sequence[str], every: int
    ) -> None:
        self._every = every
        self._training = training
        self._seeds = [
            (runs, select_sensors([runs[name] for name in training]).chosen) for runs in recordings
        ]
        self._known: dict[str, tuple[dict[str, Array], Array]] = {}

    @classmethod
    def as_published(cls, seeds: int = SEEDS) -> MillResiduals:
        """Return those of the published training: 21 samples of one duty."""
        return cls([record_runs(seed=seed) for seed in range(seeds)], ('D0',), 10)

    def all(
        self, name: str, make: Callable[..., Any] | None = None
    ) -> tuple[dict[str, Array], Array]:
        """Return residuals (seeds, 2) [um] by run, and which fits were flagged (seeds, 2)."""
        if name not in self._known:
            self._known[name] = self._judge(make or MODELS[name])
        return self._known[name]

    def median(self, name: str, run: str) -> Array:
        """Return the medians over the seeds of Y and Z [um]."""
        return np.asarray(np.median(self.all(name)[0][run], axis=0))

    def uncompensated(self, run: str) -> Array:
        """Return the medians over the seeds of the largest errors of Y and Z [um]."""
        rows = [
            np.abs(self._samples(runs[run], sensors)[1]).max(axis=0)
            for runs, sensors in self._seeds
        ]
        return np.asarray(1e6 * np.median(rows, axis=0))

    def _samples(self, run: ThermalRun, sensors: Sequence[str]) -> tuple[Array, Array]:
        """Rises are taken on all rows: their reference is the mean of the first minutes."""
        rise = run.rise()[:, run.columns(sensors)]
        return rise[:: self._every], run.displacement[:: self._every]

    def _judge(self, make: Callable[..., Any]) -> tuple[dict[str, Array], Array]:
        residuals: dict[str, list[Array]] = {}
        flagged = []
        for runs, sensors in self._seeds:
            parts = [self._samples(runs[name], sensors) for name in self._training]
            rise = np.concatenate([part[0] for part in parts])
            label = np.repeat(np.arange(len(parts)), [len(part[0]) for part in parts])
            models = [
                make(interval=60.0 * self._every).fit(rise, target, runs=label)
                for target in np.concatenate([part[1] for part in parts]).T
            ]
            flagged.append([bool(getattr(model, 'problems_', ())) for model in models])
            for name, run in runs.items():
                inputs, measured = self._samples(run, sensors)
                predicted = np.column_stack([model.predict(inputs) for model in models])
                residual = 1e6 * np.abs(predicted - measured).max(axis=0)
                residuals.setdefault(name, []).append(np.nan_to_num(residual, nan=np.inf))
        return {name: np.array(rows) for name, rows in residuals.items()}, np.array(flagged)

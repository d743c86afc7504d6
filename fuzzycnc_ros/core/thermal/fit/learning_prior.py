# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Learn from calibration runs as if they had been probed, all at once."""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from fuzzycnc_ros.core.arrays import Array
from fuzzycnc_ros.core.thermal.fit.folds import thermal_cycles
from fuzzycnc_ros.core.thermal.learning import EXPECTED, Basis, Posterior, Probe
from fuzzycnc_ros.core.thermal.prior import LAGS, MODEL_SHARE, LearningPrior
from fuzzycnc_ros.core.thermal.run import ThermalRun

EVERY = 1200.0
"""Least time whose mean displacement counts as a probe [s]: closer ones miss alike, and would be
believed too much."""

EVIDENCE_MAX = 240
"""Most means of a channel that count: the time of a search grows with their cube."""

EXPECTED_OF_RUNS = EXPECTED._replace(change=0.1)
"""Medians of the scales of calibration runs, which are planned and follow each other soon.  On the
simulated mill and grinder, whose weights never change, less would do a little better."""

NOISE, NOISE_MIN = 0.3e-6, 0.1e-6
"""Noise of displacements too far apart to tell theirs, and the least one [m]."""

TRIPLES_MIN = 10
"""Fewest displacements in three successive samples that tell of their noise."""

MEDIAN_OF_NORMAL = 0.6745
"""Median absolute value of the standard normal distribution [-]."""


class _Stretch(NamedTuple):
    """A run, or a thermal cycle of a single one: its number, and its samples from one on."""

    number: int
    time: Array
    features: Array
    displacement: Array


def learning_prior(
    runs: Sequence[ThermalRun], inputs: Sequence[str], speed: bool
) -> LearningPrior | None:
    """Return what calibration runs teach of a machine, to learn on from.

    Parameters
    ----------
    runs : sequence of ThermalRun
        Training runs, at the interval of the model.  Thermal cycles of a single one count as runs
        of their own.
    inputs : sequence of str
        Sensors that the model reads.
    speed : bool
        Whether all runs have the spindle speed.

    Returns
    -------
    LearningPrior or None
        None if the model has more inputs than can be learnt from.
    """
    try:
        basis = Basis(len(inputs), speed, runs[0].interval, LAGS)
    except ValueError:
        return None
    stretches: list[_Stretch] = []
    for run in runs:
        stretches += _stretches(run, _features(basis, run, inputs), len(stretches), len(runs) == 1)
    known = []
    for channel in range(len(runs[0].channel)):
        found = Posterior.studied(basis, list(_probes(stretches, channel)), EXPECTED_OF_RUNS)
        known.append(found._replace(mean=(1.0 - MODEL_SHARE) * found.mean))
    return LearningPrior(basis, tuple(known))


def _features(basis: Basis, run: ThermalRun, inputs: Sequence[str]) -> Array:
    speeds = run.spindle_speed if basis.speed else None
    features, state = [], basis.initial_state()
    for row, rise in enumerate(run.rise()[:, run.columns(inputs)]):
        now = 0.0 if speeds is None else float(speeds[row])
        found, state = basis.step(rise, now, state)
        features.append(found)
    return np.array(features)


def _stretches(run: ThermalRun, features: Array, first: int, alone: bool) -> Iterator[_Stretch]:
    cycle = thermal_cycles(run) if alone else np.zeros(len(run.time), dtype=np.int64)
    for number in range(int(cycle.max()) + 1):
        rows = cycle == number
        time = run.time[rows]
        yield _Stretch(first + number, time - time[0], features[rows], run.displacement[rows])


def _probes(stretches: Sequence[_Stretch], channel: int) -> Iterator[Probe]:
    """Yield the mean displacements of a channel, over times of one length, as probes."""
    measured = [np.flatnonzero(np.isfinite(item.displacement[:, channel])) for item in stretches]
    pairs = [pair for pair in zip(stretches, measured, strict=True) if len(pair[1])]
    span = sum(float(item.time[rows[-1]] - item.time[rows[0]]) for item, rows in pairs)
    every = max(EVERY, span / max(1, EVIDENCE_MAX - len(pairs)))
    noise = _noise([item.displacement[:, channel] for item in stretches])
    for item, rows in pairs:
        window = ((item.time[rows] - item.time[rows[0]]) / every).astype(np.int64)
        for number in np.unique(window):
            own = rows[window == number]
            yield Probe(
                item.number,
                float(item.time[own].mean()),
                item.features[own].mean(axis=0),
                float(item.displacement[own, channel].mean()),
                noise,
            )


def _noise(displacements: Sequence[Array]) -> float:
    """Return the standard deviation of single displacements [m], from their second differences."""
    second = np.concatenate([np.diff(values, 2) for values in displacements])
    second = second[np.isfinite(second)]
    if len(second) < TRIPLES_MIN:
        return NOISE
    return max(NOISE_MIN, float(np.median(np.abs(second)) / (MEDIAN_OF_NORMAL * np.sqrt(6.0))))

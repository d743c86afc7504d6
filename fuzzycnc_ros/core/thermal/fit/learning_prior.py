# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Learn from calibration runs as if they had been probed, all at once."""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fuzzycnc_ros.core import portable
from fuzzycnc_ros.core.arrays import Array
from fuzzycnc_ros.core.thermal.band import better, mean_of_square
from fuzzycnc_ros.core.thermal.fit.folds import independent_folds, thermal_cycles
from fuzzycnc_ros.core.thermal.fit.training_set import TrainingSet
from fuzzycnc_ros.core.thermal.learning import (
    EXPECTED,
    Basis,
    Knowledge,
    Posterior,
    Probe,
    Scales,
)
from fuzzycnc_ros.core.thermal.places import motion_of
from fuzzycnc_ros.core.thermal.prior import LAGS, MODEL_SHARE, LearningPrior
from fuzzycnc_ros.core.thermal.run import ThermalRun
from fuzzycnc_ros.core.thermal.screw_growth import screws_of

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


UNSEEN = 4.0
"""Drift of another run, over that of those that were learnt from [-]: weights fit most of theirs.
With it the bands of the simulated mill and grinder hold 95 % between hourly probes."""


class _Samples(NamedTuple):
    """Samples of all runs, each with the number of its run, or of its cycle in a single one."""

    run: NDArray[np.int64]
    time: Array
    features: Array
    displacement: Array


def learning_prior(
    runs: Sequence[ThermalRun],
    inputs: Sequence[str],
    speed: bool,
    data: TrainingSet,
    unseen: Sequence[Array],
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
    data : TrainingSet
        The same samples, with their folds.
    unseen : sequence of ndarray, shape (tested, c)
        Measured minus predicted error of the model where each fold is judged [m].

    Returns
    -------
    LearningPrior or None
        None if the model has more inputs than can be learnt from.
    """
    screws = screws_of(runs[0].channel, [run.drives for run in runs])
    try:
        basis = Basis(len(inputs), speed, runs[0].interval, LAGS, screws)
    except ValueError:
        return None
    samples = _Samples(
        run=thermal_cycles(runs[0]) if len(runs) == 1 else data.label,
        time=np.concatenate([run.time for run in runs]),
        features=np.concatenate([_features(basis, run, inputs) for run in runs]),
        displacement=data.displacement,
    )
    # Weights that read the motion of axes know what most models do not: no mean of equals.
    part = 0.0 if screws else MODEL_SHARE
    known, share = [], []
    for channel, name in enumerate(runs[0].channel):
        seen = samples._replace(features=basis.seen_by(name) * samples.features)
        probes = list(_probes(seen, channel))
        found = Posterior.studied(basis, probes, EXPECTED_OF_RUNS)
        lost = _lost(basis, seen, channel, found.scales, data, unseen, part)
        known.append(_of_another_run(found, part, mean=0.0 if lost else 1.0 - part))
        share.append(1.0 if lost else part)
    return LearningPrior(basis, tuple(known), tuple(share))


def _lost(
    basis: Basis,
    samples: _Samples,
    channel: int,
    scales: Scales,
    data: TrainingSet,
    unseen: Sequence[Array],
    part: float,
) -> bool:
    """Return whether the model alone is better than with the weights, on what neither had seen."""
    alone, both = [], []
    for fold, left in zip(data.folds, unseen, strict=True):
        tested = data.tested(fold)
        probes = list(_probes(samples, channel, ~tested))
        weights = Posterior.studied(basis, probes, scales, tuned=False).mean
        expected = portable.matmul(samples.features[tested], weights)
        missed = samples.displacement[tested, channel] - expected
        alone.append(mean_of_square(left[:, [channel]]))
        both.append(
            mean_of_square(part * left[:, [channel]] + (1.0 - part) * missed[:, np.newaxis])
        )
    return better(np.array(alone), np.array(both), independent_folds(data.folds))


def _of_another_run(known: Knowledge, part: float, mean: float) -> Knowledge:
    """Return what is known of the weights' share of an error, with the drift of an unseen run."""
    rest = 1.0 - part
    rise, speed, drift, change = known.scales
    return Knowledge(
        scales=Scales(rest * rise, rest * speed, UNSEEN * drift, change),
        fastest=known.fastest,
        mean=mean * known.mean,
        covariance=rest * rest * known.covariance,
    )


def _features(basis: Basis, run: ThermalRun, inputs: Sequence[str]) -> Array:
    speeds = run.spindle_speed if basis.speed else None
    features, state = [], basis.initial_state()
    moved = motion_of(run.drives, basis.axes, len(run.time))
    for row, rise in enumerate(run.rise()[:, run.columns(inputs)]):
        now = 0.0 if speeds is None else float(speeds[row])
        found, state = basis.step(rise, now, state, moved[row])
        features.append(found)
    return np.array(features)


def _probes(
    samples: _Samples, channel: int, seen: NDArray[np.bool_] | None = None
) -> Iterator[Probe]:
    """Yield the mean displacements of a channel, over times of one length, as probes."""
    displacement = samples.displacement[:, channel]
    measured = np.isfinite(displacement)
    noise = _noise(displacement)
    if seen is not None:
        measured &= seen
    rows = [np.flatnonzero(measured & (samples.run == run)) for run in np.unique(samples.run)]
    rows = [own for own in rows if len(own)]
    span = sum(float(samples.time[own[-1]] - samples.time[own[0]]) for own in rows)
    every = max(EVERY, span / max(1, EVIDENCE_MAX - len(rows)))
    for own in rows:
        time = samples.time[own] - samples.time[own[0]]
        window = (time / every).astype(np.int64)
        for number in np.unique(window):
            inside = window == number
            yield Probe(
                int(samples.run[own[0]]),
                float(time[inside].mean()),
                samples.features[own[inside]].mean(axis=0),
                float(displacement[own[inside]].mean()),
                noise,
            )


def _noise(displacement: Array) -> float:
    """Return the standard deviation of single displacements [m], from their second differences."""
    second = np.diff(displacement, 2)
    second = second[np.isfinite(second)]
    if len(second) < TRIPLES_MIN:
        return NOISE
    return max(NOISE_MIN, float(np.median(np.abs(second)) / (MEDIAN_OF_NORMAL * np.sqrt(6.0))))

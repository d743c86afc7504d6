# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""What fuzzy regimes are worth to a machine that learns from nothing but probes.

Takagi-Sugeno: weights w0 + mu(t) w1, the membership mu between 0 and 1, and the deviation of w1
beforehand a share of that of w0.  Memberships are

- heating: the mean of all rises is above its own slower mean; 0.1 K wide,
- running: the spindle turns, with a lag of two minutes,
- warm: the mean rise m against 5 K, m / (m + 5 K),
- c-means: the second of two clusters of mean rise and its change.  They are those of all samples
  of all runs, which no machine has before they are over: it is judged too well.

Each is judged alone; *heating, learnt* takes its share by marginal likelihood, among 0 to 1, with
the other scales.  *Chosen* is the mixture of none, heating, running and warm, each with the
likelihood of the probes so far under what it predicted, by channel.

Printed are the error without regimes, the geometric mean over runs, channels and seeds, and that
of each other over it, with the least and largest of the channels; then the share of samples in
the band.  Shares were chosen on the simulated mill and grinder, widths set beforehand.

Run with `python benchmarks/thermal_regimes.py [--recordings DIR] [--markdown FILE]`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from typing import NamedTuple
from unittest.mock import patch

import numpy as np
from thermal_learning import NOISE, all_rows, arguments, follow, show
from thermal_recordings import Machine

from fuzzycnc_ros.core import portable
from fuzzycnc_ros.core.fuzzy.clustering import FuzzyCMeans
from fuzzycnc_ros.core.thermal.band import coverage
from fuzzycnc_ros.core.thermal.fit.training import training_interval
from fuzzycnc_ros.core.thermal.learning import GATE, Basis, Learner, Posterior
from fuzzycnc_ros.core.thermal.run import ThermalRun
from fuzzycnc_ros.studies.thermal import learnt
from fuzzycnc_ros.studies.thermal.learnt import LearntRun

LAGS = np.array([300.0, 1200.0, 120.0])
"""Lags of the mean rise, the slower one, and that of the spindle [s]."""

WIDTH, WARM, TURNING = 0.1, 5.0, 1.0
"""Width of heating, rise that is half warm [K]; speed above which a spindle turns [rad/s]."""

SHARES = (1e-6, 0.2, 0.4, 0.7, 1.0)
"""Shares that are tried where it is learnt."""


class Slow(NamedTuple):
    """Slow quantities of a machine: mean rise, its slower mean [K], and how much it turns [-]."""

    rise: float | np.ndarray = 0.0
    before: float | np.ndarray = 0.0
    turning: float | np.ndarray = 0.0

    def next(self, rise: np.ndarray, speed: float, interval: float) -> Slow:
        """Return those of the next sample."""
        mean = float(np.mean(rise))
        drive = np.array([mean, mean, float(abs(speed) > TURNING)])
        share = 1.0 - portable.exp(-interval / LAGS)
        return Slow(*(np.array(self) + share * (drive - self)))


Membership = Callable[[Slow], float]


def heating(slow: Slow) -> float:
    """Return how much the machine is heating up."""
    return float(0.5 + 0.5 * np.tanh((slow.rise - slow.before) / WIDTH))


def running(slow: Slow) -> float:
    """Return how much the spindle has been turning."""
    return float(slow.turning)


def warm(slow: Slow) -> float:
    """Return how warm the machine is."""
    return float(abs(slow.rise) / (abs(slow.rise) + WARM))


def clustered(runs: Sequence[ThermalRun], interval: float) -> Membership:
    """Return the membership in the warmer of two fuzzy clusters of all samples of all runs."""
    rows = []
    for run in runs:
        slow = Slow()
        for rise in run.rise():
            slow = slow.next(rise, 0.0, interval)
            rows.append((slow.rise, slow.rise - slow.before))
    spread = np.std(rows, axis=0)
    centers = FuzzyCMeans(n_clusters=2, random_state=0).fit(rows / spread).cluster_centers_
    colder, warmer = centers[np.abs(centers[:, 0]).argsort()]

    def membership(slow: Slow) -> float:
        row = np.array([slow.rise, slow.rise - slow.before]) / spread
        cold, hot = (float(np.sum((row - center) ** 2)) for center in (colder, warmer))
        return cold / (cold + hot)

    return membership


@dataclass(frozen=True)
class RegimeBasis(Basis):
    """Features once more, times a membership; those of rises before those of the speed."""

    membership: Membership = warm

    @cached_property
    def plain(self) -> Basis:
        """The features without regimes."""
        return Basis(self.sensors, self.speed, self.interval, self.lags)

    @property
    def of_rises(self) -> int:
        """Number of features that are rises or their lags."""
        return 2 * self.plain.of_rises

    @property
    def features(self) -> int:
        """Number of features."""
        return 2 * self.plain.features

    def seen_by(self, channel: str) -> np.ndarray:
        """Return 1 for all features: none is of a screw."""
        return np.ones(self.features)

    def initial_state(self) -> np.ndarray:
        """Return the state at the thermal reference: lags, then what is slow."""
        return np.append(self.plain.initial_state(), np.zeros(len(LAGS)))

    def step(
        self,
        rise: np.ndarray,
        speed: float,
        state: np.ndarray,
        motion: np.ndarray | None = None,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return the features of a sample and the next state."""
        slow = Slow(*state[-len(LAGS) :]).next(rise, speed, self.interval)
        features, lags = self.plain.step(rise, speed, state[: -len(LAGS)], motion)
        parts = np.split(features, [self.plain.of_rises])
        degree = self.membership(slow)
        both = [values for part in parts for values in (part, degree * part)]
        return np.concatenate(both), np.concatenate((lags, slow))


class RegimePosterior(Posterior):
    """Posterior whose second weights are a share of the first; without a share it is learnt."""

    def __init__(self, basis: RegimeBasis, share: float | None) -> None:
        self._plain = Posterior(basis.plain)
        self._learnt, self._regime = share is None, 0.4 if share is None else share
        super().__init__(basis)

    def tune(self) -> None:
        """Learn the share, then the scales."""
        if self._learnt and self._probes:
            found = []
            for self._regime in SHARES:
                found.append((self._evidence(self._probes).surprise(self.scales), self._regime))
            self._regime = min(found)[1]
        super().tune()

    def _units(self) -> np.ndarray:
        self._plain._fastest = self._fastest
        parts = np.split(self._plain._units(), [self._basis.plain.of_rises])
        return np.concatenate([unit for part in parts for unit in (part, self._regime * part)])


def regime_learner(
    membership: Membership, share: float | None, basis: Basis, channel: Sequence[str]
) -> Learner:
    """Return a learner with regimes."""
    learner = Learner(basis, channel)
    learner.basis = RegimeBasis(
        basis.sensors, basis.speed, basis.interval, basis.lags, membership=membership
    )
    learner.posteriors = tuple(RegimePosterior(learner.basis, share) for _ in channel)
    learner.rest()
    return learner


NONE = 'none'
FORMS = {'heating': (heating, 0.3), 'running': (running, 0.3), 'warm': (warm, 0.5)}
CHOSEN = 'chosen'
WAYS = (NONE, *FORMS, 'heating, learnt', 'c-means', CHOSEN)


class Judged(NamedTuple):
    """What was measured and predicted in a run, and where a channel was probed, (n, c)."""

    measured: np.ndarray
    predicted: np.ndarray
    deviation: np.ndarray
    probed: np.ndarray


def judged(found: list[list[LearntRun]]) -> list[list[Judged]]:
    """Return what each seed's runs predicted."""
    return [
        [Judged(run.measured, run.predicted, run.deviation, run.probed) for run in runs]
        for runs in found
    ]


def mixed(members: Sequence[Sequence[Judged]]) -> list[Judged]:
    """Return the mixture of members along their runs, by the likelihood of the probes so far."""
    score = np.log(np.array([0.4] + [0.6 / (len(members) - 1)] * (len(members) - 1)))[:, None]
    found = []
    for runs in zip(*members, strict=True):
        measured, probed = runs[0].measured, runs[0].probed
        predicted, deviation = np.empty_like(measured), np.empty_like(measured)
        means, spreads = (np.array([run[part] for run in runs]) for part in (1, 2))
        for row, (mean, spread) in enumerate(
            zip(*(np.moveaxis(x, 1, 0) for x in (means, spreads)), strict=True)
        ):
            weight = np.exp(score - score.max(axis=0))
            weight = weight / weight.sum(axis=0)
            predicted[row] = np.sum(weight * mean, axis=0)
            square = np.square(spread) + np.square(mean - predicted[row])
            deviation[row] = np.sqrt(np.sum(weight * square, axis=0))
            if probed[row].any():
                variance = np.square(spread) + NOISE * NOISE
                off = np.minimum(np.square(measured[row] - mean) / variance, GATE * GATE)
                score = score - 0.5 * np.where(probed[row], np.log(variance) + off, 0.0)
        found.append(Judged(measured, predicted, deviation, probed))
    return found


def ways_of(machine: Machine, every: float, seeds: int) -> dict[str, list[list[Judged]]]:
    """Return what a machine's runs predict in each way, for each seed."""
    interval = training_interval(machine.sets[0])
    clusters = clustered(machine.sets[0], interval)
    forms = {**FORMS, 'heating, learnt': (heating, None), 'c-means': (clusters, 0.5)}
    found = {NONE: judged(follow(machine, every, seeds))}
    for name, form in forms.items():
        with patch.object(learnt, 'Learner', partial(regime_learner, *form)):
            found[name] = judged(follow(machine, every, seeds))
    members = zip(*(found[name] for name in (NONE, *FORMS)), strict=True)
    found[CHOSEN] = [mixed(each) for each in members]
    return found


def levels(found: list[list[Judged]]) -> np.ndarray:
    """Return the logarithms of the root mean square errors [log m], (seeds, runs, channels)."""
    squares = [
        [np.nanmean(np.square(run.measured - run.predicted), axis=0) for run in runs]
        for runs in found
    ]
    return 0.5 * np.log(squares)


def inside(found: list[list[Judged]]) -> float:
    """Return the share of all samples in the band [%]."""
    held = [
        coverage(run.measured - run.predicted, run.deviation) for runs in found for run in runs
    ]
    return 100.0 * float(np.nanmean(held))


def rows_of(machine: Machine, every: float, seeds: int) -> list[tuple[str, ...]]:
    """Return a machine's one row of the table."""
    found = ways_of(machine, every, seeds)
    plain = levels(found[NONE])
    cells = [f'{1e6 * np.exp(plain.mean()):.2f}']
    for name in WAYS[1:]:
        ratio = np.exp((levels(found[name]) - plain).mean(axis=(0, 1)))
        mean = np.exp(np.log(ratio).mean())
        cells.append(f'{mean:.2f} ({ratio.min():.2f} to {ratio.max():.2f})')
    held = (f'{inside(found[name]):.0f}' for name in (NONE, CHOSEN))
    return [(machine.name, f'{every / 60.0:g} min', *cells, ' / '.join(held))]


def main() -> None:
    """Print the table."""
    options = arguments('What regimes are worth to learning from probes, on all machines.', 5)
    rows = all_rows(options, rows_of)
    show(('machine', 'probed', *WAYS, 'in band %, none / chosen'), rows, options.markdown)


if __name__ == '__main__':
    main()

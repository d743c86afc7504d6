# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Runs of one machine whose displacements have the other sign than those of the other runs.

One linear map from rises to displacements holds for all runs of a machine, whatever their duty.
With the signs s of the runs it leaves N - s' M s of the motion unexplained, so that the signs
that fit best are found at once, and every run is asked whether it goes against what the map of
the others says.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from fuzzycnc_ros.core.arrays import Array
from fuzzycnc_ros.core.thermal.plausibility import MOTION_TELLING
from fuzzycnc_ros.core.thermal.run import REFERENCE_SAMPLES, SAMPLES_MIN, ThermalRun

RISE_TELLING = 2.0
"""Least range of the rises of a run that tell anything [K]."""

SPACING = 60.0
"""Time between the samples that are compared, or more [s]."""

RIDGE = 1e-3
"""Weight of the ridge over the mean power of the rises [-]."""

UNEXPLAINED_MAX = 0.35
"""Share of the motion that the right signs may leave unexplained [-]: of a machine whose sensors
tell little of its motion, no sign can be told."""

WORSE, WORSE_BY = 1.5, 0.03
"""Least ratio of the residual with the recorded signs to that with the right ones, and least
difference of both [-]: a run that shares little with the others fits with either sign."""

AGAINST = -0.8
"""Correlation with what the other runs predict below which a run goes against it [-]."""


class Turned(NamedTuple):
    """Channels that move against what the other runs say.

    Parameters
    ----------
    channel : tuple of str
        The channels.
    run : tuple of str
        The runs.
    others : tuple of str
        The runs that they are compared with; where these are as many, they may be the wrong ones.
    correlation : float
        That of the displacements with what the other runs predict, the one closest to 0 [-].
    unexplained, left : float
        Share of the motion that no linear map from the rises explains, as recorded and with the
        runs turned round [-].
    """

    channel: tuple[str, ...]
    run: tuple[str, ...]
    others: tuple[str, ...]
    correlation: float
    unexplained: float
    left: float


class _RunSignals(NamedTuple):
    """Rises (n, s) and displacements (n, c) of a run, both weighted."""

    rise: Array
    moved: Array


def turned_channels(runs: Sequence[ThermalRun]) -> list[Turned]:
    """Return the channels whose sign differs between runs of one machine.

    All channels are judged together first, then each for itself in the runs that are not turned
    round as a whole, which a run is not where one of its channels moves as it should.  Runs that
    hardly warm or move are left out, and so are sensors and channels that some run lacks.
    """
    channels = tuple(c for c in runs[0].channel if all(c in run.channel for run in runs))
    found = _turned(runs, channels) if len(channels) > 1 else []
    whole = {name for item in found for name in item.run}
    rest = [run for run in runs if run.name not in whole]
    for channel in channels:
        found += _turned(rest, (channel,))
    return found


def _turned(runs: Sequence[ThermalRun], channels: tuple[str, ...]) -> list[Turned]:
    told = _told(runs, channels)
    names = list(told)
    if len(names) < 2:
        return []
    known = _weighted(list(told.values()))
    power = np.array([item.rise.T @ item.rise for item in known])
    cross = np.array([item.rise.T @ item.moved for item in known])  # (N, s, c)
    ridge = RIDGE * np.trace(power.sum(axis=0)) / power.shape[1] * np.eye(power.shape[1])
    agreement = np.einsum(
        'rsc,sqc->rq', cross, np.tensordot(np.linalg.inv(power.sum(axis=0) + ridge), cross, (1, 1))
    )
    sign = _best_signs(agreement)
    count = len(names)
    unexplained = 1.0 - float(agreement.sum()) / count
    left = 1.0 - float(sign @ agreement @ sign) / count
    if left > UNEXPLAINED_MAX or unexplained < max(WORSE * left, left + WORSE_BY):
        return []
    against = {}
    for row in np.flatnonzero(sign < 0.0).tolist():
        others = np.arange(count) != row
        weights = np.linalg.solve(
            power[others].sum(axis=0) + ridge, np.tensordot(sign[others], cross[others], 1)
        )
        predicted = known[row].rise @ weights
        correlation = _cosine(predicted, known[row].moved)
        as_predicted = max(map(_cosine, predicted.T, known[row].moved.T))
        if correlation < AGAINST and as_predicted < -AGAINST:
            against[names[row]] = correlation
    if not against:
        return []
    return [
        Turned(
            channel=channels,
            run=tuple(against),
            others=tuple(name for name in names if name not in against),
            correlation=max(against.values()),
            unexplained=unexplained,
            left=left,
        )
    ]


def _told(runs: Sequence[ThermalRun], channels: tuple[str, ...]) -> dict[str, _RunSignals]:
    """Return rises and displacements a minute apart, by name, of the runs that tell anything."""
    common = [
        name
        for name in (runs[0].sensor if runs else ())
        if all(name in run.sensor for run in runs)
    ]
    rises = [run.bridged().rise()[:, [run.sensor.index(name) for name in common]] for run in runs]
    whole = np.all([np.isfinite(rise).all(axis=0) for rise in rises], axis=0)
    told = {}
    for run, rise in zip(runs, rises, strict=True):
        every = max(1, round(SPACING / float(np.median(np.diff(run.time)))))
        moved = run.displacement[:, [run.channel.index(channel) for channel in channels]]
        rows = np.isfinite(moved).all(axis=1)
        rise, moved = rise[rows][:, whole], moved[rows]
        if min(rise.shape) == 0 or len(moved) < SAMPLES_MIN:
            continue
        if (
            np.ptp(rise, axis=0).max() < RISE_TELLING
            or np.ptp(moved, axis=0).max() < MOTION_TELLING
        ):
            continue
        told[run.name] = _RunSignals(
            rise[::every], (moved - moved[:REFERENCE_SAMPLES].mean(axis=0))[::every]
        )
    return told


def _weighted(told: Sequence[_RunSignals]) -> list[_RunSignals]:
    """Return what runs tell with the same power of each run, sensor and channel."""
    rise = np.sqrt(np.mean([(item.rise**2).mean(axis=0) for item in told], axis=0))
    moved = np.sqrt(np.mean([(item.moved**2).mean(axis=0) for item in told], axis=0))
    rise[rise == 0.0] = moved[moved == 0.0] = 1.0
    scaled = [_RunSignals(item.rise / rise, item.moved / moved) for item in told]
    power = [float(np.sqrt((item.moved**2).sum())) or 1.0 for item in scaled]
    return [
        _RunSignals(item.rise / size, item.moved / size)
        for item, size in zip(scaled, power, strict=True)
    ]


def _best_signs(agreement: Array) -> Array:
    """Return the signs s of the runs with the largest s' M s, most of them positive, (N,).

    From all positive ones and from those of the leading eigenvector, one run after the other
    is turned round as long as that helps.
    """
    leading = np.linalg.eigh(agreement)[1][:, -1]
    starts = [np.ones(len(agreement)), np.where(leading < 0.0, -1.0, 1.0)]
    found = [_climbed(agreement, start) for start in starts]
    best = max(found, key=lambda sign: float(sign @ agreement @ sign))
    positive = 2 * int((best > 0.0).sum()) - len(best)
    return -best if positive < 0 or (positive == 0 and best[0] < 0.0) else best


def _climbed(agreement: Array, start: Array) -> Array:
    sign = start.copy()
    own = np.diag(agreement)
    while True:
        gain = own - sign * (agreement @ sign)  # of turning one run round, by a quarter
        row = int(np.argmax(gain))
        if gain[row] <= 1e-12:
            return sign
        sign[row] = -sign[row]


def _cosine(predicted: Array, measured: Array) -> float:
    size = np.sqrt((predicted**2).sum() * (measured**2).sum())
    return float((predicted * measured).sum() / size) if size > 0.0 else 0.0

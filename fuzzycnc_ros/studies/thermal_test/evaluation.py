# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Ranges, times and tilts of a thermal test, phase by phase, with and without compensation."""

from collections.abc import Mapping
from dataclasses import dataclass
from math import isfinite, nan, sqrt
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fuzzycnc_ros.studies.thermal_test.phases import Phase
from fuzzycnc_ros.studies.thermal_test.recording import TestRecording
from fuzzycnc_ros.studies.thermal_test.set_up import TILTS, TestSetUp

Floats = NDArray[np.float64]

HOUR = 3600.0
"""The first part of a phase that is judged on its own [s]."""

RISE = 0.9
"""Share of the whole change whose time is told."""

GAP_SHARE = 0.05
"""Longest stretch without a sample that a range bridges, as share of what it covers."""

LATE = 1.5
"""Missing spacings allowed at the ends of a stretch, in usual ones, and 2.5 within it."""

NOISE_MARGIN = 6.0
"""A change is one from so many standard deviations of the noise on."""

COMBINED = 'combined'
"""Name of the drift of all axes together."""


class MeasuredValue(NamedTuple):
    """A value in SI, or why there is none."""

    value: float
    why: str = ''


@dataclass(frozen=True)
class Drift:
    """Drift of a quantity in a phase.

    Parameters
    ----------
    first_hour, whole : MeasuredValue
        Its range in the first hour and in the whole phase [m, rad].
    change : MeasuredValue
        Its last value less its first [m, rad].
    rise_time : MeasuredValue
        Time from the beginning of the phase to 90 % of the change [s].
    """

    first_hour: MeasuredValue
    whole: MeasuredValue
    change: MeasuredValue
    rise_time: MeasuredValue


@dataclass(frozen=True)
class JudgedPhase:
    """A phase and what all quantities did in it.

    Parameters
    ----------
    phase : Phase
        The phase.
    bare : mapping of str to Drift
        Without compensation, by probe, tilt, and `COMBINED`.
    compensated : mapping of str to Drift
        The same with compensation; empty where the bag says nothing of it.
    includes : str
        'none', 'all' or 'some': which samples were measured with compensation.
    """

    phase: Phase
    bare: Mapping[str, Drift]
    compensated: Mapping[str, Drift]
    includes: str


def judge_phase(
    recording: TestRecording, phase: Phase, probes: Mapping[str, int], set_up: TestSetUp
) -> JudgedPhase:
    """Return what all quantities did in a phase.

    Parameters
    ----------
    recording : TestRecording
        The test.
    phase : Phase
        The phase.
    probes : mapping of str to int
        Column of each probe.
    set_up : TestSetUp
        Distances of the probes, and their resolution.
    """
    inside = _inside(recording.time, phase)
    flags = recording.includes[inside]
    includes = 'none' if not flags.any() else 'all' if flags.all() else 'some'
    sides: list[dict[str, Drift]] = []
    for values, wanted in (
        (recording.bare, True),
        (recording.compensated, recording.offset is not None or bool(flags.any())),
    ):
        found = {}
        if wanted:
            series = quantities(values, probes, set_up.distance)
            for name, column in series.items():
                found[name] = judge(recording, column, phase, _resolution(name, set_up))
            found[COMBINED] = _combined(recording, values, phase, probes)
        sides.append(found)
    bare, compensated = sides
    return JudgedPhase(phase, bare, compensated, includes)


def quantities(
    values: Floats, probes: Mapping[str, int], distance: Mapping[str, float]
) -> dict[str, Floats]:
    """Return the courses of probes and tilts.

    Parameters
    ----------
    values : ndarray, shape (n, c)
        Displacements [m].
    probes : mapping of str to int
        Column of each probe.
    distance : mapping of str to float
        How much farther in +Z the first probe of an axis is than the second [m].

    Returns
    -------
    dict of str to ndarray, shape (n,)
        Probes [m] and tilts [rad]; a tilt of which no distance is known is absent.
    """
    found = {name: values[:, column] for name, column in probes.items()}
    for tilt, (axis, sign) in TILTS.items():
        pair = (f'{axis}1', f'{axis}2')
        if axis in distance and all(name in probes for name in pair):
            first, second = (found[name] for name in pair)
            found[tilt] = sign * (first - second) / distance[axis]
    return found


def combined_probes(probes: Mapping[str, int]) -> tuple[str, ...]:
    """Return the probes whose drift is combined: the first one of each axis."""
    first: dict[str, str] = {}
    for name in probes:
        first.setdefault(name[0], name)
    return tuple(first.values())


def judge(
    recording: TestRecording, values: Floats, phase: Phase, resolution: float = 0.0
) -> Drift:
    """Return what a quantity did in a phase.

    Parameters
    ----------
    recording : TestRecording
        The test.
    values : ndarray, shape (n,)
        The quantity, NaN where it is not known.
    phase : Phase
        The phase.
    resolution : float
        Smallest change that the instrument shows.
    """
    first_hour = _range(recording, values, phase.start, phase.start + HOUR, phase)
    whole = _range(recording, values, phase.start, phase.end, phase)
    if whole.why:
        return Drift(first_hour, whole, whole, whole)
    rows = np.flatnonzero(_inside(recording.time, phase) & np.isfinite(values))
    time, course = recording.time[rows], values[rows]
    change = float(course[-1] - course[0])
    return Drift(
        first_hour,
        whole,
        MeasuredValue(change),
        _rise_time(time - phase.start, course, max(resolution, NOISE_MARGIN * noise(course))),
    )


def noise(values: Floats) -> float:
    """Return the standard deviation of white noise on a smooth course, by second differences.

    Half of them decide, so that steps count as none.

    Examples
    --------
    >>> import numpy as np
    >>> wave = np.sin(np.linspace(0.0, 3.0, 5000))
    >>> disturbed = wave + 0.01 * np.random.default_rng(1).normal(size=5000)
    >>> noise(wave) < 1e-6, 0.009 < noise(disturbed) < 0.011
    (True, True)
    """
    if len(values) < 3:
        return 0.0
    # sqrt(6): variance of a second difference; 1.4826: from the median to the standard deviation.
    return float(1.4826 * np.median(np.abs(np.diff(values, 2))) / sqrt(6.0))


def _inside(time: Floats, phase: Phase) -> NDArray[np.bool_]:
    """Return which samples belong to a phase: all but those at its end, where the next begins."""
    last = time[-1] <= phase.end
    return (time >= phase.start) & ((time < phase.end) | last)


def _range(
    recording: TestRecording, values: Floats, start: float, end: float, phase: Phase
) -> MeasuredValue:
    """Return the range of a quantity within a stretch of a phase, or why it has none."""
    spacing = recording.spacing
    if end > phase.end + LATE * spacing:
        return MeasuredValue(nan, f'too short: {phase.duration / 60.0:.3g} min')
    end = min(end, phase.end)
    rows = _inside(recording.time, phase) & (recording.time <= end) & np.isfinite(values)
    count = int(rows.sum())
    if count < 2:
        return MeasuredValue(nan, 'one sample' if count else 'not known')
    time = recording.time[rows]
    edges = np.concatenate([[max(start, 0.0)], time, [end]])
    gap = float(np.diff(edges).max())
    if start < 0.0:
        gap = max(gap, -start)
    if gap > max((LATE + 1.0) * spacing, GAP_SHARE * (end - start)):
        return MeasuredValue(nan, f'gap of {gap / 60.0:.3g} min')
    return MeasuredValue(float(np.ptp(values[rows])))


def _rise_time(time: Floats, values: Floats, least: float) -> MeasuredValue:
    """Return when a course first reaches 90 % of its change [s], between samples by a line."""
    if len(values) < 5:
        return MeasuredValue(nan, 'too short: few samples')
    change = values[-1] - values[0]
    if abs(change) <= least:
        return MeasuredValue(nan, 'no change')
    share = (values - values[0]) / change
    row = int(np.argmax(share >= RISE))
    before, after = share[row - 1], share[row]
    part = (RISE - before) / (after - before)
    return MeasuredValue(float(time[row - 1] + part * (time[row] - time[row - 1])))


def _combined(
    recording: TestRecording, values: Floats, phase: Phase, probes: Mapping[str, int]
) -> Drift:
    """Return how far the tool was at most from where it was when the phase began."""
    columns = values[:, [probes[name] for name in combined_probes(probes)]]
    known = _inside(recording.time, phase) & np.isfinite(columns).all(axis=1)
    distance = np.full(len(columns), nan)
    if known.any():
        distance[known] = np.linalg.norm(columns[known] - columns[known][0], axis=1)
    none = MeasuredValue(nan)
    # It is zero at first, so that its range is its largest value.
    return Drift(
        _range(recording, distance, phase.start, phase.start + HOUR, phase),
        _range(recording, distance, phase.start, phase.end, phase),
        none,
        none,
    )


def _resolution(name: str, set_up: TestSetUp) -> float:
    """Return the smallest change of a quantity that is one; 0 if nobody has stated it."""
    if not isfinite(set_up.resolution):
        return 0.0
    if name in TILTS:
        return set_up.resolution / abs(set_up.distance[TILTS[name][0]])
    return set_up.resolution

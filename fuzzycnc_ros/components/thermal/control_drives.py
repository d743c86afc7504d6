# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Heat sources that a control tells in `machine_state` beside the spindle speed: their means.

Motion is told as counters, which grow since their source began; load and coolant as they are.
One rule holds for predictors and recordings.
"""

from collections.abc import Iterable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fuzzycnc_ros.core.thermal.places import MOTION_MEANS
from fuzzycnc_ros.core.thermal.run import DRIVE_MAX, GAP_MAX
from fuzzycnc_ros.runtime.enums import Coolant
from fuzzycnc_ros.runtime.records import MOTION_FIELDS, SECOND, Floats, Stamp, nanoseconds

COUNTERS = dict(zip(MOTION_FIELDS, MOTION_MEANS, strict=True))
"""Fields of `machine_state` whose growth over time is a drive."""


class _DriveState(NamedTuple):
    """Counters, and what is told as it is, of one message."""

    stamp: Stamp
    counters: dict[str, float]
    levels: dict[str, float]


def drives_told(message: Any) -> tuple[dict[str, float], dict[str, float]] | None:
    """Return counters and levels that a record or message tells, None if it tells none.

    Parameters
    ----------
    message : MachineState, or its message
        What the control reports.
    """
    counters = {
        f'{name}/{axis}': float(value)
        for field, name in COUNTERS.items()
        for axis, value in zip(message.axis, getattr(message, field), strict=False)
        if np.isfinite(value)
    }
    levels = {}
    if np.isfinite(message.spindle_load):
        levels['spindle_load'] = abs(float(message.spindle_load))
    if message.coolant != Coolant.UNKNOWN:
        levels['coolant'] = float(message.coolant == Coolant.ON)
    return (counters, levels) if counters or levels else None


class ControlDrives:
    """Means of all drives since the sample before.

    Examples
    --------
    >>> drives = ControlDrives()
    >>> for second in range(3):
    ...     drives.note(second * 10**9, {'axis_speed/X': 0.2 * second}, {'coolant': 1.0})
    >>> drives.take(2 * 10**9)
    {'axis_speed/X': 0.2, 'coolant': 1.0}
    """

    def __init__(self) -> None:
        self._before: _DriveState | None = None
        self._sums: dict[str, float] = {}
        self._times: dict[str, int] = {}
        self._known: dict[str, tuple[Stamp, float]] = {}

    def note(self, stamp: Stamp, counters: dict[str, float], levels: dict[str, float]) -> None:
        """Take what one message tells, as `drives_told` returns it."""
        before, self._before = self._before, _DriveState(stamp, counters, levels)
        elapsed = 0 if before is None else stamp - before.stamp
        if before is None or not 0 < elapsed <= nanoseconds(GAP_MAX):
            return
        for name, count in counters.items():
            drive, _, axis = name.partition('/')
            # Moments may fall, as positions have a sign: the travel tells whether they go on.
            rising = f'{MOTION_MEANS[0]}/{axis}' if drive in MOTION_MEANS[2:] else name
            grown = counters.get(rising, np.nan) - before.counters.get(rising, np.inf)
            if grown >= 0.0 and name in before.counters:  # else it has begun anew
                self._add(name, count - before.counters[name], elapsed)
        for name, level in before.levels.items():
            self._add(name, level * (elapsed / SECOND), elapsed)

    def _add(self, name: str, amount: float, elapsed: int) -> None:
        self._sums[name] = self._sums.get(name, 0.0) + amount
        self._times[name] = self._times.get(name, 0) + elapsed

    def take(self, stamp: Stamp) -> dict[str, float]:
        """Return the means up to a sample, of what has been told within the longest gap."""
        for name, amount in self._sums.items():
            self._known[name] = stamp, amount / (self._times[name] / SECOND)
        self._sums, self._times = {}, {}
        if self._before is not None:  # told once: at rest so far, or as it is
            first = dict.fromkeys(self._before.counters, 0.0) | self._before.levels
            for name, value in first.items():
                self._known.setdefault(name, (self._before.stamp, value))
        oldest = stamp - nanoseconds(GAP_MAX)
        return {
            name: mean
            for name, (at, mean) in self._known.items()
            if at >= oldest and abs(mean) <= DRIVE_MAX  # else its unit or its source is wrong
        }


def drives_at(
    stamps: NDArray[np.int64], told: Iterable[tuple[Stamp, dict[str, float], dict[str, float]]]
) -> dict[str, Floats]:
    """Return the drives that a predictor would have known at each stamp.

    Parameters
    ----------
    stamps : ndarray of int, shape (n,)
        Machine times [ns], increasing.
    told : iterable of (stamp, counters, levels)
        What messages told, in any order; see `drives_told`.

    Returns
    -------
    dict of str to ndarray, shape (n,)
        Means since the stamp before; NaN where they were not known.  Samples from just before the
        first message count as it does.
    """
    states = sorted(told, key=lambda item: item[0])
    drives, at, found = ControlDrives(), 0, []
    if states and 0 < states[0][0] - stamps[0] <= nanoseconds(GAP_MAX):
        states = [(int(stamps[0]), *states[0][1:]), *states]
    for stamp in stamps.tolist():
        while at < len(states) and states[at][0] <= stamp:
            drives.note(*states[at])
            at += 1
        found.append(drives.take(stamp))
    names = sorted({name for item in found for name in item})
    return {name: np.array([item.get(name, np.nan) for item in found]) for name in names}

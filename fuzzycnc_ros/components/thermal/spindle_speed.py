# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The spindle speed, where two sources may tell it; the one rule for predictors and recordings.

A controller reports it in `machine_state`; a device beside the controller may report it on
`spindle_speed`.  A speed that is not finite, or whose status is not OK, is not known and leaves
the last one that was.
"""

from collections.abc import Iterable
from math import pi
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fuzzycnc_ros.runtime.component import Health, Level
from fuzzycnc_ros.runtime.enums import SpeedStatus
from fuzzycnc_ros.runtime.records import (
    Floats,
    MachineState,
    Record,
    SpindleSpeed,
    Stamp,
    nanoseconds,
)

STATE, OWN = 'machine_state', 'spindle_speed'
TOPICS: dict[str, type[Record]] = {STATE: MachineState, OWN: SpindleSpeed}
"""Topics that tell the speed; the first has precedence."""

LEAD_MAX = 60.0
"""Time [s] by which `spindle_speed` may be ahead of `machine_state` before that one counts as
silent: longer than the usual pause between two of its messages, short beside the time in which
a spindle warms up."""

HEALTH = 'speed source'
"""Name of the line of health; that of a topic is the host's."""

APART_SHARE, APART_LEAST = 0.1, 10.0
"""Difference between the two that is none: a share of the larger, and what stands for noise
[rad/s].  What is looked for is a wrong unit or ratio, not a slow filter."""


class Told(NamedTuple):
    """A speed that is known: its source, its stamp [ns] and its value [rad/s]."""

    source: str
    stamp: Stamp
    speed: float


def speed_told(topic: str, message: Any) -> float:
    """Return the speed [rad/s] that a record or message of a topic tells, NaN if none."""
    if topic == STATE:
        return float(message.spindle_speed)
    return float(message.speed) if message.status == SpeedStatus.OK else np.nan


class SpeedSources:
    """What the sources have told so far, in the order of their stamps."""

    def __init__(self) -> None:
        self._told: dict[str, Told] = {}
        self._apart_since: Stamp | None = None
        self._apart = False

    def note(self, topic: str, stamp: Stamp, speed: float) -> None:
        """Take what a topic tells, as `speed_told` returns it."""
        if not np.isfinite(speed):
            return
        self._told[topic] = Told(topic, stamp, speed)
        self._compare(stamp)

    @property
    def newest(self) -> Told | None:
        """The speed that counts: that of `machine_state` unless it has been silent."""
        state, own = self._told.get(STATE), self._told.get(OWN)
        if state is None or own is None:
            return state or own
        return own if own.stamp - state.stamp > nanoseconds(LEAD_MAX) else state

    def health(self) -> Health:
        """Say which source is used, and whether the two contradict each other."""
        told = self.newest
        if told is None:
            return Health(HEALTH, Level.WARN, f'told neither by {STATE} nor by {OWN}')
        used = f'{_in_words(told.speed)} from {told.source}'
        if not self._apart:
            return Health(HEALTH, Level.OK, used)
        text = (
            f'{used}, but {OWN} tells {_in_words(self._told[OWN].speed)}; mend unit or scale of '
            'the wrong one, or take it out'
        )
        return Health(HEALTH, Level.WARN, text)

    def _compare(self, stamp: Stamp) -> None:
        """Note whether the sources have differed for longer than one may lag behind."""
        state, own = self._told.get(STATE), self._told.get(OWN)
        if state is None or own is None:
            return
        one, other = abs(state.speed), abs(own.speed)
        differ = abs(one - other) > max(APART_SHARE * max(one, other), APART_LEAST)
        if not differ or abs(state.stamp - own.stamp) > nanoseconds(LEAD_MAX):
            self._apart_since, self._apart = None, False
            return
        if self._apart_since is None:
            self._apart_since = stamp
        self._apart = stamp - self._apart_since >= nanoseconds(LEAD_MAX)


def speeds_at(
    stamps: NDArray[np.int64], told: Iterable[tuple[str, Stamp, float]]
) -> Floats | None:
    """Return the speed that a predictor would have known at each stamp.

    Parameters
    ----------
    stamps : ndarray of int, shape (n,)
        Machine times [ns], increasing.
    told : iterable of (topic, stamp, speed)
        What the topics told, in any order; see `speed_told`.

    Returns
    -------
    ndarray, shape (n,), or None
        Speed [rad/s], NaN before the first that is known; None if none ever is.
    """
    known = sorted((item for item in told if np.isfinite(item[2])), key=lambda item: item[1])
    if not known:
        return None
    sources, at, speeds = SpeedSources(), 0, np.full(len(stamps), np.nan)
    for row, stamp in enumerate(stamps):
        while at < len(known) and known[at][1] <= stamp:
            sources.note(*known[at])
            at += 1
        newest = sources.newest
        if newest is not None:
            speeds[row] = newest.speed
    return speeds


def _in_words(speed: float) -> str:
    return f'{speed:.4g} rad/s ({speed * 60.0 / (2.0 * pi):.0f} rpm)'

# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Trend of a slow quantity: its rate over the last minutes, and the time until it is stable."""

from collections import deque
from math import isfinite

import numpy as np

from fuzzycnc_ros.core import portable
from fuzzycnc_ros.runtime.records import SECOND, Floats

RATE_WINDOW = 180.0
"""Machine time [s] over which a rate is taken."""
STEADY = 1e-6 / 600.0
"""Rate [m/s] below which nobody sees a change: 0.1 um a minute."""
STABLE_WITHIN = 1e-6
"""Distance [m] from its end value at which an error counts as stable."""
_WINDOWS = (7200.0, 3600.0, 1800.0, 900.0)
"""Machine time [s] that an approach is looked for in, the longest that fits first."""
_POINTS = 60
"""Points that a window is resampled to, a multiple of three."""
_FILLED = 0.7
"""Part of a window that must hold samples."""
_DECAYS = (0.02, 0.85)
"""Ratio of the change over one third of a window to that of the third before: faster is over,
slower is no curve yet but a straight line, whose end nobody knows."""
_MISFIT = 0.12
"""Largest root mean square beside the curve, as a part of the change in the window."""
_KEPT = 2000
_SPACING = _WINDOWS[0] / (_KEPT - 200)
"""Machine time [s] between two samples that are kept for longer than the rate needs."""


class Trend:
    """The newest two hours of one quantity."""

    def __init__(self) -> None:
        self._recent: deque[tuple[float, float]] = deque(maxlen=_KEPT)
        self._past: deque[tuple[float, float]] = deque(maxlen=_KEPT)

    def add(self, stamp: int, value: float) -> None:
        """Take a sample.

        Parameters
        ----------
        stamp : int
            Machine time [ns]; one before the newest begins anew, the same is left out.
        value : float
            The quantity [m]; what is not finite is left out.
        """
        time = stamp / SECOND
        if not isfinite(value):
            return
        if self._recent and time <= self._recent[-1][0]:
            if time == self._recent[-1][0]:
                return
            self._recent.clear()
            self._past.clear()
        self._recent.append((time, value))
        if not self._past or time - self._past[-1][0] >= _SPACING:
            self._past.append((time, value))
        while self._recent and time - self._recent[0][0] > RATE_WINDOW and len(self._recent) > 3:
            self._recent.popleft()

    @property
    def rate(self) -> float | None:
        """Slope of a straight line through the last minutes [m/s]; None with one sample."""
        if len(self._recent) < 2:
            return None
        times, values = np.array(self._recent).T
        times = times - times.mean()
        return float(
            portable.matmul(times, (values - values.mean())) / portable.matmul(times, times)
        )

    @property
    def arrow(self) -> str:
        """Direction: `up`, `down` or `steady`."""
        rate = self.rate
        if rate is None or abs(rate) < STEADY:
            return 'steady'
        return 'up' if rate > 0.0 else 'down'

    @property
    def stable_in(self) -> float | None:
        """Machine time [s] until it stays within a micrometre; None where that cannot be told."""
        if len(self._past) < 2:
            return None
        times, values = np.array(self._past).T
        for window in _WINDOWS:
            begin = times[-1] - window
            if times[0] > begin + (1.0 - _FILLED) * window:
                continue
            inside = times >= begin
            if inside.sum() < _POINTS // 3:
                continue
            found = _approach(times[inside] - times[-1], values[inside])
            if found is not None:
                return found
        return None


def _approach(times: Floats, values: Floats) -> float | None:
    """Return the time until an exponential approach is over, None if there is none.

    The means of three thirds of such a curve follow each other as a geometric series, which gives
    its end value and time constant without a starting guess.

    Parameters
    ----------
    times : ndarray, shape (n,)
        Times before now, the last one 0 [s].
    values : ndarray, shape (n,)
        The quantity [m].
    """
    if np.ptp(values) < STABLE_WITHIN:
        return 0.0
    grid = np.linspace(times[0], 0.0, _POINTS)
    evenly = np.interp(grid, times, values)
    first, second, third = evenly.reshape(3, -1).mean(axis=1)
    if first == second:
        return None
    decay = (third - second) / (second - first)
    if not _DECAYS[0] < decay < _DECAYS[1]:
        return None
    end = first - (second - first) / (decay - 1.0)
    step = grid[_POINTS // 3] - grid[0]
    rate = -portable.log(decay) / step
    shape = portable.exp(-rate * (grid - grid[0]))
    size = float(portable.matmul(shape, evenly - end) / portable.matmul(shape, shape))
    beside = evenly - end - size * shape
    if float(np.sqrt(np.mean(beside * beside))) > _MISFIT * float(np.ptp(evenly)):
        return None
    left = abs(size * float(shape[-1]))
    return 0.0 if left <= STABLE_WITHIN else portable.log(left / STABLE_WITHIN) / rate

# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Gathers the readings of devices, each with a pace of its own, into sets of all sensors."""

import warnings
from collections import deque
from collections.abc import Sequence

import numpy as np

from fuzzycnc_ros.runtime.records import Floats, nanoseconds

KEPT_MAX = 1000
"""Most readings of a device that are kept until a set is complete."""


class ReadingSets:
    """Sets of readings, complete when every device that answers has read anew.

    So sets go at the pace of the slowest device and no sensor is missing because it is slow; what
    faster devices read meanwhile enters as the median.  A device that is lost holds up nobody: it
    is waited for at most until it is known to be lost, and its sensors are missing from then on.
    While all are lost, sets without any value go at the pace of the slowest.

    Parameters
    ----------
    sizes : sequence of int
        Number of sensors of each device.
    pace : float
        Longest period of the devices [s].
    """

    def __init__(self, sizes: Sequence[int], pace: float) -> None:
        self._sizes = tuple(sizes)
        self._pace = nanoseconds(pace)
        self._kept: list[deque[Floats]] = [deque(maxlen=KEPT_MAX) for _ in sizes]
        self._lost = [False] * len(self._sizes)
        self._newest = 0
        self._sent: int | None = None

    def take(self, device: int, stamp: int, value: Floats) -> None:
        """Take what a device has read: one value per sensor [degC], NaN where there is none."""
        self._kept[device].append(value)
        self._lost[device] = False
        self._newest = stamp

    def lose(self, device: int) -> None:
        """Note that a device does not answer."""
        self._lost[device] = True

    def complete(self, now: int) -> tuple[int, Floats] | None:
        """Return stamp [ns] and values [degC] of a set, None as long as it is not complete.

        Parameters
        ----------
        now : int
            Machine time [ns].
        """
        waits = zip(self._kept, self._lost, strict=True)
        if any(not kept and not lost for kept, lost in waits):
            return None
        if any(self._kept):
            stamp = self._newest
        elif self._sent is None or abs(now - self._sent) >= self._pace:
            stamp = now
        else:
            return None
        if stamp == self._sent:
            return None  # machine time stands still
        self._sent = stamp
        values = [
            _median(kept) if kept else np.full(size, np.nan)
            for kept, size in zip(self._kept, self._sizes, strict=True)
        ]
        for kept in self._kept:
            kept.clear()
        return stamp, np.concatenate(values)


def _median(readings: Sequence[Floats]) -> Floats:
    """Return the median of each sensor over its finite readings; a wild one moves nothing."""
    if len(readings) == 1:
        return readings[0]
    with warnings.catch_warnings():
        warnings.simplefilter('ignore', RuntimeWarning)  # a sensor without any
        return np.asarray(np.nanmedian(np.stack(readings), axis=0))

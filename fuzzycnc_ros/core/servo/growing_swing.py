# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Oscillation of a following error that grows: its frequency and how fast."""

from __future__ import annotations

from fuzzycnc_ros.core import portable
from fuzzycnc_ros.core.servo.constants import Constant

_SLOW = 0.15
"""Time over which the mean of the error is taken [s]: what is slower is no swing."""

_STEADY = 1e-10
"""Change of a reference's way from period to period that is none [m]."""

_ALIKE = 1.6
"""Ratio of the times of two swings up to which they belong to one oscillation [-]."""

_GROWS = 1.01
"""Ratio of two swings in a row from which on a swing grows [-]."""

_DIES = 0.7
"""Ratio of two swings in a row up to which one that grew is over [-]."""

_HALVES, _GROWN = 5, 2.0
"""Swings in a row that have to grow, each half a swing on, and ratio of the last to the first."""

_STAYS, _LASTS = 0.9, 16
"""Ratio of two swings in a row from which on a swing does not die, and how many in a row last."""


class GrowingSwing:
    """Watches a following error for an oscillation that grows by itself.

    What the reference moves back and forth is no swing of the loop: a half swing in which the
    reference's acceleration changes its sign does not count.

    Parameters
    ----------
    period : float
        Time between two errors [s].
    least : float
        Peak from which on a swing counts [m].

    Attributes
    ----------
    grows : bool
        Whether such a swing was found.
    frequency : float
        Frequency of the last swing that grew [Hz]; 0 before the first.
    rate : float
        Rate at which it grew [1/s].

    Examples
    --------
    >>> from math import exp, sin
    >>> swing = GrowingSwing(1e-3, 1e-5)
    >>> for step in range(400):
    ...     swing.add(1e-5 * exp(8e-3 * step) * sin(0.157 * step), 0.0)
    >>> swing.grows, round(swing.frequency), round(swing.rate)
    (True, 25, 8)
    """

    def __init__(self, period: float, least: float) -> None:
        self._period, self._least = period, least
        self._share = period / _SLOW
        self.reset()

    def reset(self) -> None:
        """Forget everything."""
        self.grows, self.frequency, self.rate = False, 0.0, 0.0
        self._mean = self._reference = self._speed = self._change = 0.0
        self._fresh = 2
        self._start_over()

    @property
    def lasts(self) -> bool:
        """True if a swing neither grows nor dies, as where the drive is at its limit."""
        return self._alike >= _LASTS

    def start_over(self) -> None:
        """Look for a swing that grows anew; frequency and rate of the last one stay."""
        self.grows = False
        self._start_over()

    def _start_over(self) -> None:
        self._side = self._length = self._last_length = self._halves = self._alike = 0
        self._peak = self._last_peak = self._first = 0.0
        self._swing = 0, 0.0
        self._driven = False

    def constants(self) -> list[Constant]:
        """Return the numbers that it computes with."""
        return [
            Constant('SWING_SHARE', self._share, '-', 'Share of a new error in its mean'),
            Constant('SWING_LEAST', self._least, 'm', 'Peak from which on a swing counts'),
            Constant('SWING_STEADY', _STEADY, 'm', 'Change of pace of a reference that is none'),
            Constant('SWING_ALIKE', _ALIKE, '-', 'Ratio of times of swings that are alike'),
            Constant('SWING_GROWS', _GROWS, '-', 'Ratio of sizes from which on a swing grows'),
            Constant('SWING_DIES', _DIES, '-', 'Ratio of sizes up to which it is over'),
            Constant('SWING_GROWN', _GROWN, '-', 'Ratio of the last to the first that grew'),
            Constant('SWING_STAYS', _STAYS, '-', 'Ratio of sizes from which on it does not die'),
            Constant('SWING_HALVES', _HALVES, '', 'Half swings in a row that have to grow'),
            Constant('SWING_LASTS', _LASTS, '', 'Swings in a row that last'),
        ]

    def add(self, error: float, reference: float) -> None:
        """Take an error and the reference [m] of one more period."""
        self._mean += (error - self._mean) * self._share
        speed = reference - self._reference
        change = speed - self._speed
        self._reference, self._speed = reference, speed
        if self._fresh:
            self._fresh -= 1
            return
        if not -_STEADY < change < _STEADY:
            if change * self._change < 0.0:
                self._driven = True
            self._change = change
        size = error - self._mean
        self._length += 1
        side = self._side
        if side * size < 0.0 or not side:
            self._turn(1 if size > 0.0 else -1)
        elif abs(size) > self._peak:
            self._peak = abs(size)

    def _turn(self, side: int) -> None:
        """End a half swing; with the one before it makes a swing, whatever the mean is off."""
        length, size = self._length + self._last_length, self._peak + self._last_peak
        before, smaller = self._swing
        alike = length < _ALIKE * before and before < _ALIKE * length
        stays = alike and not self._driven and size >= max(_STAYS * smaller, 2.0 * self._least)
        self._alike = self._alike + 1 if stays else 0
        if self._driven or not alike or not smaller or size < _GROWS * smaller or length < 4:
            self._halves, self._first = 0, size
            self.grows = self.grows and size > _DIES * smaller
        else:
            self._halves += 1
            self.grows = (
                self._halves >= _HALVES
                and 0.5 * size >= self._least
                and size >= _GROWN * self._first
            )
            if self.grows:
                time = self._period * length
                self.frequency = 1.0 / time
                self.rate = 2.0 * portable.log(size / self._first) / (self._halves * time)
        self._swing = length, size
        self._last_length, self._last_peak = self._length, self._peak
        self._side, self._length, self._peak, self._driven = side, 0, 0.0, False

# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Plausibility of an axis' motion against its duty, and of its readings against its sensor.

The controllers judge reading by reading (`core.servo.feedback_watch`).  Here the motion over some
periods is held against what the nominal model allows for the duties that were commanded, whatever
gain, friction and load are believed to be.
"""

from collections import deque
from dataclasses import dataclass
from math import inf, sqrt

import numpy as np

from fuzzycnc_ros.core import portable
from fuzzycnc_ros.core.servo.axis import LinearAxis, velocity_lag
from fuzzycnc_ros.core.servo.feedback_watch import FeedbackLimits

WINDOW = 5
"""Periods over which motion is compared: long against a count, short against 20 ms."""
OUTSIDE = 3
"""Periods in a row for which it may be beyond what is possible."""
MEMORY, ROUGH = 24, 6
"""So many of so many changes of the reading must not be rough; a single glitch makes four."""
_SIGMA = 4.0
"""Third difference from which a reading is rough, as multiple of its noise."""
_LATE = 3
"""Periods by which a drive may follow a command late."""


@dataclass(frozen=True, kw_only=True)
class MotionDoubt:
    """Tolerances for an axis beside its nominal model.

    Parameters
    ----------
    gain_low, gain_high : float
        Least and largest gain, as multiple of the nominal one.
    friction, load : float
        Largest friction, and largest load either way, as duty [-].
    """

    gain_low: float = 0.4
    gain_high: float = 1.75
    friction: float = 0.12
    load: float = 0.12


class MotionWatch:
    """Judges the readings of an axis by the duties that it is commanded.

    The duties go through the lags of drive and sensor; with every gain, friction and load that
    are possible they give a fastest and a slowest velocity of the reading, which follow with the
    lag of the mechanics from what was read.  A reading that goes beyond them over some periods is
    a fault.  So are readings that are too rough for the sensor: the lags leave no room for a
    third difference.

    Parameters
    ----------
    axis : LinearAxis
        Nominal model.
    limits : FeedbackLimits
        Count and noise of the sensor.
    doubt : MotionDoubt, optional
        What else is possible.

    Attributes
    ----------
    fault : str
        What is wrong; empty while nothing is.
    """

    def __init__(
        self, axis: LinearAxis, limits: FeedbackLimits, doubt: MotionDoubt | None = None
    ) -> None:
        self._doubt = doubt or MotionDoubt()
        period, mechanics = axis.period, velocity_lag(axis)
        rates = [-float(rate) for rate in np.diag(axis.a) if rate]
        self._shares = [
            1.0 - portable.exp(-period * rate) for rate in rates if rate * mechanics != 1.0
        ]
        self._keep = portable.exp(-period / mechanics)
        self._way = axis.gain * period  # per period and duty, in the end
        noise = sqrt(limits.count * limits.count / 12.0 + limits.noise * limits.noise)
        self._room = limits.count + 4.0 * noise
        # where the drive pushes the reading with no lag, friction and load may show in one period
        lags = [1.0 / rate for rate in rates if rate * mechanics != 1.0]
        push = (self._doubt.friction + self._doubt.load) * abs(self._way) * period / mechanics
        for lag in lags:
            push *= min(1.0, period / lag)
        self._rough_from = max(_SIGMA * sqrt(20.0) * noise, 3.0 * push)
        self.reset()

    def reset(self) -> None:
        """Forget everything; the axis rests, or is about to tell how fast it is."""
        self.fault = ''
        self._lags = [0.0] * len(self._shares)
        self._pushes: deque[float] = deque([0.0] * (_LATE + 1), maxlen=_LATE + 1)
        self.interrupt()

    def interrupt(self) -> None:
        """Forget the readings so far, some of which are missing or did not come as due."""
        self._readings: deque[float] = deque(maxlen=WINDOW + 1)
        self._fast: deque[float] = deque(maxlen=WINDOW)
        self._slow: deque[float] = deque(maxlen=WINDOW)
        self._high, self._low = inf, -inf
        self._outside = 0
        self._rough: deque[bool] = deque(maxlen=MEMORY)

    def hold(self, duty: float) -> None:
        """Note the duty [-] that the drive was commanded for the period that ends now."""
        push = duty
        for index, share in enumerate(self._shares):
            push = self._lags[index] = self._lags[index] + (push - self._lags[index]) * share
        self._pushes.append(push)

    def judge(self, reading: float) -> None:
        """Judge the reading [m] at the end of the period."""
        readings = self._readings
        readings.append(reading)
        fast, slow = self._bounds()
        self._fast.append(fast)
        self._slow.append(slow)
        if len(readings) > 3:
            bend = reading - readings[-4] - 3.0 * (readings[-2] - readings[-3])
            self._rough.append(abs(bend) > self._rough_from)
            if sum(self._rough) >= ROUGH:
                self.fault = 'readings are rougher than the sensor: its count has changed'
        if len(readings) <= WINDOW:
            return
        way = reading - readings[0]
        over = way - sum(self._fast) - self._room
        under = sum(self._slow) - self._room - way
        self._outside = self._outside + 1 if over > 0.0 or under > 0.0 else 0
        if self._outside >= OUTSIDE:
            self.fault = self._reason(way, over > 0.0)
        self._anchor(way / WINDOW)

    def _bounds(self) -> tuple[float, float]:
        """Return the largest and least way of the reading in the period [m]."""
        keep = self._keep
        up, down = self._targets(self._high, self._low)
        self._high = up + (self._high - up) * keep
        self._low = down + (self._low - down) * keep
        return self._high, self._low

    def _targets(self, high: float, low: float) -> tuple[float, float]:
        """Return what a largest and a least way per period [m] tend to."""
        ends = (max(self._pushes) * self._way, min(self._pushes) * self._way)
        return self._fastest(max(ends), high), -self._fastest(-min(ends), -low)

    def _fastest(self, push: float, way: float) -> float:
        """Return the largest way per period that a push leads to from a present way [m]."""
        doubt, unit = self._doubt, abs(self._way)
        push += doubt.load * unit
        friction = doubt.friction * unit
        if way < 0.0:  # friction brakes
            push += friction
            return (doubt.gain_high if push > 0.0 else doubt.gain_low) * push
        if push > 0.0:
            return doubt.gain_high * push
        return min(0.0, doubt.gain_low * (push + friction))

    def _anchor(self, mean: float) -> None:
        """Let the bounds go on from what was read: its mean way per period [m]."""
        up, down = self._targets(mean, mean)
        later = 0.5 * (WINDOW + 1) * (1.0 - self._keep)
        room = self._room / WINDOW
        self._high = min(self._high, mean + room + max(0.0, (up - mean) * later))
        self._low = max(self._low, mean - room + min(0.0, (down - mean) * later))

    def _reason(self, way: float, over: bool) -> str:
        """Say what a way [m] that is beyond the largest, or below the least, looks like."""
        push = sum(self._pushes) * self._way
        if (push > 0.0) != over:
            if way * push < 0.0 and abs(way) > self._room:
                return 'axis runs away against its duty: wrong sign or load'
            return (
                'axis does not answer its duty: the drive is off, another owner commands it, or '
                'it is blocked'
            )
        return 'axis reads as moving faster than its duty makes it: count or drive is wrong'

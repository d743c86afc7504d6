# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Faults of an axis' feedback, as a controller notices them by itself.

No clock is asked: everything counts control periods.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import gcd, inf, isfinite

from fuzzycnc_ros.core.servo.axis import LinearAxis, response_lag, velocity_lag
from fuzzycnc_ros.core.servo.constants import Constant
from fuzzycnc_ros.core.servo.growing_swing import GrowingSwing

_IRREGULAR = 2
"""Times that a change counts which is not what its two forerunners lead to: with an encoder that
has no noise the loop itself may swing by some counts in every second period."""

_INCREMENTS = 32 * _IRREGULAR
"""Changes of the reading after which their common divisor is judged."""

_KINDS = 8
"""Different sizes among them: a steady speed alone may have a divisor.

So may a steady acceleration, size after size; only a change that is not what its forerunners
lead to counts.
"""

_SPEED_SHARE = 0.3
"""Share of a new reading in the smoothed speed of the run-away test."""

_SPEED_MIN = 0.01
"""Speed below which the run-away test is silent, as share of the speed at full duty."""

_FULL = 0.95
"""Share of the largest duty from which on it is at its end."""

_SWING_TIME = 0.25
"""Longest time between two ends of the duty that belong to one oscillation [s]."""

_SWINGS, _SWINGS_BEFORE_LOSS = 8, 2
"""Changes from end to end of the duty from which on the loop swings, and from which on that is
what a reading that jumps is put down to."""


SWINGING = 'the loop swings, it is unstable: its gains are too high for this axis'
"""Fault of a loop that is not stable; followed by how it swings."""

_SEEN = 10.0
"""Counts, and multiples of the noise, from which on an error swings with the loop [-]."""


@dataclass(frozen=True, kw_only=True)
class FeedbackLimits:
    """Thresholds beyond which a controller distrusts its feedback or gives up.

    Parameters
    ----------
    error_max : float
        Largest believable distance between reference and reading [m]; more is a wrong unit.
    acceleration_max : float
        Largest acceleration that the reading can show [m/s^2]; a reading further from the
        straight continuation of the last two is a jump.
    count : float
        One count of the sensor [m]; 0 if it does not count.
    noise : float
        RMS of the noise that its readings carry [m].
    bad_max : int
        Bad readings in a row that are bridged with the last duty; one more is a fault.
    load : float
        Largest load that is believed, friction included, as duty [-].  Above that duty an axis
        must not gain speed against it: no load pulls so hard.
    runaway_periods : int
        Periods in a row for which it may.
    response_lag : float
        Lags of drive and sensor together [s]: so old is the duty that a reading answers to.

    Raises
    ------
    ValueError
        If a value is out of its range.
    """

    error_max: float = 0.5
    acceleration_max: float = 33.6
    count: float = 0.625e-6
    noise: float = 0.2e-6
    bad_max: int = 5
    load: float = 0.2
    runaway_periods: int = 5
    response_lag: float = 8.3e-3

    def __post_init__(self) -> None:
        for name in ('error_max', 'acceleration_max', 'load', 'response_lag'):
            value = getattr(self, name)
            if not value > 0.0:
                raise ValueError(f'{name}: expected a positive number but found {value}')
        for name in ('count', 'noise'):
            value = getattr(self, name)
            if not 0.0 <= value < inf:
                raise ValueError(f'{name}: expected 0 m or more but found {value} m')
        for name in ('bad_max', 'runaway_periods'):
            if getattr(self, name) < 1:
                raise ValueError(f'{name}: expected 1 or more but found {getattr(self, name)}')

    @classmethod
    def of(
        cls,
        axis: LinearAxis,
        *,
        count: float = 0.625e-6,
        noise: float = 0.2e-6,
        travel: float = 0.5,
        load: float = 0.2,
    ) -> FeedbackLimits:
        """Return the limits of an axis whose gain may be twice the nominal one.

        Parameters
        ----------
        axis : LinearAxis
            Nominal model.
        count, noise : float
            One count of its sensor and RMS of the noise [m].
        travel : float
            Its travel [m].
        load : float
            Largest load and friction together, as duty [-].
        """
        return cls(
            error_max=travel,
            acceleration_max=2.0 * abs(axis.gain) / velocity_lag(axis),
            count=count,
            noise=noise,
            load=load,
            response_lag=max(response_lag(axis), 2.0 * axis.period),
        )


class FeedbackWatch:
    """Judges every reading before a controller uses it.

    Parameters
    ----------
    limits : FeedbackLimits
        What to believe.
    period : float
        Control period [s].
    direction : float
        Sign of the velocity that a positive duty drives.
    speed_full : float
        Speed at full duty [m/s].
    duty_max : float
        Largest magnitude of duty [-].

    Attributes
    ----------
    bad : int
        Bad readings in a row.
    bad_total : int
        Bad readings since the reset.
    fault : str
        Why the controller has given up; empty while it has not.
    swing : GrowingSwing
        Oscillation of the error that grows.
    """

    def __init__(
        self,
        limits: FeedbackLimits,
        period: float,
        direction: float,
        speed_full: float,
        duty_max: float = 1.0,
    ) -> None:
        self.limits = limits
        self.swing = GrowingSwing(period, max(_SEEN * limits.count, _SEEN * limits.noise, 2e-6))
        self._full = _FULL * duty_max
        self._period = period
        self._swing_periods = round(_SWING_TIME / period)
        self._jump = (
            limits.acceleration_max * (period * period) + 4.0 * limits.count + 12.0 * limits.noise
        )
        self._fade = min(period / limits.response_lag, 1.0)
        self._direction = direction
        self._still = _SPEED_MIN * speed_full * period
        self._leap = 2.0 * speed_full * period
        self._per_count = 1.0 / limits.count if limits.count else 0.0
        self.reset()

    def reset(self, position: float | None = None) -> None:
        """Forget everything, faults too; `position` is where the axis rests [m], if known."""
        self.bad = self.bad_total = 0
        self.fault = ''
        self._last = position
        self._aim: float | None = None  # reference of the last period
        self._off: float | None = None
        self._gap = 0
        self._slope = self._speed = self._duty = 0.0
        self._against = 0
        self._swings = self._since_end = self._between_ends = 0
        self.swing.reset()
        self._end = 0  # at which end of its range the duty was last
        self._fresh = 2  # readings
        self._restart_divisor()

    def _restart_divisor(self) -> None:
        self._divisor = self._changes = self._odd = self._bend = self._bend_before = 0
        self._kinds: set[int] = set()

    def resume(self) -> None:
        """Go on after periods without a reading, each of which was refused as one that is NaN.

        How far the axis may have come is known from those before; its speed is not, and what was
        judged over several readings begins anew.
        """
        self.bad = 0
        self._off = None
        self._against = 0
        self._restart_divisor()

    def accepts(self, reference: float, position: float) -> bool:
        """Return True if a reading [m] can be used; else count it and judge the fault."""
        error = reference - position
        size = self.limits.error_max
        if not -size <= error <= size:  # false for NaN too
            if isfinite(error):
                return self._refuse('reading and reference are further apart than the travel')
            self._gap += 1
            return self._refuse('reading or reference is not finite')
        if self._aim is None or abs(reference - self._aim) > self._leap:
            self._swings = self._end = 0  # a new target throws the duty about, too
        self._aim = reference
        if self._last is None:
            self._last = position
        change = position - self._last
        surprise = change - self._slope
        room = self._jump * (1 + self._gap) * (1 + self._gap)
        if self._fresh:
            # nothing is known of the speed yet: it may be the fastest
            room += self._leap
            self._fresh -= 1
        if not -room <= surprise <= room or self._still_off(position):
            self._off = position
            return self._refuse(
                'reading has jumped: counts were lost, or the axis is far stronger than its model'
            )
        gap = self._gap
        if gap:  # its mean since the last reading; how fast the axis is now is not known
            change = (change + self._slope * gap) / (gap + 1)
            self._fresh = 2
        self._last, self._slope, self._off = position, change, None
        self.bad = self._gap = 0
        if self._per_count and not gap and (change or surprise):
            self._count(change * self._per_count, round(surprise * self._per_count))
        self.swing.add(error, reference)
        self._follow(change)
        return not self.fault

    def applied(self, duty: float) -> None:
        """Note the duty [-] that is held from now on; judge whether it swings from end to end."""
        self._duty += (duty - self._duty) * self._fade
        self._since_end += 1
        end = 1 if duty >= self._full else -1 if duty <= -self._full else 0
        if not end:
            if self._since_end > self._swing_periods:
                self._swings = self._end = 0
            return
        if end == -self._end:
            self._swings = self._swings + 1 if self._since_end <= self._swing_periods else 0
            self._between_ends = self._since_end
            if self._swings >= _SWINGS:
                self.fault = self._unstable()
        self._end, self._since_end = end, 0

    def constants(self) -> list[Constant]:
        """Return the numbers that it computes with."""
        return [
            Constant('ERROR_MAX', self.limits.error_max, 'm', 'Largest believable error'),
            Constant('LOAD', self.limits.load, '-', 'Largest load that is believed, as duty'),
            Constant('JUMP', self._jump, 'm', 'Surprise of a reading that is believed'),
            Constant('LEAP', self._leap, 'm', 'Way of the fastest axis in two periods'),
            Constant(
                'PER_COUNT', self._per_count, '1/m', 'Counts of the sensor per length; 0 for none'
            ),
            Constant('FULL_DUTY', self._full, '-', 'Duty from which on it is at its end'),
            Constant(
                'ANSWER_SHARE', self._fade, '-', 'Share of a new duty in the one that is answered'
            ),
            Constant('STILL_CHANGE', self._still, 'm', 'Way in a period that is rest'),
            Constant('SPEED_SHARE', _SPEED_SHARE, '-', 'Share of a new reading in the speed'),
            Constant('BAD_MAX', self.limits.bad_max, '', 'Bad readings in a row that are bridged'),
            Constant(
                'RUNAWAY_PERIODS',
                self.limits.runaway_periods,
                '',
                'Periods of gaining speed against duty',
            ),
            Constant(
                'END_PERIODS', self._swing_periods, '', 'Longest time between two ends of the duty'
            ),
            Constant('ENDS_MAX', _SWINGS, '', 'Changes from end to end of a loop that swings'),
            Constant(
                'ENDS_BEFORE_LOSS', _SWINGS_BEFORE_LOSS, '', 'Those that explain a lost reading'
            ),
            Constant(
                'COUNT_CHANGES', _INCREMENTS, '', 'Changes after which their divisor is judged'
            ),
            Constant('COUNT_IRREGULAR', _IRREGULAR, '', 'Times that an irregular one counts'),
            Constant('COUNT_KINDS', _KINDS, '', 'Different sizes among them; at most 8'),
            *self.swing.constants(),
        ]

    def _still_off(self, position: float) -> bool:
        """Return True if a reading goes on smoothly from one that had jumped: an offset."""
        if self._off is None:
            return False
        return abs(position - self._off - self._slope) <= self._jump

    def _refuse(self, reason: str) -> bool:
        """Count a bad reading; give up after too many in a row."""
        self.bad += 1
        self.bad_total += 1
        if self._last is not None:
            # what is expected goes on as it was
            self._last += self._slope
        if self.bad > self.limits.bad_max:
            # An axis that is thrown from end to end jumps with all its counts.
            self.fault = self._unstable() if self._swings_already else reason
        return False

    def give_up_unstable(self) -> None:
        """Give up, as the loop is unstable."""
        self.fault = self._unstable()

    @property
    def _swings_already(self) -> bool:
        """True if the loop was seen to be unstable, of which other symptoms follow."""
        return self.swing.frequency > 0.0 or self._swings >= _SWINGS_BEFORE_LOSS

    def _unstable(self) -> str:
        """Return the fault of an unstable loop, with its frequency."""
        swing = self.swing
        if swing.frequency:
            return f'{SWINGING} ({swing.frequency:.3g} Hz, grew by {swing.rate:.2g} 1/s)'
        frequency = 0.5 / (self._between_ends * self._period)
        return f'{SWINGING} (from end to end of its duty at {frequency:.3g} Hz)'

    def _follow(self, change: float) -> None:
        """Judge whether the axis gains speed against the duty that it answers to."""
        before = self._speed
        speed = before + (change - before) * _SPEED_SHARE
        self._speed = speed
        pushed = self._duty * self._direction
        if pushed > self.limits.load:
            against = speed < before and speed < -self._still
        elif pushed < -self.limits.load:
            against = speed > before and speed > self._still
        else:
            against = False
        self._against = self._against + 1 if against else 0
        if self._against >= self.limits.runaway_periods:
            self.fault = (
                self._unstable()
                if self._swings_already
                else 'axis runs away against its duty: wrong sign or load'
            )

    def _count(self, counts: float, bend: int) -> None:
        """Judge whether the reading still moves in single counts.

        `bend` is what its change has changed by [counts].
        """
        whole = round(counts)
        if abs(counts - whole) > 0.25:
            self._odd += 1
            if self._odd > self.limits.bad_max:
                self.fault = 'reading moves in other steps than counts'
            return
        self._divisor = gcd(self._divisor, whole)
        if self._divisor == 1:
            self._restart_divisor()
            return
        steady, swings = bend == self._bend, bend == self._bend_before
        self._bend_before, self._bend = self._bend, bend
        if steady or not whole:
            return
        self._changes += 1 if swings else _IRREGULAR
        self._kinds.add(whole)
        if self._changes >= _INCREMENTS and len(self._kinds) >= _KINDS:
            self.fault = f'reading moves in steps of {self._divisor} counts'

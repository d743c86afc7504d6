# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Position controller of an axis: reference and reading in, duty out."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from math import inf, isfinite, nan

import numpy as np

from fuzzycnc_ros.core.arrays import Array
from fuzzycnc_ros.core.servo.axis import LinearAxis
from fuzzycnc_ros.core.servo.constants import Constant
from fuzzycnc_ros.core.servo.feedback_watch import FeedbackLimits, FeedbackWatch
from fuzzycnc_ros.core.servo.friction import ReferenceFriction

_TAKEN_BACK, _LEAST = 0.5, 0.2
"""Share of the gain that a loop which is unstable goes on with, and what it has to have left
before the last such step [-]."""


def closed_loop(
    dynamics: Array, duty: Array, reading: Array, law: tuple[Array, Array, Array, float]
) -> Array:
    """Return the transition of an axis and of the law that closes its loop.

    Parameters
    ----------
    dynamics : ndarray, shape (n, n)
        Transition of the axis in a period.
    duty, reading : ndarray, shape (n,)
        What a duty adds to its states, and the row of its reading.
    law : tuple
        As `AxisController.feedback_law` returns it, with k states.

    Returns
    -------
    ndarray, shape (n + k, n + k)
        Transition of both.
    """
    inner, entry, row, direct = law
    size = len(dynamics)
    whole = np.empty((size + len(inner), size + len(inner)))
    whole[:size, :size] = dynamics + direct * np.outer(duty, reading)
    whole[:size, size:] = np.outer(duty, row)
    whole[size:, :size] = np.outer(entry, reading)
    whole[size:, size:] = inner
    return whole


@dataclass(frozen=True, kw_only=True)
class ControllerStatus:
    """State of a controller in its last period; NaN for quantities that it does not have.

    Attributes
    ----------
    error, error_rate : float
        Distance to the reference [m] and its rate [m/s], as the controller sees them.
    contracted_error, contracted_rate : float
        The two on their contracted universes [-].
    cell : tuple of int or None
        Row and column of the active cell of the rule table, from 0.
    factor : float
        Scale of the output's universe [-].
    disturbance : float
        Disturbance that is made up for [-], as duty: observed or integrated.
    duty : float
        What was commanded [-].
    saturated : bool
        Whether the wanted duty was cut.
    rest : str
        What is done about friction at rest: `holding`, `dithering` or nothing.
    bad : int
        Readings in a row, up to the last, that could not be used.
    bad_total : int
        All such readings since the reset.
    fault : str
        Why the axis is commanded to zero until a reset; empty without fault.
    """

    error: float
    error_rate: float
    contracted_error: float
    contracted_rate: float
    cell: tuple[int, int] | None
    factor: float
    disturbance: float
    duty: float
    saturated: bool
    rest: str
    bad: int
    bad_total: int
    fault: str


class AxisController(ABC):
    """A position controller that is asked once per control period.

    It notices by itself when its feedback cannot be right: a bad reading is bridged with the last
    duty, too many in a row, a run-away or a changed count is a fault, and the duty stays zero
    until `reset`.

    Parameters
    ----------
    axis : LinearAxis
        Nominal model, for period, direction and what is believable.
    duty_max : float
        Largest magnitude of duty [-], above 0 and at most 1.
    duty_slew : float
        Largest change of duty [1/s]; infinite for none.
    limits : FeedbackLimits, optional
        What to believe of the feedback; by default what follows from the axis.
    friction : tuple of float
        Duty [-] that Coulomb friction takes in positive and in negative motion, not negative; it
        is fed forward.
    keeps_gain : bool
        Whether a swing that grows is a fault at once, as on a vertical axis, which less gain would
        drop; else gain is taken back where less of it is stable.

    Raises
    ------
    ValueError
        If a limit is out of its range.
    """

    def __init__(
        self,
        axis: LinearAxis,
        *,
        duty_max: float = 1.0,
        duty_slew: float = inf,
        limits: FeedbackLimits | None = None,
        friction: tuple[float, float] = (0.0, 0.0),
        keeps_gain: bool = False,
    ) -> None:
        if not 0.0 < duty_max <= 1.0:
            raise ValueError(f'duty_max: expected more than 0, at most 1, but found {duty_max}')
        if not duty_slew > 0.0:
            raise ValueError(f'duty_slew: expected a positive number but found {duty_slew} 1/s')
        self.axis = axis
        self.period = axis.period
        self.duty_max = duty_max
        self._direction = 1.0 if axis.gain > 0.0 else -1.0
        self._change_max = duty_slew * axis.period
        forward, backward = (self._direction * one for one in friction)
        self._known = ReferenceFriction(forward, backward) if any(friction) else None
        self._friction = 0.0  # what is fed forward of it
        self.watch = FeedbackWatch(
            limits or FeedbackLimits.of(axis),
            axis.period,
            self._direction,
            abs(axis.gain),
            duty_max,
        )
        self._keeps_gain = keeps_gain
        self._share = 1.0  # of the gain
        self._duty = 0.0
        self._saturated = False
        self._at: float | None = None

    @property
    def taken_back(self) -> bool:
        """True if gain was taken back since the reset, as the loop was unstable."""
        return self._share < 1.0

    def reset(self, position: float | None = None, duty: float = 0.0) -> None:
        """Start anew and clear faults.

        Parameters
        ----------
        position : float, optional
            Where the axis rests [m]; by default where the next reading says.
        duty : float
            Duty [-] that has held the axis there so far: at no error the first duty is this one,
            so that control is taken over without a bump.  An error acts on top of it at once.

        Raises
        ------
        ValueError
            If a number is not finite.  The state is unchanged.
        """
        if not isfinite(duty) or not (position is None or isfinite(position)):
            raise ValueError(f'reset: expected finite numbers but found {position} m and {duty}')
        self._duty = min(max(duty, -self.duty_max), self.duty_max)
        self._saturated = False
        self._share = 1.0
        self._at = position
        self.watch.reset(position)
        if position is not None:
            self._begin(position)

    def step(
        self,
        reference: float,
        position: float,
        velocity: float = 0.0,
        acceleration: float = 0.0,
    ) -> float:
        """Return the duty for the next period.

        Parameters
        ----------
        reference : float
            Where the axis is to be now [m].
        position : float
            What the sensor reads now [m].
        velocity, acceleration : float
            Derivatives of the reference [m/s, m/s^2]; 0 for steps.

        Returns
        -------
        float
            Duty [-] within `duty_max`; 0 after a fault.
        """
        watch = self.watch
        if watch.fault:
            self._duty = 0.0
            return 0.0
        if not watch.accepts(reference, position):
            if watch.fault or self._at is None:
                self._duty = 0.0
            else:
                self._bridge(self._duty)
            return self._duty
        if self._at is None:
            self._at = position
            self._begin(position)
        if watch.swing.grows or (self._share < 1.0 and watch.swing.lasts):
            self._take_back()
        if self._share < 1.0:  # as on an axis of less gain
            position = reference - self._share * (reference - position)
        wanted = self._wanted(reference, position, velocity, acceleration)
        top = self.duty_max
        duty = top if wanted > top else -top if wanted < -top else wanted
        last, most = self._duty, self._change_max
        if duty - last > most:
            duty = last + most
        elif last - duty > most:
            duty = last - most
        self._saturated = duty != wanted
        if duty != duty:  # a reference's derivative was not finite
            watch.fault = 'derivative of the reference is not finite'
            duty = 0.0
        self._duty = duty
        watch.applied(duty)
        self._commit(duty, position)
        return duty

    def constants(self) -> list[Constant]:
        """Return the numbers that the controller computes with."""
        friction = self._known or ReferenceFriction(0.0, 0.0)
        return [
            Constant('PERIOD', self.period, 's', 'Control period'),
            Constant('DUTY_MAX', self.duty_max, '-', 'Largest magnitude of duty'),
            Constant(
                'DUTY_CHANGE_MAX', self._change_max, '-', 'Largest change of duty in a period'
            ),
            Constant('DIRECTION', self._direction, '-', 'Sign of the velocity of a positive duty'),
            Constant(
                'KEEPS_GAIN', self._keeps_gain, '', 'Whether a swing that grows is a fault at once'
            ),
            Constant(
                'FRICTION_KNOWN', self._known is not None, '', 'Whether friction is fed forward'
            ),
            *friction.constants(),
            *self.watch.constants(),
        ]

    def _begin(self, position: float) -> None:
        """Begin at rest at a position [m] that the present duty holds."""
        self._friction = 0.0
        if self._known is not None:
            self._known.reset()
        self._restart(position, self._duty)

    def _take_back(self) -> None:
        """Take gain back where less of it is stable; else give up."""
        swing = self.watch.swing
        less = _TAKEN_BACK * self._share
        if self._keeps_gain or self._share < _LEAST or not self.settles(less):
            self.watch.give_up_unstable()
            return
        self._share = less
        swing.start_over()

    def settles(self, share: float) -> bool:
        """Return True if the loop with the nominal axis is stable at a share of its gain.

        One with an integral that is fast for its bandwidth is not, however little is left.
        """
        dynamics, duty, _ = self.axis.discrete()
        whole = closed_loop(dynamics, duty, share * self.axis.c, self.feedback_law())
        return float(np.abs(np.linalg.eigvals(whole)).max()) < 1.0 + 1e-9

    @abstractmethod
    def feedback_law(self) -> tuple[Array, Array, Array, float]:
        """Return the law from reading to duty near the target, where it is linear.

        Returns
        -------
        inner : ndarray, shape (k, k)
            Transition of the law's own states in a period.
        entry, row : ndarray, shape (k,)
            What a reading adds to them, and what duty they give.
        direct : float
            Duty that a reading gives at once [1/m].
        """

    @property
    @abstractmethod
    def status(self) -> ControllerStatus:
        """State in the last period."""

    def _plain_status(
        self, error: float, error_rate: float, disturbance: float
    ) -> ControllerStatus:
        """Return the status of a controller without rules."""
        return ControllerStatus(
            error=error,
            error_rate=error_rate,
            contracted_error=nan,
            contracted_rate=nan,
            cell=None,
            factor=nan,
            disturbance=disturbance,
            duty=self._duty,
            saturated=self._saturated,
            rest='',
            bad=self.watch.bad,
            bad_total=self.watch.bad_total,
            fault=self.watch.fault,
        )

    @abstractmethod
    def _restart(self, position: float, duty: float) -> None:
        """Begin at rest at a position [m] that a duty [-] holds."""

    @abstractmethod
    def _wanted(
        self, reference: float, position: float, velocity: float, acceleration: float
    ) -> float:
        """Return the duty [-] that is wanted, whatever the limits."""

    @abstractmethod
    def _commit(self, duty: float, position: float) -> None:
        """Go on to the next period, in which the duty [-] as limited is held."""

    @abstractmethod
    def _bridge(self, duty: float) -> None:
        """Go on to the next period without a reading."""

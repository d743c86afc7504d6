# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The variable-universe controller of a ball-screw axis, set from its nominal model alone."""

from __future__ import annotations

from fuzzycnc_ros.core.machine.ballscrew_axis import BallscrewAxis, BallscrewAxisConfig
from fuzzycnc_ros.core.servo.feedback_watch import FeedbackLimits
from fuzzycnc_ros.core.servo.observer import ObserverNoise
from fuzzycnc_ros.core.servo.params import VariableUniverseParams
from fuzzycnc_ros.core.servo.stick_slip import StickSlipParams
from fuzzycnc_ros.core.servo.variable_universe import VariableUniverseController

BANDWIDTH, OBSERVER_BANDWIDTH = 60.0, 240.0
"""Of the closed position loop and of the observer [rad/s].

Chosen on the nominal EMPS axis: the loop crosses over at 129 rad/s with a phase margin of 44
degrees; the loop that the real machine was recorded with at 138 rad/s with 38 degrees.
"""

LOAD = 0.6
"""Load and friction that the watch believes [-], as duty: the real machine bore pulses of half of
its drive."""

_RELIEF = StickSlipParams()

_MOVING = 1e-3
"""Velocity above which an axis is surely in motion [m/s]."""
_MEMORY = 0.05
"""Time of motion over which the disturbance seen in it is averaged [s]."""
_HIDDEN = 2.0
"""Friction that is believed to hide forces at rest over the known one [-]."""


class MovingDisturbance:
    """What an observer saw of the disturbance while an axis moved, by direction.

    At rest friction takes whatever force there is, and the observer learns that instead: an axis
    that set off with it was up to 28 um behind or ahead.

    Parameters
    ----------
    period : float
        Control period [s].
    settle : float
        Time of motion after which the observer has found the disturbance [s].

    Examples
    --------
    >>> memory = MovingDisturbance(1e-3, settle=2e-3)
    >>> memory.reset(0.02)
    >>> memory.recall(1)
    0.02
    >>> for seen in 0.01, 0.03, 0.05:
    ...     memory.learn(1, seen)
    >>> memory.recall(1), memory.recall(-1)
    (0.05, 0.05)
    """

    def __init__(self, period: float, settle: float) -> None:
        self._share = period / _MEMORY
        self._settle = round(settle / period)
        self.reset(0.0)

    def reset(self, disturbance: float) -> None:
        """Forget what was seen; a disturbance [-] is all that is known."""
        self._first = disturbance
        self._seen: dict[int, float] = {}
        self._count = {1: 0, -1: 0}
        self.rest()

    def rest(self) -> None:
        """Note a period in which the axis may be at rest, or turns back."""
        self._moved = 0

    def learn(self, way: int, disturbance: float) -> None:
        """Take the disturbance [-] of a period of motion in the direction 1 or -1."""
        self._moved += 1
        if self._moved <= self._settle:
            return
        self._count[way] += 1
        before = self._seen.get(way, disturbance)
        share = max(1.0 / self._count[way], self._share)
        self._seen[way] = before + (disturbance - before) * share

    def recall(self, way: int) -> float:
        """Return the mean disturbance [-] of motion in a direction, else in the other one."""
        return self._seen.get(way, self._seen.get(-way, self._first))


class BallscrewController(VariableUniverseController):
    """Production controller of a ball-screw axis, with its Coulomb friction fed forward.

    The friction that the reference's velocity will meet is added to the duty, and the observer is
    told of it: it sees the duty without it, so that only what the model does not know ends up in
    the observed disturbance.  Nothing is made up for twice, and at a reversal the observer need
    not first unlearn the friction of the way there.

    Where the reference comes to rest the friction stays fed forward until the axis has arrived:
    the axis lags, and what is left of its way meets the same friction.  (Without that it stuck
    2.4 um short after every profile, for the 0.6 s in which the observer found out.)

    Where it sets off again the observer goes on from what it saw in motion of that direction, see
    `MovingDisturbance`; friction that differs from the known one is learnt by that, too.

    Parameters
    ----------
    config : BallscrewAxisConfig, optional
        The axis as it is known; its factors, load and faults are not looked at.
    bandwidth, observer_bandwidth : float
        Natural frequency of the closed position loop and of the observer [rad/s]; positive.
    friction : float
        Share of the known Coulomb friction that is fed forward [-], 0 to 1.
    params : VariableUniverseParams, optional
        Universes and rules instead of those that follow from `bandwidth`.
    stick_slip : StickSlipParams or None
        Relief from stick-slip hunting; None for none.

    Raises
    ------
    ValueError
        If a number is out of its range.

    Examples
    --------
    >>> axis, controller = BallscrewAxis(), BallscrewController()
    >>> for step in range(1500):
    ...     axis.drive(controller.step(min(1e-4 * step, 0.1), axis.measure()))
    >>> f'{1e3 * axis.position:.3f}'
    '100.000'
    """

    def __init__(
        self,
        config: BallscrewAxisConfig | None = None,
        *,
        bandwidth: float = BANDWIDTH,
        observer_bandwidth: float = OBSERVER_BANDWIDTH,
        friction: float = 1.0,
        params: VariableUniverseParams | None = None,
        stick_slip: StickSlipParams | None = _RELIEF,
    ) -> None:
        known = config or BallscrewAxisConfig()
        if not 0.0 <= friction <= 1.0:
            raise ValueError(f'friction: expected 0 to 1 but found {friction}')
        axis = BallscrewAxis(known).linear()
        super().__init__(
            axis,
            params or VariableUniverseParams.for_axis(axis, bandwidth, damping=1.0),
            noise=ObserverNoise.of_bandwidth(axis, observer_bandwidth),
            stick_slip=stick_slip,
            duty_max=known.duty_max,
            limits=FeedbackLimits.of(axis, count=known.count, load=LOAD),
        )
        self._coulomb = 0.5 * friction * (known.coulomb_forward + known.coulomb_backward)
        self._coulomb *= self._direction / known.force_max
        self._way = 0  # direction of the motion that is under way
        self._going = 0  # that of the reference in the last period
        self._moving = MovingDisturbance(axis.period, settle=3.0 / observer_bandwidth)

    def _restart(self, position: float, duty: float) -> None:
        self._friction = 0.0
        self._way = self._going = 0
        self._moving.reset(duty)
        super()._restart(position, duty)

    def _wanted(
        self, reference: float, position: float, velocity: float, acceleration: float
    ) -> float:
        motion = velocity or acceleration  # it sets off in the period that begins
        if motion:
            self._way = 1 if motion > 0.0 else -1
            self._learn(velocity)
        elif self._way and self._error * self._way <= 0.0:
            self._way = 0  # arrived
        self._going = self._way if motion else 0
        self._friction = self._coulomb * self._way
        return super()._wanted(reference, position, velocity, acceleration)

    def _learn(self, velocity: float) -> None:
        """Have the observer set off with what was seen in motion, and see what there is to see."""
        observer = self._observer
        assert observer is not None
        if not self._going:
            # At rest the observer is off by what friction takes; a load beyond that is seen.
            seen = self._moving.recall(self._way)
            rest, hidden = observer.state[-1], abs(_HIDDEN * self._coulomb)
            observer.state = (*observer.state[:-1], min(max(seen, rest - hidden), rest + hidden))
        slowest = min(self._way * velocity, self._way * observer.state[observer.velocity_place])
        if slowest > _MOVING and self._going == self._way:
            self._moving.learn(self._way, observer.state[-1])
        else:
            self._moving.rest()

    def _commit(self, duty: float, position: float) -> None:
        super()._commit(duty - self._friction, position)

    def _bridge(self, duty: float) -> None:
        super()._bridge(duty - self._friction)

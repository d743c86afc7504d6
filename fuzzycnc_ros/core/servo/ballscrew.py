# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Position controllers of a ball-screw axis: set from its nominal model alone, and tuned."""

from __future__ import annotations

from dataclasses import replace
from types import MappingProxyType

from fuzzycnc_ros.core.machine.axis_models import BallscrewAxisConfig
from fuzzycnc_ros.core.machine.machine_data import AxisData, AxisLimits
from fuzzycnc_ros.core.servo.axis_control import make_axis_controller
from fuzzycnc_ros.core.servo.controller import AxisController
from fuzzycnc_ros.core.servo.feedback_watch import FeedbackLimits
from fuzzycnc_ros.core.servo.friction import FrictionFedController
from fuzzycnc_ros.core.servo.observer import ObserverNoise
from fuzzycnc_ros.core.servo.params import VariableUniverseParams
from fuzzycnc_ros.core.servo.stick_slip import StickSlipParams

BANDWIDTH, OBSERVER_BANDWIDTH = 60.0, 240.0
"""Of the closed position loop and of the observer [rad/s].

Chosen on the nominal EMPS axis: the loop crosses over at 129 rad/s with a phase margin of 44
degrees; the loop that the real machine was recorded with at 138 rad/s with 38 degrees.
"""

TUNED_BALLSCREW = AxisData(
    limits=AxisLimits(load=0.5),
    controller='pid',
    settings=MappingProxyType({'bandwidth': 1.85, 'damping': 0.5, 'estimator': 0.51}),
)
"""What won on the ball-screw axis after tuning with equal effort, as in the built-in machine file
`ballscrew`; that file says of the axis what matters to it."""

LOAD = 0.6
"""Load and friction that the watch believes [-], as duty: the real machine bore pulses of half of
its drive."""

_RELIEF = StickSlipParams()


class BallscrewController(FrictionFedController):
    """Production controller of a ball-screw axis, with its Coulomb friction fed forward.

    Where the reference comes to rest the friction stays fed forward until the axis has arrived.
    (Without that it stuck 2.4 um short after every profile, for the 0.6 s in which the observer
    found out.)

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
    >>> from fuzzycnc_ros.simulation.servo.axes import BallscrewAxis
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
        axis = known.linear()
        coulomb = 0.5 * friction * (known.coulomb_forward + known.coulomb_backward)
        super().__init__(
            axis,
            forward=coulomb / known.force_max,
            backward=coulomb / known.force_max,
            observer_bandwidth=observer_bandwidth,
            params=params or VariableUniverseParams.for_axis(axis, bandwidth, damping=1.0),
            noise=ObserverNoise.of_bandwidth(axis, observer_bandwidth),
            stick_slip=stick_slip,
            duty_max=known.duty_max,
            limits=FeedbackLimits.of(axis, count=known.count, load=LOAD),
        )


def tuned_ballscrew(config: BallscrewAxisConfig | None = None) -> AxisController:
    """Return the controller that won on the ball-screw axis after tuning, `TUNED_BALLSCREW`.

    Parameters
    ----------
    config : BallscrewAxisConfig, optional
        The axis as it is known; its factors, load and faults are not looked at.

    Examples
    --------
    >>> type(tuned_ballscrew()).__mro__[1].__name__
    'PidController'
    """
    return make_axis_controller(replace(TUNED_BALLSCREW, plant=config or BallscrewAxisConfig()))

# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The variable-universe controller of a ball-screw axis, set from its nominal model alone."""

from __future__ import annotations

from dataclasses import replace
from math import isfinite, sqrt

from fuzzycnc_ros.core.machine.axis_plant import LinearAxis
from fuzzycnc_ros.core.machine.ballscrew_axis import BallscrewAxis, BallscrewAxisConfig
from fuzzycnc_ros.core.servo.feedback_watch import FeedbackLimits
from fuzzycnc_ros.core.servo.observer import ObserverNoise
from fuzzycnc_ros.core.servo.params import VariableUniverseParams
from fuzzycnc_ros.core.servo.variable_universe import VariableUniverseController

BANDWIDTH, OBSERVER_BANDWIDTH = 60.0, 240.0
"""Of the closed position loop and of the observer [rad/s].

Chosen on the nominal EMPS axis: the loop crosses over at 129 rad/s with a phase margin of 44
degrees; the loop that the real machine was recorded with at 138 rad/s with 38 degrees.
"""

_RATE_PER_SPEED = 0.94036 / 0.286
"""Rate range over speed at full duty, as on the lathe axis of method sheet 004 section 9."""


def ballscrew_params(axis: LinearAxis, bandwidth: float = BANDWIDTH) -> VariableUniverseParams:
    """Return universes for an axis that its drive accelerates, rather than moves at a speed.

    The gains at the origin close a critically damped loop of that bandwidth; the universes are as
    wide against the speed at full duty as on the lathe axis.  (Narrower ones with the same gains
    cannot tell fast from faster and brake too late: on the EMPS axis a step of 10 mm then
    overshoots by 5.7 mm, with these not at all.)

    Parameters
    ----------
    axis : LinearAxis
        Nominal model.
    bandwidth : float
        Natural frequency of the closed position loop [rad/s].

    Returns
    -------
    VariableUniverseParams
        Parameters of the production controller.

    Raises
    ------
    ValueError
        If the axis damps itself more than critically at that bandwidth.

    Examples
    --------
    >>> params = ballscrew_params(BallscrewAxis().linear())
    >>> f'{params.error_range:.2f} {params.rate_range:.2f} {params.output_gain:.1f}'
    '1.45 5.68 67.5'
    """
    narrow = VariableUniverseParams.for_axis(axis, bandwidth, damping=1.0)
    scale = _RATE_PER_SPEED * abs(axis.gain) / narrow.rate_range
    return replace(
        narrow,
        error_range=scale * narrow.error_range,
        rate_range=scale * narrow.rate_range,
        output_gain=scale * narrow.output_gain,
    )


def observer_noise(axis: LinearAxis, bandwidth: float, sensor: float = 1e-8) -> ObserverNoise:
    """Return what an observer of an axis expects if it is to have a bandwidth.

    The disturbance wanders as fast as makes the observer of a plain mass a Butterworth filter of
    that bandwidth, and the velocity as fast as twice the bandwidth needs: believing the model's
    velocity alone costs the closed loop 15 degrees of its phase margin.

    Parameters
    ----------
    axis : LinearAxis
        Nominal model.
    bandwidth : float
        Natural frequency of the observer [rad/s]; positive.
    sensor : float
        RMS of the reading's error [m]; positive.  The observer's gain does not depend on it.

    Returns
    -------
    ObserverNoise
        For `VariableUniverseController` and every other user of the observer.

    Raises
    ------
    ValueError
        If the bandwidth or the sensor's error is not positive.

    Examples
    --------
    >>> noise = observer_noise(BallscrewAxis().linear(), 240.0, 5e-8 / 12**0.5)
    >>> f'{noise.disturbance:.3e} {noise.velocity:.3e}'
    '1.707e-03 1.052e-04'
    """
    if not (isfinite(bandwidth) and bandwidth > 0.0):
        raise ValueError(f'bandwidth: expected a positive number but found {bandwidth} rad/s')
    velocity = axis.states.index('velocity')
    acceleration = abs(float(axis.disturbance[velocity]))  # per duty
    density = sensor * sqrt(axis.period)
    return ObserverNoise(
        sensor=sensor,
        disturbance=bandwidth**3 * density / acceleration,
        velocity=(2.0 * bandwidth) ** 2 * density,
    )


class BallscrewController(VariableUniverseController):
    """Production controller of a ball-screw axis, with its Coulomb friction fed forward.

    The friction that the reference's velocity will meet is added to the duty, and the observer is
    told of it: it sees the duty without it, so that only what the model does not know ends up in
    the observed disturbance.  Nothing is made up for twice, and at a reversal the observer need
    not first unlearn the friction of the way there.

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
    ) -> None:
        known = config or BallscrewAxisConfig()
        if not 0.0 <= friction <= 1.0:
            raise ValueError(f'friction: expected 0 to 1 but found {friction}')
        axis = BallscrewAxis(known).linear()
        super().__init__(
            axis,
            params or ballscrew_params(axis, bandwidth),
            noise=observer_noise(axis, observer_bandwidth),
            stick_slip=None,  # set for the lathe's friction; here it shook the axis loose for less
            duty_max=known.duty_max,
            limits=FeedbackLimits.of(axis, count=known.count),
        )
        self._coulomb = 0.5 * friction * (known.coulomb_forward + known.coulomb_backward)
        self._coulomb *= self._direction / known.force_max
        self._fed = 0.0

    def _restart(self, position: float, duty: float) -> None:
        self._fed = 0.0
        super()._restart(position, duty)

    def _wanted(
        self, reference: float, position: float, velocity: float, acceleration: float
    ) -> float:
        coulomb = self._coulomb
        self._fed = coulomb if velocity > 0.0 else -coulomb if velocity < 0.0 else 0.0
        return super()._wanted(reference, position, velocity, acceleration) + self._fed

    def _commit(self, duty: float, position: float) -> None:
        super()._commit(duty - self._fed, position)

    def _bridge(self, duty: float) -> None:
        super()._bridge(duty - self._fed)

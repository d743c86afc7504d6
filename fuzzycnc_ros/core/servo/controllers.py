# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Position controllers by name, the one naming of nodes, commands and documentation.

That of a ball-screw axis is set from its nominal model alone.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from types import MappingProxyType
from typing import Any

from fuzzycnc_ros.core.machine.axis_models import BallscrewAxisConfig
from fuzzycnc_ros.core.machine.machine_data import AxisData, AxisLimits
from fuzzycnc_ros.core.servo.axis import LinearAxis
from fuzzycnc_ros.core.servo.axis_control import make_axis_controller
from fuzzycnc_ros.core.servo.baselines import (
    CascadeController,
    FixedUniverseController,
    PidController,
)
from fuzzycnc_ros.core.servo.controller import AxisController
from fuzzycnc_ros.core.servo.feedback_watch import FeedbackLimits
from fuzzycnc_ros.core.servo.friction import FrictionFedController
from fuzzycnc_ros.core.servo.observer import ObserverNoise
from fuzzycnc_ros.core.servo.params import VariableUniverseParams
from fuzzycnc_ros.core.servo.stick_slip import StickSlipParams
from fuzzycnc_ros.core.servo.variable_universe import VariableUniverseController

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


Factory = Callable[..., AxisController]
"""Makes a controller from the nominal model of an axis and options by name."""


def _paper_scales(axis: LinearAxis, **options: Any) -> AxisController:
    """Return the published rules on the published universes, which do not contract."""
    published = VariableUniverseParams.published()
    return FixedUniverseController(
        axis,
        mode='static',
        error_range=published.error_range,
        rate_range=published.rate_range,
        output_gain=published.output_gain,
        **options,
    )


def _in_mode(mode: str) -> Factory:
    def make(axis: LinearAxis, **options: Any) -> AxisController:
        return VariableUniverseController(axis, mode=mode, **options)

    return make


def _model_free(axis: LinearAxis, **options: Any) -> AxisController:
    return VariableUniverseController(axis, observer=False, **options)


CONTROLLERS: Mapping[str, Factory] = MappingProxyType(
    {
        'variable_universe': VariableUniverseController,
        'variable_universe_model_free': _model_free,
        'variable_universe_static': _in_mode('static'),
        'variable_universe_paper': _in_mode('paper_literal'),
        'fixed_universe': FixedUniverseController,
        'fixed_universe_paper': _paper_scales,
        'cascade': CascadeController,
        'pid': PidController,
    }
)
"""Controllers by name, the default first, as they are meant to be used on the lathe axis.

`variable_universe` is the repaired form with observer and feedforward, `_model_free` the same with
filtered differences and an integral, `_static` the published surface alone, `_paper` the published
recursion as printed.  `fixed_universe` is the default on universes that do not contract,
`fixed_universe_paper` the published rules on the published ones.
"""

DEFAULT_CONTROLLER = next(iter(CONTROLLERS))
"""Controller that axes get if nothing else is asked for."""

FOR_USE = tuple(name for name in CONTROLLERS if name != 'fixed_universe_paper')
"""Controllers that a node offers; the one left out stops far short, for comparison alone."""

SUITED = 'suited'
"""Stands for the controller that won on an axis after tuning with equal effort."""

WITH_PARAMS = tuple(name for name in CONTROLLERS if name.startswith('variable_universe'))
"""Controllers that `VariableUniverseParams` are for."""


def make_controller(
    name: str,
    axis: LinearAxis,
    params: VariableUniverseParams | None = None,
    **options: Any,
) -> AxisController:
    """Return the controller of a name for an axis.

    Parameters
    ----------
    name : str
        Of `CONTROLLERS`.
    axis : LinearAxis
        Nominal model of the axis.
    params : VariableUniverseParams, optional
        Universes and rules instead of the controller's own.
    **options
        What the controller takes beside: `duty_max`, `duty_slew` and `limits` all do, `noise`
        those with an observer.

    Raises
    ------
    ValueError
        If the name is unknown, the controller has no universes to set, or a number is out of its
        range.

    Examples
    --------
    >>> lags = {'amplifier': 8e-4, 'torque': 1.5e-3}
    >>> axis = LinearAxis.chain(0.286, lags, 0.017, sensor_lag=6e-3, period=1e-3)
    >>> type(make_controller('cascade', axis)).__name__
    'CascadeController'
    """
    if name not in CONTROLLERS:
        raise ValueError(
            f'controller: expected one of {", ".join(CONTROLLERS)} but found {name!r}'
        )
    if params is None:
        return CONTROLLERS[name](axis, **options)
    if name not in WITH_PARAMS:
        raise ValueError(
            f'params: expected one of the controllers {", ".join(WITH_PARAMS)} but found {name}, '
            'which has no such parameters'
        )
    return CONTROLLERS[name](axis, params=params, **options)

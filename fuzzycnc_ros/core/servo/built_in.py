# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Built-in axes, the lathe of [long2014] and the ball screw of the EMPS benchmark."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from types import MappingProxyType
from typing import Any

from fuzzycnc_ros.core.machine.axis_models import BallscrewAxisConfig, LatheAxisConfig
from fuzzycnc_ros.core.machine.machine_data import AxisData, AxisLimits
from fuzzycnc_ros.core.servo.axis_control import (
    LATHE_CONTROLLERS,
    make_axis_controller,
    make_controller,
)
from fuzzycnc_ros.core.servo.controller import AxisController
from fuzzycnc_ros.core.servo.rule_table import RuleTable

BALLSCREW_SETTINGS: Mapping[str, Mapping[str, float]] = MappingProxyType(
    {
        'variable_universe': MappingProxyType(
            {'bandwidth': 0.6, 'damping': 1.0, 'estimator': 4.0}
        ),
        'pid': MappingProxyType({'bandwidth': 1.85, 'damping': 0.5, 'estimator': 0.51}),
    }
)
"""Settings of the ball-screw axis by controller; the last won after tuning with equal effort.

Those of the variable universe were chosen on the nominal EMPS axis: the loop crosses over at 129
rad/s with a phase margin of 44 degrees; the loop that the real machine was recorded with at 138
rad/s with 38 degrees.
"""

_WAY = AxisLimits(positioning_velocity=0.2, positioning_acceleration=1.5)

BUILT_IN_AXES: Mapping[str, AxisData] = MappingProxyType(
    {
        'lathe': AxisData(limits=_WAY, plant=LatheAxisConfig(), controller=LATHE_CONTROLLERS[0]),
        'ballscrew': AxisData(
            limits=replace(_WAY, load=0.5),
            plant=BallscrewAxisConfig(),
            controller='pid',
            settings=BALLSCREW_SETTINGS['pid'],
        ),
    }
)
"""The axes, as in the built-in machine files, but that the lathe's controller has its numbers."""


def built_in_controller(
    axis: str,
    name: str = '',
    settings: Mapping[str, float] | None = None,
    rules: RuleTable | None = None,
    **plant: Any,
) -> AxisController:
    """Return a controller of a built-in axis.

    Parameters
    ----------
    axis : str
        Of `BUILT_IN_AXES`.
    name : str
        Of `LATHE_CONTROLLERS`, or on the ball screw of `BALLSCREW_SETTINGS`; by default what won
        on the axis after tuning.
    settings : mapping of str to float, optional
        Settings instead of its own.
    rules : RuleTable, optional
        Rules instead of the published ones.
    **plant
        What differs of the axis as it is known.

    Raises
    ------
    ValueError
        If a name is unknown or a number out of its range.

    Examples
    --------
    >>> type(built_in_controller('ballscrew')).__name__
    'PidController'
    """
    data = BUILT_IN_AXES[axis]
    known, chosen = replace(data.known_plant(), **plant), name or data.controller
    if axis == 'lathe':
        return make_controller(chosen, known.linear(), settings, rules, duty_max=known.duty_max)
    if chosen not in BALLSCREW_SETTINGS:
        raise ValueError(
            f'controller: expected {" or ".join(BALLSCREW_SETTINGS)} for a ballscrew axis but '
            f'found {chosen}'
        )
    own = {**BALLSCREW_SETTINGS[chosen], **(settings or {})}
    return make_axis_controller(replace(data, plant=known), chosen, own, rules)

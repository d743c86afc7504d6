# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The ball-screw axis of the EMPS benchmark, and its controllers."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from types import MappingProxyType
from typing import Any

from fuzzycnc_ros.core.machine.axis_models import BallscrewAxisConfig
from fuzzycnc_ros.core.machine.machine_data import AxisData, AxisLimits
from fuzzycnc_ros.core.servo.axis_control import make_axis_controller
from fuzzycnc_ros.core.servo.controller import AxisController
from fuzzycnc_ros.core.servo.rule_table import RuleTable

BALLSCREW_SETTINGS: Mapping[str, Mapping[str, float]] = MappingProxyType(
    {
        'pid': MappingProxyType({'bandwidth': 1.85, 'damping': 0.5, 'estimator': 0.51}),
        'variable_universe': MappingProxyType(
            {'bandwidth': 0.6, 'damping': 1.0, 'estimator': 4.0}
        ),
    }
)
"""Settings of the ball-screw axis by controller; the first won after tuning with equal effort.

Those of the variable universe were chosen on the nominal EMPS axis: the loop crosses over at 129
rad/s with a phase margin of 44 degrees; the loop that the real machine was recorded with at 138
rad/s with 38 degrees.
"""

BALLSCREW = AxisData(
    limits=AxisLimits(positioning_velocity=0.2, positioning_acceleration=1.5, load=0.5),
    plant=BallscrewAxisConfig(),
    controller='pid',
    settings=BALLSCREW_SETTINGS['pid'],
)
"""The axis, as in the built-in machine file `ballscrew`."""


def ballscrew_controller(
    name: str = 'pid',
    settings: Mapping[str, float] | None = None,
    rules: RuleTable | None = None,
    **plant: Any,
) -> AxisController:
    """Return a controller of the ball-screw axis.

    Parameters
    ----------
    name : str
        Of `BALLSCREW_SETTINGS`.
    settings : mapping of str to float, optional
        Settings instead of those.
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
    >>> type(ballscrew_controller()).__name__
    'PidController'
    """
    if name not in BALLSCREW_SETTINGS:
        raise ValueError(
            f'controller: expected {" or ".join(BALLSCREW_SETTINGS)} for a ballscrew axis but '
            f'found {name}'
        )
    known = replace(BALLSCREW, plant=replace(BALLSCREW.known_plant(), **plant))
    own = {**BALLSCREW_SETTINGS[name], **(settings or {})}
    return make_axis_controller(known, name, own, rules)

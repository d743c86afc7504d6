# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Node parameters from machine data."""

from __future__ import annotations

import json
from dataclasses import asdict
from typing import Any

from fuzzycnc_ros.core.machine.machine_data import MachineData, axis_texts
from fuzzycnc_ros.machine_file.feeds import scheduler_parameters, simulated_loop

_LOOP = (
    'interpolation_period', 'control_steps', 'filter_samples', 'position_gain',
    'velocity_bandwidth', 'velocity_max', 'acceleration_max', 'run_out',
)  # fmt: skip


def node_parameters(machine: MachineData) -> dict[str, dict[str, Any]]:
    """Return the parameters that machine data decide, by node, in SI.

    Examples
    --------
    >>> node_parameters(MachineData())['simulated_machine']['axis_position_gain']
    40.0
    """
    loop = asdict(simulated_loop(machine))
    axes = axis_texts(machine.axes)
    return {
        'feedrate_scheduler': scheduler_parameters(machine),
        'joint_trajectory_bridge': {
            'velocity_max': min(machine.limits('velocity')),
            'acceleration_max': min(machine.limits('acceleration')),
        },
        'simulated_machine': {
            **{f'axis_{name}': loop[name] for name in _LOOP},
            'axis_data': axes,
        },
        'servo_controller': {**_servo_limits(machine), 'axis_data': axes},
    }


def _servo_limits(machine: MachineData) -> dict[str, float]:
    """Return the limits of a controller of several axes: the widest, as each keeps its own."""
    limits = [data.limits for data in machine.axes.values() if data.plant is not None]
    if not limits:
        return {}
    ways = zip(*(one.positioning for one in limits), strict=True)
    return {
        **dict(zip(('velocity_max', 'acceleration_max', 'jerk_max'), map(max, ways), strict=True)),
        'trajectory_velocity_max': max(one.velocity for one in limits),
        'trajectory_acceleration_max': max(one.acceleration for one in limits),
    }


def parameter_text(machine: MachineData) -> str:
    """Return these parameters as a ROS parameter file for any namespace."""
    content = {
        f'/**/{node}': {
            'ros__parameters': {
                # ROS has no empty lists: without a type they cannot be read
                name: value
                for name, value in parameters.items()
                if value not in ((), [])
            }
        }
        for node, parameters in node_parameters(machine).items()
    }
    return json.dumps(content, indent=1) + '\n'  # JSON is YAML, and keeps 1.0 a float

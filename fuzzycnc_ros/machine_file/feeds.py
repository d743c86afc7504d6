# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Scheduling limits from machine data."""

from __future__ import annotations

from typing import Any

from fuzzycnc_ros.core.machine.machine_data import MachineData
from fuzzycnc_ros.core.machine.path_loop import ContouringConfig, loop_of_constant


def scheduler_parameters(machine: MachineData) -> dict[str, Any]:
    """Return the parameters of `feedrate_scheduler` that machine data decide, in SI.

    Examples
    --------
    >>> parameters = scheduler_parameters(MachineData())
    >>> parameters['path_velocity'], parameters['axis_acceleration']
    (0.25, (4.0, 4.0, 4.0))
    """
    path = machine.path
    return {
        'feed_max': min(path.feed or path.velocity, path.velocity),
        'machine_constant': machine.machine_constant,
        'path_velocity': path.velocity,
        'path_acceleration': path.acceleration,
        'path_jerk': path.jerk,
        'axis_velocity': machine.limits('velocity'),
        'axis_acceleration': machine.limits('acceleration'),
        'axis_jerk': machine.limits('jerk') if _jerk(machine) else (0.0, 0.0, 0.0),
        'settle': path.settle,
    }


def simulated_loop(machine: MachineData) -> ContouringConfig:
    """Return the axes on which contour errors are simulated.

    A contour constant of the file counts more than the loop's gains: these are then slower or
    faster throughout.
    """
    if not machine.contour_constant:
        return machine.loop
    return loop_of_constant(machine.machine_constant, machine.loop)


def _jerk(machine: MachineData) -> bool:
    return any(axis.limits.jerk for axis in machine.axes.values())

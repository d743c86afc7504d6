# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Servo: a position controller for an axis, from what a machine file says of it.

Examples
--------
>>> from fuzzycnc_ros import servo
>>> axis = servo.read_axis('lathe', 'X')
>>> controller = servo.controller(axis, 'variable_universe')
>>> plant = servo.simulated_axis(axis)
>>> run = servo.position(controller, plant, 1e-3, 0.5)
>>> f'{1e3 * run.position[-1]:.2f} mm'
'1.00 mm'
"""

from __future__ import annotations

import os
from typing import Any

from fuzzycnc_ros.core.machine.machine_data import AxisData
from fuzzycnc_ros.core.servo.axis_control import AXIS_CONTROLLERS, make_axis_controller
from fuzzycnc_ros.core.servo.controller import AxisController
from fuzzycnc_ros.core.servo.variable_universe import VariableUniverseController
from fuzzycnc_ros.machine_file.reader import read_machine_file
from fuzzycnc_ros.simulation.servo.axes import simulated_axis
from fuzzycnc_ros.simulation.servo.positioning import position

__all__ = [
    'AXIS_CONTROLLERS',
    'AxisData',
    'VariableUniverseController',
    'controller',
    'position',
    'read_axis',
    'simulated_axis',
]


def read_axis(machine: str | os.PathLike[str], name: str) -> AxisData:
    """Return an axis of a machine file, or of a machine that comes with the package.

    Parameters
    ----------
    machine : str or path
        The file, or the name of a built-in machine such as `lathe`.
    name : str
        Letter of the axis.

    Raises
    ------
    ValueError
        If the file cannot be used, or has no such axis.

    Examples
    --------
    >>> from fuzzycnc_ros import servo
    >>> type(servo.read_axis('lathe', 'X')).__name__
    'AxisData'
    """
    axes = read_machine_file(os.fspath(machine)).axes
    if name not in axes:
        known = ', '.join(axes) or 'none'
        raise ValueError(f'axis: expected one of {known}, as {machine} has them, but found {name}')
    return axes[name]


def controller(axis: AxisData, name: str = '', **settings: Any) -> AxisController:
    """Return a position controller for an axis.

    Parameters
    ----------
    axis : AxisData
        What is known of the axis; it must have a model.
    name : str
        One of `AXIS_CONTROLLERS`; that of the machine file by default, else `pid`.
    **settings
        Settings instead of the machine file's, such as `bandwidth=2.0`; those of the file are for
        the controller that it names alone.

    Raises
    ------
    ValueError
        If the axis has no model, or a name or setting is unknown.

    Examples
    --------
    >>> from fuzzycnc_ros import servo
    >>> controller = servo.controller(servo.read_axis('lathe', 'X'), 'pid')
    >>> -1.0 <= controller.step(1e-3, 0.0) <= 1.0
    True
    """
    return make_axis_controller(axis, name, settings or None)

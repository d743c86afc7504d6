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
import warnings
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from fuzzycnc_ros.core.identify.axis_data import identify_axis
from fuzzycnc_ros.core.identify.axis_fit import AxisRecording
from fuzzycnc_ros.core.machine.machine_data import AxisData, MachineData
from fuzzycnc_ros.core.servo.axis_control import AXIS_CONTROLLERS, make_axis_controller
from fuzzycnc_ros.core.servo.controller import AxisController
from fuzzycnc_ros.core.servo.variable_universe import VariableUniverseController
from fuzzycnc_ros.files.atomic import write_text
from fuzzycnc_ros.machine_file.reader import is_axis_name, read_machine_file
from fuzzycnc_ros.machine_file.writer import machine_text
from fuzzycnc_ros.simulation.servo.axes import simulated_axis
from fuzzycnc_ros.simulation.servo.axis_tuning import (
    AxisTuning,
    axis_cases,
    tune_controller,
    untuned_controllers,
)
from fuzzycnc_ros.simulation.servo.positioning import DrivenAxis, position

__all__ = [
    'AXIS_CONTROLLERS',
    'AxisData',
    'DrivenAxis',
    'VariableUniverseController',
    'controller',
    'identify',
    'position',
    'read_axis',
    'save_axis',
    'simulated_axis',
    'tune',
]

DUTY_MAX = 1.0 + 1e-6
"""Largest duty that is one, rounding included [-]."""

SPEED_MAX = 10.0
"""Speed of an axis that is likely [m/s]."""


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


def identify(
    duty: ArrayLike, position: ArrayLike, period: float, *, force: float | None = None
) -> AxisData:
    """Return the data of an axis from a recording, like `fuzzycnc machine identify`.

    Parameters
    ----------
    duty : array_like, shape (n,)
        Share of the full drive in force from each sample on, -1 to 1 [-]; a positive one drives
        to positive positions.
    position : array_like, shape (n,)
        Measured position [m].
    period : float
        Time between two samples [s].
    force : float, optional
        Force at full duty [N]; without it the mass is called 1 kg.

    Raises
    ------
    ValueError
        If a figure is out of its bounds, there are too few samples, or the axis does not follow
        its duty.

    Warns
    -----
    UserWarning
        If positions look like millimetres.
    """
    recording = AxisRecording(np.asarray(duty, float), np.asarray(position, float), period)
    largest = float(np.abs(recording.command).max(initial=0.0))
    if largest > DUTY_MAX:
        raise ValueError(
            f'duty: expected shares of the full drive, -1 to 1, but found {largest:g}; divide by '
            'what the full drive is, such as 100 of %'
        )
    if force is not None and not force > 0.0:
        raise ValueError(f'force: expected a number above 0 N but found {force:g} N')
    fastest = float(np.abs(np.diff(recording.position)).max(initial=0.0)) / period
    if fastest > SPEED_MAX:
        warnings.warn(
            f'position: expected metres, at most {SPEED_MAX:g} m/s, but found {fastest:.3g} m/s '
            'between two samples; divide by 1000 if they are in millimetres',
            stacklevel=2,
        )
    return identify_axis([recording], force=force).data


def tune(axis: AxisData, *, seed: int = 0, generations: int = 8, population: int = 6) -> AxisData:
    """Return an axis with the controller that suits it, like `fuzzycnc servo tune`.

    All of `AXIS_CONTROLLERS` are tuned with equal effort on simulated moves, and judged on
    others.  The default effort takes minutes.

    Parameters
    ----------
    axis : AxisData
        The axis; it must have a model.
    seed : int
        Seed of moves and search.
    generations, population : int
        Generations after the first population, and candidates per setting.

    Raises
    ------
    ValueError
        If the axis has no model, or a number is out of its bounds.
    """
    for argument, number, least in (
        ('seed', seed, 0), ('generations', generations, 1), ('population', population, 1),
    ):  # fmt: skip
        if number < least:
            raise ValueError(f'{argument}: expected {least} or more but found {number}')
    found = [
        tune_controller(axis, name, seed=seed, generations=generations, population=population)
        for name in AXIS_CONTROLLERS
    ]
    plain = untuned_controllers(axis, tuple(AXIS_CONTROLLERS), seed=seed)
    cases = axis_cases(axis, held_out=True, seed=seed)
    return AxisTuning((*found, *plain), cases).tuned(axis)


def save_axis(axis: AxisData, path: str | os.PathLike[str], name: str) -> None:
    """Write an axis as a machine file, for `read_axis`, commands and nodes.

    Parameters
    ----------
    axis : AxisData
        The axis.
    path : path
        File to write.
    name : str
        Letter of the axis.

    Raises
    ------
    OSError
        If the file cannot be written.
    ValueError
        If the name is none of an axis.

    Examples
    --------
    >>> from pathlib import Path
    >>> from tempfile import TemporaryDirectory
    >>> from fuzzycnc_ros import servo
    >>> axis = servo.read_axis('lathe', 'X')
    >>> with TemporaryDirectory() as folder:
    ...     servo.save_axis(axis, Path(folder) / 'mine.yaml', 'X')
    ...     again = servo.read_axis(Path(folder) / 'mine.yaml', 'X')
    >>> again.controller == axis.controller
    True
    """
    if not is_axis_name(name):
        raise ValueError(f'name: expected one such as X of letters and digits but found {name!r}')
    machine = MachineData(name=f'axis {name}', axes={name: axis})
    write_text(Path(path), machine_text(machine))


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

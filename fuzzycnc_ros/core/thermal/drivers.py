# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Heat sources that a model may read beside the temperatures: the spindle speed.

A bearing heats with the torque of its lubricant times its speed.  With a torque that grows with
the speed this is the square of the speed, which is what a model is given, in units of
(1000 rpm)^2, so that it extrapolates to speeds beyond those of its training as heat does.
"""

from collections.abc import Sequence
from math import pi

import numpy as np

from fuzzycnc_ros.core.arrays import Array
from fuzzycnc_ros.core.thermal.run import ThermalDataError, ThermalRun

SPINDLE_SPEED = 'spindle_speed'
"""Name of the driver that follows from the spindle speed."""

SPEED_UNIT = 2.0 * pi * 1000.0 / 60.0
"""Spindle speed whose square is the unit of the driver [rad/s]."""


def speed_drive(speed: Array) -> Array:
    """Return the driver [-] of spindle speeds [rad/s]: their square over that of 1000 rpm."""
    return np.asarray((speed / SPEED_UNIT) ** 2)


def driven_speed(drive: Array) -> Array:
    """Return the size of the spindle speeds [rad/s] of drivers [-], undoing `speed_drive`."""
    return np.asarray(SPEED_UNIT * np.sqrt(drive))


def speed_known(run: ThermalRun) -> bool:
    """Return whether a run has its spindle speed in every sample."""
    return run.spindle_speed is not None and bool(np.isfinite(run.spindle_speed).all())


def drivers_of(runs: Sequence[ThermalRun]) -> tuple[str, ...]:
    """Return the drivers that all runs have without a gap."""
    if not all(map(speed_known, runs)):
        return ()
    # A speed that never changes tells nothing that a constant would not.
    moving = any(float(np.ptp(run.spindle_speed)) > 0.0 for run in runs)  # type: ignore[arg-type]
    return (SPINDLE_SPEED,) if moving else ()


def drive_of(run: ThermalRun, drivers: Sequence[str]) -> Array:
    """Return the drivers of a run, shape (n, d).

    Raises
    ------
    ThermalDataError
        If the run lacks a driver or has gaps in it.
    """
    if not drivers:
        return np.empty((len(run.time), 0))
    if run.spindle_speed is None:
        raise ThermalDataError(
            f'run {run.name!r}: expected a spindle speed in every sample, since the model reads '
            'it, but found none; record machine_state or spindle_speed, or train without it'
        )
    lost = np.flatnonzero(~np.isfinite(run.spindle_speed))
    if len(lost):
        raise ThermalDataError(
            f'run {run.name!r}: expected a spindle speed in every sample, since the model reads '
            f'it, but found none at sample {lost[0]}; train without it'
        )
    return speed_drive(run.spindle_speed)[:, np.newaxis]

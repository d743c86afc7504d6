# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Friction of an axis with breakaway and Stribeck effect (method sheet 004 section 9)."""

from math import copysign, exp

import numpy as np

from fuzzycnc_ros.core.arrays import Array


def stribeck_friction(
    velocity: float, drive: float, coulomb: float, breakaway: float, stribeck_velocity: float
) -> float:
    """Return what friction takes from the drive, in the drive's unit.

    At rest friction balances any drive up to the breakaway value; in motion, or above it, it is
    (coulomb + (breakaway - coulomb) exp(-(v/vs)^2)) against the motion.

    Parameters
    ----------
    velocity : float
        Velocity v [m/s]; exactly 0 is rest.
    drive : float
        What drives the axis, load already taken off.
    coulomb, breakaway : float
        Friction in fast motion and at the onset of motion, in the drive's unit; not negative.
    stribeck_velocity : float
        Velocity vs over which friction falls from one to the other [m/s]; positive.

    Returns
    -------
    float
        Friction, to be subtracted from the drive; the drive itself while the axis sticks.

    Examples
    --------
    >>> stribeck_friction(0.0, -0.025, 0.02, 0.03, 2e-3)
    -0.025
    >>> stribeck_friction(0.0, 0.04, 0.02, 0.03, 2e-3)
    0.03
    >>> round(stribeck_friction(-2e-3, 0.0, 0.02, 0.03, 2e-3), 6)
    -0.023679
    """
    if velocity == 0.0:
        return drive if abs(drive) <= breakaway else copysign(breakaway, drive)
    ratio = velocity / stribeck_velocity
    return copysign(coulomb + (breakaway - coulomb) * exp(-ratio * ratio), velocity)


def stribeck_frictions(
    velocity: Array, drive: Array, coulomb: Array, breakaway: Array, stribeck_velocity: Array
) -> Array:
    """Return `stribeck_friction` of many axes at once; all arguments of shape (cases,)."""
    ratio = velocity / stribeck_velocity
    moving = np.copysign(coulomb + (breakaway - coulomb) * np.exp(-ratio * ratio), velocity)
    return np.where(velocity == 0.0, np.clip(drive, -breakaway, breakaway), moving)

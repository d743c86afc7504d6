# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""From the words of G2 and G3 to a centre and an angle."""

import math

from fuzzycnc_ros.core import portable
from fuzzycnc_ros.core.feedrate.gcode.segments import ProgramError

PLANES = {17: (0, 1, 2), 18: (2, 0, 1), 19: (1, 2, 0)}
"""First and second axis of a plane, and the axis across, by the number of its G word."""

_FULL = 2.0 * math.pi

# Programs carry three to four decimals of a millimetre or four of an inch: centre, start and end
# are rounded each.  Worst of the 9,000 arcs that the tests read: 0.9 um.
ABSOLUTE_MISFIT = 12.7e-6
"""Difference of both radii that rounding explains [m]."""

RELATIVE_MISFIT = 1e-3
"""Difference of both radii that LinuxCNC accepts, as a share of the larger one [-]."""

MISFIT_MILLIMETRE = 2.0 * 0.01e-3 * math.sqrt(2.0)
"""Difference of both radii that LinuxCNC accepts whatever the radius, in millimetres [m]."""

MISFIT_INCH = 2.0 * 0.001 * 25.4e-3 * math.sqrt(2.0)
"""The same in programs in inches [m]."""

MISFIT_MOST = 100.0
"""Difference of both radii that LinuxCNC refuses in any case, as a multiple of these [-]."""


POINT_ROUNDING = 1e-9
"""Points closer than this are one [m]: sums of relative moves are off by the last digits."""


TURNS_MAX = 1000
"""Largest number of turns of an arc."""


def fits(
    start: tuple[float, float],
    end: tuple[float, float],
    centre: tuple[float, float],
    misfit: float = MISFIT_MILLIMETRE,
) -> bool:
    """Return whether LinuxCNC takes two points [m] as equally far from a centre.

    Parameters
    ----------
    start, end, centre : tuple of float, length 2
        In the plane [m].
    misfit : float
        `MISFIT_MILLIMETRE` or `MISFIT_INCH`, as the unit of the program is [m].
    """
    first, last = math.dist(start, centre), math.dist(end, centre)
    off = abs(first - last)
    most = min(max(misfit, RELATIVE_MISFIT * max(first, last)), MISFIT_MOST * misfit)
    return first > 0.0 and off <= most


def centred(
    start: tuple[float, float],
    end: tuple[float, float],
    centre: tuple[float, float],
    clockwise: bool,
    extra_turns: int,
) -> float:
    """Return the angle of an arc that is given by its centre (I, J, K).

    Parameters
    ----------
    start, end, centre : tuple of float, length 2
        In the plane [m]; start and end alike make a full circle.
    clockwise : bool
        G2.
    extra_turns : int
        Full turns on top.

    Returns
    -------
    float
        Angle swept [rad], below 0 for G2.
    """
    if math.dist(start, end) < POINT_ROUNDING:
        sweep = _FULL
    else:
        turn = portable.arctan2(end[1] - centre[1], end[0] - centre[0]) - portable.arctan2(
            start[1] - centre[1], start[0] - centre[0]
        )
        sweep = (-turn if clockwise else turn) % _FULL
    sweep += _FULL * extra_turns
    return -sweep if clockwise else sweep


def by_radius(
    line: int,
    start: tuple[float, float],
    end: tuple[float, float],
    radius: float,
    clockwise: bool,
) -> tuple[tuple[float, float], float]:
    """Return centre and angle of an arc that is given by its radius (R, CR=).

    Parameters
    ----------
    line : int
        Number of the line, for errors.
    start, end : tuple of float, length 2
        In the plane [m].
    radius : float
        Radius [m]; below 0 for the arc of more than half a turn.
    clockwise : bool
        G2.

    Returns
    -------
    centre : tuple of float, length 2
        In the plane [m].
    sweep : float
        Angle swept [rad], below 0 for G2.

    Raises
    ------
    ProgramError
        If no circle of that radius runs through both points, or start and end are the same.
    """
    across = (end[0] - start[0], end[1] - start[1])
    half = 0.5 * math.hypot(*across)
    if 2.0 * half < POINT_ROUNDING:
        raise ProgramError(
            line,
            'expected an end other than the start of an arc with a radius but found the same '
            'point; give a full circle by its centre (I, J, K)',
        )
    rest = abs(radius) - half
    if rest < -max(ABSOLUTE_MISFIT, RELATIVE_MISFIT * half):
        raise ProgramError(
            line,
            f'expected a radius of at least {1e3 * half:.6g} mm, half of the way from start to '
            f'end, but found {1e3 * abs(radius):.6g} mm: the radius does not fit',
        )
    height = math.sqrt(max(0.0, (abs(radius) - half) * (abs(radius) + half)))
    # Of both centres the one to the right of the way belongs to the short way clockwise.
    side = height / (2.0 * half) * (-1.0 if clockwise == (radius > 0.0) else 1.0)
    centre = (
        0.5 * (start[0] + end[0]) - side * across[1],
        0.5 * (start[1] + end[1]) + side * across[0],
    )
    short = 2.0 * portable.arctan2(half, height)
    sweep = short if radius > 0.0 else _FULL - short
    return centre, -sweep if clockwise else sweep

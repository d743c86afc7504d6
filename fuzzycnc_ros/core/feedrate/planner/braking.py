# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The fastest way to rest along a path."""

from __future__ import annotations

import numpy as np

from fuzzycnc_ros.core.arrays import Array
from fuzzycnc_ros.core.feedrate.motion.axis_limits import acceleration_bands
from fuzzycnc_ros.core.feedrate.motion.pieces import Pieces
from fuzzycnc_ros.core.feedrate.motion.sweeps import Braking

REMAINDER_MIN = 1e-6
"""Pieces are not cut closer to their ends [m], where positions would not tell their bend."""

_GROUP = 64


def strongest_braking(
    pieces: Pieces, square: float, plan_place: Array, plan: Array, limits: Array
) -> Braking:
    """Return the fastest way to rest from the beginning of some pieces.

    It never goes faster than a plan, which leads to rest as well: where the limits leave no
    stronger braking than planned, the plan is what remains possible.

    Parameters
    ----------
    pieces : Pieces
        Pieces ahead, m or more than the plan leads along.
    square : float
        Squared speed at their beginning [m^2/s^2].
    plan_place, plan : array, shape (l,)
        Squared speeds planned, to rest at the last place [m, m^2/s^2].
    limits : array, shape (3, d + 1) or (m,)
        Limits as `MotionLimits.table` gives them, for motion that is averaged the largest change
        of speed in each piece [m/s^2].
    """
    place, found = [float(pieces.place[0])], [square]
    planned = np.interp(pieces.place, plan_place, plan, right=0.0)
    for begin in range(0, len(pieces), _GROUP):
        some = pieces.part(begin, min(begin + _GROUP, len(pieces)))
        length = some.length
        bands = acceleration_bands(some.geometry, limits) if limits.ndim == 2 else None
        for k in range(len(some)):
            if found[-1] <= 0.0:
                return Braking(np.array(place), np.array(found), plan_place, plan)
            if bands is None:
                least = found[-1] - 2.0 * float(limits[begin + k]) * float(length[k])
            else:
                least = float((-bands.width[k] - bands.slope[k] * found[-1]).max())
            share = 1.0 if least >= 0.0 else found[-1] / (found[-1] - least)
            if (1.0 - share) * length[k] < REMAINDER_MIN:
                share = 1.0
            place.append(
                float(some.place[k] + share * length[k])
                if share < 1.0
                else float(some.place[k + 1])
            )
            found.append(
                float(np.clip(least, 0.0, planned[begin + k + 1])) if share == 1.0 else 0.0
            )
    found[-1] = 0.0
    return Braking(np.array(place), np.array(found), plan_place, plan)

# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Coordinates of the places of a probing cycle from its touches, or why there are none."""

from dataclasses import dataclass
from math import copysign

import numpy as np
from numpy.typing import NDArray

from fuzzycnc_ros.core.probing.plan import ProbePlan

Floats = NDArray[np.float64]

AGREEING = 2 / 3
"""Share of the repeats of a side that have to agree: one of three may be a chip.

None may be deeper than those: a chip is always above the surface, so the others had one.
"""


@dataclass(frozen=True)
class CycleLimits:
    """Limits beyond which touches are not believed.

    Attributes
    ----------
    spread_max : float
        Distance from the median of its repeats up to which a touch counts [m].
    size_max : float
        Change of the distance of two sides beyond which something lies between [m].
    window : float
        Distance from where the surface is expected beyond which something else was touched [m].
    drift_max : float
        Largest thermal error that can be [m].
    noise : float
        Least standard deviation of one touch [m]: what a control resolves.
    """

    spread_max: float
    size_max: float
    window: float
    drift_max: float
    noise: float


@dataclass(frozen=True)
class Coordinates:
    """Coordinates of the places of a cycle, parallel to them.

    Attributes
    ----------
    coordinate, size, noise : ndarray, shape (p,)
        Coordinate, distance of its two sides (NaN where it has one), standard deviation [m]; NaN
        where a place is not believed.
    doubts : tuple of str
        Why, one text for each place that is not believed.
    """

    coordinate: Floats
    size: Floats
    noise: Floats
    doubts: tuple[str, ...]


def coordinates(
    plan: ProbePlan, measured: Floats, limits: CycleLimits, zero: 'Coordinates | None' = None
) -> Coordinates:
    """Return the coordinates of the places.

    Parameters
    ----------
    plan : ProbePlan
        The cycle.
    measured : ndarray, shape (touches,)
        Coordinate of each touch along its axis, offset in force included [m].
    limits : CycleLimits
        What is believed.
    zero : Coordinates, optional
        Coordinates at the thermal reference.
    """
    found = np.full((3, len(plan.places)), np.nan)
    doubts, at = [], 0
    for number, place in enumerate(plan.places):
        sides, variances, doubt = [], [], ''
        for touch in place.touches:
            values = measured[at : at + plan.repeats]
            at += plan.repeats
            deeper = copysign(1.0, touch.end - touch.surface) * (values - np.median(values))
            kept = values[np.abs(deeper) <= limits.spread_max]
            if len(kept) < AGREEING * len(values) or deeper.max() > limits.spread_max:
                doubt = doubt or (
                    f'touches differ by {1e6 * np.ptp(values):.1f} µm, more than spread_max '
                    f'{1e6 * limits.spread_max:g} µm: dirt, a loose stylus, or vibration'
                )
            side = float(np.mean(kept)) if len(kept) else np.nan
            if not abs(side - touch.surface) <= limits.window:
                doubt = doubt or (
                    f'touched at {1e3 * side:.3f} mm, expected within {1e3 * limits.window:g} mm '
                    f'of {1e3 * touch.surface:.3f} mm'
                )
            spread = float(np.std(kept, ddof=1)) if len(kept) > 1 else 0.0
            deviation = max(spread, limits.noise)
            variances.append(deviation * deviation / max(len(kept), 1))
            sides.append(side)
        apart = abs(sides[-1] - sides[0]) if len(sides) > 1 else np.nan
        middle = float(np.mean(sides))
        if zero is not None and not doubt:
            doubt = _change(middle - zero.coordinate[number], apart - zero.size[number], limits)
        if doubt:
            doubts.append(f'{place.name}, {place.axis}: {doubt}')
            continue
        found[:, number] = middle, apart, np.sqrt(sum(variances)) / len(sides)
    return Coordinates(found[0], found[1], found[2], tuple(doubts))


def _change(moved: float, grown: float, limits: CycleLimits) -> str:
    """Say why a change since the reference is not thermal; empty if it may be."""
    if abs(grown) > limits.size_max:
        return (
            f'its two sides are {1e6 * grown:+.1f} µm further apart than at the reference, more '
            f'than size_max {1e6 * limits.size_max:g} µm: a chip'
        )
    if abs(moved) > limits.drift_max:
        return (
            f'moved by {1e6 * moved:+.1f} µm since the reference, more than drift_max '
            f'{1e6 * limits.drift_max:g} µm'
        )
    return ''

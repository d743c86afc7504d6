# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Limits of motion and the backward-forward pass.

With w the squared speed and a the largest acceleration, w may rise and fall by 2 a ds along ds.
The fastest schedule below a desired one is then a cumulative minimum from either side, which
numpy takes in one sweep; no loop runs over points.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from fuzzycnc_ros.core.arrays import Array

_BLOCK = 4096
"""Points per sweep: sums start anew in each, so their rounding does not grow with the path."""


@dataclass(frozen=True, kw_only=True)
class MotionLimits:
    """Limits that a trajectory keeps at every moment.

    Those of the path bound the speed along it and the first two derivatives of that speed with
    respect to time.  Those of the axes, one number each, bound the derivatives of the positions.
    Infinite means no limit.

    Attributes
    ----------
    path_velocity, path_acceleration, path_jerk : float
        Limits along the path [m/s, m/s^2, m/s^3].
    velocity, acceleration, jerk : tuple of float or None
        Limits of the axes, in the order of the path's columns [m/s, m/s^2, m/s^3].

    Raises
    ------
    ValueError
        If a limit is not positive, or neither the path nor every axis has a limit of velocity
        and of acceleration.
    """

    path_velocity: float = np.inf
    path_acceleration: float = np.inf
    path_jerk: float = np.inf
    velocity: tuple[float, ...] | None = None
    acceleration: tuple[float, ...] | None = None
    jerk: tuple[float, ...] | None = None

    def __post_init__(self) -> None:
        for name, unit in (('velocity', 'm/s'), ('acceleration', 'm/s^2'), ('jerk', 'm/s^3')):
            path, axes = getattr(self, f'path_{name}'), getattr(self, name)
            for label, value in [(f'path_{name}', path)] + [(name, each) for each in axes or ()]:
                if not value > 0.0:
                    raise ValueError(
                        f'{label}: expected a positive limit [{unit}], but found {value}; '
                        'leave it out where there is none'
                    )
            if name != 'jerk' and not np.isfinite([path, *(axes or ())]).any():
                raise ValueError(f'expected a limit of {name} [{unit}], but found none')

    @property
    def limits_jerk(self) -> bool:
        """True if any jerk is limited."""
        return bool(np.isfinite([self.path_jerk, *(self.jerk or ())]).any())

    def table(self, axes: int) -> Array:
        """Return limits of velocity, acceleration and jerk: rows; the path and each axis: columns.

        Raises
        ------
        ValueError
            If a limit of the axes has another number of entries than the path has axes.
        """
        found = np.full((3, axes + 1), np.inf)
        for row, name in enumerate(('velocity', 'acceleration', 'jerk')):
            found[row, 0] = getattr(self, f'path_{name}')
            values = getattr(self, name)
            if values is not None:
                if len(values) != axes:
                    raise ValueError(
                        f'{name}: expected {axes} limits, one per axis, but found {len(values)}'
                    )
                found[row, 1:] = values
        return found


def reachable_speed(
    arc_length: ArrayLike,
    speed: ArrayLike,
    acceleration: ArrayLike,
    *,
    start: float = 0.0,
    end: float = 0.0,
    stop: ArrayLike | None = None,
) -> Array:
    """Return the fastest speeds below the desired ones that the acceleration can follow.

    Parameters
    ----------
    arc_length : array, shape (n,)
        Places, not falling [m].
    speed : array, shape (n,)
        Desired speeds, 0 or more [m/s]; lower values serve as given speeds of junctions.
    acceleration : float or array, shape (n - 1,)
        Largest change of speed along the path, for all or for each segment [m/s^2].
    start, end : float
        Speeds at the ends [m/s]; lower ones are taken where these cannot be had.
    stop : array of bool, shape (n,), optional
        Places of exact stops.

    Returns
    -------
    array, shape (n,)
        Speeds [m/s]; between two places the squared speed is linear.

    Raises
    ------
    ValueError
        If shapes differ, a value is not finite or negative, or arc length falls.
    """
    place, cap, rise = _checked_pass(arc_length, speed, acceleration, stop)
    for name, value in (('start', start), ('end', end)):
        if not 0.0 <= value < np.inf:
            raise ValueError(f'{name}: expected a speed of 0 m/s or more, but found {value}')
    if len(place) == 0:
        return cap
    cap[0] = min(cap[0], start * start)
    cap[-1] = min(cap[-1], end * end)
    return np.sqrt(sweep(sweep(cap[::-1], rise[::-1])[::-1], rise))


def _checked_pass(
    arc_length: ArrayLike,
    speed: ArrayLike,
    acceleration: ArrayLike,
    stop: ArrayLike | None,
) -> tuple[Array, Array, Array]:
    """Return places, squared speeds and largest rises of the squared speed per segment."""
    place, wanted = np.asarray(arc_length, dtype=float), np.asarray(speed, dtype=float)
    most = np.asarray(acceleration, dtype=float)
    n = len(place) if place.ndim == 1 else -1
    if n < 0 or wanted.shape != (n,) or most.shape not in ((), (max(n - 1, 0),)):
        raise ValueError(
            'expected arc_length and speed of shape (n,) and acceleration a number or of shape '
            f'(n - 1,), but found {place.shape}, {wanted.shape} and {most.shape}'
        )
    step = np.diff(place)
    for name, values, low in (
        ('arc_length', place, -np.inf),
        ('steps of arc_length', step, 0.0),
        ('speed', wanted, 0.0),
        ('acceleration', np.atleast_1d(most), np.nextafter(0.0, 1.0)),
    ):
        good = (values >= low) & (values < np.inf)
        if not good.all():
            at = int(np.argmin(good))
            raise ValueError(
                f'{name}: expected finite numbers of {max(low, 0.0):.0f} or more, but found '
                f'{values[at]} at {at}'
            )
    cap = wanted * wanted
    if stop is not None:
        cap[np.asarray(stop, dtype=bool)] = 0.0
    return place, cap, 2.0 * most * step


def sweep(cap: Array, rise: Array) -> Array:
    """Return the largest w <= cap with w[i + 1] <= w[i] + rise[i]; shapes (n,) and (n - 1,).

    Each block is swept alone; what the block before hands over is then one more minimum.
    """
    blocks = -(-len(cap) // _BLOCK)
    size = blocks * _BLOCK
    rises = np.zeros(size)
    rises[1 : len(cap)] = rise
    total = rises.reshape(blocks, _BLOCK)
    entry = total[:, 0].copy()  # the rise into each block
    total[:, 0] = 0.0
    np.cumsum(total, axis=1, out=total)
    caps = np.full(size, np.inf)
    caps[: len(cap)] = cap
    found = caps.reshape(blocks, _BLOCK)
    found -= total
    np.minimum.accumulate(found, axis=1, out=found)
    given = np.inf
    for row in range(blocks):
        np.minimum(found[row], given + entry[row], out=found[row])
        given = found[row, -1] + total[row, -1]
    found += total
    return np.asarray(np.minimum(found.reshape(-1)[: len(cap)], cap))

# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The simulated soft sheet that the foot of a quilting machine drags along while it stitches."""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import hypot, isfinite, pi, radians

import numpy as np
from numpy.typing import ArrayLike

from fuzzycnc_ros.core import portable
from fuzzycnc_ros.core.arrays import Array

FOOT_RADIUS = 5e-3
"""Radius of the presser foot [m]."""

_DEPTH_RATIO_MAX = 0.8
"""Feed depth over thickness at which the foot goes through the sheet [-]."""

ELASTIC_MEMORY = 2e-3
"""Way over which the elastic drag follows the foot [m]."""

RELAXATION_LENGTH = 60e-3
"""Way over which edge tension takes the locked drift back [m]."""

_LOCKED, _PROMPT = 0.196, 0.13  # share of the elastic drag locked by a stitch; felt by it at once
_ANISOTROPY, _SOFT_AXIS = 0.45, radians(-40.0)
_ARC_TWIST = radians(12.0)  # by which a left turn twists the drag against the feed
_MODULUS_SCATTER, _FRICTION_SCATTER, STITCH_NOISE = 0.03, 0.05, 3e-5
"""Standard deviations over runs of the logarithms of modulus and friction, and of a stitch [m]."""


@dataclass(frozen=True)
class FoamSheet:
    """A sheet of foam clamped on all four edges, lower left corner at the origin.

    Parameters
    ----------
    thickness : float
        Thickness h [m]; positive.
    size : tuple of float
        Lengths along X and Y [m]; positive.
    young_modulus : float
        Modulus E [Pa]; positive.
    poisson_ratio : float
        Ratio nu [-]; from 0 to less than 0.5.
    friction : float
        Coefficient mu between foot and sheet [-]; not negative.

    Raises
    ------
    ValueError
        If a figure is out of its range.

    Notes
    -----
    The model is a made-up one and no measured foam.  The modulus cancels out of the drag:
    a stiffer sheet presses harder and gives less.

    Examples
    --------
    The first check value, 6 mm deep in a sheet of 15 mm:

    >>> sheet = FoamSheet(15e-3)
    >>> f'{sheet.normal_force(6e-3):.4f} N'
    '17.5921 N'
    >>> (1e3 * sheet.compliance([0.1, 0.06], 6e-3)).round(6).tolist()
    [[0.372368, -0.15306], [-0.15306, 0.318391]]
    """

    thickness: float
    size: tuple[float, float] = (0.2, 0.12)
    young_modulus: float = 365.2e3
    poisson_ratio: float = 0.25
    friction: float = 0.35

    def __post_init__(self) -> None:
        lengths = {'thickness': self.thickness, 'size X': self.size[0], 'size Y': self.size[1]}
        for name, value in lengths.items():
            if not (isfinite(value) and value > 0.0):
                raise ValueError(f'{name}: expected more than 0 mm but found {1e3 * value} mm')
        if not (isfinite(self.young_modulus) and self.young_modulus > 0.0):
            raise ValueError(
                f'young_modulus: expected more than 0 MPa but found {1e-6 * self.young_modulus}'
            )
        if not 0.0 <= self.poisson_ratio < 0.5:
            raise ValueError(
                f'poisson_ratio: expected 0 to less than 0.5 but found {self.poisson_ratio}'
            )
        if not (isfinite(self.friction) and self.friction >= 0.0):
            raise ValueError(f'friction: expected 0 or more but found {self.friction}')

    def scattered(self, rng: np.random.Generator) -> FoamSheet:
        """Return the sheet of one run: modulus, then friction, drawn around their means."""
        return replace(
            self,
            young_modulus=self.young_modulus * portable.exp(rng.normal(0.0, _MODULUS_SCATTER)),
            friction=self.friction * portable.exp(rng.normal(0.0, _FRICTION_SCATTER)),
        )

    def normal_force(self, depth: float) -> float:
        """Return the force of the foot N = pi a^2 E eps (1 + 2 eps^2 / (1 - eps)) [N].

        Parameters
        ----------
        depth : float
            How far the foot goes in [m]; above 0, cut at 0.8 of the thickness.

        Raises
        ------
        ValueError
            If the depth is not positive.
        """
        strain = self._strain(depth)
        stiffening = 1.0 + 2.0 * strain * strain / (1.0 - strain)
        return pi * (FOOT_RADIUS * FOOT_RADIUS) * self.young_modulus * strain * stiffening

    def compliance(self, point: ArrayLike, depth: float) -> Array:
        """Return displacement of the sheet under the foot per force on it, shape (2, 2) [m/N].

        Parameters
        ----------
        point : array_like, shape (2,)
            Place of the foot [m]; beyond an edge it counts as on it.
        depth : float
            How far the foot goes in [m]; above 0, cut at 0.8 of the thickness.

        Raises
        ------
        ValueError
            If the depth is not positive.
        """
        x, y = np.asarray(point, float)
        edge = max(min(x, y, self.size[0] - x, self.size[1] - y), 0.0)
        shear = 0.5 * self.young_modulus / (1.0 + self.poisson_ratio)
        pressed = self.thickness * (1.0 - self._strain(depth))
        reach = FOOT_RADIUS + 0.5 * pressed
        mean = (3.0 - self.poisson_ratio) * portable.log(1.0 + edge / FOOT_RADIUS) / (
            8.0 * pi * shear * self.thickness
        ) + pressed / (shear * pi * reach * reach)
        return mean * _ANISOTROPIC

    def stitch(
        self,
        commanded: ArrayLike,
        depth: ArrayLike,
        turn: ArrayLike = 0,
        rng: np.random.Generator | None = None,
    ) -> Array:
        """Return where the stitches of a path lie once the sheet has relaxed.

        Parameters
        ----------
        commanded : array_like, shape (n + 1, 2)
            Commanded points [m].
        depth : array_like, shape () or (n,)
            Feed depth of each step [m]; positive.
        turn : array_like, shape () or (n,)
            1 on an arc that turns left, -1 to the right, 0 on a line.
        rng : Generator, optional
            Draws the noise of the stitches, point by point; none without it.

        Returns
        -------
        ndarray, shape (n + 1, 2)
            Stitched points [m].

        Raises
        ------
        ValueError
            If a point is not finite or a depth not positive.
        """
        points = np.asarray(commanded, float)
        steps = max(len(points) - 1, 0)
        depths, turns = np.broadcast_to(depth, steps), np.broadcast_to(turn, steps)
        stitching = FoamStitching(self, points[0], rng)
        course = [stitching.stitched]
        course += [stitching.step(*step) for step in zip(points[1:], depths, turns, strict=True)]
        return np.array(course)

    def _strain(self, depth: float) -> float:
        if not (isfinite(depth) and depth > 0.0):
            raise ValueError(f'depth: expected more than 0 mm but found {1e3 * depth} mm')
        return min(depth / self.thickness, _DEPTH_RATIO_MAX)


class FoamStitching:
    """A run on a sheet, stitch by stitch: drag e, locked drift w, and what comes of them.

    Parameters
    ----------
    sheet : FoamSheet
        Sheet of this run, see `FoamSheet.scattered`.
    start : array_like, shape (2,)
        First point [m], stitched as commanded.
    rng : Generator, optional
        Draws the noise of the stitches, point by point; none without it.

    Attributes
    ----------
    stitched : ndarray, shape (2,)
        Last stitch [m].

    Raises
    ------
    ValueError
        If the start is not finite.
    """

    def __init__(
        self, sheet: FoamSheet, start: ArrayLike, rng: np.random.Generator | None = None
    ) -> None:
        self._sheet, self._rng = sheet, rng
        self._commanded = _finite_point(start)
        self._elastic, self._locked = np.zeros(2), np.zeros(2)
        self.stitched = self._observed(self._commanded)

    def step(self, point: ArrayLike, depth: float, turn: int = 0) -> Array:
        """Feed to the next point and stitch.

        Parameters
        ----------
        point : array_like, shape (2,)
            Commanded point [m]; the last one again stitches once more in the same place.
        depth : float
            Feed depth [m]; positive.
        turn : int
            1 on an arc that turns left, -1 to the right, 0 on a line.

        Returns
        -------
        ndarray, shape (2,)
            The stitch [m].

        Raises
        ------
        ValueError
            If the point is not finite or the depth not positive.  The state is unchanged.
        """
        target = _finite_point(point)
        feed_x, feed_y = target - self._commanded
        length = hypot(feed_x, feed_y)
        drag = self._sheet.friction * self._sheet.normal_force(depth)
        compliance = self._sheet.compliance(target, depth)
        if length > 0.0:
            twist = _ARC_TWIST * turn
            along = np.array(
                [
                    portable.cos(twist) * feed_x - portable.sin(twist) * feed_y,
                    portable.sin(twist) * feed_x + portable.cos(twist) * feed_y,
                ]
            )
            memory = portable.exp(-length / ELASTIC_MEMORY)
            pull = portable.matmul(compliance, drag / length * along)
            self._elastic = memory * self._elastic + (1.0 - memory) * pull
        self._locked = (
            portable.exp(-length / RELAXATION_LENGTH) * self._locked + _LOCKED * self._elastic
        )
        self._commanded = target
        self.stitched = self._observed(target - self._locked - _PROMPT * self._elastic)
        return self.stitched

    def _observed(self, point: Array) -> Array:
        if self._rng is None:
            return point
        return point + self._rng.normal(0.0, STITCH_NOISE, 2)


def _finite_point(point: ArrayLike) -> Array:
    found = np.array(point, float)
    if found.shape != (2,) or not np.isfinite(found).all():
        raise ValueError(f'point: expected two finite coordinates [m] but found {point!r}')
    return found


def _anisotropic() -> Array:
    """Return Rot(th0) diag(1 + 0.45, 1 - 0.45) Rot(th0)^T."""
    c, s = portable.cos(_SOFT_AXIS), portable.sin(_SOFT_AXIS)
    rotation = np.array([[c, -s], [s, c]])
    stretch = np.diag([1.0 + _ANISOTROPY, 1.0 - _ANISOTROPY])
    return np.asarray(portable.matmul(portable.matmul(rotation, stretch), rotation.T))


_ANISOTROPIC = _anisotropic()

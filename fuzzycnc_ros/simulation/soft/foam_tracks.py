# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Closed test tracks on the simulated sheet and how well they were stitched."""

from __future__ import annotations

from dataclasses import dataclass
from math import degrees, hypot, isfinite, pi
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from fuzzycnc_ros.core import portable
from fuzzycnc_ros.core.arrays import Array

FEEDRATE = 240.0 / (4 * 2.86) * 1e-3
"""Feed [m/s] at which the test track takes the published 2.86 s a side."""


@dataclass(frozen=True, eq=False)
class FoamTrack:
    """A parallelogram of stitches, anticlockwise from its lower left corner back to it.

    Attributes
    ----------
    points : ndarray, shape (n + 1, 2)
        Nominal stitches [m].
    corners : tuple of int
        Indices of the five corners, the first and the last of which are the same point.
    angle : float
        Nominal interior angle at the first corner [rad].
    """

    points: Array
    corners: tuple[int, ...]
    angle: float

    @classmethod
    def parallelogram(
        cls,
        angle: float,
        base: float = 70e-3,
        side: float = 50e-3,
        *,
        centre: tuple[float, float] = (75e-3, 50e-3),
        step: float = 3e-3,
    ) -> FoamTrack:
        """Return a parallelogram with a horizontal base.

        Parameters
        ----------
        angle : float
            Interior angle at the first corner [rad]; between 0 and pi.
        base, side : float
            Lengths of the sides [m]; at least a step each.
        centre : tuple of float
            Where its centre lies [m]; as it stands, that of a sheet of 150x100 mm.
        step : float
            Nominal step [m]; a side is divided into the nearest whole number of equal steps.

        Raises
        ------
        ValueError
            If a figure is out of its range.

        Examples
        --------
        The test track, a parallelogram like that of [deng2014]:

        >>> track = FoamTrack.parallelogram(np.radians(45.0))
        >>> track.corners
        (0, 23, 40, 63, 80)
        >>> (1e3 * track.points[[0, 23, 40, 63]]).round(3).tolist()
        [[22.322, 32.322], [92.322, 32.322], [127.678, 67.678], [57.678, 67.678]]
        """
        if not 0.0 < angle < pi:
            raise ValueError(
                f'angle: expected more than 0 and less than 180 deg but found {degrees(angle)} deg'
            )
        if not (isfinite(step) and step > 0.0):
            raise ValueError(f'step: expected more than 0 mm but found {1e3 * step} mm')
        for name, length in (('base', base), ('side', side)):
            if not (isfinite(length) and length >= step):
                raise ValueError(
                    f'{name}: expected at least the step of {1e3 * step:g} mm but found '
                    f'{1e3 * length} mm'
                )
        if not np.isfinite(centre).all():
            raise ValueError(f'centre: expected finite coordinates [m] but found {centre}')
        rise = side * portable.sin(angle)
        along, up = np.array([base, 0.0]), np.array([rise / portable.tan(angle), rise])
        corner = np.asarray(centre) - 0.5 * (along + up)
        points, corners = [corner], [0]
        for edge, length in ((along, base), (up, side), (-along, base), (-up, side)):
            count = round(length / step)
            share = np.arange(1, count + 1) / count
            points.extend(corner + share[:, None] * edge)
            corner = corner + edge
            corners.append(corners[-1] + count)
        return cls(np.array(points), tuple(corners), angle)

    def measure(
        self, stitched: ArrayLike, commanded: ArrayLike | None = None, feedrate: float = FEEDRATE
    ) -> TrackQuality:
        """Return how well the track was stitched.

        Parameters
        ----------
        stitched : array_like, shape (n + 1, 2)
            Stitched points [m], parallel to `points`.
        commanded : array_like, shape (n + 1, 2), optional
            Commanded points [m] that the machine went through; the nominal ones if left out.
        feedrate : float
            Constant feed along the commanded path [m/s]; positive.

        Raises
        ------
        ValueError
            If the shapes differ, a point is not finite or the feed not positive.
        """
        stitched = self._parallel('stitched', stitched)
        commanded = self._parallel('commanded', self.points if commanded is None else commanded)
        if not (isfinite(feedrate) and feedrate > 0.0):
            raise ValueError(f'feedrate: expected more than 0 m/s but found {feedrate} m/s')
        sides = len(self.corners) - 1
        directions, spreads = np.empty((sides, 2)), np.empty(sides)
        for index, (first, last) in enumerate(
            zip(self.corners[:-1], self.corners[1:], strict=True)
        ):
            side = stitched[first : last + 1]
            directions[index], spreads[index] = _line_through(side)
        errors = [
            abs(_angle_between(-directions[index - 1], directions[index]) - nominal)
            for index, nominal in enumerate((self.angle, pi - self.angle) * 2)
        ]
        deviation = np.hypot(*(stitched - self.points).T)
        length = np.hypot(*np.diff(commanded, axis=0).T).sum()
        return TrackQuality(
            angle_error=float(np.mean(errors)),
            straightness=float(spreads.mean()),
            rms_deviation=float(np.sqrt(np.mean(deviation**2))),
            max_deviation=float(deviation.max()),
            closure_gap=hypot(*(stitched[-1] - stitched[0])),
            time=float(length / feedrate / sides),
        )

    def _parallel(self, name: str, points: ArrayLike) -> Array:
        found = np.asarray(points, float)
        if found.shape != self.points.shape or not np.isfinite(found).all():
            raise ValueError(
                f'{name}: expected finite points parallel to the track, shape '
                f'{self.points.shape}, but found shape {found.shape}'
            )
        return found


class TrackQuality(NamedTuple):
    """Quality of a stitched track.

    Attributes
    ----------
    angle_error : float
        Mean deviation of the interior angles between the lines fitted to the sides [rad].
    straightness : float
        Peak-to-peak spread of a side across its line, both corners included, mean of the
        sides [m].
    rms_deviation, max_deviation : float
        Distance of the stitches from their nominal places [m].
    closure_gap : float
        Distance between the first stitch and the last [m].
    time : float
        Mean time of a side at constant feed [s].
    """

    angle_error: float
    straightness: float
    rms_deviation: float
    max_deviation: float
    closure_gap: float
    time: float


def _line_through(points: Array) -> tuple[Array, float]:
    """Return direction of the total-least-squares line, in the order of points, and spread."""
    centred = points - points.mean(axis=0)
    _, _, axes = np.linalg.svd(centred, full_matrices=False)
    along = axes[0] if portable.matmul(points[-1] - points[0], axes[0]) >= 0.0 else -axes[0]
    return along, float(np.ptp(portable.matmul(centred, axes[1])))


def _angle_between(first: Array, second: Array) -> float:
    cross = first[0] * second[1] - first[1] * second[0]
    return float(portable.arctan2(abs(cross), portable.matmul(first, second)))

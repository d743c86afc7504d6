# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Input of stitching: the sheet, primitives of a pattern, and their stitches."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from math import degrees, hypot, isfinite

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fuzzycnc_ros.core import portable
from fuzzycnc_ros.core.arrays import Array
from fuzzycnc_ros.core.deformation.features import DEPTH_RATIO_MAX

ARC, LINE = 1, 2
"""Types of primitives, as the models know them."""

_JOIN_TOLERANCE = 1e-6


@dataclass(frozen=True)
class SheetMaterial:
    """The sheet, as far as it is known before it is stitched.

    Parameters
    ----------
    thickness : float
        Thickness [m]; positive.
    size : tuple of float, optional
        Lengths of the clamped area along X and Y from the origin [m]; positive.
    name : str
        What the material is called.

    Raises
    ------
    ValueError
        If a length is not positive.
    """

    thickness: float
    size: tuple[float, float] | None = None
    name: str = ''

    def __post_init__(self) -> None:
        _check_positive('thickness', self.thickness)
        for axis, length in zip('XY', self.size or (), strict=False):
            _check_positive(f'size {axis}', length)

    def check(self, path: StitchPath) -> None:
        """Refuse a path that this sheet cannot take.

        Raises
        ------
        ValueError
            If the foot goes through the sheet or a nominal point lies outside of it.
        """
        # in millimetres, so that rounding draws the line where the models draw it
        deep = (path.depth / 1e-3) / (self.thickness / 1e-3) > DEPTH_RATIO_MAX
        if deep.any():
            step = int(deep.argmax())
            raise ValueError(
                f'depth: expected at most {DEPTH_RATIO_MAX:g} of the thickness of '
                f'{1e3 * self.thickness:g} mm but found {1e3 * path.depth[step]:g} mm in step '
                f'{step}: the foot would go through the sheet'
            )
        self.check_points(path.points)

    def check_points(self, points: Array, slack: float = 0.0) -> None:
        """Refuse points, shape (k, 2) [m], that lie outside by more than a slack [m].

        Raises
        ------
        ValueError
            If one does; where the size is not known, none does.
        """
        if self.size is None:
            return
        outside = ((points < -slack) | (points > np.add(self.size, slack))).any(axis=1)
        if outside.any():
            index = int(outside.argmax())
            raise ValueError(
                f'points: expected all within the clamped area of {1e3 * self.size[0]:g} x '
                f'{1e3 * self.size[1]:g} mm but found '
                f'{(1e3 * points[index]).round(3).tolist()} mm at index {index}'
            )


class StitchPath:
    """Stitches of a pattern and the process values of the steps between them.

    Parameters
    ----------
    points : array_like, shape (n + 1, 2)
        Points in the order of stitching [m]; a point given twice is no step.
    kind : array_like of int, shape () or (n,)
        Type of the primitive of each step: 1 arc, 2 line.
    depth : array_like, shape () or (n,)
        Feed depth [m]; positive.
    step : array_like, shape () or (n,)
        Nominal stitch step of the primitive [m]; positive.
    turn : array_like, shape () or (n,)
        1 where an arc turns left, -1 right; counts on arcs only.

    Attributes
    ----------
    points, kind, depth, step, turn : ndarray
        As given, one entry per point or step.
    lengths : ndarray, shape (n,)
        Lengths of the steps [m].

    Raises
    ------
    ValueError
        If a figure is not finite or out of its range, or an array of another length.
    """

    def __init__(
        self,
        points: ArrayLike,
        kind: ArrayLike = LINE,
        *,
        depth: ArrayLike,
        step: ArrayLike,
        turn: ArrayLike = 1,
    ) -> None:
        self.points = np.array(points, float)
        if self.points.ndim != 2 or self.points.shape[1] != 2 or len(self.points) < 2:
            raise ValueError(
                f'points: expected two or more points, shape (n + 1, 2), but found shape '
                f'{self.points.shape}'
            )
        bad = ~np.isfinite(self.points).all(axis=1)
        if bad.any():
            index = int(bad.argmax())
            raise ValueError(
                f'points: expected finite coordinates [m] but found '
                f'{self.points[index].tolist()} at index {index}'
            )
        self.kind = self._per_step('kind', kind)
        self.turn = self._per_step('turn', turn)
        self.depth, self.step = self._per_step('depth', depth), self._per_step('step', step)
        self._refuse('kind', ~np.isin(self.kind, (ARC, LINE)), '1 (arc) or 2 (line)')
        self._refuse('turn', ~np.isin(self.turn, (-1, 0, 1)), '1 (left) or -1 (right)')
        for name in ('depth', 'step'):
            values = getattr(self, name)
            good = np.isfinite(values) & (values > 0.0)
            self._refuse(name, ~good, 'more than 0 m')
        self.lengths = np.hypot(*np.diff(self.points, axis=0).T)

    @classmethod
    def of_primitives(cls, primitives: Iterable[Primitive]) -> StitchPath:
        """Return the stitches of primitives in a row.

        Raises
        ------
        ValueError
            If there is none, or one does not begin where the last ends.

        Examples
        --------
        >>> corner = [Primitive((0.0, 0.0), (0.01, 0.0), 6e-3, 3e-3)]
        >>> corner += [Primitive((0.01, 0.0), (0.02, 0.01), 6e-3, 3e-3, (0.01, 0.01), np.pi / 2)]
        >>> path = StitchPath.of_primitives(corner)
        >>> path.kind.astype(int).tolist()
        [2, 2, 2, 1, 1, 1, 1, 1]
        >>> (1e3 * path.lengths).round(2).tolist()
        [3.33, 3.33, 3.33, 3.13, 3.13, 3.13, 3.13, 3.13]
        """
        row = list(primitives)
        if not row:
            raise ValueError('primitives: expected one or more but found none')
        points = [np.asarray(row[0].start, float)[None]]
        for index, primitive in enumerate(row):
            gap = hypot(*(primitive.start - points[-1][-1]))
            if gap > _JOIN_TOLERANCE:
                raise ValueError(
                    f'primitives: expected number {index} to begin where the last ends but '
                    f'found a gap of {1e3 * gap:.3f} mm'
                )
            points.append(primitive.stitches())
        counts = [len(stitches) for stitches in points[1:]]

        def per_step(values: list[float]) -> Array:
            return np.repeat(values, counts)

        return cls(
            np.concatenate(points),
            per_step([LINE if p.centre is None else ARC for p in row]),
            depth=per_step([p.depth for p in row]),
            step=per_step([p.step for p in row]),
            turn=per_step([np.sign(p.turn) for p in row]),
        )

    def moved(self, offset: Array) -> StitchPath:
        """Return the path with `offset` [m], shape (n + 1, 2), added to its points."""
        return StitchPath(
            self.points + offset, self.kind, depth=self.depth, step=self.step, turn=self.turn
        )

    def _per_step(self, name: str, values: ArrayLike) -> Array:
        found, steps = np.asarray(values, float), len(self.points) - 1
        if found.shape not in {(), (steps,)}:
            raise ValueError(
                f'{name}: expected one value or one for each of the {steps} steps but found '
                f'shape {found.shape}'
            )
        return np.broadcast_to(found, steps)

    def _refuse(self, name: str, bad: NDArray[np.bool_], expected: str) -> None:
        if bad.any():
            step = int(bad.argmax())
            found = getattr(self, name)[step]
            raise ValueError(f'{name}: expected {expected} but found {found:g} in step {step}')


@dataclass(frozen=True)
class Primitive:
    """A line or an arc of a pattern, stitched in equal steps.

    Parameters
    ----------
    start, end : tuple of float
        Where it begins and ends [m].
    depth : float
        Feed depth [m]; positive.
    step : float
        Nominal stitch step [m]; positive, at most the length of the primitive.
    centre : tuple of float, optional
        Centre of an arc [m]; a line without it.
    turn : float
        Angle by which an arc turns [rad], positive to the left.

    Raises
    ------
    ValueError
        If a figure is not finite or out of its range, or start and end do not lie on one arc.
    """

    start: tuple[float, float]
    end: tuple[float, float]
    depth: float
    step: float
    centre: tuple[float, float] | None = None
    turn: float = 0.0

    def __post_init__(self) -> None:
        places = [*self.start, *self.end, *(self.centre or ()), self.turn]
        if not np.isfinite(places).all():
            raise ValueError(f'primitive: expected finite figures but found {places}')
        _check_positive('depth', self.depth)
        _check_positive('step', self.step)
        if self.centre is not None:
            self._check_arc()
        if self.step > self.length * (1.0 + 1e-9):
            raise ValueError(
                f'step: expected at most the length of the primitive of {1e3 * self.length:g} mm '
                f'but found {1e3 * self.step:g} mm'
            )

    @property
    def length(self) -> float:
        """Length along the primitive [m]."""
        if self.centre is None:
            return hypot(self.end[0] - self.start[0], self.end[1] - self.start[1])
        return abs(self.turn) * self._radius

    def stitches(self) -> Array:
        """Return the points after the start, shape (steps, 2) [m]."""
        # Half a step stays half a step in every direction: 50 mm at 4 mm are 12 steps, never 13.
        count = max(round(round(self.length / self.step, 9)), 1)
        share = np.arange(1, count + 1)[:, None] / count
        start, end = np.asarray(self.start), np.asarray(self.end)
        if self.centre is None:
            return np.asarray(start + share * (end - start))
        arm = start - self.centre
        sine, cosine = portable.sin_cos(share * self.turn)
        points = self.centre + cosine * arm + sine * np.array([-arm[1], arm[0]])
        points[-1] = end
        return np.asarray(points)

    @property
    def _radius(self) -> float:
        assert self.centre is not None
        return hypot(self.start[0] - self.centre[0], self.start[1] - self.centre[1])

    def _check_arc(self) -> None:
        if not (self._radius > 0.0 and self.turn != 0.0):
            raise ValueError(
                f'arc: expected a radius and a turn other than 0 but found '
                f'{1e3 * self._radius:g} mm and {degrees(self.turn):g} deg'
            )
        turned = complex(portable.cos(self.turn), portable.sin(self.turn))
        arm = complex(*self.start) - complex(*self.centre)  # type: ignore[misc]
        reached = complex(*self.centre) + arm * turned  # type: ignore[misc]
        gap = abs(reached - complex(*self.end))
        if gap > _JOIN_TOLERANCE:
            raise ValueError(
                f'arc: expected its turn of {degrees(self.turn):g} deg to lead to its end but '
                f'found a gap of {1e3 * gap:.3f} mm'
            )


def _check_positive(name: str, length: float) -> None:
    if not (isfinite(length) and length > 0.0):
        raise ValueError(f'{name}: expected more than 0 mm but found {1e3 * length:g} mm')

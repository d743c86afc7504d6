# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Random paths and what a trajectory makes of its limits, for tests of feedrates."""

import numpy as np
from paths.path_parts import joined_path, straight_lines
from scipy.interpolate import BSpline, make_interp_spline

from fuzzycnc_ros.core.feedrate.motion.limits import MotionLimits
from fuzzycnc_ros.core.feedrate.motion.trajectory import PathMotion
from fuzzycnc_ros.core.feedrate.path.path_geometry import PathGeometry

KINDS = ('spline', 'polyline', 'reversals', 'arcs', 'arcs and corner')


def sampled(curve: BSpline, parameter: np.ndarray) -> PathGeometry:
    """Return the path through samples of a spline, with its exact derivatives."""
    first, second = curve.derivative(1)(parameter), curve.derivative(2)(parameter)
    square = (first**2).sum(axis=1, keepdims=True)
    along = (first * second).sum(axis=1, keepdims=True)
    return PathGeometry.from_samples(
        curve(parameter), first, second / square - first * along / square**2
    )


def quintic(rng: np.random.Generator, axes: int) -> BSpline:
    """Return a spline of degree 5 through random points some 20 mm apart, over 0..1."""
    count = int(rng.integers(6, 9))
    points = np.cumsum(0.02 * rng.normal(size=(count, axes)), axis=0)
    return make_interp_spline(np.linspace(0.0, 1.0, count), points, k=5)


def arc(radius: float, turn: float, axes: int, samples: int) -> PathGeometry:
    """Return an arc around the origin from the first axis, in the plane of the first two."""
    angle = np.linspace(0.0, turn, samples)
    outward = np.zeros((samples, axes))
    outward[:, 0], outward[:, 1] = np.cos(angle), np.sin(angle)
    tangent = np.zeros((samples, axes))
    tangent[:, 0], tangent[:, 1] = -np.sin(angle), np.cos(angle)
    return PathGeometry.from_samples(radius * outward, tangent, -outward / radius, radius * angle)


def line_arc_line(rng: np.random.Generator, axes: int) -> list[PathGeometry]:
    """Return a line, the arc it runs into, and the line that leaves the arc."""
    middle = arc(10.0 ** rng.uniform(-3.0, -1.3), rng.uniform(0.3, 6.0), axes, 60)
    ends = []
    for k in (0, -1):
        at = middle.coefficient[k, 5 * -k]
        other = middle.coefficient[k, 1 + 3 * -k]
        away = (at - other) / np.linalg.norm(at - other) * rng.uniform(0.001, 0.1)
        ends.append(straight_lines([at + away, at] if k == 0 else [at, at + away]))
    return [ends[0], middle, ends[1]]


def random_path(rng: np.random.Generator, kind: str, axes: int) -> PathGeometry:
    """Return a path of one of `KINDS`."""
    if kind == 'spline':
        return sampled(quintic(rng, axes), np.linspace(0.0, 1.0, int(rng.integers(20, 200))))
    if kind == 'polyline':
        steps = rng.normal(size=(int(rng.integers(2, 12)), axes)) * 10.0 ** rng.uniform(-4, -1.5)
        return straight_lines(np.cumsum(steps, axis=0))
    if kind == 'reversals':
        points = np.outer([0.0, 0.05, 0.02, 0.03, -0.04, 0.1], rng.normal(size=axes))
        return straight_lines(points * 10.0 ** rng.uniform(-1.0, 0.0) + 5.0)
    parts = line_arc_line(rng, axes)
    if kind == 'arcs':
        return joined_path(parts)
    corner = parts[-1].coefficient[-1, -1]
    return joined_path([*parts, straight_lines([corner, corner + 0.02 * rng.normal(size=axes)])])


def random_limits(rng: np.random.Generator, axes: int, jerk: bool) -> MotionLimits:
    """Return limits of path and axes that differ by axis, with or without those of jerk."""
    more = {}
    if jerk:
        more = {
            'path_jerk': 10.0 ** rng.uniform(0.5, 2.5),
            'jerk': tuple(10.0 ** rng.uniform(0.5, 2.5, axes)),
        }
    return MotionLimits(
        path_velocity=10.0 ** rng.uniform(-1.5, 0.0),
        path_acceleration=10.0 ** rng.uniform(-0.5, 1.0),
        velocity=tuple(rng.uniform(0.02, 0.5, axes)),
        acceleration=tuple(rng.uniform(0.3, 6.0, axes)),
        **more,
    )


def used(trajectory: PathMotion, limits: MotionLimits, period: float) -> float:
    """Return the largest share of a limit that any sample uses, of any limit.

    Taken from the samples' own derivatives and from differences of the positions alone.
    """
    found = trajectory.sample(period)
    velocity, acceleration, jerk = limits.table(trajectory.geometry.axes)
    one, two, three = (np.diff(found.position, k, axis=0) / period**k for k in (1, 2, 3))
    along = [found.speed, *(np.diff(found.speed, k) / period**k for k in (1, 2))]
    pairs = [
        (found.velocity, velocity[1:]),
        (found.acceleration, acceleration[1:]),
        (one, velocity[1:]),
        (two, acceleration[1:]),
        (three, jerk[1:]),
        *zip(along, (velocity[0], acceleration[0], jerk[0]), strict=True),
    ]
    return max(float(np.abs(values / bound).max(initial=0.0)) for values, bound in pairs)

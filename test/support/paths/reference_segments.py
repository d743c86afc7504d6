# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Random programs of segments, and the distance of a path from what they say."""

import math
from itertools import pairwise

import numpy as np
from scipy.spatial import cKDTree

from fuzzycnc_ros.core.feedrate.gcode.arcs import PLANES
from fuzzycnc_ros.core.feedrate.gcode.segments import (
    ArcSegment,
    DwellSegment,
    LineSegment,
    NurbsSegment,
)
from fuzzycnc_ros.core.feedrate.path.nurbs import NurbsCurve
from fuzzycnc_ros.core.feedrate.path.path_geometry import bernstein
from fuzzycnc_ros.core.feedrate.path.reference_path import PathBuilder, ReferencePath


def line(start, end, number=1, *, feed=0.01, rapid=False):
    start, end = tuple(map(float, start)), tuple(map(float, end))
    return LineSegment(number, start, end, None if rapid else feed, rapid, False, 1)


def polyline(points, **options):
    pairs = pairwise(points)
    return [line(*ends, k, **options) for k, ends in enumerate(pairs, 1)]


def reference_path(segments, *, blend=0.0, exact_stop=None):
    """Return the whole reference path of segments."""
    builder = PathBuilder(blend=blend)
    parts = [builder.push(segments, exact_stop), builder.finish()]
    return ReferencePath.join([part for part in parts if part is not None])


def dwell(place, duration, number=1):
    place = tuple(map(float, place))
    return DwellSegment(number, place, place, None, False, False, 1, duration)


def arc(start, radius, direction, sweep, *, plane=17, rise=0.0, change=0.0, number=1, feed=0.01):
    """Return the arc that leaves `start` along the angle `direction` of its plane."""
    first, second, across = PLANES[plane]
    angle = direction - math.copysign(0.5 * math.pi, sweep)
    centre = (
        start[first] - radius * math.cos(angle),
        start[second] - radius * math.sin(angle),
    )
    end = list(map(float, start))
    end[first] = centre[0] + (radius + change) * math.cos(angle + sweep)
    end[second] = centre[1] + (radius + change) * math.sin(angle + sweep)
    end[across] += rise
    return ArcSegment(
        number,
        tuple(map(float, start)),
        tuple(end),
        feed,
        False,
        False,
        1,
        (first, second, across),
        centre,
        sweep,
    )


def nurbs(control, degree=3, *, weight=None, knot=None, number=1, feed=0.01):
    control = np.array(control, dtype=float)
    count = len(control)
    if knot is None:
        inner = np.arange(1, count - degree)
        knot = np.concatenate(
            [np.zeros(degree + 1), inner, np.full(degree + 1, max(count - degree, 1))]
        )
    weight = np.ones(count) if weight is None else weight
    curve = NurbsCurve(control, weight, knot, degree)
    first, last = tuple(control[0].tolist()), tuple(control[-1].tolist())
    return NurbsSegment(number, first, last, feed, False, False, 1, curve, number)


def in_space(curve):
    """Return a curve of the plane as a segment."""
    control = np.column_stack([curve.control, np.zeros(len(curve.control))])
    return nurbs(control, curve.degree, weight=curve.weight, knot=curve.knot)


def random_segment(rng, start, number, kinds=('line', 'arc', 'nurbs')):
    kind = rng.choice(kinds)
    size = 10.0 ** rng.uniform(-4.0, -2.0)
    start = np.array(start)
    if kind == 'line':
        way = rng.normal(size=3)
        return line(start, start + size * way / np.linalg.norm(way), number, feed=size)
    if kind == 'arc':
        return arc(
            start,
            size,
            rng.uniform(-3.0, 3.0),
            rng.choice([-1.0, 1.0]) * rng.uniform(0.05, 6.0),
            plane=int(rng.choice([17, 18, 19])),
            rise=float(rng.choice([0.0, 0.3])) * size,
            change=float(rng.choice([0.0, 1e-3])) * size,
            number=number,
        )
    degree = int(rng.integers(1, 5))
    way = np.cumsum(rng.normal(size=(degree + int(rng.integers(1, 5)), 3)), axis=0)
    control = np.concatenate([start[np.newaxis], start + size * way])
    return nurbs(control, degree, weight=rng.uniform(0.5, 2.0, len(control)), number=number)


def random_program(rng, count):
    """Return segments of all kinds, with rapids, dwells and segments of no length, and flags."""
    found, place = [], (0.0, 0.0, 0.0)
    while len(found) < count:
        number, chance = len(found) + 1, rng.uniform()
        if chance < 0.08:
            found.append(dwell(place, float(rng.uniform(0.0, 2.0)), number))
        elif chance < 0.16:
            found.append(line(place, place, number))
        elif chance < 0.26:
            found.append(
                line(place, np.array(place) + rng.normal(size=3) / 100, number, rapid=True)
            )
        elif chance < 0.36 and found and isinstance(found[-1], LineSegment) and found[-1].length:
            on = np.array(found[-1].end) - found[-1].start
            found.append(line(place, np.array(place) + rng.uniform(0.3, 3.0) * on, number))
        else:
            found.append(random_segment(rng, place, number))
        place = found[-1].end
    return found, rng.uniform(size=count) < 0.1


def distances(path, segments, *, probes=16):
    """Return distances of each piece from the segment that owns it, shape (pieces, probes) [m].

    They are no smaller than the distances from the whole program.
    """
    share = np.linspace(0.0, 1.0, probes)
    at = np.einsum('kb,mbd->mkd', bernstein(5, share), path.geometry.coefficient)
    found = np.empty(at.shape[:2])
    for owner in np.unique(path.owner).tolist():
        rows = path.owner == owner
        place, point = at[rows].reshape(-1, 3), _points(segments[owner])
        near = cKDTree(point).query(place, k=range(1, min(5, len(point)) + 1))[1]
        edges = np.concatenate([near, near - 1], axis=1).clip(0, len(point) - 2)
        away = [_to_edge(place, point[k], point[k + 1]) for k in edges.T]
        found[rows] = np.min(away, axis=0).reshape(-1, probes)
    return found


def _to_edge(place, start, end):
    edge = end - start
    square = np.maximum((edge * edge).sum(axis=1), 1e-300)
    share = np.clip(((place - start) * edge).sum(axis=1) / square, 0.0, 1.0)
    return np.linalg.norm(place - start - share[:, np.newaxis] * edge, axis=1)


def _points(segment):
    """Points of a segment so close that lines between them lie within some nanometres."""
    if isinstance(segment, LineSegment):
        return np.array([segment.start, segment.end])
    if isinstance(segment, ArcSegment):
        return segment.points(2000)
    curve = segment.curve
    u = np.unique(
        np.concatenate([np.linspace(*curve.domain, 200), np.clip(curve.knot, *curve.domain)])
    )
    for _ in range(12):
        point, middle = curve.point(u), 0.5 * (u[1:] + u[:-1])
        sag = np.linalg.norm(curve.point(middle) - 0.5 * (point[1:] + point[:-1]), axis=1)
        if sag.max() < 4e-9:
            break
        u = np.sort(np.concatenate([u, middle[sag >= 4e-9]]))
    return curve.point(u)


def curvatures(geometry, place):
    """Return the curvature of a geometry [1/m]."""
    first, second = geometry.evaluate(place, 1), geometry.evaluate(place, 2)
    return np.linalg.norm(np.cross(first, second), axis=1) / np.linalg.norm(first, axis=1) ** 3


def jumps(geometry):
    """Return the turn [rad] and the jump of the curvature [1/m] at the inner nodes."""
    one, two = geometry.derivative(1), geometry.derivative(2)
    before, after = (one[:-1, -1], two[:-1, -1]), (one[1:, 0], two[1:, 0])
    unit = [v / np.linalg.norm(v, axis=1, keepdims=True) for v in (before[0], after[0])]
    bend = []
    for (first, second), u in zip((before, after), unit, strict=True):
        across = second - (second * u).sum(axis=1, keepdims=True) * u
        bend.append(across / (first * first).sum(axis=1, keepdims=True))
    turn = 2.0 * np.arcsin(np.minimum(0.5 * np.linalg.norm(unit[1] - unit[0], axis=1), 1.0))
    return turn, np.linalg.norm(bend[1] - bend[0], axis=1)

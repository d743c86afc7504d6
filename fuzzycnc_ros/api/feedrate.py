# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Feedrate: the fastest motion along a curve that keeps a contour tolerance.

Examples
--------
>>> from fuzzycnc_ros import feedrate
>>> limits = feedrate.MotionLimits(path_velocity=0.2, path_acceleration=1.5)
>>> points = [(0.0, 0.0), (0.01, 0.004), (0.02, 0.0), (0.03, -0.004), (0.04, 0.0)]
>>> motion = feedrate.schedule(points, tolerance=20e-6, machine_constant=2e-4, limits=limits)
>>> f'{motion.duration:.3f} s'
'1.091 s'
"""

from __future__ import annotations

import warnings

import numpy as np
from numpy.typing import ArrayLike

from fuzzycnc_ros.core.feedrate.gcode.reader import read_program
from fuzzycnc_ros.core.feedrate.gcode.writer import write_program
from fuzzycnc_ros.core.feedrate.motion.limits import MotionLimits
from fuzzycnc_ros.core.feedrate.motion.trajectory import PathMotion, limit_motion
from fuzzycnc_ros.core.feedrate.path.nurbs import NurbsCurve
from fuzzycnc_ros.core.feedrate.path.path_geometry import PathGeometry
from fuzzycnc_ros.core.feedrate.path.reference_path import smooth_geometry
from fuzzycnc_ros.core.feedrate.path.sampled_path import SampledPath
from fuzzycnc_ros.core.feedrate.path.shapes import STILL_LENGTH
from fuzzycnc_ros.core.feedrate.schedule.program_schedule import schedule_program
from fuzzycnc_ros.core.feedrate.schedule.program_settings import ProgramSettings
from fuzzycnc_ros.core.feedrate.schedule.scheduler import ConstantFeed, ConstantNormalAcceleration
from fuzzycnc_ros.core.feedrate.schedule.tolerance_feed import ToleranceFeed

__all__ = [
    'ConstantFeed',
    'ConstantNormalAcceleration',
    'MotionLimits',
    'NurbsCurve',
    'PathGeometry',
    'PathMotion',
    'ProgramSettings',
    'ToleranceFeed',
    'read_program',
    'schedule',
    'schedule_program',
    'write_program',
]

LENGTH_MAX = 20.0
"""Extent of a path that is likely [m]."""

SAMPLES_MAX = 1_000_000
"""Most places at which a feed is chosen."""

TOLERANCE_MAX = 2e-3
"""Contour tolerance that is likely [m]."""


def schedule(
    path: NurbsCurve | PathGeometry | ArrayLike,
    *,
    tolerance: float,
    machine_constant: float,
    limits: MotionLimits,
    samples: int = 2000,
) -> PathMotion:
    """Return the fastest motion along a path that keeps a contour tolerance.

    The feed of a place is v = sqrt(tolerance / (C curvature)) with a guard and an approach to
    places of more curvature; the motion follows it within the limits.

    Parameters
    ----------
    path : NurbsCurve, PathGeometry or array_like, shape (n, 2) or (n, 3)
        Points [m] are joined by a smooth curve through all of them.
    tolerance : float
        Contour error that the feed is chosen for [m].
    machine_constant : float
        Contour error over normal acceleration of the machine, C [s^2]; a machine file has it,
        and `fuzzycnc machine identify` measures it.
    limits : MotionLimits
        Limits of path and axes.
    samples : int
        Places at which the feed is chosen, 2 to 1,000,000; at least one for each point.

    Returns
    -------
    PathMotion
        `duration` [s]; `sample(period)` gives positions, velocities and accelerations.

    Raises
    ------
    ValueError
        If the path, the tolerance or the constant cannot be used, or no velocity is limited.

    Warns
    -----
    UserWarning
        If points, tolerance or limits look like millimetres.

    Examples
    --------
    >>> import numpy as np
    >>> from fuzzycnc_ros import feedrate
    >>> angle = np.linspace(0.0, np.pi, 50)
    >>> half_circle = 0.01 * np.column_stack([np.cos(angle), np.sin(angle)])
    >>> limits = feedrate.MotionLimits(path_velocity=0.2, path_acceleration=1.5)
    >>> motion = feedrate.schedule(
    ...     half_circle, tolerance=20e-6, machine_constant=2e-4, limits=limits
    ... )
    >>> motion.sample(1e-3).position.shape[1]
    2
    """
    for name, number, low, high in (
        ('samples', samples, 2, SAMPLES_MAX), ('machine_constant', machine_constant, 0.0, 1.0),
    ):  # fmt: skip
        if not low <= number <= high:
            raise ValueError(f'{name}: expected {low:g} to {high:g} but found {number:g}')
    samples = int(samples)
    geometry = _geometry(path, samples)
    node = geometry.node
    extent = float(np.ptp(geometry.evaluate(node), axis=0).max())
    for name, length, most in (
        ('path', extent, LENGTH_MAX), ('tolerance', tolerance, TOLERANCE_MAX),
    ):  # fmt: skip
        if length > most:
            warnings.warn(
                f'{name}: expected metres, at most {most:g} m, but found {length:g} m; divide by '
                '1000 if it is in millimetres',
                stacklevel=2,
            )
    for name, unit, most in (('velocity', 'm/s', 100.0), ('acceleration', 'm/s^2', 1e4)):
        own = (getattr(limits, f'path_{name}'), *(getattr(limits, name) or ()))
        largest = max((value for value in own if value < np.inf), default=0.0)
        if largest > most:
            warnings.warn(
                f'{name}: expected {unit}, at most {most:g} {unit}, but found {largest:g} {unit}; '
                'divide by 1000 if it is in millimetres',
                stacklevel=2,
            )
    if len(node) < samples:
        pieces = -(-samples // (len(node) - 1))
        geometry = geometry.split(np.full(len(node) - 1, pieces))
        node = geometry.node
    feed_max = limits.path_velocity
    if not np.isfinite(feed_max):
        feed_max = float(np.linalg.norm(limits.velocity or (np.inf,)))
    scheduler = ToleranceFeed(
        feed_max=feed_max, tolerance=tolerance, machine_constant=machine_constant
    )
    bend = np.linalg.norm(geometry.evaluate(node, 2), axis=1)
    return limit_motion(geometry, scheduler.feed(SampledPath(node, bend)), limits)


def _geometry(path: NurbsCurve | PathGeometry | ArrayLike, samples: int) -> PathGeometry:
    if isinstance(path, PathGeometry):
        return path
    if not isinstance(path, NurbsCurve):
        return PathGeometry.from_samples(path)
    if not path.length > STILL_LENGTH:
        raise ValueError('path: expected a curve with a length but found one and the same point')
    u = path.parameter(np.linspace(0.0, path.length, samples))
    first, second = path.derivative(u), path.derivative(u, 2)
    size = np.linalg.norm(first, axis=1, keepdims=True)
    if size.min() <= 1e-6 * size.max():  # it stands still, or turns back: smooth between only
        return smooth_geometry(path)
    along = first / size
    across = second - (second * along).sum(axis=1, keepdims=True) * along
    return PathGeometry.from_samples(path.point(u), first, across / size**2)

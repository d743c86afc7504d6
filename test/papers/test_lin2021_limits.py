# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The absolute kinematic limit, and TOPP-RA on random splines."""

import numpy as np
import pytest

from fuzzycnc_ros.core.feedrate.motion.limits import MotionLimits
from fuzzycnc_ros.core.feedrate.motion.trajectory import limit_motion
from fuzzycnc_ros.core.feedrate.path.curves import butterfly, infinity, trident
from fuzzycnc_ros.core.feedrate.path.nurbs import NurbsCurve
from fuzzycnc_ros.core.feedrate.path.path_geometry import PathGeometry

pytestmark = pytest.mark.paper

CURVES = {'infinity': (infinity, 0.65), 'trident': (trident, 2.3), 'butterfly': (butterfly, 0.875)}
N = 4000


def path_of(curve: NurbsCurve) -> PathGeometry:
    """Return the path through evenly spaced parameters, with exact derivatives."""
    u = np.linspace(0.0, 1.0, N)
    first, second = curve.derivative(u, 1), curve.derivative(u, 2)
    square = (first**2).sum(axis=1, keepdims=True)
    along = (first * second).sum(axis=1, keepdims=True)
    bend = second / square - first * along / square**2
    return PathGeometry.from_samples(curve.point(u), first, bend, curve.arc_length(u))


@pytest.mark.parametrize(
    ('name', 'velocity', 'acceleration', 'seconds'),
    [
        ('infinity', 0.2, 1.5, 1.948),
        ('trident', 0.2, 1.5, 1.632),
        ('butterfly', 0.2, 1.5, 3.420),
        ('infinity', 0.1, 0.5, 3.565),
        ('trident', 0.1, 0.5, 2.944),
        ('butterfly', 0.1, 0.5, 5.945),
    ],
)
def test_kinematic_limit_of_the_axes(name, velocity, acceleration, seconds):
    build, scale = CURVES[name]
    limits = MotionLimits(velocity=(velocity,) * 2, acceleration=(acceleration,) * 2)
    found = limit_motion(path_of(build(scale)), 1.0, limits)
    assert found.duration == pytest.approx(seconds, rel=0.02)


@pytest.mark.parametrize(
    ('name', 'seconds'), [('infinity', 1.999), ('trident', 1.675), ('butterfly', 3.401)]
)
def test_kinematic_limit_with_a_speed_of_the_path(name, seconds):
    build, scale = CURVES[name]
    limits = MotionLimits(path_velocity=0.2, acceleration=(1.5, 1.5))
    found = limit_motion(path_of(build(scale)), 1.0, limits)
    assert found.duration == pytest.approx(seconds, rel=0.02)

# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Times of trajectories without limits of jerk, against TOPP-RA on the same curves."""

import numpy as np
import pytest
from paths.path_parts import straight_lines
from paths.random_paths import quintic, sampled
from tiers import rest_slow

from fuzzycnc_ros.core.feedrate.motion.limits import MotionLimits
from fuzzycnc_ros.core.feedrate.motion.trajectory import limit_motion

GRID = 1001


def fastest(curve, derivative, limits):
    """Return the time TOPP-RA takes for `curve(u)`, with derivatives from `derivative(u, k)`."""
    toppra = pytest.importorskip('toppra', reason='needs toppra (pip install toppra)')
    from toppra.algorithm import TOPPRA
    from toppra.constraint import JointAccelerationConstraint, JointVelocityConstraint
    from toppra.interpolator import AbstractGeometricPath

    class Path(AbstractGeometricPath):
        """The curve, as TOPP-RA wants it."""

        dof = len(limits.velocity)
        path_interval = np.array([0.0, 1.0])
        waypoints = None

        def __call__(self, path_positions, order=0):
            return derivative(path_positions, order) if order else curve(path_positions)

    toppra.setup_logging('ERROR')
    both = [np.outer(values, [-1.0, 1.0]) for values in (limits.velocity, limits.acceleration)]
    grid = np.linspace(0.0, 1.0, GRID)
    search = TOPPRA(
        [JointVelocityConstraint(both[0]), JointAccelerationConstraint(both[1])],
        Path(),
        gridpoints=grid,
        solver_wrapper='seidel',
    )
    speed = search.compute_parameterization(0.0, 0.0)[1]
    return float((2.0 * np.diff(grid) / (speed[1:] + speed[:-1])).sum())


def limits_of_axes(rng, axes):
    return MotionLimits(
        velocity=tuple(rng.uniform(0.05, 0.3, axes)),
        acceleration=tuple(rng.uniform(0.5, 4.0, axes)),
    )


@pytest.mark.parametrize('axes', rest_slow([2, 3], 1))
def test_splines_take_nearly_the_same_time(axes):
    ratio = []
    for seed in range(20):
        rng = np.random.default_rng([axes, seed])
        curve = quintic(rng, axes)
        limits = limits_of_axes(rng, axes)
        expected = fastest(curve, lambda u, k, of=curve: of.derivative(k)(u), limits)
        found = limit_motion(sampled(curve, np.linspace(0.0, 1.0, 1000)), 10.0, limits)
        ratio.append(found.duration / expected)
    assert 0.97 < min(ratio)
    assert max(ratio) < 1.15
    assert np.median(ratio) < 1.01


def test_lines_take_the_same_time():
    for seed in range(20):
        rng = np.random.default_rng(seed)
        step = rng.normal(size=3) * 10.0 ** rng.uniform(-4.0, 0.0)
        limits = limits_of_axes(rng, 3)
        expected = fastest(
            lambda u, by=step: np.multiply.outer(np.asarray(u), by),
            lambda u, k, by=step: np.multiply.outer(np.full(np.shape(u), k == 1), by),
            limits,
        )
        found = limit_motion(straight_lines([np.zeros(3), step]), 10.0, limits)
        assert found.duration == pytest.approx(expected, rel=0.03)

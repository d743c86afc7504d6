# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The fuzzy schedulers and the published rules [lin2021]."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from fuzzycnc_ros.core.feedrate.path.curves import butterfly, infinity, trident
from fuzzycnc_ros.core.feedrate.path.nurbs import NurbsCurve
from fuzzycnc_ros.core.feedrate.path.sampled_path import SampledPath
from fuzzycnc_ros.core.feedrate.schedule.scheduler import ConstantNormalAcceleration
from fuzzycnc_ros.core.feedrate.schedule.tolerance_feed import ToleranceFeed
from fuzzycnc_ros.core.fuzzy.mamdani import MamdaniTable
from fuzzycnc_ros.papers.feedrate import FuzzyScheduler, JerkLimitedFeed, published_feed_rules
from fuzzycnc_ros.simulation.motion.contour import Contour
from fuzzycnc_ros.simulation.motion.contouring import simulate_contouring
from fuzzycnc_ros.studies.pareto.refinement import knob_at_error

pytestmark = pytest.mark.paper


def star():
    """Clamped uniform cubic B-spline through a 14-gon of alternating radii 40 and 22 mm."""
    angle = np.arange(14) * 2.0 * np.pi / 14
    radius = 1e-3 * np.tile([40.0, 22.0], 7)
    gon = np.column_stack([radius * np.cos(angle), radius * np.sin(angle)])
    control = np.concatenate([gon[:1], gon, gon[:1], gon[:1]])
    count = len(control)
    knots = np.concatenate([np.zeros(3), np.linspace(0.0, 1.0, count - 2), np.ones(3)])
    return NurbsCurve(control, np.ones(count), knots, 3)


CURVES = {
    'infinity': infinity(0.65),
    'trident': trident(2.3),
    'butterfly': butterfly(0.875),
    'star': star(),
    'half butterfly': butterfly(0.4375),
}
PUBLISHED = FuzzyScheduler(feed_max=0.3 / 60.0, vvlf='VLF', average=15)
LOG_FUZZY = ToleranceFeed(feed_max=0.2, tolerance=5e-5, machine_constant=2.1517e-4)

# Rules R1 to R30: down the curvature, one column of the curvature ahead after the other
RULE_LIST = """
TF VVHF VHF HF MF VLF
TF VVHF HF HF LF VLF
VVHF VHF HF MF LF VLF
VVHF VHF HF MF VLF VLF
VVLF VVLF MF MF VLF VLF
"""

# Ratios that scikit-fuzzy 0.5.0 gives for the 60 pairs of `oracle_pairs`
# fmt: off
SCIKIT_FUZZY = {
    'MF': [
        0.4253, 0.7303, 0.9599, 0.8316, 0.2358, 0.1561, 0.5307, 0.2196, 0.4798, 0.2216,
        0.1731, 0.5593, 0.2016, 0.5288, 0.3070, 0.7790, 0.1773, 0.4048, 0.5003, 0.5275,
        0.8012, 0.7629, 0.3160, 0.3082, 0.4393, 0.5666, 0.1033, 0.1, 0.4106, 0.3037,
        0.2616, 0.4413, 0.9034, 0.2329, 0.4177, 0.4862, 0.6145, 0.1, 0.1, 0.5396,
        0.4273, 0.6779, 0.4066, 0.5118, 0.5731, 0.1809, 0.7140, 0.3426, 0.9346, 0.1152,
        0.1944, 0.7847, 0.1273, 0.9507, 0.5957, 0.7433, 0.4481, 0.3587, 0.5772, 0.9550,
    ],
    'VLF': [
        0.4253, 0.7303, 0.9599, 0.8316, 0.2358, 0.1561, 0.5307, 0.2196, 0.4798, 0.2216,
        0.1731, 0.3669, 0.2016, 0.3308, 0.3070, 0.7790, 0.1773, 0.4048, 0.3428, 0.5275,
        0.7857, 0.7629, 0.3160, 0.3082, 0.4393, 0.5666, 0.1033, 0.1, 0.4106, 0.3037,
        0.2616, 0.4125, 0.9034, 0.2329, 0.4177, 0.3398, 0.6145, 0.1, 0.1, 0.4471,
        0.4273, 0.6779, 0.4066, 0.4060, 0.5731, 0.1809, 0.7140, 0.3426, 0.9346, 0.1152,
        0.1944, 0.7847, 0.1273, 0.9507, 0.5721, 0.7433, 0.4481, 0.3587, 0.4477, 0.9550,
    ],
}
# fmt: on


def oracle_pairs():
    rng = np.random.default_rng(0)
    return rng.uniform(0.0, 3000.0, 60), rng.uniform(0.0, 1.0, 60)


@cache
def sampled(name, count=2000):
    part = np.linspace(0.0, 1.0, count)
    contour = Contour.curve(CURVES[name].point)
    path = SampledPath.from_points(CURVES[name].point(part))
    return contour, contour.arc_length(part), path


def drive(name, scheduler, count=2000):
    contour, arc_length, path = sampled(name, count)
    return simulate_contouring(contour, arc_length, scheduler.feed(path))


def segment_sum(path, feed):
    return (2.0 * np.diff(path.arc_length) / (feed[1:] + feed[:-1])).sum()


@pytest.mark.parametrize('vvlf', ['VLF', 'MF', 'HF'])
def test_30_rules(vvlf):
    listed = [row.split() for row in RULE_LIST.replace('VVLF', vvlf).split('\n') if row]
    assert list(zip(*published_feed_rules(vvlf), strict=True)) == [tuple(row) for row in listed]


@pytest.mark.parametrize('vvlf', ['VLF', 'MF'])
def test_ratio_runs_from_a_tenth_to_full(vvlf):
    nodes = MamdaniTable(replace(PUBLISHED, vvlf=vvlf).system).nodes
    assert nodes.min() == pytest.approx(0.1, abs=1e-12)
    assert nodes.max() == pytest.approx(1.0, abs=1e-12)
    assert nodes[0, 0] == pytest.approx(1.0, abs=1e-12)


@pytest.mark.parametrize('vvlf', ['VLF', 'MF'])
def test_inference_agrees_with_scikit_fuzzy(vvlf):
    found = replace(PUBLISHED, vvlf=vvlf).system(*oracle_pairs())
    assert np.abs(found - SCIKIT_FUZZY[vvlf]).max() < 1e-3


@pytest.mark.parametrize(('vvlf', 'most'), [('MF', 0.005), ('VLF', 0.007)])
def test_lookup_is_near_the_inference(vvlf, most):
    system = replace(PUBLISHED, vvlf=vvlf).system
    rng = np.random.default_rng(1)
    pairs = rng.uniform(0.0, 3000.0, 60_000), rng.uniform(0.0, 1.0, 60_000)
    assert np.abs(MamdaniTable(system)(*pairs) - system(*pairs)).max() <= most


@pytest.mark.parametrize(
    ('name', 'seconds', 'error_um', 'within'),
    [
        ('infinity', 62.46, 1.62, 0.02),
        ('trident', 46.10, 2.31, 0.02),
        ('butterfly', 130.1, 12.1, 0.05),
    ],
)
def test_published_mode_at_300_mm_per_minute(name, seconds, error_um, within):
    path = sampled(name)[2]
    assert segment_sum(path, PUBLISHED.feed(path)) == pytest.approx(seconds, rel=0.002)
    assert 1e6 * drive(name, PUBLISHED).error_max == pytest.approx(error_um, rel=within)


def test_readings_of_the_gaps_that_were_not_taken():
    path = sampled('infinity')[2]
    for vvlf, seconds in (('VLF', 71.5), ('MF', 65.1)):
        scheduler = replace(PUBLISHED, vvlf=vvlf, average=5, normalisation='path')
        assert segment_sum(path, scheduler.feed(path)) == pytest.approx(seconds, abs=0.05)
    path = sampled('butterfly')[2]
    causal = replace(PUBLISHED, smoothing='causal')
    assert segment_sum(path, causal.feed(path)) == pytest.approx(117.2, abs=0.05)
    for vvlf, seconds in (('LF', 94), ('MF', 83), ('HF', 78), ('VVHF', 72)):
        scheduler = replace(PUBLISHED, vvlf=vvlf)
        assert segment_sum(path, scheduler.feed(path)) == pytest.approx(seconds, abs=0.51)


@pytest.mark.parametrize(
    ('name', 'seconds'), [('infinity', 11.2), ('trident', 10.0), ('butterfly', 18.7)]
)
def test_published_method_at_equal_error(name, seconds):
    found = knob_at_error(
        lambda feed: drive(name, FuzzyScheduler(feed_max=feed)), 5e-5, 0.02, high=0.25
    )
    assert found.run.duration == pytest.approx(seconds, rel=0.02)


@pytest.mark.parametrize(
    ('name', 'seconds'), [('infinity', 3.6), ('trident', 3.0), ('butterfly', 8.3)]
)
def test_log_fuzzy_at_equal_error(name, seconds):
    found = knob_at_error(
        lambda tolerance: drive(name, replace(LOG_FUZZY, tolerance=tolerance)), 5e-5, 5e-5
    )
    assert found.run.duration <= seconds


@pytest.mark.parametrize('tolerance', [1e-5, 5e-5, 1e-4])
@pytest.mark.parametrize('name', CURVES)
def test_untuned_log_fuzzy_keeps_the_tolerance(name, tolerance):
    scheduler = replace(LOG_FUZZY, tolerance=tolerance)
    for count in (2000, 4000, 8000):
        assert drive(name, scheduler, count).error_max <= 1.05 * tolerance
    # Nor does it give the tolerance away.
    assert drive(name, scheduler).error_max >= 0.8 * tolerance


@pytest.mark.parametrize(
    ('name', 'seconds', 'low', 'high'),
    [('infinity', 3.57, 1.2, 1.9), ('trident', 2.98, 1.2, 1.9), ('butterfly', 9.43, 4.4, 6.0)],
)
def test_comparators_at_equal_error(name, seconds, low, high):
    def time(scheduler):
        return knob_at_error(
            lambda acceleration: drive(name, scheduler(acceleration)), 5e-5, 0.2
        ).run.duration

    normal = time(lambda a: ConstantNormalAcceleration(feed_max=0.2, normal_acceleration=a))
    # The prototype scaled the largest feed along with the acceleration.
    assert normal == pytest.approx(seconds, rel=0.03)
    jerk = time(lambda a: JerkLimitedFeed(feed_max=0.2, chord_error=1e-3, acceleration=a))
    assert low <= jerk / normal <= high


def test_dimensionless_ratio_does_not_depend_on_the_scale():
    def ratio(scale):
        points = trident(2.3 * scale).point(np.linspace(0.0, 1.0, 2000))
        scheduler = replace(
            LOG_FUZZY,
            feed_max=0.2 * np.sqrt(scale),
            guard_length=scale * LOG_FUZZY.guard_length,
            guard_time=np.sqrt(scale) * LOG_FUZZY.guard_time,
            approach_time=np.sqrt(scale) * 0.028,
            approach_slope=68.0 / np.sqrt(scale),
        )
        return scheduler.bounded_ratio(SampledPath.from_points(points))

    for scale in (0.1, 10.0):
        np.testing.assert_allclose(ratio(scale), ratio(1.0), rtol=1e-6)


def test_published_ratio_depends_on_the_scale():
    found = []
    for scale in (0.1, 1.0, 10.0):
        path = SampledPath.from_points(trident(2.3 * scale).point(np.linspace(0.0, 1.0, 2000)))
        time = segment_sum(path, PUBLISHED.feed(path))
        found.append((path.arc_length[-1] / (time * PUBLISHED.feed_max)).round(3))
    assert found == pytest.approx([0.686, 0.978, 0.998], abs=0.0011)

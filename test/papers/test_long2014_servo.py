# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The variable-universe controller against the figures on the page about servo [long2014]."""

import numpy as np
import pytest

from fuzzycnc_ros.core.fuzzy.mamdani import memberships
from fuzzycnc_ros.core.machine.axis_models import LatheAxisConfig
from fuzzycnc_ros.core.servo.observer import ObserverDesign
from fuzzycnc_ros.core.servo.params import VariableUniverseParams
from fuzzycnc_ros.core.servo.profile import ProfileLimits, point_to_point
from fuzzycnc_ros.core.servo.rule_table import CENTRES, RuleTable, published_rules
from fuzzycnc_ros.core.servo.stability import stability_report
from fuzzycnc_ros.core.servo.stick_slip import StickSlipParams
from fuzzycnc_ros.core.servo.variable_universe import VariableUniverseController
from fuzzycnc_ros.simulation.servo.axes import LatheAxis
from fuzzycnc_ros.simulation.servo.lathe_axes import random_moves
from fuzzycnc_ros.simulation.servo.positioning import position, position_many

pytestmark = pytest.mark.paper

AXIS = LatheAxisConfig().linear()
OFF_GRID = 2.9e-7
SMOOTH = {'coulomb': 0.0, 'breakaway': 0.0}


def contracted(value, exponent=0.9, floor=1e-4):
    return value / (abs(value) ** exponent + floor)


def move(target, knobs, *, mode='production', duration=3.0, **options):
    controller = VariableUniverseController(AXIS, mode=mode, **options)
    return position(controller, LatheAxis(LatheAxisConfig(**knobs)), target + OFF_GRID, duration)


@pytest.mark.parametrize(('medium', 'duty'), [(0.67, 0.4998), (0.677, 0.5050), (2 / 3, 0.4973)])
def test_worked_example(medium, duty):
    rules = published_rules(medium)
    x, y = contracted(-0.25), contracted(0.12)
    assert (abs(0.722) ** 0.9 + 1e-4) * rules(x, y) == pytest.approx(duty, abs=1e-4)
    assert abs(0.12) ** 0.9 + 1e-4 == pytest.approx(0.1484, abs=5e-5)  # printed .1485


def test_memberships_of_the_worked_example():
    x, y = contracted(-0.25), contracted(0.12)
    error, rate = (memberships(np.array([value]), CENTRES)[:, 0] for value in (x, y))
    assert error[:2] == pytest.approx([0.6068, 0.3932], abs=1e-4)  # printed .5009, .4991
    assert rate[4:] == pytest.approx([0.5806, 0.4194], abs=1e-4)


def test_bilinear_interpolation_is_the_sum_over_36_rules():
    rng = np.random.default_rng(0)
    rules = published_rules()
    x, y = rng.uniform(-1.1, 1.1, (2, 2000))
    rows, columns = memberships(x, CENTRES), memberships(y, CENTRES)
    strength = rows[:, np.newaxis] * columns
    book = np.einsum('ijk,ij->k', strength, np.array(rules.values)) / strength.sum(axis=(0, 1))
    assert np.abs(rules.surface(x, y) - book).max() < 1e-12
    scalar = [rules(*pair) for pair in zip(x.tolist(), y.tolist(), strict=True)]
    assert np.abs(rules.surface(x, y) - scalar).max() < 1e-12


def test_slopes_of_the_centre_cell():
    assert published_rules().slopes == pytest.approx((1.520, 0.511), abs=1e-3)


@pytest.mark.parametrize('mode', ['production', 'static', 'paper_literal'])
def test_a_mirrored_sequence_gives_mirrored_duties(mode):
    rng = np.random.default_rng(1)
    readings = np.cumsum(rng.normal(0.0, 2e-6, 400))
    duties = []
    for sign in (1.0, -1.0):
        controller = VariableUniverseController(AXIS, mode=mode)
        controller.reset(0.0)
        duties.append(
            [controller.step(sign * 1e-3, sign * reading) for reading in readings.tolist()]
        )
    assert np.abs(np.add(*duties)).max() < 1e-12
    assert np.abs(duties[0]).max() > 1e-6


@pytest.mark.parametrize(
    ('output', 'fixpoint', 'within'),
    [(0.67, 0.018888, 1e-5), (0.677, 0.0209, 5e-5), (0.5, 1.4e-3, 5e-5), (0.333, 1.6e-4, 1e-5)],
)
def test_recursion_of_the_source_is_a_memory_that_fades_to_a_crawl(output, fixpoint, within):
    # rules that give a constant on either side of zero error
    row = (output,) * 6
    table = RuleTable(CENTRES, (row,) * 3 + (tuple(-value for value in row),) * 3)
    controller = VariableUniverseController(
        AXIS, VariableUniverseParams.published(table), mode='paper_literal'
    )
    controller.reset(0.0)
    duties = [controller.step(0.19, 0.0) for _ in range(400)]
    assert duties[0] == pytest.approx(output)  # the first factors are 1
    assert duties[-1] == pytest.approx(fixpoint, abs=within)


@pytest.mark.slow
@pytest.mark.parametrize(('target', 'seconds'), [(-0.05, 11.29), (-0.17, 33.36)])
def test_published_recursion_crawls_to_the_target(target, seconds):
    run = move(target, SMOOTH, mode='paper_literal', duration=seconds + 1.0)
    assert run.settle() == pytest.approx(seconds, rel=0.005)
    assert run.steady_error(run.time[-1] - 0.05) < 0.7e-6
    assert run.overshoot < 0.7e-6
    at_two_seconds = abs(run.error[2000])
    assert at_two_seconds == pytest.approx(0.0385 if target == -0.05 else 0.1577, rel=0.01)


@pytest.mark.parametrize(('target', 'seconds'), [(-0.05, 0.6), (-0.17, 1.2)])
def test_minimal_change_settles_without_friction(target, seconds):
    run = move(target, SMOOTH, mode='static')
    assert run.settle() <= seconds
    assert run.overshoot < 1e-6
    assert run.steady_error(2.0) < 0.7e-6


def test_minimal_change_sticks_far_off_with_friction():
    run = move(-0.05, {}, mode='static')
    assert run.steady_error(2.0) == pytest.approx(156e-6, rel=0.02)


@pytest.mark.parametrize('seed', [0, 1, 2])
@pytest.mark.parametrize(
    ('target', 'knobs', 'seconds'),
    [
        (-0.05, SMOOTH, 0.6),
        (-0.05, {}, 0.6),
        (-0.17, SMOOTH, 1.1),
        (-0.17, {}, 1.1),
        (-0.05, {'gain_factor': 0.5}, 0.8),
        (-0.05, {'gain_factor': 1.5}, 0.8),
        (2e-5, {}, 0.4),
    ],
)
def test_production_step(target, knobs, seconds, seed):
    run = move(target, {**knobs, 'seed': seed})
    assert run.settle() <= seconds
    assert run.overshoot < 1e-6
    assert run.steady_error(2.0) < 1e-6


@pytest.mark.parametrize('load', [0.1, -0.1])
def test_load_step(load):
    run = move(-0.05, {'load': load, 'load_time': 2.0}, duration=4.0)
    late = run.time >= 2.0
    assert np.abs(run.error[late]).max() < 260e-6
    assert run.settle() - 2.0 < 0.35
    assert run.steady_error(2.5) < 2e-6


@pytest.mark.parametrize(('target', 'seconds'), [(-0.05, 0.7), (-0.17, 1.3)])
def test_profile_with_feedforward(target, seconds):
    limits = ProfileLimits(velocity=0.2, acceleration=1.5, jerk=30.0)
    profile = point_to_point(0.0, target + OFF_GRID, limits)
    controller = VariableUniverseController(AXIS)
    run = position(controller, LatheAxis(), profile.sample(1e-3), 3.0)
    assert run.settle() <= seconds
    assert run.overshoot < 1e-6
    assert run.steady_error(2.0) < 1e-6


def random_positioning(count, *, hard, stick_slip):
    moves = random_moves(count, hard=hard, seed=0)
    controllers = [
        VariableUniverseController(AXIS, stick_slip=stick_slip) for _ in range(len(moves))
    ]
    batch = position_many(controllers, moves, 4.0)
    assert not any(batch.fault)
    return 1e6 * batch.steady_error(3.0)


MOVES = pytest.mark.parametrize('count', [60, pytest.param(200, marks=pytest.mark.qualify)])


@pytest.mark.slow
@MOVES
def test_random_moderate_moves(count):
    error = random_positioning(count, hard=False, stick_slip=StickSlipParams())
    assert (error <= 1.0).mean() >= 0.97
    assert (error <= 2.0).mean() >= 0.99


@pytest.mark.slow
@MOVES
def test_random_moves_with_hard_friction(count):
    error = random_positioning(count, hard=True, stick_slip=StickSlipParams())
    assert (error <= 2.0).mean() >= 0.96
    assert error.max() < 30.0  # without relief some hunt at 50 um for good


@pytest.mark.slow
def test_hard_friction_hunts_without_relief():
    error = random_positioning(60, hard=True, stick_slip=None)
    assert error.max() > 30.0
    assert (error <= 2.0).mean() < 0.99


def test_gain_of_the_observer():
    gain = [5.0544e-4, 89.6186, 0.730339, 0.365172, -558.585]  # the prototype's, in metres
    assert ObserverDesign.of(AXIS).gain[2:] == pytest.approx(gain[1:], rel=3e-4)


def test_spectral_radius_over_the_gain():
    report = stability_report(VariableUniverseController(AXIS))
    assert list(report.spectral_radius.values()) == pytest.approx(
        [0.9692, 0.9653, 0.9682, 0.9727, 0.9970, 1.014], abs=5e-4
    )
    assert report.error_gain == pytest.approx(284.6, abs=0.1)
    assert report.rate_gain == pytest.approx(7.38, abs=0.01)
    assert report.ultimate_gain == pytest.approx(496.0, abs=2.0)


def test_published_floor_without_the_recursion_swings_by_millimetres():
    published = VariableUniverseParams.published()
    report = stability_report(
        VariableUniverseController(AXIS, published, mode='paper_literal'), gains=(1.0,)
    )
    assert report.error_gain / report.ultimate_gain == pytest.approx(161.0, abs=1.0)
    assert report.error_floor_min == pytest.approx(0.0161, abs=1e-4)
    with pytest.warns(UserWarning, match='error_floor'):
        controller = VariableUniverseController(AXIS, published, mode='static')
    run = position(controller, LatheAxis(LatheAxisConfig(**SMOOTH)), -0.05, 3.0)
    swing = run.steady_error(2.0)
    assert 1e-3 < swing < 2.4e-3
    assert report.limit_cycle == pytest.approx(swing, rel=0.3)

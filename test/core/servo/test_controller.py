# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Controllers of an axis: modes, limits, start, status, feedback that cannot be right."""

from dataclasses import replace
from math import nan

import numpy as np
import pytest

from fuzzycnc_ros.core.machine.axis_models import BallscrewAxisConfig, LatheAxisConfig
from fuzzycnc_ros.core.servo.axis_control import make_controller
from fuzzycnc_ros.core.servo.feedback_watch import FeedbackLimits
from fuzzycnc_ros.core.servo.filtered_rate import Integrator
from fuzzycnc_ros.core.servo.params import ServoParamsWarning, VariableUniverseParams
from fuzzycnc_ros.core.servo.pid_cascade import CascadeController, PidController
from fuzzycnc_ros.core.servo.profile import ProfileLimits, point_to_point
from fuzzycnc_ros.core.servo.variable_universe import VariableUniverseController
from fuzzycnc_ros.simulation.servo.axes import BallscrewAxis, LatheAxis
from fuzzycnc_ros.simulation.servo.positioning import position

AXIS = LatheAxisConfig().linear()
CONTROLLERS = {
    'production': lambda axis, **more: VariableUniverseController(axis, **more),
    'model_free': lambda axis, **more: VariableUniverseController(axis, observer=False, **more),
    'static': lambda axis, **more: VariableUniverseController(axis, mode='static', **more),
    'literal': lambda axis, **more: VariableUniverseController(axis, mode='paper_literal', **more),
    'fixed': lambda axis, **more: make_controller('fixed_universe', axis, **more),
    'pid': PidController,
    'cascade': CascadeController,
}
SERVOS = ('production', 'model_free', 'fixed', 'pid', 'cascade')
SMOOTH = {'coulomb': 0.0, 'breakaway': 0.0}


def run(name, target, duration, *, more=None, **knobs):
    controller = CONTROLLERS[name](AXIS, **(more or {}))
    return position(controller, LatheAxis(LatheAxisConfig(**knobs)), target, duration)


def profile(target, **limits):
    return point_to_point(0.0, target, ProfileLimits(**limits)).sample(1e-3)


@pytest.mark.parametrize('name', SERVOS)
def test_all_controllers_reach_the_target_with_friction(name):
    found = run(name, 0.05, 2.0)
    assert found.settle(5e-6) < 1.0
    assert found.fault == ''


@pytest.mark.parametrize('name', ['production', 'pid', 'cascade', 'literal'])
@pytest.mark.parametrize('sign', [1.0, -1.0])
def test_duty_has_the_sign_of_the_axis(name, sign):
    axis = LatheAxis(LatheAxisConfig(direction=sign))
    controller = CONTROLLERS[name](axis.config.linear())
    found = position(controller, axis, 1e-3, 0.2)
    assert np.sign(found.duty[0]) == sign
    assert found.position[-1] > 1e-5


@pytest.mark.parametrize('name', CONTROLLERS)
def test_step_is_reproducible_and_reset_forgets(name):
    controller = CONTROLLERS[name](AXIS)
    readings = np.cumsum(np.random.default_rng(0).normal(0.0, 1e-6, 60)).tolist()
    courses = []
    for _ in range(2):
        controller.reset(0.0)
        courses.append([controller.step(2e-3, reading) for reading in readings])
    assert courses[0] == courses[1]


@pytest.mark.parametrize('name', SERVOS)
def test_control_is_taken_over_without_a_bump(name):
    controller = CONTROLLERS[name](AXIS)
    controller.reset(0.1, duty=0.07)
    assert controller.step(0.1, 0.1) == pytest.approx(0.07)
    controller.reset(0.1, duty=3.0)
    assert controller.step(0.1, 0.1) == pytest.approx(1.0)
    # and an error acts at once: only what held the axis is taken over
    controller.reset(0.1)
    assert controller.step(0.101, 0.1) > 0.05


def test_first_reading_is_the_start_where_none_is_given():
    controller = VariableUniverseController(AXIS)
    controller.reset()
    assert controller.step(0.123, 0.123) == pytest.approx(0.0)


@pytest.mark.parametrize('name', CONTROLLERS)
def test_duty_and_its_change_are_limited(name):
    found = run(name, 0.05, 0.4, more={'duty_max': 0.6, 'duty_slew': 40.0})
    assert np.abs(found.duty).max() <= 0.6
    assert np.abs(np.diff(found.duty, prepend=0.0)).max() <= 0.04 + 1e-12
    assert np.abs(found.duty).max() > 0.3 or name == 'literal'


@pytest.mark.parametrize('name', SERVOS)
def test_saturation_winds_nothing_up(name):
    found = run(name, 0.15, 2.5, more={'duty_max': 0.5})
    assert found.overshoot < 80e-6
    assert found.settle(5e-6) < 2.0


def test_integral_goes_on_where_the_axis_is_stuck_beyond_its_band():
    integral = Integrator(1000.0, 1e-3, dead_zone=1e-6, band=1e-4, still=2e-3)
    added = []
    for error, speed in ((5e-7, 0.0), (5e-5, 0.1), (2e-4, 0.1), (2e-4, 1e-3), (-2e-4, -1e-3)):
        integral.reset(0.0)
        integral.add(error, speed, False, 0.1)
        added.append(integral.value)
    assert added == pytest.approx([0.0, 5e-5, 0.0, 2e-4, -2e-4])
    integral.reset(0.0)
    integral.add(2e-4, 0.0, True, 1.0)  # would be cut even more
    assert integral.value == 0.0


@pytest.mark.parametrize('name', ['pid', 'model_free'])
def test_a_load_that_pushes_the_axis_out_of_the_band_is_made_up_for(name):
    # the error that the load alone asks for is larger than the band, and friction holds the axis
    found = run(name, 5e-3, 3.0, load=0.15, coulomb=0.03, breakaway=0.045)
    assert np.abs(found.error[-500:]).max() < 10e-6
    assert not found.fault


def test_status_says_what_happened():
    controller = VariableUniverseController(AXIS)
    controller.reset(0.0)
    controller.step(0.05, 0.0)
    status = controller.status
    assert status.error == pytest.approx(0.05)
    assert status.duty == 1.0
    assert status.saturated
    assert status.cell == (3, 2)
    assert status.contracted_error == pytest.approx(
        (0.05 / 0.19) / ((0.05 / 0.19) ** 0.68588 + 0.072693)
    )
    assert status.factor == 1.0
    assert (status.bad, status.fault, status.rest) == (0, '', '')
    pid = PidController(AXIS).status
    assert pid.cell is None
    assert np.isnan(pid.contracted_error)


def test_surface_is_the_law_for_arrays():
    controller = VariableUniverseController(AXIS)
    rng = np.random.default_rng(0)
    error, rate = rng.normal(0.0, 0.1, 500), rng.normal(0.0, 0.5, 500)
    one_by_one = [
        controller.law(*pair) for pair in zip(error.tolist(), rate.tolist(), strict=True)
    ]
    assert controller.surface(error, rate) == pytest.approx(one_by_one, abs=1e-14)
    assert controller.surface(error[:, np.newaxis], rate[:3]).shape == (500, 3)


def test_feedforward_moves_the_ideal_axis_without_feedback():
    # the share that the rules add on a smooth axis stays small
    controller = VariableUniverseController(AXIS)
    found = position(controller, LatheAxis(LatheAxisConfig(**SMOOTH)), profile(0.1), 1.5)
    assert np.abs(found.error).max() < 150e-6


@pytest.mark.parametrize('name', SERVOS)
def test_a_few_missing_readings_are_bridged(name):
    found = run(name, 0.05, 1.5, dropout_time=0.1, dropout_duration=0.005)
    assert found.fault == ''
    assert found.settle(5e-6) < 1.2
    missing = np.isnan(found.measured)
    assert missing.sum() == 5
    assert len(set(found.duty[np.flatnonzero(missing)])) == 1  # the last duty is held


@pytest.mark.parametrize('name', CONTROLLERS)
def test_more_missing_readings_are_a_fault_that_stays_until_reset(name):
    controller = CONTROLLERS[name](AXIS)
    found = position(
        controller,
        LatheAxis(LatheAxisConfig(dropout_time=0.1, dropout_duration=0.006)),
        0.05,
        0.5,
    )
    assert 'not finite' in found.fault
    assert (found.duty[105:] == 0.0).all()
    assert controller.status.bad == 6
    controller.reset(0.0)
    assert controller.status.fault == ''
    assert controller.step(0.05, 0.0) != 0.0


@pytest.mark.parametrize('value', [nan, float('inf')])
@pytest.mark.parametrize('at', ['reference', 'velocity', 'acceleration'])
def test_numbers_that_are_none_never_leave_the_controller(value, at):
    controller = VariableUniverseController(AXIS)
    controller.reset(0.0)
    given = {'reference': 0.0, 'position': 0.0, 'velocity': 0.0, 'acceleration': 0.0}
    for _ in range(10):
        assert np.isfinite(controller.step(**{**given, at: value}))
    assert controller.status.fault or at != 'reference'
    assert abs(controller.status.duty) <= 1.0


@pytest.mark.parametrize('counts', [100, -100, 5000])
@pytest.mark.parametrize('time', [0.15, 1.2])
def test_lost_counts_stop_the_axis(counts, time):
    controller = VariableUniverseController(AXIS)
    axis = LatheAxis(LatheAxisConfig(counts_lost=counts, count_loss_time=time))
    found = position(controller, axis, profile(0.05), 1.5)
    assert 'counts were lost' in found.fault
    stop = np.flatnonzero(found.duty)[-1] + 1
    assert stop - round(time / 1e-3) <= 6
    assert found.position.max() < 0.0502


def test_a_single_wild_reading_is_ridden_over():
    controller = VariableUniverseController(AXIS)
    axis = LatheAxis()
    reference = profile(0.05)
    course = reference.over(1.5)
    controller.reset(0.0)
    for step, (place, speed, rise) in enumerate(
        zip(*(part.tolist() for part in course), strict=True)
    ):
        wild = 1e-3 if step in (150, 300, 301) else 0.0
        axis.drive(controller.step(place, axis.measure() + wild, speed, rise))
    assert controller.status.fault == ''
    assert controller.status.bad_total == 3
    assert abs(axis.position - 0.05) < 2e-6


@pytest.mark.parametrize('factor', [0.5, 1.5, 2.0, 3.0, 16.0])
@pytest.mark.parametrize('time', [0.0, 0.1])
def test_a_changed_count_stops_the_axis(factor, time):
    found = run('production', profile(0.05), 1.5, count_factor=factor, count_change_time=time)
    assert 'counts' in found.fault
    assert found.duty[-1] == 0.0
    assert found.position.max() < 0.0501


WRONG = (
    (-0.05, {}),
    (0.001, {}),
    (0.001, {'gain_factor': 0.5}),
    (profile(0.05), {}),
    (profile(0.001), {'coulomb': 0.05, 'breakaway': 0.09}),
)


@pytest.mark.parametrize('name', SERVOS)
@pytest.mark.parametrize(('reference', 'knobs'), WRONG)
def test_a_wrong_sign_is_noticed_within_20_ms_of_wrong_motion(name, reference, knobs):
    found = run(name, reference, 1.0, direction=-1.0, **knobs)
    assert 'runs away' in found.fault
    begun = np.flatnonzero(-found.position * np.sign(found.target) > 5e-6)[0]
    stopped = np.flatnonzero(found.duty)[-1] + 1
    assert stopped - begun <= 20
    assert np.abs(found.position).max() < 2.5e-3


def test_a_wrong_sign_is_noticed_on_the_ball_screw_too():
    axis = BallscrewAxisConfig().linear()
    controller = VariableUniverseController.for_axis(axis, count=5e-8)
    wrong = BallscrewAxis(BallscrewAxisConfig(direction=-1.0))
    found = position(controller, wrong, profile(0.1, acceleration=1.0), 1.0)
    begun = np.flatnonzero(found.position < -5e-6)[0]
    stopped = np.flatnonzero(found.duty)[-1] + 1
    assert 'runs away' in found.fault
    assert stopped - begun <= 20


@pytest.mark.parametrize('name', ['production', 'pid'])
def test_hard_use_raises_no_alarm(name):
    # targets change in full motion, gain and load are off, noise is high
    rng = np.random.default_rng(7)
    for seed in range(4):
        axis = LatheAxis(
            LatheAxisConfig(
                seed=seed,
                gain_factor=rng.uniform(0.5, 1.5),
                load=rng.uniform(-0.1, 0.1),
                noise=0.5e-6,
            )
        )
        controller = CONTROLLERS[name](AXIS)
        controller.reset(0.0)
        for step in range(1500):
            if step % (60 + 40 * seed) == 0:
                target = rng.uniform(-0.15, 0.15)
            axis.drive(controller.step(target, axis.measure()))
        assert controller.status.fault == ''
        assert controller.status.bad_total == 0


def test_a_wrong_unit_is_refused():
    controller = VariableUniverseController(AXIS)
    controller.reset(0.0)
    for _ in range(6):
        controller.step(50.0, 0.0)
    assert 'further apart than the travel' in controller.status.fault


def test_a_ball_screw_that_nothing_was_tuned_on_follows_a_profile():
    axis = BallscrewAxis()
    controller = VariableUniverseController.for_axis(axis.config.linear(), count=5e-8)
    found = position(controller, axis, profile(0.1, acceleration=1.0), 1.2)
    largest, _ = found.following_error()
    assert largest < 100e-6
    assert found.settle(2e-6) < 0.9


@pytest.mark.parametrize(
    ('options', 'message'),
    [
        ({'mode': 'best'}, 'mode: expected one of production, static, paper_literal'),
        ({'duty_max': 0.0}, 'duty_max: expected more than 0, at most 1'),
        ({'duty_max': 1.5}, 'duty_max: expected more than 0, at most 1'),
        ({'duty_slew': nan}, 'duty_slew: expected a positive number'),
        ({'observer': False, 'rate_lag': -1.0}, 'rate_lag: expected 0 s or more'),
        ({'observer': False, 'integral_gain': nan}, 'integral_gain: expected a finite'),
        ({'observer': False, 'integral_band': 0.0}, 'integral_band: expected more than'),
    ],
)
def test_refusals_of_a_controller(options, message):
    with pytest.raises(ValueError, match=message):
        VariableUniverseController(AXIS, **options)


def test_refusal_of_a_reset_changes_nothing():
    controller = VariableUniverseController(AXIS)
    controller.reset(0.0)
    before = controller.step(0.001, 0.0)
    with pytest.raises(ValueError, match='reset: expected finite numbers'):
        controller.reset(nan)
    assert controller.status.duty == before


@pytest.mark.parametrize(
    'change',
    [
        {'error_exponent': 0.0},
        {'rate_exponent': 1.1},
        {'error_floor': 0.0},
        {'output_floor': 0.0},  # zero duty would be for good
        {'error_range': -1.0},
        {'rate_range': nan},
        {'output_gain': float('inf')},
    ],
)
def test_refusals_of_params(change):
    with pytest.raises(
        ValueError, match=f'VariableUniverseParams: {next(iter(change))}: expected'
    ):
        VariableUniverseParams(**change)


def test_params_that_do_not_suit_the_axis_are_warned_of():
    # the source's rate range, taken for a speed instead of a way per sample of 0.1 s
    with pytest.warns(ServoParamsWarning, match='displacement per sample'):
        VariableUniverseController(AXIS, VariableUniverseParams(rate_range=0.02587))
    with pytest.warns(ServoParamsWarning, match='error_floor'):
        VariableUniverseController(AXIS, VariableUniverseParams(error_floor=0.01))


@pytest.mark.parametrize(
    'change',
    [{'error_max': 0.0}, {'count': -1.0}, {'noise': nan}, {'bad_max': 0}, {'load': nan}],
)
def test_refusals_of_feedback_limits(change):
    with pytest.raises(ValueError, match=f'{next(iter(change))}: expected'):
        FeedbackLimits(**change)


@pytest.mark.parametrize(
    ('make', 'options', 'message'),
    [
        (PidController, {'proportional': -1.0}, 'proportional: expected 0 or more'),
        (CascadeController, {'velocity_gain': 0.0}, 'velocity_gain: expected a positive'),
    ],
)
def test_refusals_of_baselines(make, options, message):
    with pytest.raises(ValueError, match=message):
        make(AXIS, **options)


@pytest.mark.parametrize('name', SERVOS)
@pytest.mark.parametrize('load', [0.4, -0.4])
@pytest.mark.parametrize('reference', [0.05, profile(0.05)], ids=['step', 'profile'])
def test_a_load_that_is_believed_is_held(name, load, reference):
    controller = CONTROLLERS[name](AXIS)
    controller.watch.limits = replace(controller.watch.limits, load=0.5)
    found = position(controller, LatheAxis(LatheAxisConfig(load=load)), reference, 3.0)
    assert found.fault == ''
    assert abs(found.position[-1] - 0.05) < 5e-6


@pytest.mark.parametrize('name', ['production', 'cascade'])
def test_a_loop_that_swings_is_called_that(name):
    found = run(name, profile(0.05), 3.0, gain_factor=2.0)
    assert 'the loop swings' in found.fault
    assert found.duty[-1] == 0.0


@pytest.mark.parametrize('name', ['production', 'cascade'])
def test_a_loop_that_grows_gives_gain_back_until_it_does_not_swing(name):
    found = run(name, profile(0.05), 3.0, gain_factor=3.0)
    assert not found.fault
    assert np.abs(found.error[-300:]).max() < 5e-5

# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""What is around the law: observer, relief from stick-slip, stability report, runs."""

from dataclasses import replace

import numpy as np
import pytest

from fuzzycnc_ros.core.machine.axis_models import BallscrewAxisConfig, LatheAxisConfig
from fuzzycnc_ros.core.servo.axis import LinearAxis, response_lag
from fuzzycnc_ros.core.servo.feedback_watch import FeedbackLimits
from fuzzycnc_ros.core.servo.observer import (
    DisturbanceObserver,
    ObserverDesign,
    ObserverNoise,
    predictor,
)
from fuzzycnc_ros.core.servo.params import VariableUniverseParams, settles, ultimate_gain
from fuzzycnc_ros.core.servo.profile import point_to_point
from fuzzycnc_ros.core.servo.stability import stability_report
from fuzzycnc_ros.core.servo.stick_slip import StickSlipParams
from fuzzycnc_ros.core.servo.variable_universe import VariableUniverseController
from fuzzycnc_ros.simulation.servo.axes import LatheAxis
from fuzzycnc_ros.simulation.servo.lathe_axes import LatheMove
from fuzzycnc_ros.simulation.servo.positioning import PositioningRun, position, position_many

AXIS = LatheAxisConfig().linear()
SMOOTH = {'coulomb': 0.0, 'breakaway': 0.0}


CHAINS = {
    'lathe': AXIS,
    'ballscrew': BallscrewAxisConfig().linear(),
    'one lag': LinearAxis.chain(-0.3, {'drive': 2e-3}, 0.02, period=1e-3),
    'one lag and sensor': LinearAxis.chain(
        0.3, {'drive': 2e-3}, 0.02, sensor_lag=3e-3, period=2e-3
    ),
    'six states': LinearAxis.chain(
        0.3, {'a': 1e-3, 'b': 2e-3, 'c': 4e-3}, 0.02, sensor_lag=3e-3, period=1e-3
    ),
}


@pytest.mark.parametrize('name', CHAINS)
def test_predictor_is_the_product_with_its_matrices(name):
    observer = DisturbanceObserver(CHAINS[name])
    design = observer.design
    observer.reset(0.02, 0.1)
    state = np.array(observer.state)
    rng = np.random.default_rng(0)
    for duty, reading in rng.normal(0.0, 0.1, (50, 2)).tolist():
        off = reading - design.reading @ state
        state = design.dynamics @ state + design.duty * duty + design.gain * off
        observer.advance(duty, reading)
        assert observer.state == pytest.approx(state, rel=1e-12, abs=1e-12)
    observer.coast(0.3)
    state = design.dynamics @ state + design.duty * 0.3
    assert observer.state == pytest.approx(state, rel=1e-12, abs=1e-12)


def test_predictor_takes_models_that_are_no_chain():
    rng = np.random.default_rng(1)
    for size in (3, 5, 8):
        dynamics = rng.normal(0.0, 0.3, (size, size))
        duty, reading, gain = rng.normal(0.0, 0.3, (3, size))
        step = predictor(dynamics, duty, reading, gain)
        state = rng.normal(0.0, 1.0, size)
        expected = dynamics @ state + duty * 0.7 + gain * (0.2 - reading @ state)
        assert step(tuple(state.tolist()), 0.7, 0.2) == pytest.approx(expected, abs=1e-12)


def test_gain_solves_the_riccati_equation():
    noise = ObserverNoise()
    design = ObserverDesign.of(AXIS, noise)
    a, c, gain = design.dynamics, design.reading, design.gain
    wander = np.zeros_like(a)
    wander[-1, -1] = noise.disturbance**2 * AXIS.period
    wander[design.velocity, design.velocity] = noise.velocity**2 * AXIS.period
    # the covariance that the gain leaves, by summing what it lets through
    closed = a - np.outer(gain, c)
    covariance = np.zeros_like(a)
    for _ in range(4000):
        driven = wander + noise.sensor**2 * np.outer(gain, gain)
        covariance = closed @ covariance @ closed.T + driven
    best = a @ covariance @ c / (c @ covariance @ c + noise.sensor**2)
    assert gain == pytest.approx(best, rel=1e-6, abs=1e-9)


def test_gain_depends_on_the_ratios_of_the_noise_alone():
    noise = ObserverNoise()
    louder = ObserverNoise(
        sensor=1e3 * noise.sensor,
        disturbance=1e3 * noise.disturbance,
        velocity=1e3 * noise.velocity,
    )
    assert ObserverDesign.of(AXIS, louder).gain == pytest.approx(ObserverDesign.of(AXIS).gain)


def test_observer_finds_a_load():
    axis = LatheAxis(LatheAxisConfig(load=0.08, noise=0.0, **SMOOTH))
    observer = DisturbanceObserver(AXIS)
    observer.reset(0.0, 0.0)
    for _ in range(300):
        observer.advance(0.2, axis.measure())
        axis.drive(0.2)
    assert observer.disturbance == pytest.approx(0.08, abs=2e-3)
    assert observer.velocity == pytest.approx(axis.velocity, rel=0.01)


@pytest.mark.parametrize(
    'change', [{'sensor': 0.0}, {'disturbance': -1.0}, {'velocity': float('nan')}]
)
def test_refusals_of_noise(change):
    with pytest.raises(ValueError, match=f'{next(iter(change))}: expected'):
        ObserverNoise(**change)


HUNTING = {'gain_factor': 1.4, 'coulomb': 0.045, 'breakaway': 0.08, 'load': -0.05}


def test_relief_ends_hunting_that_goes_on_without():
    errors = {}
    for name, relief in (('with', StickSlipParams()), ('without', None)):
        controller = VariableUniverseController(AXIS, stick_slip=relief)
        config = LatheAxisConfig(**HUNTING)
        errors[name] = position(controller, LatheAxis(config), 0.0047, 4.0).steady_error(3.0)
    assert errors['with'] < 2e-6
    assert errors['without'] > 20e-6


def test_relief_holds_a_stuck_axis_and_lets_it_go():
    controller = VariableUniverseController(AXIS)
    axis = LatheAxis(LatheAxisConfig(**HUNTING))
    controller.reset(0.0)
    seen = []
    for _ in range(4000):
        axis.drive(controller.step(0.0047, axis.measure()))
        seen.append(controller.status.rest)
    assert seen[0] == ''
    assert 'dithering' in seen
    assert seen[-1] == 'holding'
    held = {controller.step(0.0047, axis.measure()) for _ in range(50)}
    assert len(held) == 1
    axis.drive(controller.step(0.0147, axis.measure()))
    assert controller.status.rest == ''
    assert abs(controller.status.duty) > 0.5


def test_relief_lets_go_of_an_axis_that_is_to_move_and_comes_back():
    controller = VariableUniverseController(AXIS)
    axis = LatheAxis(LatheAxisConfig(**HUNTING))
    controller.reset(0.0)
    for _ in range(4000):
        axis.drive(controller.step(0.0047, axis.measure()))
    assert controller.status.rest == 'holding'
    there = point_to_point(0.0047, 0.0147).sample(1e-3)
    back = point_to_point(0.0147, 0.0047).sample(1e-3)
    for part in (there, back):
        for motion in zip(*(rows.tolist() for rows in part.over(None)), strict=True):
            place, speed, rise = motion
            axis.drive(controller.step(place, axis.measure(), speed, rise))
            if speed:
                assert controller.status.rest == ''
    for _ in range(1500):
        axis.drive(controller.step(0.0047, axis.measure()))
    assert abs(axis.position - 0.0047) < 2e-6


def test_relief_leaves_an_axis_without_friction_alone():
    controller = VariableUniverseController(AXIS)
    axis = LatheAxis(LatheAxisConfig(**SMOOTH))
    controller.reset(0.0)
    for _ in range(3000):
        axis.drive(controller.step(0.003, axis.measure()))
        assert controller.status.rest == ''


def test_dithering_can_be_turned_off_alone():
    controller = VariableUniverseController(AXIS, stick_slip=StickSlipParams(amplitude_max=0.0))
    axis = LatheAxis(LatheAxisConfig(**HUNTING))
    controller.reset(0.0)
    for _ in range(2000):
        axis.drive(controller.step(0.0047, axis.measure()))
        assert controller.status.rest != 'dithering'


@pytest.mark.parametrize('change', [{'patience': -1.0}, {'half_period': 0.0}])
def test_refusals_of_relief(change):
    with pytest.raises(ValueError, match=f'StickSlipParams: {next(iter(change))}: expected'):
        StickSlipParams(**change)


def simulated_radius(controller, factor):
    """Growth per period of a small swing on the smooth axis without counts and noise."""
    config = LatheAxisConfig(gain_factor=factor, noise=0.0, count=0.0, **SMOOTH)
    axis = LatheAxis(config)
    controller.reset(0.0)
    course = []
    for _ in range(1000):
        course.append(axis.position - 1e-9)
        axis.drive(controller.step(1e-9, axis.measure()))
    early, late = (np.abs(course[k : k + 100]).max() for k in (400, 900))
    return (late / early) ** (1.0 / 500.0)


@pytest.mark.parametrize('factor', [1.5, 1.75])
def test_spectral_radius_is_how_a_small_swing_grows(factor):
    # with a noise in which no swing shows, so that none makes it take gain back
    limits = FeedbackLimits(count=0.0, noise=1e-2)
    controller = VariableUniverseController(AXIS, stick_slip=None, limits=limits)
    report = stability_report(controller, gains=(factor,))
    assert simulated_radius(controller, factor) == pytest.approx(
        report.spectral_radius[factor], abs=1.5e-3
    )


@pytest.mark.parametrize('options', [{}, {'observer': False}, {'mode': 'static'}])
def test_gain_margin_is_where_the_spectral_radius_is_one(options):
    controller = VariableUniverseController(AXIS, **options)
    margin = stability_report(controller, gains=(1.0,)).gain_margin[1]
    radius = stability_report(controller, gains=(0.97 * margin, 1.03 * margin)).spectral_radius
    low, high = radius.values()
    assert low < 1.0 < high


def test_report_judges_as_a_whole():
    assert stability_report(VariableUniverseController(AXIS), gains=(0.5, 1.0, 1.5)).settles
    assert not stability_report(VariableUniverseController(AXIS)).settles  # gain x1.75
    with pytest.raises(ValueError, match='gains: expected positive factors'):
        stability_report(VariableUniverseController(AXIS), gains=(0.0,))


def test_settles_says_what_the_ultimate_gain_says():
    most = ultimate_gain(AXIS)
    assert settles(AXIS, 0.999 * most, 0.0)
    assert not settles(AXIS, 1.001 * most, 0.0)


def test_params_for_another_axis_close_the_loop_where_asked():
    axis = LinearAxis.chain(1.7, {}, 0.4, period=1e-3)
    params = VariableUniverseParams.for_axis(axis, 80.0, damping=1.0)
    # lag s^2 + (1 + gain rate_gain) s + gain error_gain
    assert 1.7 * params.error_gain / 0.4 == pytest.approx(80.0**2)
    assert (1.0 + 1.7 * params.rate_gain) / 0.4 == pytest.approx(2.0 * 80.0)
    with pytest.raises(ValueError, match='damps itself more'):
        VariableUniverseParams.for_axis(axis, 0.5)
    assert response_lag(AXIS) == pytest.approx(8.3e-3)


def test_figures_of_a_run():
    time = 1e-3 * np.arange(6)
    place = np.array([0.0, 6e-3, 10.5e-3, 9.9e-3, 10e-3, 10e-3])
    run = PositioningRun(time, np.full(6, 0.01), place, place, np.zeros(6), 0.01, 0.0)
    assert run.settle(2e-6) == 4e-3
    assert run.overshoot == pytest.approx(0.5e-3)
    assert run.steady_error(2.5e-3) == pytest.approx(0.1e-3)
    assert run.following_error(2e-3)[0] == pytest.approx(0.5e-3)
    assert replace(run, position=np.zeros(6)).settle() == np.inf
    assert replace(run, position=np.full(6, 0.01)).settle() == 0.0
    with pytest.raises(ValueError, match='since: expected less than'):
        run.steady_error(1.0)


def test_refusals_of_a_move():
    controller = VariableUniverseController(AXIS)
    with pytest.raises(ValueError, match='duration: expected a time for a step'):
        position(controller, LatheAxis(), 0.01)
    with pytest.raises(ValueError, match=r'expected one period but found 0\.001 s'):
        position(controller, LatheAxis(LatheAxisConfig(period=2e-3)), 0.01, 0.1)
    with pytest.raises(ValueError, match='expected one for each of 1 moves but found 2'):
        position_many([controller] * 2, [LatheMove(LatheAxisConfig(), 0.01)], 0.1)


def test_moves_side_by_side_are_the_moves_one_by_one():
    moves = [LatheMove(LatheAxisConfig(seed=k, gain_factor=0.7 + 0.3 * k), 3e-3) for k in range(3)]
    batch = position_many([VariableUniverseController(AXIS) for _ in moves], moves, 0.4)
    for k, move in enumerate(moves):
        run = position(VariableUniverseController(AXIS), LatheAxis(move.config), move.target, 0.4)
        assert batch.position[k] == pytest.approx(run.position, abs=1e-9)
        assert batch.settle(1e-5)[k] == pytest.approx(run.settle(1e-5), abs=2e-3)
    assert batch.overshoot.shape == batch.steady_error(0.3).shape == (3,)

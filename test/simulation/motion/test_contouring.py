# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import quad

from fuzzycnc_ros.core.machine.path_loop import ContouringConfig
from fuzzycnc_ros.simulation.motion.contour import Contour
from fuzzycnc_ros.simulation.motion.contouring import (
    circle_contour_constant,
    controller_feed,
    identify_contour_constant,
    simulate_contouring,
    travel,
)
from fuzzycnc_ros.simulation.motion.contouring_axes import ContouringAxes

CONFIG = ContouringConfig()


def eight(part):
    turn = 2.0 * np.pi * np.asarray(part)
    return np.column_stack([0.05 * np.sin(turn), 0.03 * np.sin(2.0 * turn)])


def helix(part):
    turn = 4.0 * np.pi * np.asarray(part)
    return np.column_stack([0.02 * np.cos(turn), 0.02 * np.sin(turn), 0.015 * turn])


def circle(radius, speed, seconds):
    angle = speed / radius * 1e-3 * np.arange(round(seconds * 1e3))
    return radius * np.column_stack([np.cos(angle), np.sin(angle)])


def plain_loop(reference, config=CONFIG):
    """The axes as their definition words them, one control step after the other."""
    samples = config.filter_samples
    full = np.concatenate([np.tile(reference[0], (samples - 1, 1)), reference])
    position, velocity = reference[0].copy(), np.zeros(reference.shape[1])
    course = []
    dt = config.interpolation_period / config.control_steps
    for k in range(len(reference)):
        held = full[k : k + samples].mean(axis=0)
        for _ in range(config.control_steps):
            asked = config.position_gain * (held - position)
            asked = np.clip(asked, -config.velocity_max, config.velocity_max)
            change = config.velocity_bandwidth * (asked - velocity)
            change = np.clip(change, -config.acceleration_max, config.acceleration_max)
            velocity = velocity + dt * change
            position = position + dt * velocity
        course.append(position)
    return np.array(course)


def wild(seed, size=1500):
    """Positions with jumps, so that every limit is met and left again many times."""
    rng = np.random.default_rng(seed)
    smooth = np.cumsum(rng.normal(0.0, 1e-4, (size, 3)), axis=0)
    jump = np.cumsum(rng.normal(0.0, 0.01, (size, 3)) * (rng.random((size, 3)) < 0.01), axis=0)
    return smooth + jump


@pytest.mark.parametrize(
    'reference',
    [circle(0.02, 0.1, 2.0), wild(0), wild(1), np.repeat([[0.0, 0.0], [0.1, -0.3]], 2500, axis=0)],
    ids=['no limit met', 'wild', 'wilder', 'step'],
)
def test_axes_follow_as_the_plain_loop_does(reference):
    axes = ContouringAxes(reference[0])
    np.testing.assert_allclose(axes.follow(reference), plain_loop(reference), rtol=0, atol=1e-13)


@pytest.mark.parametrize('reference', [circle(0.02, 0.1, 1.0), wild(2, 600)])
@given(cut=st.lists(st.integers(0, 600), max_size=4))
@settings(max_examples=10, deadline=None)
def test_steps_and_pieces_give_what_the_whole_gives(reference, cut):
    whole = ContouringAxes(reference[0])
    expected = whole.follow(reference)
    pieces = ContouringAxes(reference[0])
    found = [pieces.follow(part) for part in np.split(reference, sorted(cut))]
    np.testing.assert_allclose(np.concatenate(found), expected, rtol=0, atol=1e-13)
    np.testing.assert_allclose(pieces.velocity, whole.velocity, rtol=0, atol=1e-10)
    steps = ContouringAxes(reference[0])
    found = np.array([steps.step(position) for position in reference])
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-13)
    np.testing.assert_allclose(steps.position, expected[-1], rtol=0, atol=1e-13)


@pytest.mark.parametrize('steps', [4, 7])
def test_axes_follow_alone_as_together_to_the_last_digit(steps):
    config = ContouringConfig(control_steps=steps)
    calm = circle(0.02, 0.1, 4.0)
    jump = np.where(np.arange(len(calm)) < 1500, 0.0, 0.2)[:, None]  # meets limits
    together = np.column_stack([calm, jump])
    found = ContouringAxes(together[0], config).follow(together)
    for axis, alone in enumerate(together.T):
        expected = ContouringAxes(alone[:1], config).follow(alone[:, None])
        np.testing.assert_array_equal(found[:, axis], expected[:, 0])


@pytest.mark.parametrize('seed', range(3))
def test_axes_keep_their_limits(seed):
    axes = ContouringAxes(np.zeros(3))
    velocity = []
    for position in wild(seed, 1000):
        axes.step(position)
        velocity.append(axes.velocity)
    change = np.abs(np.diff(velocity, axis=0)) / CONFIG.interpolation_period
    assert np.abs(velocity).max() <= CONFIG.velocity_max * (1 + 1e-9)
    assert change.max() == pytest.approx(CONFIG.acceleration_max, rel=1e-9)  # met, not passed


def test_axes_lag_by_the_delay():
    ramp = np.column_stack([0.05e-3 * np.arange(1000.0), -0.1e-3 * np.arange(1000.0)])
    lag = ramp - ContouringAxes([0.0, 0.0]).follow(ramp)
    # a reference that is held lags by half a period more, its period's end comes one later
    expected = CONFIG.delay * np.array([0.05, -0.1])
    np.testing.assert_allclose(lag[-1], expected, rtol=0.03)


def test_far_away_the_axes_move_alike():
    reference = circle(0.02, 0.1, 1.0)
    far = np.array([900.0, -700.0])
    moved = ContouringAxes(reference[0] + far).follow(reference + far)
    at_home = ContouringAxes(reference[0]).follow(reference)
    np.testing.assert_allclose(moved - far, at_home, rtol=0, atol=1e-11)


def test_axes_refuse_what_is_no_position_and_keep_their_state():
    for bad in ([], [[0.0]], [0.0, np.nan]):
        with pytest.raises(ValueError, match='position: expected one finite number per axis'):
            ContouringAxes(bad)
    axes = ContouringAxes([0.0, 0.0])
    axes.follow(circle(0.02, 0.1, 0.1) - [0.02, 0.0])
    before = axes.position, axes.velocity
    with pytest.raises(ValueError, match='expected 2 numbers per position'):
        axes.step([0.0, 0.0, 0.0])
    with pytest.raises(ValueError, match='finite positions'):
        axes.follow([[0.0, 0.0], [0.0, np.inf]])
    assert axes.follow(np.empty((0, 2))).shape == (0, 2)
    np.testing.assert_array_equal(before, (axes.position, axes.velocity))


def test_config_refuses_loops_that_do_not_settle():
    with pytest.raises(ValueError, match=r'expected loops that settle .* raise control_steps'):
        ContouringConfig(velocity_bandwidth=9000.0, control_steps=4)
    ContouringConfig(velocity_bandwidth=9000.0, control_steps=20)
    with pytest.raises(ValueError, match='position_gain'):
        ContouringConfig(position_gain=0.0)


def test_controller_starts_and_ends_at_rest_within_its_acceleration():
    rng = np.random.default_rng(5)
    arc = np.append(0.0, np.cumsum(rng.uniform(1e-5, 2e-4, 2000)))
    asked = rng.uniform(0.0, 0.4, 2001)
    speed = controller_feed(arc, asked, CONFIG)
    assert speed[0] == speed[-1] == CONFIG.velocity_min
    assert np.all(speed <= np.maximum(np.minimum(asked, 0.25), CONFIG.velocity_min))
    change = np.abs(np.diff(speed**2)) / (2.0 * np.diff(arc))
    assert change.max() <= 1.5 * (1 + 1e-6)
    # and as fast as that allows: where it is below what was asked, a neighbour brakes it
    below = np.flatnonzero(speed[1:-1] < np.minimum(asked, 0.25)[1:-1] * (1 - 1e-9)) + 1
    bound = np.maximum(change[below - 1], change[below])
    np.testing.assert_allclose(bound[speed[below] > 1e-3], 1.5, rtol=1e-4)


@given(
    speed=st.lists(st.floats(1e-4, 0.2), min_size=2, max_size=8),
    period=st.sampled_from([1e-3, 0.02, 0.3]),
)
@settings(max_examples=40, deadline=None)
def test_travel_takes_the_time_that_the_speed_says(speed, period):
    arc = 0.01 * np.arange(len(speed))
    way, duration = travel(arc, speed, period)
    expected = sum(
        quad(lambda s: 1.0 / np.interp(s, arc, speed), arc[i], arc[i + 1], epsabs=0)[0]
        for i in range(len(arc) - 1)
    )
    assert duration == pytest.approx(expected, rel=1e-6)
    assert way[0] == 0.0
    assert way[-1] == arc[-1]
    assert np.all(np.diff(way) >= 0.0)
    assert (len(way) - 2) * period <= duration <= (len(way) - 1) * period * (1 + 1e-12)
    for k in range(0, len(way) - 1, max(1, len(way) // 5)):
        until = sum(
            quad(lambda s: 1.0 / np.interp(s, arc, speed), low, high, epsabs=0)[0]
            for low, high in zip(arc[:-1], np.minimum(arc[1:], way[k]), strict=True)
            if high > low
        )
        assert until == pytest.approx(k * period, rel=1e-6, abs=1e-12)


def test_a_straight_line_has_no_contour_error():
    line = Contour.polyline([[0.01, 0.0], [0.07, 0.09]])
    run = simulate_contouring(line, np.linspace(0.0, line.length, 200), np.full(200, 0.2))
    assert run.error_max < 1e-12
    assert run.duration > line.length / 0.2
    np.testing.assert_allclose(run.position[-1], [0.07, 0.09], atol=1e-6)
    assert len(run.time) == len(run.error) == len(run.position) == len(run.reference)
    assert run.time[-1] == pytest.approx(run.duration + CONFIG.run_out, abs=1.01e-3)


def test_no_part_of_the_error_depends_on_where_the_contour_lies():
    turn = np.array([[0.6, -0.8], [0.8, 0.6]])

    def moved(part):
        return eight(part) @ turn.T + [0.4, -0.2]

    runs = []
    for curve in (eight, moved):
        contour = Contour.curve(curve)
        arc = contour.arc_length(np.linspace(0.0, 1.0, 1000))
        runs.append(simulate_contouring(contour, arc, np.full(1000, 0.05)))
    assert runs[0].error_max > 1e-6
    np.testing.assert_allclose(runs[1].error, runs[0].error, rtol=0, atol=2e-10)


def test_error_in_space_is_that_of_the_normal_acceleration():
    contour = Contour.curve(helix)
    arc = np.linspace(0.0, contour.length, 1000)
    run = simulate_contouring(contour, arc, np.full(1000, 0.04))
    curvature = 0.02 / (0.02**2 + 0.015**2)
    steady = run.error[len(run.error) // 3 : len(run.error) // 2]
    expected = CONFIG.contour_constant * curvature * 0.04**2
    np.testing.assert_allclose(steady, expected, rtol=0.03)


def test_corner_is_cut_on_the_inside():
    corner = Contour.polyline([[0.0, 0.0], [0.02, 0.0], [0.02, 0.02]])
    arc = np.linspace(0.0, 0.04, 400)
    run = simulate_contouring(corner, arc, np.full(400, 0.05))
    worst = run.position[run.error.argmax()]
    assert worst[0] < 0.02
    assert worst[1] > 0.0
    # nobody cuts a corner at rest
    feed = np.where(np.abs(arc - 0.02) < 1e-4, 1e-4, 0.05)
    assert simulate_contouring(corner, arc, feed).error_max < 0.02 * run.error_max


def test_the_run_out_brings_the_axes_to_the_end():
    contour = Contour.curve(eight)
    arc = np.linspace(0.0, contour.length, 500)
    ends = [
        simulate_contouring(
            contour, arc, np.full(500, 0.1), ContouringConfig(run_out=seconds)
        ).position[-1]
        for seconds in (0.0, 0.3)
    ]
    assert np.linalg.norm(ends[1] - eight([1.0])[0]) < 1e-7
    assert np.linalg.norm(ends[0] - eight([1.0])[0]) > 1e-5


@pytest.mark.parametrize(
    ('arc', 'feed', 'words'),
    [
        ([0.0, 0.1], [0.1, 0.1], r'expected 0 m to 0\.33\d+ m, the length of the contour, but'),
        ([0.0], [0.1], 'two or more arc lengths and as many speeds'),
        ([0.0, 0.1], [0.1], r'found the shapes \(2,\) and \(1,\)'),
        ([0.0, 0.0, 0.1], [0.1, 0.1, 0.1], 'drop duplicate points'),
        ([0.0, np.nan], [0.1, 0.1], 'arc_length: expected finite'),
        ([0.0, 0.1], [0.1, -0.1], 'none negative'),
        ([0.0, 0.1], [0.1, np.nan], 'speed: expected finite'),
    ],
)
def test_simulation_refuses_what_is_no_schedule(arc, feed, words):
    with pytest.raises(ValueError, match=words):
        simulate_contouring(Contour.curve(eight, vertices=1001), arc, feed)


def test_travel_refuses_rest():
    with pytest.raises(ValueError, match='expected more than 0 m/s everywhere'):
        travel([0.0, 1.0], [0.0, 1.0], 1e-3)


@pytest.mark.parametrize(
    'changes',
    [
        {'position_gain': 80.0},
        {'velocity_bandwidth': 600.0},
        {'filter_samples': 40},
        {'position_gain': 20.0, 'filter_samples': 1},
    ],
)
def test_constant_of_other_machines(changes):
    config = ContouringConfig(**changes)
    found = identify_contour_constant(config, radius=0.05, speed=0.05)
    # the sampled loops differ from their formula by what they do in one period
    assert found == pytest.approx(config.contour_constant, rel=0.1)


def test_a_driven_circle_gives_back_its_constant():
    radius, speed = 0.03, 0.08
    turn = np.linspace(0.0, 2.0 * np.pi, 90, endpoint=False)
    driven = (radius - 3e-4 * speed**2 / radius) * np.column_stack([np.cos(turn), np.sin(turn)])
    found = circle_contour_constant(driven + np.array([1.0, 2.0]), [1.0, 2.0], radius, speed)
    assert found == pytest.approx(3e-4, rel=1e-9)


def test_identification_refuses():
    with pytest.raises(ValueError, match=r'position: expected the shape \(n, 2\)'):
        circle_contour_constant([[0.0, 0.0, 0.0]], [0.0, 0.0], 1.0, 1.0)
    with pytest.raises(ValueError, match='finite'):
        circle_contour_constant([[0.0, np.nan]], [0.0, 0.0], 1.0, 1.0)
    with pytest.raises(ValueError, match='speed: expected more than 0 m/s but found 0'):
        circle_contour_constant([[0.0, 0.0]], [0.0, 0.0], 1.0, 0.0)
    with pytest.raises(ValueError, match='radius: expected more than 0 m but found -1'):
        identify_contour_constant(radius=-1.0)
    for speed in (0.0, 0.3, np.nan):
        with pytest.raises(ValueError, match=r'speed: .* at most 0\.25'):
            identify_contour_constant(speed=speed)

# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The ball-screw axis against the EMPS recording of the real one, and our controller on it.

A. Janot, M. Gautier, M. Brunot: Data set and reference models of EMPS, 2019.
"""

import numpy as np
import pytest
from emps import from_rest
from scipy.io import loadmat
from tiers import rest_slow

from fuzzycnc_ros.components.servo.servo_controller_config import (
    ServoControllerConfig,
    make_controllers,
)
from fuzzycnc_ros.core.machine.axis_models import BallscrewAxisConfig
from fuzzycnc_ros.core.servo.built_in import built_in_controller
from fuzzycnc_ros.core.servo.observer import ObserverDesign, ObserverNoise
from fuzzycnc_ros.simulation.servo.axes import BallscrewAxis

pytestmark = pytest.mark.paper

PERIOD = 1e-3
VARIATIONS = {
    'mass +30 %': {'mass_factor': 1.3},
    'mass -30 %': {'mass_factor': 0.7},
    'friction x0.5': {'friction_factor': 0.5},
    'friction x2': {'friction_factor': 2.0},
}
CASES = {'nominal': {}, **VARIATIONS}
HARDEST = ('nominal', 'mass +30 %', 'friction x2')


@pytest.fixture(scope='module')
def recording(data):
    """Reference qg [m], position qm [m], voltage vir [V], gains kp [1/s] and kv [V s/m]."""
    path = data / 'emps-ballscrew' / 'DATA_EMPS.mat'
    if not path.is_file():
        pytest.skip(f'expected the EMPS recording at {path} but found none')
    raw = loadmat(path)
    return {name: raw[name].ravel().astype(float) for name in ('qg', 'qm', 'vir', 'kp', 'kv')}


@pytest.fixture(scope='module')
def reference(recording):
    """Recorded reference, led back to its start from rest."""
    return from_rest(recording['qg'])


@pytest.fixture(scope='module')
def followed(reference):
    """Errors and duties of our controller on the nominal axis and on each variation."""
    return {name: follow(reference, **knobs) for name, knobs in CASES.items()}


@pytest.fixture(scope='module')
def voltage_off(recording):
    """Relative error of the voltage with the published parameters."""
    return mismatch(recording, BallscrewAxisConfig())[1]


def ruled(**settings):
    """Return the production controller of the ball screw, with other settings."""
    return built_in_controller('ballscrew', 'variable_universe', settings)


def published_loop(recording, config):
    """Positions [m] and voltages [V] under nu = kp kv (qg - q) - kv dq/dt, from qm's beginning."""
    kp, kv = recording['kp'].item(), recording['kv'].item()
    # what the first voltage says about the velocity at the first sample
    velocity = kp * (recording['qg'][0] - recording['qm'][0]) - recording['vir'][0] / kv
    axis = BallscrewAxis(config, position=recording['qm'][0], velocity=velocity)
    course = []
    for target in recording['qg'].tolist():
        volts = kp * kv * (target - axis.measure()) - kv * axis.velocity
        course.append((axis.position, volts))
        axis.drive(volts / config.voltage_max)
    return np.array(course).T


def mismatch(recording, config):
    """Differences of position from the recorded one [m], and relative error of the voltage."""
    position, volts = published_loop(recording, config)
    off = np.linalg.norm(volts - recording['vir']) / np.linalg.norm(recording['vir'])
    return position - recording['qm'], float(off)


def follow(reference, controller=None, *, position=None, velocity=0.0, **knobs):
    """Following errors and duties of a controller on the axis, by default from rest."""
    controller = controller or ruled()
    start = float(reference[0] if position is None else position)
    axis = BallscrewAxis(BallscrewAxisConfig(**knobs), position=start, velocity=velocity)
    speeds = np.gradient(reference, PERIOD)
    acceleration = np.pad(np.diff(reference, 2), 1) / PERIOD**2
    course = []
    for target, speed, change in np.column_stack([reference, speeds, acceleration]).tolist():
        error = target - axis.position
        duty = controller.step(target, axis.measure(), speed, change)
        course.append((error, duty))
        axis.drive(duty)
    error, duty = np.array(course).T
    assert not controller.watch.fault
    return error, duty


def millimetres(error):
    """Largest and rms error [mm]."""
    return 1e3 * float(np.abs(error).max()), 1e3 * rms(error)


def rms(values):
    return float(np.sqrt(np.mean(np.square(values))))


def test_the_real_loop_lags_as_published(recording):
    error = recording['qg'] - recording['qm']
    assert 1e3 * np.abs(error).max() == pytest.approx(0.852, abs=0.0005)
    assert 1e3 * rms(error) == pytest.approx(0.578, abs=0.0005)


@pytest.mark.parametrize(
    ('config', 'off'),
    [(BallscrewAxisConfig(), 0.048), (BallscrewAxisConfig.by_direction(), 0.040)],
    ids=['symmetric', 'by direction'],
)
def test_the_simulated_loop_is_the_recorded_one(recording, config, off):
    difference, voltage = mismatch(recording, config)
    assert 1e6 * rms(difference) < 3.3  # the reference reached 3.1, at most 5 is asked for
    assert 1e6 * np.abs(difference).max() < 15.0
    # the model's own residual is published as 4.08 %; so stiff a loop shows it in the voltage
    assert voltage < off


@pytest.mark.parametrize(
    'wrong',
    [
        {'mass': 0.9 * 95.1},
        {'mass': 1.1 * 95.1},
        {'viscous_forward': 163.0, 'viscous_backward': 163.0},
        {'viscous_forward': 244.0, 'viscous_backward': 244.0},
        {'coulomb_forward': 16.3, 'coulomb_backward': 16.3},
        {'coulomb_forward': 24.5, 'coulomb_backward': 24.5},
        {'offset': 0.0},
        {'force_constant': 1.1 * 35.15},
    ],
    ids=str,
)
def test_the_match_shows_a_wrong_parameter(recording, voltage_off, wrong):
    _, off = mismatch(recording, BallscrewAxisConfig(**wrong))
    assert off > 1.4 * voltage_off


def test_the_recorded_reference_began_at_rest_at_zero(recording, reference):
    ahead = len(reference) - len(recording['qg'])
    assert ahead == 16
    assert abs(reference[0]) < 1e-12
    # one acceleration from there into the recording
    np.testing.assert_allclose(np.diff(reference[: ahead + 20], 2), 0.84236e-6, rtol=1e-4)


def test_the_settings_keep_the_margins_of_the_recorded_loop(recording):
    # chosen on the nominal model alone: not faster than what the machine has been run with
    model = BallscrewAxisConfig().linear()
    dynamics, duty, _ = model.discrete()
    frequency = np.geomspace(5.0, 3000.0, 4000)
    unit = np.exp(1j * frequency * PERIOD)
    kp, kv = recording['kp'].item(), recording['kv'].item()

    def states(matrix, entry):
        return np.array([np.linalg.solve(z * np.eye(len(entry)) - matrix, entry) for z in unit])

    def crossing(loop):
        at = int(np.argmin(np.abs(np.log(np.abs(loop)))))
        return frequency[at], 180.0 + np.degrees(np.angle(loop[at]))

    recorded = states(dynamics, duty) @ [kv, kp * kv] / BallscrewAxisConfig().voltage_max
    params = ruled().params
    design = ObserverDesign.of(model, ObserverNoise.of_bandwidth(model, 240.0))
    row = np.array([-params.rate_gain, -params.error_gain, 1.0])
    estimator = (
        design.dynamics - np.outer(design.gain, design.reading) + np.outer(design.duty, row)
    )
    ours = -(states(dynamics, duty) @ model.c) * (states(estimator, design.gain) @ row)
    assert crossing(recorded) == (pytest.approx(138.0, abs=1.0), pytest.approx(37.7, abs=0.5))
    assert crossing(ours) == (pytest.approx(129.0, abs=1.0), pytest.approx(44.3, abs=0.5))


def test_our_controller_follows_the_recorded_reference(followed):
    largest, mean = millimetres(followed['nominal'][0])
    assert largest <= 0.10
    assert mean <= 0.020
    assert largest < 0.006  # against 0.852 and 0.578 of the real loop
    assert mean < 0.0013


@pytest.mark.parametrize('name', list(VARIATIONS))
def test_it_follows_on_an_axis_it_was_not_set_for(followed, name):
    error, duty = followed[name]
    largest, mean = millimetres(error)
    assert largest <= 0.20
    assert mean <= 0.040
    assert largest < 0.08
    assert mean < 0.019
    assert np.abs(duty).max() < 0.55


def test_without_friction_fed_forward_it_follows_too(reference):
    # the plain production controller with scaled universes
    bounds = {'nominal': (0.06, 0.007), 'mass': (0.08, 0.020), 'friction': (0.14, 0.017)}
    for name in HARDEST:
        plain = ruled(friction=0.0)
        found = millimetres(follow(reference, plain, **CASES[name])[0])
        assert np.all(np.array(found) < bounds[name.split(' ')[0]])


def test_from_the_recorded_state_the_first_error_decides(recording):
    # when the recording begins the axis is 0.1003 mm behind and moves at 40 % of the speed
    position, speed = recording['qm'][0], 0.00565
    error, _ = follow(recording['qg'], position=position, velocity=speed)
    assert 1e3 * error[0] == pytest.approx(0.1003, abs=0.0001)
    largest, mean = millimetres(error)
    assert largest < 0.16
    assert mean < 0.008
    assert millimetres(error[150:])[0] < 0.006


def test_what_the_fuzzy_surface_contributes(reference):
    # left out: feedforward and observed disturbance alone hold no position
    without = ruled(output_gain=1e-9)
    largest, mean = millimetres(follow(reference, without)[0])
    assert largest > 0.15
    assert mean > 0.1
    for name in HARDEST[1:]:
        without.reset()
        assert millimetres(follow(reference, without, **CASES[name])[0])[0] > 0.6


@pytest.mark.parametrize('name', HARDEST)
def test_its_tangent_follows_as_well(reference, followed, name):
    # a proportional-derivative law with the surface's slopes at the origin, beside the same
    # feedforward and observer: in following, the surface does not matter further
    params = ruled().params
    tangent = ruled(
        error_range=1e4 * params.error_range,
        rate_range=1e4 * params.rate_range,
        output_gain=1e4 * params.output_gain,
        error_exponent=1.0,
        rate_exponent=1.0,
    )
    assert tangent.params.error_gain == pytest.approx(params.error_gain)
    assert tangent.params.rate_gain == pytest.approx(params.rate_gain)
    linear = follow(reference, tangent, **CASES[name])[0]
    assert millimetres(linear) == pytest.approx(millimetres(followed[name][0]), rel=0.02)


def pulsed(reference, control, volts, sign):
    """Following errors [m] under pulses of half a second, as the real axis had them."""
    config = BallscrewAxisConfig()
    axis = BallscrewAxis(config, position=float(reference[0]))
    speeds = np.gradient(reference, PERIOD)
    acceleration = np.pad(np.diff(reference, 2), 1) / PERIOD**2
    errors = []
    for step, (target, speed, change) in enumerate(
        np.column_stack([reference, speeds, acceleration]).tolist()
    ):
        duty = control(axis, target, speed, change)
        errors.append(target - axis.position)
        pulse = sign * volts / config.voltage_max * (step // 500 % 2)
        axis.drive(min(max(duty + pulse, -1.0), 1.0))
    return np.array(errors)


def published_with_feedforward(axis, target, speed, change):
    """The real machine's PD, with mass and friction fed forward; its velocity is ideal [-]."""
    config = BallscrewAxisConfig()
    volts = 160.18 * 243.45 * (target - axis.measure()) + 243.45 * (speed - axis.velocity)
    force = config.mass * change + config.viscous_forward * speed + config.offset
    force += config.coulomb_forward * float(np.sign(speed))
    return (volts + force / config.force_constant) / config.voltage_max


@pytest.mark.parametrize('volts', rest_slow([1.0, 2.5, 5.0], 2))
@pytest.mark.parametrize('sign', [1.0, -1.0])
def test_pulses_of_half_the_drive_are_borne(recording, volts, sign):
    """As the real machine bore them, and by the node's default better than under its own law."""
    reference = from_rest(recording['qg'])[:8000]
    tuned = make_controllers(ServoControllerConfig(axes=('X:ballscrew',)))['X']
    fuzzy = ruled()
    error, plain, own = (
        1e3 * np.abs(pulsed(reference, control, volts, sign)).max()
        for control in (
            published_with_feedforward,
            lambda axis, *aim: fuzzy.step(aim[0], axis.measure(), *aim[1:]),
            lambda axis, *aim: tuned.step(aim[0], axis.measure(), *aim[1:]),
        )
    )
    assert tuned.watch.fault == fuzzy.watch.fault == ''
    assert own < 0.6 * error
    assert plain < 1.6 * error

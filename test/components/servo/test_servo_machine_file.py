# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Axes of a machine file under control: their data, controllers and limits, and refusals."""

from dataclasses import replace

import numpy as np
import pytest
from bag_libraries import need_bag_libraries
from benches.positioning_run import PositioningError, run_positioning
from hypothesis import given
from hypothesis import strategies as st

from fuzzycnc_ros.components.machine.simulated_machine import (
    SimulatedMachine,
    SimulatedMachineConfig,
)
from fuzzycnc_ros.components.servo.servo_controller import TELL_EVERY, ServoController
from fuzzycnc_ros.components.servo.servo_controller_config import (
    ServoControllerConfig,
    make_controllers,
)
from fuzzycnc_ros.core.machine.axis_models import BallscrewAxisConfig, LatheAxisConfig
from fuzzycnc_ros.core.machine.machine_data import (
    AxisData,
    AxisLimits,
    MachineData,
    axis_texts,
    parse_axis_texts,
)
from fuzzycnc_ros.core.servo.axis_control import AXIS_CONTROLLERS, make_axis_controller
from fuzzycnc_ros.core.servo.profile import ProfileLimits, point_to_point
from fuzzycnc_ros.machine_file.parameters import node_parameters
from fuzzycnc_ros.replay.replay import replay
from fuzzycnc_ros.simulation.servo.axes import simulated_axis
from fuzzycnc_ros.simulation.servo.positioning import position
from fuzzycnc_ros.studies.published_bag import PublishedBag

SLOW = AxisData(
    limits=AxisLimits(
        velocity=0.1,
        acceleration=1.0,
        positioning_jerk=20.0,
        travel_low=0.05,
        travel_high=0.45,
        load=0.2,
        friction=0.1,
    ),
    plant=LatheAxisConfig(
        gain=0.15, velocity_lag=0.03, delay=1.5e-3, coulomb=0.04, breakaway=0.05
    ),
    controller='cascade',
    settings={'bandwidth': 1.5},
)
"""A slow axis that is nowhere near 0."""
HEAVY = AxisData(
    limits=AxisLimits(load=0.3),
    plant=BallscrewAxisConfig(mass=150.0, drive_lag=1e-3),
    controller='pid',
)
BARE = AxisData()


def of(*axes, **changes):
    """Return parameters of the controller for axes of a machine file."""
    data = {'Y': SLOW, 'Z': HEAVY, 'B': BARE} | changes.pop('data', {})
    parameters = node_parameters(MachineData(axes=data))['servo_controller']
    names = tuple(f'{axis}:machine_file' for axis in axes)
    return ServoControllerConfig(**{**parameters, 'axes': names, **changes})


@given(
    st.floats(1e-6, 1.0),
    st.floats(1e-5, 10.0),
    st.sampled_from(['', *AXIS_CONTROLLERS]),
    st.dictionaries(st.sampled_from(['bandwidth', 'damping']), st.floats(0.5, 2.0)),
)
def test_axes_are_read_as_they_are_written(gain, lag, controller, settings):
    plant = LatheAxisConfig(gain=gain, velocity_lag=lag, sensor='encoder', direction=-1.0)
    axes = {
        'X': AxisData(plant=plant, controller=controller, settings=settings),
        'Y': SLOW,
        'Z': HEAVY,
        'B': BARE,
    }
    assert parse_axis_texts('axis_data', axis_texts(axes)) == axes


@pytest.mark.parametrize(
    ('texts', 'message'),
    [
        (('X',), 'axis_data: expected <axis>:<name>:<value>.* found .X'),
        (('X:model:lags', 'X:model:lags'), 'each once'),
        (('X:model:gears',), 'X:model: expected one of lags, mass, none but found .gears'),
        (('X:colour:red',), "axis_data: X: expected model, .* found 'colour'"),
        (('X:plant.gain:1',), "axis_data: X: expected model, .* found 'plant.gain'"),
        (('X:model:lags', 'X:plant.gain:fast'), 'X:plant.gain: expected a number .*fast'),
        (('X:model:lags', 'X:plant.gain:-1.0'), 'axis_data: X: gain = -1.0 is outside'),
        (('X:settings.bandwidth:',), 'X:settings.bandwidth: expected a number'),
    ],
)
def test_texts_that_are_no_axis_are_refused(texts, message):
    with pytest.raises(ValueError, match=message):
        parse_axis_texts('axis_data', texts)


@pytest.mark.parametrize(
    ('make', 'message'),
    [
        (lambda: of('Q'), 'axes: expected an axis of the machine file, Y, Z, B, but found Q'),
        (lambda: of('B'), r'axes: expected the model \(plant\) of B .* machine identify'),
        (
            lambda: ServoControllerConfig(axes=('X:machine_file',)),
            'axes: expected data of the axis X but found none; give the machine file',
        ),
        (
            lambda: of('Y', data={'Y': replace(SLOW, controller='', settings={})}),
            'axes: expected a tuned controller of Y .* servo tune .* axis_controller',
        ),
        (lambda: of('Y', period=2e-3), 'period: expected 0.001 s, the control period of Y'),
        (lambda: of('Y', axis_controller='fuzzy'), 'axis_controller: expected one of'),
        (
            lambda: ServoController(of('Y', data={'Y': replace(SLOW, controller='mrac')})),
            "axis_data: Y: controller: expected one of pid, .* found 'mrac'",
        ),
        (
            lambda: ServoController(of('Y', data={'Y': replace(SLOW, settings={'speed': 1.0})})),
            "axis_data: Y: settings: expected bandwidth, .* found 'speed'",
        ),
        (
            lambda: SimulatedMachine(
                SimulatedMachineConfig(duties=(), servo_axes=('X:machine_file',), moves=('X:0.1',))
            ),
            'servo_axes: expected data of the axis X but found none',
        ),
        (
            lambda: SimulatedMachine(
                SimulatedMachineConfig(
                    duties=(),
                    servo_axes=('Y:machine_file',),
                    axis_data=axis_texts({'Y': SLOW}),
                    axis_interpolation_period=2e-3,
                    moves=('Y:0.1',),
                )
            ),
            'axis_interpolation_period: expected 0.001 s, the control period of Y',
        ),
    ],
)
def test_what_the_file_does_not_know_is_refused(make, message):
    with pytest.raises(ValueError, match=message):
        make()


@pytest.mark.parametrize('name', ['machine_file', *AXIS_CONTROLLERS])
def test_duties_are_those_of_the_core_with_the_controller_that_is_asked_for(name):
    """Bit for bit, on its own plant; another controller than the file's is untuned."""
    (move,) = run_positioning(('Z:0.05',), of('Z', axis_controller=name))
    chosen = HEAVY.controller if name == 'machine_file' else name
    own = make_axis_controller(HEAVY, chosen)
    velocity, acceleration, jerk = HEAVY.limits.positioning
    limits = ProfileLimits(velocity=velocity, acceleration=acceleration, jerk=jerk)
    reference = point_to_point(0.0, 0.05, limits).sample(1e-3)
    alone = position(own, simulated_axis(HEAVY), reference, 0.7)
    moving = np.flatnonzero(move.duty)[0]
    begun = np.flatnonzero(alone.duty)[0]
    size = 600
    np.testing.assert_array_equal(
        move.duty[moving : moving + size], alone.duty[begun : begun + size]
    )


def test_axes_of_a_file_arrive_and_their_bag_needs_no_file(tmp_path):
    """Also those nowhere near 0; what the file says is in the bag."""
    need_bag_libraries()
    with PublishedBag(tmp_path / 'bag') as sink:
        moves = run_positioning(('Y:0.1,Z:-0.05', 'Y:0.06,Z:0.0'), of('Y', 'Z'), sink=sink)
    assert [(item.axis, item.target) for item in moves] == [
        ('Y', 0.1), ('Z', -0.05), ('Y', 0.06), ('Z', 0.0),
    ]  # fmt: skip
    assert all(item.fault == '' and item.left < 5e-6 for item in moves)
    report = replay(tmp_path / 'bag')
    assert report.identical, report.topics


def test_limits_of_the_file_are_those_of_travel_motion_and_watch():
    config = of('Y')
    watch = make_controllers(config)['Y'].watch.limits
    assert watch.error_max == pytest.approx(0.4)
    assert watch.load == pytest.approx(0.3)
    assert watch.bad_max == config.missed_max
    axis = ServoController(config)._axes[0]
    assert (axis.motion._doubt.load, axis.motion._doubt.friction) == (0.2, 0.1)
    assert 'expected Y within 50 to 450 mm but found 20 mm' in axis.refusal(0.02, 0.1)
    assert make_controllers(of('Y', duty_max=0.5))['Y'].duty_max == 0.5
    (move,) = run_positioning(('Y:0.12',), config, SimulatedMachineConfig(move_time=2.0))
    assert np.diff(move.reference).max() == pytest.approx(0.1 * TELL_EVERY, rel=1e-3)
    wide = of('Y', 'Z')
    assert wide.velocity_max == HEAVY.limits.velocity


def test_a_load_beyond_what_the_file_says_is_found_and_one_within_is_not():
    """The built-in axes take 12 %; this one 20 %."""
    config, seen = of('Y'), {}
    for load in (0.18, 0.4):
        machine = SimulatedMachineConfig(
            servo_axes=config.axes,
            axis_data=config.axis_data,
            servo_plant=(f'Y:load:{load}', 'Y:load_time:0.6'),
            move_time=2.0,
            move_tolerance=1e-4,
        )
        try:
            (move,) = run_positioning(('Y:0.1',), config, machine)
            seen[load] = move.fault
        except PositioningError as error:
            seen[load] = str(error)
    assert seen[0.18] == ''
    assert 'Y: axis runs away against its duty: wrong sign or load' in seen[0.4]


def test_a_wrong_sign_is_found():
    config = of('Y')
    machine = SimulatedMachineConfig(
        servo_axes=config.axes, axis_data=config.axis_data, servo_plant=('Y:direction:-1',)
    )
    with pytest.raises(PositioningError, match='expected Y within'):
        run_positioning(('Y:0.1',), config, machine)
    run_positioning(('Y:0.1',), of('Y', reversed_axes=('Y',)), machine)

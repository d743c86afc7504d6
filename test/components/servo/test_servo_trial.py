# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Trials of a controller on a driven axis: what begins one, what ends one, what is back then."""

from dataclasses import replace

import numpy as np
import pytest
from benches.component_bench import machine_state
from benches.servo_bench import PERIOD, Axis

from fuzzycnc_ros.core.machine.axis_models import BallscrewAxisConfig
from fuzzycnc_ros.core.machine.machine_data import AxisData, AxisLimits, axis_hash, axis_texts
from fuzzycnc_ros.core.servo.course import there_and_back
from fuzzycnc_ros.core.servo.profile import ProfileLimits
from fuzzycnc_ros.runtime.enums import MachineMode, ServoStatus, TrialStatus
from fuzzycnc_ros.runtime.records import SECOND, ServoTrial, Trajectory
from fuzzycnc_ros.simulation.servo.axes import BallscrewAxis

DATA = AxisData(
    limits=AxisLimits(travel_low=-0.1, travel_high=0.1, velocity=0.1, acceleration=1.0),
    plant=BallscrewAxisConfig(),
    controller='pid',
    settings={'bandwidth': 1.0},
)
GOOD = {'bandwidth': 1.5, 'damping': 1.0, 'estimator': 0.5}
WAY = 0.02
COURSE = 2.2
"""Time of the way there and back, its rests included, and a little more [s]."""


class Tried(Axis):
    """An axis of a machine file whose operator holds trials, or does not."""

    def __init__(self, data=DATA, plant=None, **config):
        plants = {'X': BallscrewAxis(plant or data.plant)}
        config |= {'axes': ('X:machine_file',), 'axis_data': axis_texts({'X': data})}
        super().__init__(plants, **config)
        self.hash = axis_hash('X', data)
        self.machine()
        self.run(0.05)

    def machine(self, **changes):
        """Have the machine say what it does."""
        known = {'state': int(MachineMode.ON), 'spindle_speed': 0.0}
        assert self.push('machine_state', machine_state(self.now / SECOND, **known | changes))

    def sign(self, number=1, settings=GOOD, **changes):
        """Give a sign of life for a trial, or ask for one."""
        asked = {
            'axis_name': 'X',
            'machine_file': self.hash,
            'controller': 'pid',
            'setting': tuple(settings),
            'value': np.array([*settings.values()], float),
            'gain': 1.0,
            'way': WAY,
            'pace': 1.0,
            'error_max': 5e-3,
        }
        self.push('servo_trial', ServoTrial(stamp=self.now, trial=number, **asked | changes))

    def held(self, time, number=1, **changes):
        """Hold a trial for some time [s]."""
        for _ in range(round(10.0 * time)):
            self.sign(number, **changes)
            self.run(0.1)

    def outcome(self):
        """Return what was said last of a trial: status and reason."""
        last = self.records('servo_trial_state')[-1]
        return TrialStatus(last.status), last.reason

    def is_back(self):
        """Return whether the axis rests where it was, under its own controller."""
        self.run(1.0)
        own = self.merger.component._axes[0]
        return (
            abs(self.place()) < 2e-6
            and self.state.status == ServoStatus.RESTING
            and own.controller is own._own
            and own.gain == 1.0
        )


def test_a_trial_makes_its_way_and_tells_how_well_it_followed():
    axis = Tried()
    before = len(axis.records('axis_command'))
    axis.held(COURSE)
    done = axis.records('servo_trial_state')[-1]
    assert [item.status for item in axis.records('servo_trial_state')] == [
        TrialStatus.RUNNING,
        TrialStatus.DONE,
    ]
    assert 0.0 < done.rest < done.rms < done.largest < 1e-3
    assert axis.is_back()
    # one command a period, whoever drives
    stamps = [item.stamp for item in axis.records('axis_command')[before:]]
    assert set(np.diff(stamps)) == {PERIOD}
    # the same trial again is none: its number is used up
    axis.held(0.2)
    assert axis.records('servo_trial_state')[-1] is done


def test_a_factor_on_the_duty_is_an_axis_of_that_gain():
    scaled, strong = Tried(), Tried(plant=replace(DATA.plant, gain_factor=1.5))
    scaled.held(COURSE, gain=1.5)
    strong.held(COURSE)
    mine, its = (axis.records('servo_trial_state')[-1] for axis in (scaled, strong))
    assert mine.rms == pytest.approx(its.rms, rel=0.02)
    assert mine.largest == pytest.approx(its.largest, rel=0.05)


def test_a_trajectory_leads_a_trial_without_a_way_of_its_own():
    led, own = Tried(), Tried()
    own.held(COURSE)
    limits = ProfileLimits(velocity=0.1, acceleration=1.0, jerk=30.0)
    rows = there_and_back(WAY, limits, 1e-3).rows
    led.sign(way=0.0)
    led.run(0.002)
    part = Trajectory(
        stamp=led.now,
        frame_id='mill/workpiece',
        path_id='led',
        epoch=1,
        part=0,
        last=True,
        start=led.now + 5 * PERIOD,
        period=1e-3,
        committed=len(rows),
        axis=('X',),
        position=rows[:, 0] + led.merger.component._axes[0].reference,
        velocity=rows[:, 1],
        arc_length=np.append(0.0, np.cumsum(np.abs(np.diff(rows[:, 0])))),
    )
    assert led.push('trajectory', part)
    led.held(COURSE, way=0.0)
    assert led.outcome() == (TrialStatus.DONE, '')
    mine, its = (axis.records('servo_trial_state')[-1] for axis in (led, own))
    assert mine.rms == pytest.approx(its.rms, rel=0.1)
    assert mine.largest == pytest.approx(its.largest, rel=0.1)
    assert mine.rest == pytest.approx(its.rest, rel=0.5)
    assert led.is_back()


def test_a_trial_ends_half_a_second_after_the_last_sign_of_life():
    axis = Tried()
    axis.held(0.3)
    last = axis.now - SECOND // 10
    axis.run(0.6)
    ended = axis.records('servo_trial_state')[-1]
    assert 'no sign of life' in ended.reason
    assert 0 <= ended.stamp - last - SECOND // 2 <= 2 * PERIOD
    assert axis.is_back()


def test_an_operator_who_lets_go_ends_it_at_once():
    axis = Tried()
    axis.held(0.6)
    axis.sign(controller='')
    axis.run(0.002)
    assert axis.outcome() == (TrialStatus.ENDED, 'its operator has ended it')
    assert axis.is_back()
    assert 'OK state: resting' in axis.health()


def test_growth_ends_a_trial_before_it_is_large_and_the_axis_goes_on():
    late = replace(DATA.plant, delay=3e-3)  # the model knows nothing of it
    axis = Tried(plant=late)
    places = []
    for _ in range(20):
        axis.sign(settings={'bandwidth': 4.0, 'damping': 1.0, 'estimator': 1.0})
        for _ in range(100):
            axis.tick()
            places.append(axis.place())
    status, reason = axis.outcome()
    assert status == TrialStatus.ENDED
    assert 'swings' in reason or 'chatters' in reason
    assert max(np.abs(places)) < WAY + 5e-3
    assert axis.is_back()


def test_force_and_error_have_their_limits():
    fast = replace(DATA, limits=replace(DATA.limits, velocity=0.5, acceleration=3.0))
    weak = Tried(fast, plant=replace(DATA.plant, gain_factor=0.45))
    weak.held(1.5, way=0.09, error_max=1.0)
    assert 'at its limit' in weak.outcome()[1]
    bound = Tried()
    bound.held(COURSE, error_max=2e-6)
    assert 'following error is beyond 0.002 mm' in bound.outcome()[1]
    assert bound.is_back()


@pytest.mark.parametrize(
    ('change', 'reason'),
    [
        ({'spindle_speed': 10.0}, 'spindle'),
        ({'spindle_speed': float('nan')}, 'spindle'),
    ],
)
def test_a_machine_that_begins_to_work_ends_it_and_lets_none_begin(change, reason):
    axis = Tried()
    axis.held(0.4)
    axis.machine(**change)
    axis.run(0.01)
    assert axis.outcome()[0] == TrialStatus.ENDED
    assert reason in axis.outcome()[1]
    assert axis.is_back()
    axis.sign(2)
    axis.run(0.01)
    assert axis.outcome()[0] == TrialStatus.REFUSED
    assert reason in axis.outcome()[1]


def test_a_machine_that_switches_off_ends_it_with_the_duties_at_zero():
    axis = Tried()
    axis.held(0.4)
    axis.machine(state=int(MachineMode.ESTOP))
    axis.run(0.01)
    assert axis.outcome()[0] == TrialStatus.ENDED
    assert axis.duty['X'] == 0.0
    axis.run(0.5)
    axis.machine()
    axis.run(0.5)
    assert axis.state.status == ServoStatus.RESTING
    assert axis.merger.component._axes[0].gain == 1.0


def test_feedback_that_stops_is_a_fault_in_a_trial_too():
    axis = Tried()
    axis.held(0.5)
    for _ in range(40):
        axis.tick(heard=False)
        axis.emitted += axis.merger.advance(axis.now)
    axis.run(0.01)
    assert 'feedback has stopped' in axis.outcome()[1]
    assert axis.state.status == ServoStatus.FAULT
    axis.sign(2)
    axis.run(0.01)
    assert axis.outcome()[0] == TrialStatus.REFUSED
    assert 'no alarm' in axis.outcome()[1]


@pytest.mark.parametrize(
    ('data', 'change', 'reason'),
    [
        (replace(DATA, limits=replace(DATA.limits, vertical=True)), {}, 'no brake'),
        (DATA, {'machine_file': '0' * 64}, 'machine file that servo_controller was started'),
        (DATA, {'axis_name': 'Z'}, 'expected one of a machine file'),
        (DATA, {'way': 0.11}, 'within its travel'),
        (DATA, {'way': float('nan')}, 'expected a gain'),
        (DATA, {'pace': 0.002}, 'within 12 s'),
        (DATA, {'controller': 'best'}, 'controller'),
        (DATA, {'settings': {'bandwidth': 1e9}}, 'bandwidth'),
        (DATA, {'settings': {'bandwidth': float('nan')}}, 'bandwidth'),
    ],
)
def test_what_is_not_safe_is_refused_in_one_line_and_moves_nothing(data, change, reason):
    axis = Tried(data)
    axis.sign(**change)
    axis.run(0.05)
    status, why = axis.outcome()
    assert status == TrialStatus.REFUSED
    assert reason in why
    assert '\n' not in why
    assert abs(axis.place()) < 1e-6


def test_an_axis_outside_its_soft_limits_or_on_its_way_is_not_tried():
    outside = Tried(replace(DATA, limits=replace(DATA.limits, travel_low=0.01)))
    outside.sign()
    outside.run(0.01)
    assert 'within its travel' in outside.outcome()[1]
    moving = Tried()
    moving.go(X=0.05)
    moving.run(0.1)
    moving.sign()
    moving.run(0.01)
    assert 'at rest' in moving.outcome()[1]


def test_an_activation_begins_no_trial_that_was_asked_for_before():
    axis = Tried()
    assert axis.request('deactivate').success
    axis.sign()
    axis.merger.advance(axis.now)
    assert axis.request('activate').success
    axis.run(0.1)
    assert not axis.records('servo_trial_state')
    assert axis.state.status == ServoStatus.RESTING


def test_nothing_else_moves_the_axes_in_a_trial():
    axis = Tried()
    axis.held(0.2)
    axis.go(X=0.05)
    axis.run(0.01)
    assert 'WARN command: position_command: a controller is being tried' in axis.health()
    axis.held(COURSE)
    assert axis.outcome()[0] == TrialStatus.DONE
    assert axis.is_back()

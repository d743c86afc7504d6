# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The bridge against LinuxCNC's registers and HAL file as they were measured, without a HAL."""

from dataclasses import replace

import numpy as np
import pytest
from benches.bridge_bench import Compensated
from benches.linuxcnc_rig import (
    CYCLE,
    HOLD,
    RATE,
    SCALE,
    SLEW,
    Controller,
    Rig,
    ThreadController,
    settled,
)
from benches.probe_rig import zeroed
from hypothesis import given, settings
from hypothesis import strategies as st

from fuzzycnc_ros.adapters.linuxcnc.linuxcnc_bridge import LinuxcncBridge, LinuxcncBridgeConfig
from fuzzycnc_ros.adapters.linuxcnc.status import ServoThreadLimits
from fuzzycnc_ros.adapters.probing.programs import BEGIN, END
from fuzzycnc_ros.core.inputs.offset_input import OffsetStatus
from fuzzycnc_ros.runtime.enums import Coolant, TouchKind
from fuzzycnc_ros.runtime.records import nanoseconds


def test_inactive_it_reads_and_writes_nothing():
    rig = Rig(active=False)
    rig.run(0.5)
    rig.command((10, 0, 0))
    rig.run(0.5)
    assert rig.bridge.orders is None
    assert (rig.last.status, rig.last.reason) == (OffsetStatus.IDLE, '')
    assert rig.at((0, 0, 0))
    assert not rig.allowed


def test_follows_at_the_slew_limit():
    rig = settled()
    assert rig.allowed
    assert rig.largest_step <= SLEW * CYCLE + SCALE
    assert rig.last.epoch == 1


def test_touches_of_a_probing_cycle_are_passed_on_once():
    rig = Rig(active=False)
    rig.controller.probe = (5.0, 12.0)  # of an older cycle
    rig.run(0.1)
    for code, value in ((BEGIN, 4711.0), (1.0, -52.5), (2.0, -52.5), (-3.0, 0.0), (END, 0.0)):
        rig.controller.probe = (code, value)
        rig.run(0.1)
    found = [(item.kind, item.number) for item in rig.bench.records('probe_touch')]
    assert found == [
        (TouchKind.BEGIN, 4711),
        (TouchKind.TOUCH, 1),
        (TouchKind.TOUCH, 2),
        (TouchKind.MISS, 3),
        (TouchKind.END, 0),
    ]
    touch = rig.bench.records('probe_touch')[1]
    assert touch.position == pytest.approx(-0.0525)
    assert touch.includes_offset


def test_a_clock_that_stands_still_loses_no_touch():
    rig = Rig(active=False)
    stamps = []
    for code in (7.0, BEGIN, 1.0, 2.0):
        for _ in range(2):
            rig.controller.probe = (code, 0.0)
            found = rig.bridge.observe(nanoseconds(5.0), rig.controller.cycle())
            stamps += [item.record.stamp for item in found if item.output == 'probe_touch']
    assert len(set(stamps)) == 3


def test_what_the_axes_have_moved_is_told():
    rig = Rig(active=False)
    rig.run(0.1)
    for step in range(100):
        rig.controller.position = np.array([1e-3 * (step % 2), 1e-3 * step, 0.0])
        rig.run(CYCLE)
    rig.run(1.0)
    state = rig.bench.records('machine_state')[-1]
    np.testing.assert_allclose(state.travel, [0.099, 0.099, 0.0], atol=1e-9)
    np.testing.assert_allclose(state.square_speed, [0.0099, 0.0099, 0.0], rtol=1e-6)
    # where they moved: X evenly from 0 to 1 mm, Y from 0 to 99 mm
    moments = np.array([state.travel_moment[:2], state.travel_second_moment[:2]])
    ends = np.array([1e-3, 0.099])
    np.testing.assert_allclose(moments, 0.099 * np.array([ends / 2, ends**2 / 3]), rtol=1e-6)
    assert state.coolant == Coolant.UNKNOWN
    rig.bench.emitted += rig.bridge.lose(nanoseconds(rig.time), 'it has ended')
    rig.controller.position = np.array([0.0, 5.0, 0.0])
    rig.run(1.0)
    assert rig.bench.records('machine_state')[-1].travel[1] == pytest.approx(0.099)


def test_what_is_due_is_shown():
    rig = Rig(active=False)
    assert not rig.bridge.probe_due
    state = replace(zeroed().state, due=True)
    rig.bench.push('probe_cycle_state', state)
    rig.bench.until(state.stamp * 1e-9)
    assert rig.bridge.probe_due


def test_counts_are_whole():
    rig = settled((0.123456, 0, 0))
    assert rig.controller.told[0] == 12
    assert abs(rig.last.offset[0] - 0.123456e-6) <= 0.5 * SCALE + 1e-12


def test_slope_is_refused_where_the_servo_thread_takes_none():
    rig = settled((0, 0, 0))
    rig.command((10, 0, 0), slope=(1e-4, 0, 0), reference=(0.1, 0, 0))
    rig.run(2.0)
    assert rig.last.status == OffsetStatus.REFUSED
    assert 'LinuxCNC takes none on X; its HAL file is fuzzycnc.hal; load' in rig.last.reason
    assert rig.at((0, 0, 0))


def test_line_follows_the_axis_between_two_cycles():
    rig = settled((0, 0, 0), controller=ThreadController())
    rig.command((10, 0, 0), slope=(1e-4, 0, 0), reference=(0.1, 0, 0))
    rig.controller.position = np.array([0.3, 0, 0])
    rig.run(3.0)
    assert rig.at((30, 0, 0))
    told = rig.bridge.orders
    rig.controller.position = np.array([-0.1, 0, 0])
    rig.controller.cycle(steps=1000)
    np.testing.assert_allclose(rig.controller.applied[0], -10e-6, atol=SCALE)
    assert rig.bridge.orders is told
    rig.run(0.5)
    assert rig.at((-10, 0, 0))
    assert not rig.last.at_limit.any()
    np.testing.assert_allclose(rig.last.slope, [1e-4, 0, 0], atol=1e-15)
    np.testing.assert_allclose(rig.last.position, [-0.1, 0, 0])


def test_line_is_cut_where_it_is_too_large_and_nowhere_else():
    rig = settled((0, 0, 0), controller=ThreadController())
    rig.command((10, 0, 0), slope=(4e-4, 0, 0))
    rig.run(5.0)
    assert rig.at((10, 0, 0))
    assert not rig.last.at_limit.any()
    rig.controller.position = np.array([0.3, 0, 0])
    rig.run(1.0)
    assert rig.at((60, 0, 0))
    assert rig.last.at_limit.tolist() == [True, False, False]
    assert 'cut at the limit of X 60.00 um' in rig.last.reason


def test_too_steep_a_line_is_cut():
    rig = settled((0, 0, 0), controller=ThreadController())
    rig.command((10, 0, 0), slope=(9e-4, 0, 0))
    rig.controller.position = np.array([0.05, 0, 0])
    rig.run(5.0)
    assert rig.at((35, 0, 0))
    assert rig.last.at_limit.tolist() == [True, False, False]
    assert rig.last.reason == 'slope of X cut at 500 um/m'


def test_a_slope_without_a_travel_is_refused():
    rig = settled((0, 0, 0), controller=ThreadController(travel=0.0))
    rig.command((10, 0, 0), slope=(1e-4, 0, 0))
    rig.run(1.0)
    assert 'give MIN_LIMIT and MAX_LIMIT of X' in rig.last.reason


def test_new_bridge_goes_on_along_the_line_that_stands():
    rig = settled((0, 0, 0), controller=ThreadController())
    rig.command((10, 0, 0), slope=(1e-4, 0, 0))
    rig.controller.position = np.array([0.2, 0, 0])
    rig.run(3.0)
    rig.silence(1.0)
    rig.restart()
    rig.run(1.0)
    assert rig.at((30, 0, 0))
    rig.controller.position = np.array([0.0, 0, 0])
    rig.run(1.0)
    assert rig.at((10, 0, 0))


def test_offsets_stay_in_joint_mode_and_go_on_after_it():
    rig = settled((0, 0, 20), controller=ThreadController())
    rig.controller.tracking = False
    rig.command((0, 0, 40))
    rig.run(3.0)
    assert 'stays at Z 20.00 um instead of Z 40.00 um' in rig.last.reason
    rig.controller.tracking = True
    begin = len(rig.path)
    rig.run(2.0)
    assert rig.at((0, 0, 40))
    assert not rig.last.reason
    steps = np.abs(np.diff(rig.path[begin:], axis=0)).max()
    assert steps <= RATE * SCALE * CYCLE + SCALE


def test_ramps_to_zero_before_it_lets_go():
    rig = settled()
    assert rig.bench.request('deactivate').success
    assert not rig.bench.request('deactivate').success
    rig.run(0.1)
    assert 'inactive while' in rig.last.reason
    assert 'ramping to zero' in rig.last.reason
    assert rig.bridge.orders is not None
    assert not rig.bridge.at_rest
    rig.run(2.0)
    assert rig.bridge.at_rest
    assert rig.bridge.orders is None
    assert rig.at((0, 0, 0))
    assert rig.largest_step <= SLEW * CYCLE + SCALE


def test_expired_command_goes_to_zero():
    rig = settled()
    rig.command((10, -20, 30), valid=1.0)
    rig.run(3.0)
    assert rig.last.status == OffsetStatus.EXPIRED
    assert rig.at((0, 0, 0))


@pytest.mark.parametrize('what', ['on', 'homed'])
def test_registers_are_cleared_while_not_ready(what):
    """Off with counts standing, and on again: nothing may be left of them, on either sign."""
    rig = settled()
    setattr(rig.controller, what, False)
    rig.run(0.5)
    assert rig.last.status == OffsetStatus.REFUSED
    assert ('off' if what == 'on' else 'not homed') in rig.last.reason
    assert not rig.allowed
    rig.command((40, 40, 40))
    rig.run(0.5)
    setattr(rig.controller, what, True)
    rig.controller.applied = np.zeros(3)  # LinuxCNC begins at its register
    rig.run(0.5)
    assert rig.at((0, 0, 0))
    assert rig.allowed
    rig.command((5, 5, 5))
    rig.run(2.0)
    assert rig.at((5, 5, 5))
    rig.command((0, 0, 0))
    rig.run(2.0)
    assert rig.at((0, 0, 0))
    assert not rig.controller.counts.any()


def test_frozen_offsets_stay_and_go_on():
    rig = settled()
    rig.controller.enable = False
    rig.run(0.2)
    rig.command((0, 0, 0))
    rig.run(2.0)
    assert 'frozen at X 10.00 um' in rig.last.reason
    assert rig.at((10, -20, 30))
    rig.controller.enable = True
    rig.run(2.0)
    assert rig.allowed
    assert rig.at((10, -20, 30))
    rig.command((0, 0, 0))
    rig.run(2.0)
    assert rig.at((0, 0, 0))
    assert not rig.controller.counts.any()
    assert rig.largest_step <= SLEW * CYCLE + SCALE


def test_frozen_when_deactivated_it_does_not_let_go():
    rig = settled()
    rig.controller.enable = False
    rig.run(0.2)
    rig.bench.request('deactivate')
    rig.run(3.0)
    assert not rig.bridge.at_rest
    assert 'frozen' in rig.last.reason
    rig.controller.enable = True
    rig.run(3.0)
    assert rig.bridge.at_rest
    assert rig.at((0, 0, 0))


@pytest.mark.parametrize('factor', [0.5, 2.0])
def test_scale_changed_with_counts_standing(factor):
    """Counts of zero would mean another offset: ramp to zero, clear, start anew."""
    rig = settled()
    rig.controller.scale = rig.controller.scale * factor
    rig.run(0.5)
    assert 'counts of zero meant' in rig.last.reason
    assert not rig.allowed
    rig.run(3.0)
    assert rig.allowed
    assert rig.at((0, 0, 0))
    rig.command((10, 20, 30))
    rig.run(2.0)
    np.testing.assert_allclose(rig.controller.applied, [10e-6, 20e-6, 30e-6], atol=2 * SCALE)
    np.testing.assert_allclose(rig.controller.counts * rig.controller.scale, rig.last.offset)
    assert rig.largest_step <= SLEW * CYCLE + 4 * SCALE


def test_soft_limit_is_told():
    rig = settled((0, 0, 0))
    rig.controller.cap = np.array([np.inf, np.inf, 12e-6])
    rig.command((0, 0, 30))
    rig.run(2.0)
    assert rig.last.at_limit.tolist() == [False, False, True]
    assert 'a soft limit cuts Z 30.00 um to Z 12.00 um' in rig.last.reason
    assert 'WARN compensation' in rig.bench.health()


def test_own_limit_is_told():
    rig = settled((0, 0, 0))
    rig.command((0, 0, 90))
    rig.run(3.0)
    assert rig.at((0, 0, 60))
    assert rig.last.at_limit.tolist() == [False, False, True]


def test_offsets_that_do_not_move_are_told():
    """As in joint mode."""
    rig = settled((0, 0, 20))
    rig.controller.cap = np.array([np.inf, np.inf, 20e-6])
    controller_cycle = rig.controller.cycle
    rig.controller.cycle = lambda: replace(controller_cycle(), soft_limited=False)
    rig.command((0, 0, 40))
    rig.run(1.0)
    assert 'joint mode' not in rig.last.reason
    rig.run(3.0)
    assert 'stays at Z 20.00 um instead of Z 40.00 um' in rig.last.reason


def test_killed_bridge_is_gone_from_the_machine_after_the_hold():
    rig = settled()
    rig.silence(HOLD - 0.1)
    assert np.any(rig.controller.applied)
    rig.silence(2.0)
    assert np.abs(rig.controller.applied).max() <= 1e-15


def test_new_bridge_goes_on_without_a_step():
    rig = settled()
    rig.silence(1.0)
    rig.restart(active=False)
    rig.run(0.3)
    assert 'nobody owns it' in rig.last.reason
    assert 'ERROR compensation' in rig.bench.health()
    rig.controller.writer = 'fuzzycnc-1-2'
    rig.run(0.3)
    assert 'written by fuzzycnc-1-2' in rig.last.reason
    assert rig.bench.request('activate').success
    begin = len(rig.path)
    rig.run(5.0)
    assert rig.at((10, -20, 30))
    assert np.ptp(rig.path[begin:], axis=0).max() <= SCALE
    rig.command((20, -20, 30), epoch=2)
    rig.run(2.0)
    assert rig.at((20, -20, 30))


def test_adopted_offsets_do_not_stand_for_ever():
    rig = settled(adopt_time=10.0)
    rig.restart()
    rig.run(9.0)
    assert rig.at((10, -20, 30))
    rig.run(4.0)
    assert rig.at((0, 0, 0))
    assert rig.last.status == OffsetStatus.EXPIRED


def test_new_bridge_on_the_way_to_zero():
    rig = settled((0, 0, 60))
    rig.silence(HOLD + 0.3)
    assert 1e-6 < rig.controller.applied[2] < 59e-6
    rig.restart()
    rig.run(1.0)
    assert rig.allowed
    rig.command((0, 0, 30))
    rig.run(3.0)
    assert rig.at((0, 0, 30))
    assert rig.largest_step <= RATE * SCALE * CYCLE + SCALE


def test_bridge_that_stood_still_begins_at_what_is_in_force():
    """Stopped for longer than the hold, it has a command in force that the machine let go."""
    rig = settled()
    rig.silence(HOLD + 3.0)
    rig.run(2.0)
    assert rig.at((0, 0, 0))
    assert rig.allowed
    rig.command((10, 0, 0))
    rig.run(2.0)
    assert rig.at((10, 0, 0))
    assert rig.largest_step <= RATE * SCALE * CYCLE + SCALE


def test_controller_that_ends_is_told_and_comes_back():
    rig = settled()
    told = list(rig.bridge.lose(nanoseconds(rig.time), 'LinuxCNC has ended'))
    rig.bench.emitted += told
    assert {item.output for item in told} == {'machine_state', 'compensation_applied'}
    assert (rig.last.status, rig.last.reason) == (OffsetStatus.REFUSED, 'LinuxCNC has ended')
    assert not rig.allowed
    assert rig.bridge.orders is None
    assert 'ERROR linuxcnc: LinuxCNC has ended' in rig.bench.health()
    assert not list(rig.bridge.lose(nanoseconds(rig.time + 0.05), 'LinuxCNC has ended'))
    assert list(rig.bridge.lose(nanoseconds(rig.time + 1.0), 'LinuxCNC has ended'))
    rig.controller = Controller()
    rig.run(1.0)
    assert rig.allowed
    rig.command((5, 5, 5))
    rig.run(2.0)
    assert rig.at((5, 5, 5))


def test_two_sources_are_both_refused():
    rig = settled()
    rig.bench.request('sources', input='compensation', node=['/a', '/b'])
    rig.run(2.0)
    assert 'several nodes' in rig.last.reason
    assert rig.at((0, 0, 0))
    rig.bench.request('sources', input='compensation', node=[])
    rig.run(0.5)
    assert rig.allowed


def test_stale_and_old_owners_are_refused():
    rig = settled()
    rig.command((50, 50, 50), epoch=1, valid=-1.0)
    rig.run(2.0)
    assert 'stale' in rig.last.reason
    assert rig.at((10, -20, 30))
    rig.command((20, 20, 20), epoch=5)
    rig.run(2.0)
    rig.command((0, 0, 0), epoch=2)
    rig.run(2.0)
    assert rig.last.status == OffsetStatus.REFUSED
    assert rig.at((20, 20, 20))


@pytest.mark.parametrize(
    ('limits', 'text'),
    [
        ((10000.0, 10000.0), ''),
        ((5000.0, 10000.0), 'offset_max = 60 µm is above the 50 µm'),
        ((10000.0, 1000.0), 'slew_max = 50 µm/s is above the 10 µm/s'),
    ],
)
def test_limits_of_the_hal_file_are_wider(limits, text):
    rig = Rig()
    given_limits = ServoThreadLimits(counts_max=limits[0], counts_rate=limits[1], hold_time=2.0)
    found = rig.bridge.refusal(given_limits, rig.controller.cycle())
    assert (text in found) if text else not found


def test_scale_of_zero_is_refused():
    rig = Rig()
    rig.controller.scale = np.zeros(3)
    limits = ServoThreadLimits(counts_max=1e4, counts_rate=1e4, hold_time=2.0)
    assert 'set [FUZZYCNC]SCALE' in rig.bridge.refusal(limits, rig.controller.cycle())


@pytest.mark.parametrize('axes', [(), ('Q',), ('X', 'X')])
def test_axes_are_checked(axes):
    with pytest.raises(ValueError, match='axes: expected distinct names'):
        LinuxcncBridge(LinuxcncBridgeConfig(axes=axes))


def test_same_cycles_give_the_same_messages():
    def told():
        rig = settled()
        rig.controller.on = False
        rig.run(0.3)
        rig.controller.on = True
        rig.run(0.5)
        return [(item.output, item.record.stamp, repr(item.record)) for item in rig.bench.emitted]

    assert told() == told()


EVENTS = st.sampled_from(
    ['command', 'off', 'on', 'freeze', 'thaw', 'kill', 'restart', 'scale', 'wait', 'deactivate']
)


@pytest.mark.parametrize('controller', [Controller, ThreadController])
@settings(max_examples=15, deadline=None)
@given(events=st.lists(st.tuples(EVENTS, st.integers(-60, 60)), max_size=12))
def test_whatever_happens_it_never_steps_and_zero_is_zero(controller, events):
    """Offsets move no faster than the HAL file lets them, and end at zero with counts of zero."""
    rig = Rig(controller())
    rig.run(0.2)
    killed = False
    for event, number in events:
        if event == 'command':
            slope = 1e-6 * number if controller is ThreadController else 0.0
            rig.command((number, -number, 0), slope=(0.0, slope, 0.0))
        elif event in ('off', 'on'):
            rig.controller.on = event == 'on'
        elif event in ('freeze', 'thaw'):
            rig.controller.enable = event == 'thaw'
        elif event == 'scale':
            rig.controller.scale = np.full(3, SCALE * (2.0 if number > 0 else 1.0))
        elif event == 'kill':
            killed = True
        elif event == 'restart':
            rig.restart()
            killed = False
        elif event == 'deactivate':
            rig.bench.request('deactivate')
        (rig.silence if killed else rig.run)(0.3)
    steps = np.abs(np.diff(rig.path, axis=0)).max(axis=1)
    # What stood at switch-off has become part of the position at switch-on.
    on = np.array(rig.on)
    assert steps[on[1:] & on[:-1]].max() <= 2.0 * RATE * SCALE * CYCLE + SCALE
    rig.controller.on = rig.controller.enable = True
    rig.restart()
    rig.run(3.0)
    rig.command((0, 0, 0), epoch=9)
    rig.run(3.0)
    assert np.all(np.abs(rig.controller.applied) <= 4 * SCALE)
    assert not rig.controller.counts.any()


def test_compensator_and_bridge_survive_each_others_restarts():
    """The offset that the compensator wants is there in the end, without a step."""
    rig = Rig()
    loop = Compensated(rig)
    loop.run(25)
    wanted = np.array([0.0, -4e-6, 2e-6])
    np.testing.assert_allclose(rig.controller.applied, wanted, atol=SCALE)
    begin = len(rig.path)
    rig.restart()
    loop.run(10)
    loop.restart()
    loop.run(15)
    np.testing.assert_allclose(
        rig.path[begin:], np.tile(wanted, (len(rig.path) - begin, 1)), atol=2 * SCALE
    )

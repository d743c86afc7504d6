# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The hand-shake with a control that takes lines: whose it is, and how it changes hands."""

import numpy as np
import pytest
from benches.bridge_bench import Compensated
from benches.line_control import WATCHDOG, LineControl
from benches.line_rig import CYCLE, SCALE, SLEW, Rig, settled

from fuzzycnc_ros.adapters.opcua.hand_shake import NUMBERS
from fuzzycnc_ros.core.inputs.offset_input import OffsetStatus
from fuzzycnc_ros.runtime.records import nanoseconds


def test_one_set_at_a_time_each_with_its_own_number():
    rig = settled()
    numbers = [item.sequence for item in rig.sets]
    assert len(set(numbers)) == len(numbers)
    rig.control.frozen = True
    rig.command((30, 0))
    before = len(rig.sets)
    rig.run(1.5)
    assert len(rig.sets) == before + 1
    assert rig.allowed
    rig.control.frozen = False
    rig.run(5.0)
    assert rig.at((30, 0))


def test_numbers_begin_anew():
    rig = settled(validity=1.0)
    hand_shake = rig.bridge._hand_shake
    hand_shake._sequences.append(NUMBERS - 2)
    hand_shake._heartbeats.append(NUMBERS - 2)
    rig.run(5.0)
    assert rig.at((10, -20))
    assert 1 in [item.sequence for item in rig.sets]
    assert 0 not in [item.heartbeat for item in rig.sets]


def test_frozen_acknowledgement_is_told_and_the_control_lets_go():
    rig = settled(validity=5.0)
    rig.control.frozen = True
    rig.run(4.5)
    assert rig.last.status == OffsetStatus.REFUSED
    assert 'has not been acknowledged within 2 s' in rig.last.reason
    assert not rig.allowed
    rig.run(6.0)
    assert not np.any(rig.control.applied)
    rig.command((20, 20))
    rig.control.frozen = False
    rig.run(1.0)
    assert rig.allowed
    rig.command((5, 5))
    rig.run(4.0)
    assert rig.at((5, 5))
    assert rig.largest_step <= 20e-6 * CYCLE + 1e-12


def test_ramps_to_zero_then_gives_the_hand_shake_back():
    rig = settled()
    assert rig.bench.request('deactivate').success
    rig.run(0.5)
    assert 'ramping to zero' in rig.last.reason
    assert not rig.bridge.at_rest
    rig.run(4.0)
    assert rig.bridge.at_rest
    assert rig.bridge.orders is None
    assert rig.control.sequence == 0
    assert rig.at((0, 0))
    assert rig.largest_way <= SLEW * (1.0 + 3 * CYCLE)
    assert rig.bench.request('activate').success
    rig.run(1.0)
    assert rig.allowed


def test_killed_bridge_and_the_watchdog_of_the_control():
    rig = settled()
    rig.silence(WATCHDOG - 0.5)
    assert np.any(rig.control.applied)
    rig.silence(3.0)
    assert not np.any(rig.control.applied)
    rig.restart()
    rig.run(2.0)
    assert rig.allowed
    assert rig.at((0, 0))


@pytest.mark.parametrize('says', [True, False])
def test_stopped_bridge_goes_on_from_where_the_control_went_meanwhile(says):
    """SIGSTOP: the watchdog takes the offsets away; SIGCONT must not put them back in a step.

    A control that does not say that its watchdog has ended is known by where its axes are.
    """
    control = LineControl()
    control.slew = 20 * SLEW
    rig = settled((0, 40), control=control)
    rig.says_alive = says
    rig.silence(WATCHDOG + 6.0)
    assert not np.any(rig.control.applied)
    begin = len(rig.path)
    rig.run(1.0)
    rig.command((0, 40))
    rig.run(6.0)
    assert rig.at((0, 40))
    way = np.abs(np.diff(rig.path[begin:], axis=0)).max()
    assert way <= 2.01 * SLEW * CYCLE  # a set comes a cycle late now and then


@pytest.mark.parametrize('slope', [0.0, 1e-4])
def test_new_bridge_goes_on_without_a_step(slope):
    rig = settled((0, 0))
    rig.command((10, -20), slope=(slope, 0))
    rig.run(6.0)
    place = rig.control.applied.copy()
    rig.silence(1.0)
    rig.restart(active=False)
    rig.run(0.3)
    assert 'nobody owns it' in rig.last.reason
    assert 'ERROR compensation' in rig.bench.health()
    assert rig.bench.request('activate').success
    begin = len(rig.path)
    rig.run(10.0)
    assert np.ptp(np.array([place, *rig.path[begin:]]), axis=0).max() <= 1e-12
    assert rig.sets[-1].lines.slope[0] == pytest.approx(slope)
    rig.command((20, -20), epoch=2)
    rig.run(4.0)
    assert rig.at((20, -20))


def test_line_is_kept_where_the_axis_has_moved_between_two_readings():
    rig = settled((0, 0))
    rig.command((10, -20), slope=(1e-4, 0))
    rig.run(6.0)
    rig.silence(1.0)
    rig.control.position = np.array([0.005, 0.0])  # offset and position are read apart
    rig.restart()
    rig.run(3.0)
    assert rig.sets[-1].lines.slope[0] == pytest.approx(1e-4)


def test_new_bridge_amid_a_way_of_the_control_stays_there():
    rig = settled((0, 40))
    rig.silence(WATCHDOG + 1.0)
    there = rig.control.applied[1]
    assert 1e-6 < there < 39e-6
    rig.restart()
    rig.run(4.0)
    assert rig.allowed
    rig.command((0, 30))
    rig.run(4.0)
    assert rig.at((0, 30))
    assert rig.largest_step <= rig.control.slew * CYCLE + 1e-12


def test_adopted_offsets_do_not_stand_for_ever():
    rig = settled(adopt_time=10.0)
    rig.restart()
    rig.run(9.0)
    assert rig.at((10, -20))
    rig.run(6.0)
    assert rig.at((0, 0))
    assert rig.last.status == OffsetStatus.EXPIRED


def test_adopted_offsets_do_not_stand_for_ever_on_a_connection_that_comes_and_goes():
    """Each time the bridge goes on from what stands; nobody has commanded it since."""
    rig = settled(adopt_time=10.0)
    for _ in range(6):
        rig.bench.emitted += rig.bridge.lose(nanoseconds(rig.time), 'no answer within 2 s')
        rig.silence(1.0)
        rig.run(4.0)
    assert rig.at((0, 0))
    assert rig.last.status == OffsetStatus.EXPIRED
    rig.command((10, -20))
    rig.run(5.0)
    assert rig.at((10, -20))
    rig.bench.emitted += rig.bridge.lose(nanoseconds(rig.time), 'no answer within 2 s')
    rig.silence(1.0)
    rig.run(8.0)
    assert rig.at((10, -20))  # there was a command again


def test_lost_connection_is_told_and_taken_up_again_without_a_step():
    rig = settled()
    told = list(rig.bridge.lose(nanoseconds(rig.time), 'no answer within 2 s'))
    rig.bench.emitted += told
    assert (rig.last.status, rig.last.reason) == (OffsetStatus.REFUSED, 'no answer within 2 s')
    np.testing.assert_allclose(rig.last.offset, [10e-6, -20e-6], atol=1e-8)
    assert not rig.allowed
    assert rig.bridge.orders is None
    assert 'ERROR control: no answer within 2 s' in rig.bench.health()
    begin = len(rig.path)
    rig.silence(2.0)
    rig.run(0.3)
    assert rig.bridge.holding  # what stands is its own: nobody is waited for
    rig.run(5.0)
    assert np.ptp(rig.path[begin:], axis=0).max() <= 1e-12
    assert rig.allowed


def test_second_writer_is_named_and_both_are_refused():
    rig = settled()
    rig.control.owner, rig.control.sequence = 'panel 7', 4711
    rig.control.offset = np.array([1e-6, 1e-6])
    rig.run(0.3)
    assert rig.bridge.orders is None
    assert rig.last.status == OffsetStatus.REFUSED
    assert 'two writers' in rig.last.reason
    assert 'panel 7 (set 4711)' in rig.last.reason
    assert not rig.allowed
    for number in range(20):
        rig.control.heartbeat = 20_000 + number
        rig.run(1.0)
        assert not rig.bridge.holding
    rig.run(9.0)
    assert not rig.bridge.holding
    rig.run(3.0)
    assert rig.bridge.holding
    rig.run(1.0)
    assert rig.allowed


def test_values_that_another_one_writes_are_noticed():
    rig = settled()
    rig.control.offset = np.array([1e-6, 1e-6])
    rig.run(0.3)
    assert 'two writers' in rig.last.reason


def test_hand_shake_that_another_one_gives_back_is_noticed():
    rig = settled()
    rig.control.sequence = 0
    rig.run(0.3)
    assert not rig.bridge.holding
    assert not rig.allowed
    rig.run(12.0)
    assert rig.allowed


def test_is_not_activated_beside_another_writer():
    rig = Rig(active=False)
    for number in range(1, 20):
        rig.control.sequence, rig.control.heartbeat = 5, number
        rig.run(0.2)
    assert 'set 5' in rig.bridge.refusal()
    rig.run(2.0)
    assert not rig.bridge.refusal()


def test_two_sources_are_both_refused():
    rig = settled()
    rig.bench.request('sources', input='compensation', node=['/a', '/b'])
    rig.run(5.0)
    assert 'several nodes' in rig.last.reason
    assert rig.at((0, 0))
    rig.bench.request('sources', input='compensation', node=[])
    rig.run(0.5)
    assert rig.allowed


def test_compensator_and_bridge_survive_each_others_ends():
    """The offset that the compensator wants is there in the end, without a step."""
    rig = Rig(axes=('Y', 'Z'))
    loop = Compensated(rig)
    loop.run(25)
    wanted = np.array([-4e-6, 2e-6])
    np.testing.assert_allclose(rig.control.applied, wanted, atol=SCALE)
    begin = len(rig.path)
    rig.restart()
    loop.run(10)
    rig.bench.emitted += rig.bridge.lose(nanoseconds(rig.time), 'no answer within 2 s')
    rig.silence(2.0)
    loop.run(10)
    loop.restart()
    loop.run(15)
    path = np.array(rig.path[begin:])
    np.testing.assert_allclose(path, np.tile(wanted, (len(path), 1)), atol=SCALE)
    assert rig.last.status == OffsetStatus.FOLLOWING

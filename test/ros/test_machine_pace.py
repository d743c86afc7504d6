# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""When the simulated machine ticks without lock-step."""

import pytest

pytestmark = pytest.mark.ros


@pytest.fixture(scope='module')
def pace_of():
    """The class; its module needs rclpy."""
    pytest.importorskip('rclpy', reason='rclpy is not installed here: run `make test`')
    from fuzzycnc_ros.nodes.simulated_machine import Pace

    return Pace


SECOND = 1_000_000_000


@pytest.mark.parametrize('rate', [0.5, 1.0, 1000.0])
def test_machine_time_passes_at_its_rate(pace_of, rate):
    pace = pace_of(rate, 7 * SECOND, 100.0)
    assert pace.due(7 * SECOND) == 100.0
    assert pace.due(19 * SECOND) == pytest.approx(100.0 + 12.0 / rate)
    assert pace.due(7 * SECOND + 1_000_000) == pytest.approx(100.0 + 1e-3 / rate)


def test_late_ticks_are_counted_and_caught_up(pace_of):
    pace = pace_of(1.0, 0, 100.0)
    for tick, wall in ((1, 101.0), (2, 102.005), (3, 103.05), (4, 104.0)):
        pace.count(tick * SECOND, wall)
    assert pace.late == 1
    assert pace.due(5 * SECOND) == 105.0  # the late one moves no other


def test_time_slips_where_the_machine_stood_still(pace_of):
    """It does not rush through what it missed."""
    pace = pace_of(1.0, 0, 100.0)
    pace.count(1 * SECOND, 104.0)
    assert pace.late == 1
    assert pace.due(2 * SECOND) == 105.0


def test_time_goes_on_from_the_last_tick_where_a_long_one_is_broken_off(pace_of):
    pace = pace_of(1.0, 0, 100.0)
    assert pace.due(1_000_000) < 107.0
    pace.resume(0, 107.0)
    assert pace.due(1_000_000) == pytest.approx(107.001)
    assert pace.due(12 * SECOND) == pytest.approx(119.0)


def test_where_others_drive_the_axes_next_to_nothing_is_caught_up(pace_of):
    """A tick that follows at once is one that nobody can answer."""
    pace = pace_of(1.0, 0, 100.0, slip=5e-4)
    pace.count(1_000_000, 100.0013)
    assert pace.due(2_000_000) == pytest.approx(100.002)
    pace.count(2_000_000, 100.0027)
    assert pace.due(3_000_000) == pytest.approx(100.0037)


def test_nights_between_duties_are_left_out(domain, monkeypatch):
    """Nodes hear of the next duty's time before its first message, and nobody waits for it."""
    rclpy = pytest.importorskip('rclpy')
    from fuzzycnc_ros.nodes import simulated_machine as module

    monkeypatch.setenv('ROS_DOMAIN_ID', str(domain))
    words = "duties:=['T2', 'T3']", 'duty_duration:=600.0', 'rate:=600.0'
    rclpy.init(args=['--ros-args', *(word for text in words for word in ('-p', text))])
    machine = module.make()
    now, sent = [100.0], []
    try:
        with monkeypatch.context() as patch:
            patch.setattr(module.time, 'monotonic', lambda: now[0])
            patch.setattr(machine._gate, 'open', lambda: True)
            patch.setattr(machine, '_wake', lambda wait: now.append(now.pop() + max(wait, 1e-6)))
            patch.setattr(
                machine, 'publish', lambda found: sent.extend(item.record for item in found)
            )
            patch.setattr(machine._clock, 'publish', lambda message: sent.append(message.clock))
            while not machine.done:
                machine._tick_in_time()
    finally:
        machine.node.destroy_node()
        rclpy.shutdown()
    assert now[0] - 100.0 == pytest.approx(2 * 600.0 / 600.0, abs=0.1)
    times = [getattr(item, 'stamp', None) or item.sec * SECOND + item.nanosec for item in sent]
    assert times == sorted(times)
    second = 30 * 3600 * SECOND  # six in the morning of day two
    first = next(place for place, time in enumerate(times) if time >= second)
    assert times[first] == second
    assert not hasattr(sent[first], 'stamp'), 'the clock comes first'
    assert times[first + 1] > second

# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Pace of the simulated body: ticks when they are due, the clock in between."""

import pytest

pytest.importorskip('rclpy', reason='rclpy is not installed here: run `make test`')

from fuzzycnc_ros.nodes import simulated_body as module
from fuzzycnc_ros.ros.clocks import CLOCK_PERIOD
from fuzzycnc_ros.runtime.records import SECOND

pytestmark = pytest.mark.ros


@pytest.mark.parametrize('rate', [60.0, 1200.0])
def test_ticks_come_when_they_are_due_and_the_clock_between_them(make_node, monkeypatch, rate):
    """On the wall no tick comes early, none later than the clock's own period."""
    body = module.SimulatedBodyNode(make_node('simulated_body', rate=rate, duration=60.0))
    now, ticks, told = [100.0], [], []
    monkeypatch.setattr(module.time, 'monotonic', lambda: now[0])
    monkeypatch.setattr(body._gate, 'open', lambda: True)
    monkeypatch.setattr(
        body, 'publish', lambda found: ticks.extend([(now[0], body.now())] * bool(list(found)))
    )
    monkeypatch.setattr(
        body._clock, 'publish', lambda message: told.append((now[0], message.clock))
    )
    pauses = []
    looks_most = 60.0 / rate / CLOCK_PERIOD + 20.0
    while not body.done:
        assert len(pauses) < looks_most, 'rests until the next tick'
        body._on_timer()
        if not body.done:
            pauses.append(1e-9 * body._timer.timer_period_ns)
            now[0] += pauses[-1]
    assert len(ticks) == 5
    first_wall, first = ticks[0]
    for wall, stamp in ticks:
        due = first_wall + 1e-9 * (stamp - first) / rate
        assert due - 1e-9 <= wall <= due + 2.0 * CLOCK_PERIOD
    assert max(pauses) <= CLOCK_PERIOD
    times = [item.sec * SECOND + item.nanosec for _, item in told]
    assert times == sorted(times)
    assert len(times) == len(pauses), 'each look tells the time'
    for (wall, _), time in zip(told, times, strict=True):
        assert time == pytest.approx(first + 1e9 * rate * (wall - first_wall), abs=1e6 * rate)

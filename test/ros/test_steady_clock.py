# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The clock of a node when the clock of the computer is set, stands or is slow."""

import pytest

from fuzzycnc_ros.ros.clocks import STEP, LogClock, SteadyClock

SECOND = 1_000_000_000


class Clocks:
    """A wall clock and a monotonic one that a test moves."""

    def __init__(self):
        self.wall, self.monotonic = 1_000 * SECOND, 5 * SECOND
        self.steady = SteadyClock(lambda: self.wall, lambda: self.monotonic)

    def pass_time(self, seconds, wall=None):
        """Let time pass, on the wall clock as much unless said otherwise [s]."""
        self.monotonic += int(seconds * SECOND)
        self.wall += int((seconds if wall is None else wall) * SECOND)

    def set(self, seconds):
        """Set the wall clock forward."""
        self.wall += int(seconds * SECOND)


def test_goes_with_the_wall_clock():
    clocks = Clocks()
    for _ in range(10):
        clocks.pass_time(0.1)
        assert clocks.steady.now() == clocks.wall
    assert clocks.steady.step() == 0


@pytest.mark.parametrize('step', [-86_400, -3_600, -2, 2, 3_600])
def test_step_is_told_once_and_followed(step):
    clocks = Clocks()
    clocks.pass_time(0.1)
    clocks.steady.now()
    clocks.set(step)
    assert clocks.steady.step() == step * SECOND
    assert clocks.steady.step() == 0
    assert clocks.steady.now() == clocks.wall
    clocks.pass_time(1.0)
    assert clocks.steady.now() == clocks.wall


@pytest.mark.parametrize('set_by', [-0.9, 0.9])
def test_small_correction_is_followed_without_going_back(set_by):
    clocks = Clocks()
    clocks.steady.now()
    clocks.set(set_by)
    before, slow, fast = clocks.steady.now(), 0.9 - 1e-9, 1.1 + 1e-9
    for _ in range(200):
        clocks.pass_time(0.1)
        now = clocks.steady.now()
        assert slow * 0.1 * SECOND <= now - before <= fast * 0.1 * SECOND
        before = now
    assert clocks.steady.now() == clocks.wall
    assert clocks.steady.step() == 0


def test_clock_that_creeps_back_is_a_step_in_the_end():
    """Else whatever expires would do so more and more slowly."""
    clocks, before, told = Clocks(), 0, 0
    for _ in range(100):
        clocks.pass_time(1.0, wall=0.0)
        told += clocks.steady.step()
        before += SECOND
    assert -before <= told <= -before + 20 * SECOND
    assert clocks.steady.now() - clocks.wall <= STEP


def test_process_that_was_stopped_between_two_readings_sees_no_step():
    clocks = Clocks()
    readings = iter([0.0, 60.0])

    def stopped():
        clocks.pass_time(next(readings, 0.0))
        return clocks.wall

    clocks.steady._clock = stopped
    clocks.steady.now()
    assert clocks.steady.step() == 0


def test_what_is_logged_by_never_goes_back():
    clocks = Clocks()
    log = LogClock(clocks.steady)
    start = clocks.wall

    def passed(set_by=0.0):
        clocks.pass_time(1.0)
        clocks.set(set_by)
        return (log.now() - start) / SECOND

    assert [passed() for _ in range(3)] == [1.0, 2.0, 3.0]
    # Set back by an hour it goes on as if nothing was.
    assert [passed(-3600.0), passed(), passed()] == [4.0, 5.0, 6.0]
    # Forward by less makes up for a part of it, by more is followed.
    assert [passed(3000.0), passed()] == [7.0, 8.0]
    assert [passed(1600.0), passed()] == [1009.0, 1010.0]
    assert log.now() == clocks.wall

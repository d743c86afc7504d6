# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Clocks, timers and the pace of ticks.

A wall clock is set, by an operator or by NTP, and then offsets would expire an hour too late or at
once.  That of a node is disciplined by the monotonic one: it follows the wall clock slowly, never
goes back, and tells when that has stepped.
"""

import time
from collections.abc import Callable, Collection, Mapping
from typing import Any

from rclpy.clock import Clock, ClockType
from rclpy.node import Node

from fuzzycnc_ros.runtime.records import nanoseconds

STEP = 1_000_000_000
"""Difference to the monotonic clock that is a step [ns]; less is followed slowly."""
FOLLOWING = 0.1
"""Largest rate difference from the monotonic clock while this one follows the wall clock [-]."""
TOGETHER = 5_000_000
"""Time within which two clocks are read [ns] so that their difference means something."""


class AwakeTime:
    """Wall time in which this process was there to hear the others.

    What came while it stood still, on a busy computer, waits to be taken, and timers come first:
    its own silence must not be taken for that of others.

    Parameters
    ----------
    period : float
        Period of the timer that calls `look` [s].
    """

    def __init__(self, period: float) -> None:
        self._period, self._late = period, 0.0
        self._looked_at = time.monotonic()

    def look(self) -> None:
        """Note that the timer has come; by what it is late the process stood still."""
        now = time.monotonic()
        self._late += max(0.0, now - self._looked_at - 2.0 * self._period)
        self._looked_at = now

    def now(self) -> float:
        """Return the time [s]."""
        return time.monotonic() - self._late


class SteadyClock:
    """Tell the time of a clock that may be set.

    Parameters
    ----------
    clock : callable
        The clock of the node [ns].
    monotonic : callable
        The monotonic clock [ns].
    """

    def __init__(
        self, clock: Callable[[], int], monotonic: Callable[[], int] = time.monotonic_ns
    ) -> None:
        self._clock, self._monotonic = clock, monotonic
        self._now, self._read_at = self._read()
        self._stepped = 0

    def now(self) -> int:
        """Return the time [ns]; it never goes back but by a step, which `step` tells."""
        clock, read_at = self._read()
        elapsed = read_at - self._read_at
        ahead = clock - self._now - elapsed
        self._read_at = read_at
        if abs(ahead) > STEP:
            self._stepped += ahead
            self._now = clock
        else:
            reach = int(FOLLOWING * elapsed)
            self._now += elapsed + max(-reach, min(ahead, reach))
        return self._now

    def step(self) -> int:
        """Return by how much the clock has stepped since this was asked last [ns]; 0 if not."""
        self.now()
        return self.step_before()

    def step_before(self) -> int:
        """Return the same as at the last `now`, without another look at the clocks."""
        stepped, self._stepped = self._stepped, 0
        return stepped

    def _read(self) -> tuple[int, int]:
        """Return both clocks [ns], read together: a process may be stopped in between."""
        while True:
            before = self._monotonic()
            clock, after = self._clock(), self._monotonic()
            if after - before < TOGETHER:
                return clock, after


class LogClock:
    """Tell the time that a recorder logs by: it follows a clock that may be set, but never back.

    Readers take the messages of a bag in the order of their log times.

    Parameters
    ----------
    steady : SteadyClock
        The clock, which nobody else asks for its steps.
    """

    def __init__(self, steady: SteadyClock) -> None:
        self._steady = steady
        self._kept = 0  # by how much the clock was set back, and not forward again [ns]

    def now(self) -> int:
        """Return the time [ns]."""
        now = self._steady.now()
        self._kept = max(0, self._kept - self._steady.step_before())
        return now + self._kept


SIMULATED_FASTER = 60
"""Factor on how far a stamp may be ahead where time is simulated: that goes hundreds of times
as fast as the wall clock, and a node's clock is behind by what its messages take on the wall."""


def stamp_ahead_max(node: Node) -> int:
    """Return how far ahead of a node's clock a stamp may be [ns]; 0 if any distance is allowed."""
    most = nanoseconds(node.get_parameter('stamp_ahead_max').value)
    return most * SIMULATED_FASTER if node.get_parameter('use_sim_time').value else most


def wall_timer(node: Node, period: float, callback: Callable[[], None]) -> Any:
    """Call back every `period` seconds of wall time, whatever the node's clock says."""
    return node.create_timer(period, callback, clock=Clock(clock_type=ClockType.STEADY_TIME))


START_POLL = 0.05
"""Wall time [s] between two looks at the graph before a run without lock-step starts."""
SETTLING = 1.0
"""Wall time [s] for which the graph must have been complete before a run without lock-step starts:
the other nodes, above all the recorder, still find each other's topics."""
SLIP = 0.1
"""Wall time [s] from which on what is late is no longer caught up: a machine whose process stood
still does not rush through what it missed."""
CLOCK_PERIOD = 0.01
"""Wall time [s] between two messages on `/clock` in real time: each wakes every reader."""
LATE = 0.01
"""Wall time [s] from which on a tick counts as late."""


class Pace:
    """Wall times at which ticks of machine time are due.

    Parameters
    ----------
    rate : float
        Speed of machine time; 1 is real time.
    stamp : int
        Machine time [ns] that is now.
    now : float
        Wall time [s].
    slip : float
        Wall time [s] from which on what is late is not caught up.
    """

    def __init__(self, rate: float, stamp: int, now: float, slip: float = SLIP) -> None:
        self._rate, self._slip = rate, slip
        self._stamp, self._now = stamp, now
        self.late = 0
        """Ticks that came late."""

    def due(self, stamp: int) -> float:
        """Return the wall time [s] of a tick."""
        return self._now + 1e-9 * (stamp - self._stamp) / self._rate

    def time(self, now: float) -> int:
        """Return the machine time [ns] at wall time `now` [s]."""
        return self._stamp + round(1e9 * self._rate * (now - self._now))

    def count(self, stamp: int, now: float) -> None:
        """Note that a tick is made at wall time `now` [s]; far behind, machine time slips."""
        behind = now - self.due(stamp)
        self.late += behind > LATE
        if behind > self._slip:
            self.resume(stamp, now)

    def resume(self, stamp: int, now: float) -> None:
        """Go on from machine time `stamp` [ns] at wall time `now` [s].

        Machine time moves in ticks alone.  What arrives in the midst of a long one and asks for
        a short one continues from its beginning, rather than have hundreds of ticks be late.
        So does a machine that is far behind.
        """
        self._stamp, self._now = stamp, now


class StartGate:
    """Hold a run without lock-step until its nodes are there.

    Parameters
    ----------
    node : Node
        The node that waits.
    wanted : collection of str
        Names of the nodes to wait for.
    timeout : float
        Wall time [s] after which it waits no more.
    matched : callable
        Whether both ends of all routes of the node are matched.
    """

    def __init__(
        self,
        node: Node,
        wanted: Collection[str],
        timeout: float,
        matched: Callable[[Mapping[str, int]], bool],
    ) -> None:
        self._node, self._wanted, self._matched = node, set(wanted), matched
        self._timeout = timeout
        self._since = time.monotonic()
        self._complete_since: float | None = None

    def open(self) -> bool:
        """Return True if the run may start now."""
        missing = self._wanted - set(self._node.get_node_names())
        if missing or not self._matched({}):
            self._complete_since = None
        elif self._complete_since is None:
            self._complete_since = time.monotonic()
        elif time.monotonic() - self._complete_since > SETTLING:
            return True
        if time.monotonic() - self._since < self._timeout:
            return False
        if missing:
            named = ', '.join(sorted(missing))
            self._node.get_logger().warning(f'starting without {named}: not seen on the graph')
        return True

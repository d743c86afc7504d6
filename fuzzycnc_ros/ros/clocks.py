# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The clock of a node, disciplined by the monotonic one.

A wall clock is set, by an operator or by NTP, and then offsets would expire an hour too late or at
once.  This one follows it slowly, never goes back, and tells when the wall clock has stepped.
"""

import time
from collections.abc import Callable
from typing import Any

from rclpy.clock import Clock, ClockType
from rclpy.node import Node

STEP = 1_000_000_000
"""Difference to the monotonic clock that is a step [ns]; less is followed slowly."""
FOLLOWING = 0.1
"""How much faster or slower than the monotonic clock this one goes to follow the wall clock."""
TOGETHER = 5_000_000
"""Time within which two clocks are read [ns] so that their difference means something."""


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
        stepped, self._stepped = self._stepped, 0
        return stepped

    def _read(self) -> tuple[int, int]:
        """Return both clocks [ns], read together: a process may be stopped in between."""
        while True:
            before = self._monotonic()
            clock, after = self._clock(), self._monotonic()
            if after - before < TOGETHER:
                return clock, after


def wall_timer(node: Node, period: float, callback: Callable[[], None]) -> Any:
    """Call back every `period` seconds of wall time, whatever the node's clock says."""
    return node.create_timer(period, callback, clock=Clock(clock_type=ClockType.STEADY_TIME))

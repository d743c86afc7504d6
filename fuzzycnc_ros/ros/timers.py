# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Timers of wall time: with `use_sim_time` a node's own timers stand still or race."""

from collections.abc import Callable
from typing import Any

from rclpy.clock import Clock, ClockType
from rclpy.node import Node


def wall_timer(node: Node, period: float, callback: Callable[[], None]) -> Any:
    """Call back every `period` seconds of wall time, whatever the node's clock says."""
    return node.create_timer(period, callback, clock=Clock(clock_type=ClockType.STEADY_TIME))

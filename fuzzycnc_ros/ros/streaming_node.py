# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Managed nodes that send parts of a trajectory ahead of their time, driven by nothing meanwhile.

In real time such a node works up to the present by itself: what it has heard does not pile up, and
a request finds it at the present machine time.  Where that makes the component act it is written
down as `deadline_fired`, so that a replay repeats it.
"""

from collections.abc import Mapping
from typing import Any

from rcl_interfaces.msg import SetParametersResult
from rclpy.parameter import Parameter

from fuzzycnc_ros.ros.clocks import wall_timer
from fuzzycnc_ros.ros.host import DEADLINE_POLL
from fuzzycnc_ros.ros.lifecycle import ManagedComponentNode
from fuzzycnc_ros.runtime.component import Answer, Component
from fuzzycnc_ros.runtime.records import nanoseconds

LAG = 0.02
"""Delay of the node behind the present [s]: messages take their time to arrive."""


class StreamingNode(ManagedComponentNode):
    """Serve a component whose configuration has `lead` and `chunk`, up to the present."""

    def __init__(self, component_type: type[Component]) -> None:
        super().__init__(component_type)
        config: Any = self.component.configuration
        # A part must leave well before its start.
        often = 0.25 * min(config.lead, config.chunk)
        if not self.settings.lockstep and often < DEADLINE_POLL:
            wall_timer(self.node, often, self.on_poll)

    def request(self, name: str, arguments: Mapping[str, Any]) -> Answer:
        """Carry out a request at the present machine time."""
        self._work_to_now(note=True)
        return super().request(name, arguments)

    def on_parameters(self, parameters: list[Parameter]) -> SetParametersResult:
        """Take live parameters at the present machine time."""
        self._work_to_now(note=True)
        return super().on_parameters(parameters)

    def on_poll(self) -> None:
        """Real time: work up to now."""
        self._work_to_now()

    def _work_to_now(self, *, note: bool = False) -> None:
        """Work up to now in real time, and write down how far if something follows from it."""
        if self.settings.lockstep:
            return
        now = self.now() - nanoseconds(LAG)
        emissions = self.merger.advance(max(now, self.merger.time))
        self.publish(emissions)
        if emissions or note:
            self.note_deadline(self.merger.time)

# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Node `servo_controller`: in real time it notices within some periods that feedback has stopped.

Axis states that are on their way are waited for; meanwhile the machine side, which knows how long
a command is valid, has taken the drives to zero by itself.
"""

from fuzzycnc_ros.components.records import DeadlineFired, nanoseconds
from fuzzycnc_ros.components.servo_controller import ServoController
from fuzzycnc_ros.convert import encode
from fuzzycnc_ros.nodes import run
from fuzzycnc_ros.nodes.host import DEADLINE_POLL
from fuzzycnc_ros.nodes.managed import ManagedComponentNode
from fuzzycnc_ros.nodes.messages import RCLPY
from fuzzycnc_ros.nodes.timers import wall_timer

POLL = 0.01
"""Wall time [s] between two looks at the deadline in real time."""
LAG = 0.05
"""How long an axis state may be on its way [s]."""


class ServoControllerNode(ManagedComponentNode):
    """Serve the controller of the axes."""

    component: ServoController

    def __init__(self) -> None:
        super().__init__(ServoController)
        if not self.settings.lockstep and POLL < DEADLINE_POLL:
            wall_timer(self.node, POLL, self._poll_deadline)

    def _poll_deadline(self) -> None:
        """Real time: count the axis states that have not come, and write it down."""
        deadline, present = self.component.next_deadline, self._now() - nanoseconds(LAG)
        if deadline is None or deadline > present:
            return
        self.publish(self.merger.advance(max(present, self.merger.time)))
        record = DeadlineFired(
            stamp=self.merger.time,
            frame_id=self.component.frame('machine'),
            node=self.node.get_name(),
        )
        self._deadlines.publish(encode(record, RCLPY))


def make() -> ServoControllerNode:
    """Create the node."""
    return ServoControllerNode()


def main() -> None:
    """Run the node until it is interrupted."""
    run.main(make)


if __name__ == '__main__':
    main()

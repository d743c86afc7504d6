# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Node `servo_controller`: in real time it keeps up with the machine as well as the host lets it.

It answers the newest axis state: one that it had no time for is a missed deadline, counted and
bridged, rather than a reason to fall further behind.  It notices that feedback has stopped;
axis states that are on their way are waited for, and meanwhile the machine side, which knows how
long a command is valid, has taken the drives to zero by itself.
"""

import contextlib
import gc
import os
from pathlib import Path

from fuzzycnc_ros.components.servo.servo_controller import ServoController
from fuzzycnc_ros.ros import run
from fuzzycnc_ros.ros.clocks import wall_timer
from fuzzycnc_ros.ros.host import DEADLINE_POLL
from fuzzycnc_ros.ros.lifecycle import ManagedComponentNode
from fuzzycnc_ros.runtime.records import nanoseconds

POLL = 0.01
"""Wall time [s] between two looks at the deadline in real time."""
LAG = 0.05
"""Longest delay of an axis state on its way [s]."""


class ServoControllerNode(ManagedComponentNode):
    """Serve the controller of the axes."""

    component: ServoController
    keeps_newest = True

    def __init__(self) -> None:
        super().__init__(ServoController)
        if not self.settings.lockstep and POLL < DEADLINE_POLL:
            wall_timer(self.node, POLL, self.on_poll)

    def start(self) -> None:
        """Announce the configuration; in real time, get out of the way of what may hold us up."""
        super().start()
        if self.settings.lockstep:
            return
        gc.collect()
        gc.freeze()  # what is there by now is not looked through again
        config = self.component.configuration
        if config.realtime_priority:
            self._prefer(config.realtime_priority)

    def _prefer(self, priority: int) -> None:
        """Have all threads, those of DDS too, run before all that have no such priority."""
        try:
            for thread in Path('/proc/self/task').iterdir():
                with contextlib.suppress(ProcessLookupError):  # it has ended meanwhile
                    os.sched_setscheduler(
                        int(thread.name), os.SCHED_FIFO, os.sched_param(priority)
                    )
        except (OSError, AttributeError) as error:
            self.troubles['priority'] = (
                f'realtime_priority: {priority} is not given to this process ({error}); it needs '
                'CAP_SYS_NICE or a limit of rtprio on Linux'
            )
            self.node.get_logger().warning(self.troubles['priority'])

    def on_poll(self) -> None:
        """Real time: count the axis states that have not come, and write it down."""
        deadline, present = self.component.next_deadline, self.now() - nanoseconds(LAG)
        if deadline is None or deadline > present:
            return
        self.publish(self.merger.advance(max(present, self.merger.time)))
        self.note_deadline(self.merger.time)


def make() -> ServoControllerNode:
    """Create the node."""
    return ServoControllerNode()


def main() -> None:
    """Run the node until it is interrupted."""
    run.main(make)


if __name__ == '__main__':
    main()

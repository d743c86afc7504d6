# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Node `simulated_body`: heats up behind a real controller, and makes `/clock` at a rate.

Its readings come in ticks, but the clock goes on between them: a controller has its own pace, and
what is read back of it wants a stamp of its own.
"""

import json
import sys
import time

from rclpy.node import Node
from rosgraph_msgs.msg import Clock as ClockMessage

from fuzzycnc_ros.components.machine.simulated_body import SimulatedBody
from fuzzycnc_ros.ros import run
from fuzzycnc_ros.ros.clocks import CLOCK_PERIOD, START_POLL, Pace, StartGate, wall_timer
from fuzzycnc_ros.ros.host import ComponentNode
from fuzzycnc_ros.ros.topics import RCLPY, publisher_qos
from fuzzycnc_ros.runtime.component import STREAM


class SimulatedBodyNode(ComponentNode):
    """Tick the body at a rate of machine time, and tell the time."""

    makes_time = True
    takes_turns = False
    component: SimulatedBody

    def __init__(self, node: Node) -> None:
        super().__init__(node, SimulatedBody)
        config = self.component.configuration
        self._rate = config.rate
        self._clock = node.create_publisher(ClockMessage, '/clock', publisher_qos(STREAM))
        self._pace: Pace | None = None
        self._ticks = 0
        self._done = False
        if self.settings.lockstep:
            self.troubles['lockstep'] = 'a controller keeps its own time: in lock-step it stands'
            return
        self._gate = StartGate(node, config.nodes, config.start_timeout, self.matched)
        self._timer = wall_timer(node, START_POLL, self._on_timer)

    @property
    def done(self) -> bool:
        """True if the time is over."""
        return self._done

    def now(self) -> int:
        """Return machine time, which this node makes; its own clock is the wall's."""
        return self.merger.time

    def _on_timer(self) -> None:
        """Make the tick that is due, else tell the time."""
        now = time.monotonic()
        stamp = self.component.next_tick
        if stamp is None:
            self._timer.cancel()
            self._finish()
            return
        if self._pace is None:
            if not self._gate.open():
                return
            self._pace = Pace(self._rate, stamp, now)
        if self._pace.due(stamp) <= now:
            self._pace.count(stamp, now)
            self._tell_time(stamp)
            self.work(stamp)
            self._ticks += 1
            self.publish(self.component.tick())
        else:
            self._tell_time(min(self._pace.time(now), stamp - 1))
        following = self.component.next_tick
        left = 0.0 if following is None else self._pace.due(following) - time.monotonic()
        self._timer.timer_period_ns = max(int(1e9 * min(left, CLOCK_PERIOD)), 1000)
        self._timer.reset()

    def _tell_time(self, stamp: int) -> None:
        self._clock.publish(ClockMessage(clock=RCLPY.time(stamp)))

    def _finish(self) -> None:
        late = self._pace.late if self._pace is not None else 0
        print(json.dumps({'ticks': self._ticks, 'late': late}), file=sys.stdout, flush=True)
        self.report()
        self._done = True


def make() -> SimulatedBodyNode:
    """Create the node."""
    return SimulatedBodyNode(Node(SimulatedBody.NAME))


def main() -> None:
    """Run the node until its time is over or it is interrupted."""
    run.main(make)


if __name__ == '__main__':
    main()

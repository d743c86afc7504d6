# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Node `simulated_machine`: makes machine time, in lock-step or by the clock, and `/clock`."""

import json
import sys
import time
from collections.abc import Mapping

from rclpy.node import Node
from rosgraph_msgs.msg import Clock as ClockMessage

from fuzzycnc_ros.components.machine.simulated_machine import (
    SimulatedMachine,
)
from fuzzycnc_ros.graph.sequencer import Sequencer
from fuzzycnc_ros.ros import run
from fuzzycnc_ros.ros.clocks import CLOCK_PERIOD, SLIP, START_POLL, Pace, StartGate, wall_timer
from fuzzycnc_ros.ros.host import ComponentNode
from fuzzycnc_ros.ros.topics import RCLPY, publisher_qos
from fuzzycnc_ros.runtime.component import STREAM
from fuzzycnc_ros.runtime.records import SECOND, nanoseconds

HOUR = 3600 * SECOND
CATCH_UP = 0.02
"""Wall time [s] for which late ticks are caught up before messages get their turn again."""
SLIP_DRIVEN = 5e-4
"""Wall time [s] from which on what is late is not caught up where others drive the axes: ticks
that nobody can answer are worse than slow ones."""


class SimulatedMachineNode(ComponentNode):
    """Tick the simulated machine: as fast as all nodes answer, or at a rate of machine time."""

    makes_time = True
    takes_turns = False
    component: SimulatedMachine

    def __init__(self, node: Node) -> None:
        super().__init__(node, SimulatedMachine)
        config = self.component.configuration
        self._clock = node.create_publisher(ClockMessage, '/clock', publisher_qos(STREAM))
        self._done = False
        self._ticks = 0
        self._told_time = 0.0
        self._driven = bool(config.servo_axes)
        self._gave_way = False
        self.sequencer: Sequencer | None = None
        self._pace: Pace | None = None
        if self.settings.lockstep:
            self.sequencer = Sequencer(
                node,
                config.lockstep_nodes,
                advance=self._tick,
                published=lambda: self.published,
                matched=self._all_matched,
                finished=self._finish,
                recorder=config.lockstep_recorder,
                answer_timeout=config.answer_timeout,
                reads=self.reads,
            )
        else:
            recorder = ('recorder',) if config.lockstep_recorder else ()
            self._gate = StartGate(
                node, {*config.lockstep_nodes, *recorder}, config.start_timeout, self.matched
            )
            self._timer = wall_timer(node, START_POLL, self._tick_in_time)

    @property
    def done(self) -> bool:
        """True if the programme is over."""
        return self._done

    def now(self) -> int:
        """Return machine time, which this node makes; its own clock is the wall's."""
        return self.merger.time

    def on_heard(self, topic: str, sequence_number: int) -> None:
        """Count the message in lock-step; in real time act on it at once."""
        if self.sequencer is not None:
            self.sequencer.received(topic, sequence_number)
        elif self._pace is not None:
            self._take_at_once(self._pace)

    def _take_at_once(self, pace: Pace) -> None:
        """Real time: look at what came in, as it may bring the next tick forward."""
        before = self.component.next_tick
        self.work(self.merger.time)
        after, now = self.component.next_tick, time.monotonic()
        if before is not None and after is not None and after < before:
            if pace.due(after) < now:
                pace.resume(self.merger.time, now)
            self._wake(pace.due(after) - now)

    def _all_matched(self, readers: Mapping[str, int]) -> bool:
        clock = self._clock
        return clock.get_subscription_count() >= readers.get(clock.topic_name, 0) and self.matched(
            readers
        )

    def _tick(self) -> int | None:
        self.work(self.merger.time)
        stamp = self.component.next_tick
        if stamp is None:
            return None
        self._ticks += 1
        self._tell_time(stamp)
        self.work(stamp)
        self.publish(self.component.tick())
        return stamp

    def _tell_time(self, stamp: int) -> None:
        """Publish machine time, in real time not for every tick of the axes."""
        if self.sequencer is None:
            now = time.monotonic()
            if now - self._told_time < CLOCK_PERIOD:
                return
            self._told_time = now
        self._clock.publish(ClockMessage(clock=RCLPY.time(stamp)))

    def _tick_in_time(self) -> None:
        """Make the ticks that are due, once the nodes of the run are there."""
        now = time.monotonic()
        if self._pace is None:
            first = self.component.next_tick
            if first is None or not self._gate.open():
                return
            config = self.component.configuration
            self._pace = Pace(config.rate, first, now, SLIP_DRIVEN if self._driven else SLIP)
        if self._driven and self._lets_commands_in(self._pace, now):
            self._wake(0.0)
            return
        # axes that others drive: their commands get a turn between any two ticks
        until = now + (0.0 if self._driven else CATCH_UP)
        while now <= until:
            stamp = self.component.next_tick
            if stamp is None:
                self._timer.cancel()
                self._finish()
                return
            if self._pace.due(stamp) > now:
                break
            self._pace.count(stamp, now)
            self._tick()
            now = time.monotonic()
            self._leave_out_night(self._pace, stamp, now)
        following = self.component.next_tick
        self._wake(0.0 if following is None else self._pace.due(following) - now)

    def _leave_out_night(self, pace: Pace, stamp: int, now: float) -> None:
        """Go on to the next duty at once, for which the machine stands until it is cold.

        The other nodes hear of it a tick before its first message, so that none is refused as
        one from the future.
        """
        config, following = self.component.configuration, self.component.next_tick
        begin = 0 if following is None else following - nanoseconds(config.tick_period)
        if begin <= stamp:
            return
        pace.resume(begin, now)
        self._clock.publish(ClockMessage(clock=RCLPY.time(begin)))
        self.node.get_logger().info(
            f'the next duty begins, cold, {(begin - stamp) / HOUR:.1f} h of machine time later'
        )

    def _lets_commands_in(self, pace: Pace, now: float) -> bool:
        """Return True if a late tick waits once for the commands that have come in meanwhile.

        The executor calls timers before it takes messages.
        """
        stamp = self.component.next_tick
        late = stamp is not None and now - pace.due(stamp) > SLIP_DRIVEN
        self._gave_way = late and not self._gave_way
        return self._gave_way

    def _wake(self, wait: float) -> None:
        """Have the timer call back once more, in `wait` [s] from now."""
        self._timer.timer_period_ns = max(int(1e9 * wait), 1000)
        self._timer.reset()

    def _finish(self) -> None:
        lost = self.sequencer.lost if self.sequencer else []
        missed = self.sequencer.missed if self.sequencer else 0
        outcome = {
            'ticks': self._ticks,
            'degraded': bool(lost or missed),
            'lost': lost,
            'missed': missed,
        }
        if self._pace is not None:
            outcome['late'] = self._pace.late
        if self.component.failure:
            outcome['failure'] = self.component.failure
            self.exit_code = 1
        print(json.dumps(outcome), file=sys.stdout, flush=True)
        self.report()
        self._done = True


def make() -> SimulatedMachineNode:
    """Create the node."""
    return SimulatedMachineNode(Node(SimulatedMachine.NAME))


def main() -> None:
    """Run the node until its programme is over or it is interrupted."""
    run.main(make)


if __name__ == '__main__':
    main()

# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Node `simulated_machine`: makes machine time, in lock-step or by the clock, and `/clock`."""

import json
import sys
import time
from collections.abc import Mapping

from rclpy.node import Node
from rosgraph_msgs.msg import Clock as ClockMessage

from fuzzycnc_ros.components.component import STREAM
from fuzzycnc_ros.components.simulated_machine import SimulatedMachine, SimulatedMachineConfig
from fuzzycnc_ros.nodes import run
from fuzzycnc_ros.nodes.host import ComponentNode
from fuzzycnc_ros.nodes.messages import RCLPY
from fuzzycnc_ros.nodes.qos import publisher_qos
from fuzzycnc_ros.nodes.sequencer import Sequencer
from fuzzycnc_ros.nodes.timers import wall_timer

SETTLING = 1.0
"""Wall time [s] for which the graph must have been complete before a run without lock-step starts:
the other nodes, above all the recorder, still find each other's topics."""


class SimulatedMachineNode(ComponentNode):
    """Tick the simulated machine: as fast as all nodes answer, or at a rate of machine time."""

    takes_turns = False
    component: SimulatedMachine

    def __init__(self, node: Node) -> None:
        super().__init__(node, SimulatedMachine)
        config = self.component.configuration
        assert isinstance(config, SimulatedMachineConfig)
        self._clock = node.create_publisher(ClockMessage, '/clock', publisher_qos(STREAM))
        self._done = False
        self.sequencer: Sequencer | None = None
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
                reads=tuple(self._subscriptions),
            )
        else:
            self._waiting_since: float | None = time.monotonic()
            self._complete_since: float | None = None
            wall_timer(node, config.tick_period / config.rate, self._tick_in_time)

    @property
    def done(self) -> bool:
        """Whether the programme is over."""
        return self._done

    def _heard(self, topic: str, sequence_number: int) -> None:
        if self.sequencer is not None:
            self.sequencer.received(topic, sequence_number)

    def _all_matched(self, readers: Mapping[str, int]) -> bool:
        clock = self._clock
        return clock.get_subscription_count() >= readers.get(clock.topic_name, 0) and self.matched(
            readers
        )

    def _tick(self) -> int | None:
        stamp = self.component.next_tick
        if stamp is None:
            return None
        self._clock.publish(ClockMessage(clock=RCLPY.time(stamp)))
        self._work(stamp)
        self.publish(self.component.tick())
        return stamp

    def _tick_in_time(self) -> None:
        """Tick, once the nodes of the run are there; what they miss at first is lost."""
        if self._waiting_since is not None and not self._may_start(self._waiting_since):
            return
        self._waiting_since = None
        if self._tick() is None:
            self._finish()

    def _may_start(self, since: float) -> bool:
        config = self.component.configuration
        assert isinstance(config, SimulatedMachineConfig)
        wanted = {*config.lockstep_nodes, *(('recorder',) if config.lockstep_recorder else ())}
        missing = wanted - set(self.node.get_node_names())
        if missing or not self.matched({}):
            self._complete_since = None
        elif self._complete_since is None:
            self._complete_since = time.monotonic()
        elif time.monotonic() - self._complete_since > SETTLING:
            return True
        if time.monotonic() - since < config.start_timeout:
            return False
        if missing:
            named = ', '.join(sorted(missing))
            self.node.get_logger().warning(f'starting without {named}: not seen on the graph')
        return True

    def _finish(self) -> None:
        lost = self.sequencer.lost if self.sequencer else []
        missed = self.sequencer.missed if self.sequencer else 0
        outcome = {
            'ticks': self.sequencer.tick if self.sequencer else self.component.total_ticks,
            'degraded': bool(lost or missed),
            'lost': lost,
            'missed': missed,
        }
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

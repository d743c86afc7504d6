# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Live control at 1 kHz: how fast machine and controller run over DDS in lock-step.

Two graphs, without and with a recorder, each of separate processes.  In one run of each the same
two processes are timed twice:

- *empty loop*: the controller is not active.  The machine ticks every millisecond and publishes
  `axis_state`; the node gets its turn in every tick, receives it, does nothing and answers.  No
  command is computed, published or waited for.
- *servo loop*: the controller has been activated, answers every axis state by a command that the
  machine waits for, and moves the axis there and back, 50 mm in 1.2 s each.

The servo loop is to reach 0.6 times the ticks per second of the empty loop.  Times are the wall's,
taken from `servo_state`, which comes every 50 ticks, so they mean something on an idle host only;
the load is printed.  Run with `python benchmarks/bench_servo_graph.py`.
"""

import os
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import rclpy
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
from rclpy.executors import SingleThreadedExecutor

from fuzzycnc_ros.cli.live.free_domain import own_domain
from fuzzycnc_ros.cli.live.graph_processes import GraphProcesses
from fuzzycnc_ros.graph.bring_up import NodeSpec
from fuzzycnc_ros.ros.topics import message_class, subscription_qos
from fuzzycnc_ros.runtime.component import STREAM
from fuzzycnc_ros.runtime.convert import decode
from fuzzycnc_ros.runtime.enums import ServoStatus
from fuzzycnc_ros.runtime.records import SECOND, ServoState

MOVE_TIME, EMPTY, MOVES = 1.2, 10, 10
"""Time of a move [s], and how many times it runs empty, and moves."""
TARGET = -0.05
RATIO_MIN = 0.6
TIMEOUT = 180.0


@dataclass(frozen=True)
class Speed:
    """Ticks per second of wall time of the two loops."""

    empty: float
    servo: float


class Stopwatch:
    """A node that hears `servo_state` now and then, and activates the controller half-way."""

    def __init__(self) -> None:
        rclpy.init()
        self.node = rclpy.create_node('stopwatch', namespace='/mill')
        self.executor = SingleThreadedExecutor()
        self.executor.add_node(self.node)
        self.heard: list[tuple[int, float, int]] = []
        self.node.create_subscription(
            message_class(ServoState.TYPE),
            'servo_state',
            self._on_state,
            subscription_qos(STREAM, lockstep=True),
        )
        self._change = self.node.create_client(ChangeState, 'servo_controller/change_state')

    def _on_state(self, message: Any) -> None:
        state = decode(ServoState, message)
        self.heard.append((state.stamp, time.perf_counter(), state.status))

    def spin(self) -> None:
        """Work for a moment."""
        self.executor.spin_once(timeout_sec=0.05)

    def transition(self, number: int) -> None:
        """Take the controller through a transition of its lifecycle."""
        while not self._change.service_is_ready():
            self.spin()
        future = self._change.call_async(ChangeState.Request(transition=Transition(id=number)))
        while not future.done():
            self.spin()
        if not future.result().success:
            raise RuntimeError(f'transition {number} was refused')

    def speed(self, begin: int, end: int) -> float:
        """Return the ticks per second of wall time between two machine times [ns]."""
        part = [(stamp, wall) for stamp, wall, _ in self.heard if begin <= stamp <= end]
        (first, started), (last, ended) = part[0], part[-1]
        return 1e-6 * (last - first) / (ended - started)

    def close(self) -> None:
        """Leave the graph."""
        self.executor.shutdown()
        self.node.destroy_node()
        rclpy.shutdown()


def measure(bag: Path | None, folder: Path) -> Speed:
    """Run one graph, with a recorder if there is a bag to write; return its speeds."""
    moves = ['X:0.0'] * EMPTY + [f'X:{TARGET}', 'X:0.0'] * (MOVES // 2)
    specs = [NodeSpec('servo_controller', {'lockstep': True})]
    if bag is not None:
        specs.append(NodeSpec('recorder', {'lockstep': True, 'output': str(bag)}))
    machine = {
        'duties': [''],
        'servo_axes': ['X:lathe'],
        'moves': moves,
        'move_time': MOVE_TIME,
        'lockstep': True,
        'lockstep_nodes': ['servo_controller'],
        'lockstep_recorder': bag is not None,
    }
    with GraphProcesses('mill', folder=folder) as graph:
        for spec in specs:
            graph.start(spec)
        watch = Stopwatch()
        try:
            watch.transition(Transition.TRANSITION_CONFIGURE)
            graph.start(NodeSpec('simulated_machine', machine))
            while not watch.heard:
                watch.spin()
            begin = watch.heard[0][0]
            half = begin + round(0.8 * EMPTY * MOVE_TIME * SECOND)
            until = time.monotonic() + TIMEOUT
            while watch.heard[-1][0] < half and time.monotonic() < until:
                watch.spin()
            asked = watch.heard[-1][0]
            watch.transition(Transition.TRANSITION_ACTIVATE)
            while 'simulated_machine' not in graph.poll() and time.monotonic() < until:
                watch.spin()
            outcome = graph.outcome('simulated_machine')
            if outcome.get('degraded') is not False or 'failure' in outcome:
                raise RuntimeError(f'the run is worth nothing: {outcome}')
            moving = begin + round(EMPTY * MOVE_TIME * SECOND)
            idle = [status for stamp, _, status in watch.heard if stamp <= asked]
            if set(idle) != {int(ServoStatus.INACTIVE)} or asked >= moving:
                raise RuntimeError('the controller was not idle where it was to be')
            return Speed(
                watch.speed(begin + SECOND, asked), watch.speed(moving, watch.heard[-1][0])
            )
        finally:
            watch.close()


def main() -> int:
    """Print ticks per second, ratios and real-time factors; fail below the least ratio."""
    own_domain()
    print(f'load of this host: {os.getloadavg()[0]:.2f} on {os.cpu_count()} cores')
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        found = {
            'without recorder': measure(None, folder / 'bare'),
            'with recorder': measure(folder / 'bag', folder / 'recorded'),
        }
    print(f'{"":18} {"empty":>9} {"servo":>9} {"servo /":>8} {"times":>10}')
    print(f'{"ticks/s":18} {"loop":>9} {"loop":>9} {"empty":>8} {"real time":>10}')
    for what, speed in found.items():
        ratio = speed.servo / speed.empty
        print(
            f'{what:18} {speed.empty:9.0f} {speed.servo:9.0f} {ratio:8.2f} '
            f'{1e-3 * speed.servo:10.2f}'
        )
    least = min(speed.servo / speed.empty for speed in found.values())
    print(f'{least:.2f} times the empty loop, {RATIO_MIN:g} expected')
    return 0 if least >= RATIO_MIN else 1


if __name__ == '__main__':
    sys.exit(main())

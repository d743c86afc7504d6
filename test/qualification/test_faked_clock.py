# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The clock of the system is set under a whole process, middleware and all, by libfaketime.

The other tests of clocks set that of a node inside Python.  Here `clock_gettime` itself lies to
bridge, compensator, or both, while offsets are in force in a control behind OPC UA.
"""

import json
import signal
import sys
import time
from functools import partial
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip('asyncua')

from benches.component_bench import thermal_error
from equipment.field_servers import Field
from equipment.opcua_machine import AXES, FILE, ControlServer, LineControl, control_file
from live_graph import parameter_file, ros_arguments

from fuzzycnc_ros.core.inputs.offset_input import OffsetStatus
from fuzzycnc_ros.graph.bring_up import NodeSpec
from fuzzycnc_ros.ros.topics import RCLPY, message_class, publisher_qos
from fuzzycnc_ros.runtime.component import Durability
from fuzzycnc_ros.runtime.convert import encode
from fuzzycnc_ros.runtime.host import NodeEvent
from fuzzycnc_ros.runtime.records import SECOND, CompensationApplied, ThermalError

LIBRARIES = sorted(Path('/usr/lib').glob('**/faketime/libfaketimeMT.so.1'))
pytestmark = [
    pytest.mark.ros,
    pytest.mark.realtime,
    pytest.mark.qualify,
    pytest.mark.skipif(not LIBRARIES, reason='libfaketime is absent: apt-get install faketime'),
]

MICRON = 1e-6
WANTED, CLOSE = 30 * MICRON, 0.2 * MICRON
SLEW = 10 * MICRON
"""Of compensator and bridge [m/s]; the control itself would move twenty times as fast."""
NODES = {
    'compensator': {
        **{'autostart': True, 'axes': list(AXES), 'slew_max': SLEW, 'ramp_rate': SLEW},
        **{'period': 0.1, 'validity': 2.0, 'stale_after': 3.0, 'hold_time': 2.0},
    },
    'opcua_bridge': {
        **{'autostart': True, 'axes': list(AXES), 'slew_max': SLEW, 'cycle_period': 0.05},
        **{'acknowledge_time': 1.0, 'takeover_time': 0.5, 'validity': 4.0},
    },
}
APART, SLACK = 0.25, 0.3
"""Wall time [s] between samples that are compared, and by how much theirs may be off."""
LAG = 5 * MICRON
"""How far the control may be behind what is written [m]."""


class Loop:
    """A lasting thermal error, a compensator and a bridge against it, each with a clock."""

    def __init__(self, graph, observer, server, folder):
        self.graph, self.observer, self.server, self.folder = graph, observer, server, folder
        self.applied = observer.records('compensation_applied', CompensationApplied)
        self.events = observer.records('node_event', NodeEvent, Durability.HISTORY)
        observer.watch_diagnostics()
        self._publisher = observer.node.create_publisher(
            message_class(ThermalError.TYPE), 'thermal_error', publisher_qos(Durability.STREAM)
        )
        observer.node.create_timer(0.1, self._tell_error)
        self.ahead = 0
        self.running = []
        self._sample, self._watched = (time.monotonic(), server.control.offset.copy()), True
        for node in NODES:
            self.set_clock(node, 0)

    def start(self):
        """Start both nodes, each under a libfaketime that its own file leads."""
        for node, parameters in NODES.items():
            place = self.folder / node
            if node == 'opcua_bridge':
                control = control_file(place, self.server.port, FILE, timeout=1.0)
                parameters = {**parameters, 'control_file': str(control)}
            file = parameter_file(place, '/mill', [NodeSpec(node, parameters)])
            command = [
                'env',
                f'LD_PRELOAD={LIBRARIES[0]}',
                f'FAKETIME_TIMESTAMP_FILE={self._file(node)}',
                'FAKETIME_DONT_FAKE_MONOTONIC=1',
                'FAKETIME_CACHE_DURATION=1',
                *(sys.executable, '-m', f'fuzzycnc_ros.nodes.{node}'),
                *ros_arguments('/mill', [file]),
            ]
            self.running.append(self.graph.launch(node, command, place))

    def _file(self, node):
        return self.folder / node / 'clock'

    def set_clock(self, node, ahead):
        """Set the clock of a node ahead of the true one [s]."""
        file = self._file(node)
        file.parent.mkdir(exist_ok=True)
        new = file.with_name('clock.new')
        new.write_text(f'{ahead:+d}\n')
        new.replace(file)

    def _tell_error(self):
        record = thermal_error(
            time.time() + self.ahead, np.full(len(AXES), -WANTED), axis=AXES, channel=AXES
        )
        self._publisher.publish(encode(record, RCLPY))

    def until(self, condition, what):
        def sampled():
            control = self.server.control
            now, (since, before) = time.monotonic(), self._sample
            written = control.offset.copy()
            # A control that hears nothing for long leaves what is written, as fast as it likes.
            low, high = np.minimum(before, written), np.maximum(before, written)
            inside = (control.applied >= low - LAG) & (control.applied <= high + LAG)
            self._watched &= bool(np.all(inside))
            if now - since >= APART:
                if self._watched:
                    moved = np.max(np.abs(written - before))
                    assert moved <= SLEW * (now - since + SLACK), f'stepped by {moved} m'
                left = np.max(np.abs(control.applied - written))
                self._sample, self._watched = (now, written), bool(left <= LAG)
            return condition()

        try:
            self.observer.until(sampled, what, 60.0)
        except AssertionError as error:
            raise AssertionError(f'{error}; last {self.applied[-1:]}') from None

    def stands_at(self, offset):
        return bool(np.all(np.abs(self.server.control.applied - offset) < CLOSE))

    def arrives(self):
        self.until(
            lambda: self.stands_at(WANTED) and self.applied[-1].status == OffsetStatus.FOLLOWING,
            'the offset is in force',
        )

    def told(self, node, count, step):
        """Wait for a step of a node's clock, in its events and its health."""

        def steps():
            return [
                json.loads(event.request)['step'] / SECOND
                for event in self.events
                if event.name == 'clock_step' and event.node == node
            ]

        self.until(lambda: len(steps()) >= count, f'event of {node}')
        assert steps()[count - 1 :] == [pytest.approx(step, abs=5.0)]
        said = partial(self.observer.told, f'mill/{node}: clock', 'the clock stepped by')
        self.until(said, f'{node} says it')


@pytest.fixture
def loop(graph, observer, tmp_path):
    field = Field()
    server = field.add(ControlServer(LineControl()))
    server.control.slew = 20 * SLEW
    loop = Loop(graph, observer, server, tmp_path)
    loop.start()
    loop.arrives()
    yield loop
    field.close()


@pytest.mark.parametrize('step', [-3_600, 3_600])
def test_clock_of_the_computer_is_set(loop, step):
    """Both nodes say it and begin a new series; the offset stays."""
    loop.ahead = step
    for node in NODES:
        loop.set_clock(node, step)
    for node in NODES:
        loop.told(node, 1, step)
    heard = len(loop.applied)
    loop.until(
        lambda: any(
            abs(item.stamp - time.time_ns() - step * SECOND) < 60 * SECOND
            and item.status == OffsetStatus.FOLLOWING
            for item in loop.applied[heard:]
        ),
        'followed by the new clock',
    )
    loop.arrives()


def test_computer_was_suspended(loop):
    """Ten minutes, in which the control has let the offset go: it comes back, never by a step."""
    for running in loop.running:
        running.send(signal.SIGSTOP)
    loop.until(lambda: loop.stands_at(0.0), 'the control takes it to zero by itself')
    loop.ahead = 600
    for node in NODES:
        loop.set_clock(node, loop.ahead)
    for running in loop.running:
        running.send(signal.SIGCONT)
    for node in NODES:
        loop.told(node, 1, loop.ahead)
    loop.arrives()


@pytest.mark.parametrize('step', [-3_600, 3_600])
@pytest.mark.parametrize('node', [*NODES])
def test_clock_of_one_node_is_set(loop, node, step):
    """What the other says is of another time: the offset ramps to zero, and comes back later."""
    loop.set_clock(node, step)
    loop.told(node, 1, step)
    loop.until(lambda: loop.stands_at(0.0), 'taken to zero')
    loop.set_clock(node, 0)
    loop.told(node, 2, -step)
    loop.arrives()

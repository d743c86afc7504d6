# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Nodes killed and clocks set while offsets move and LinuxCNC cuts: nothing steps.

What LinuxCNC applies is sampled in every servo period: nothing escapes between two reports.
"""

import contextlib
import shutil
import tempfile
import time
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from benches.component_bench import thermal_error
from equipment.linuxcnc_machine import LinuxcncMachine, exclusive
from equipment.linuxcnc_offsets import OffsetTrace, fastest

from fuzzycnc_ros.core.inputs.offset_input import OffsetStatus
from fuzzycnc_ros.ros.topics import RCLPY, message_class, publisher_qos
from fuzzycnc_ros.runtime.component import Durability
from fuzzycnc_ros.runtime.convert import encode
from fuzzycnc_ros.runtime.records import Compensation, CompensationApplied, ThermalError

pytestmark = [pytest.mark.ros, pytest.mark.realtime, pytest.mark.qualify]

MICRON = 1e-6
CLOSE = 0.2 * MICRON
WANTED = 30 * MICRON
MIDWAY = 12 * MICRON
SLEW = 10 * MICRON
"""Of the compensator [m/s]; the bridge may go half as fast again, the HAL file twice as fast."""
HOLD = 5.0
COMPENSATOR = {
    'autostart': True,
    'slew_max': SLEW,
    'ramp_rate': SLEW,
    'period': 0.1,
    'validity': 2.0,
    'stale_after': 5.0,
}
BRIDGE = {'autostart': True, 'axes': ['Y', 'Z'], 'slew_max': 1.5 * SLEW, 'adopt_time': 20.0}
HAL = {'COUNTS_PER_SECOND': 2 * SLEW / 1e-8, 'HOLD_TIME': HOLD}
COUNT = 1e-8
CIRCLES = """G21 G90 G94 G64 P0.01
F3000
G0 X10 Y0
o1 repeat [500]
G2 X10 Y0 I-10 J0
o1 endrepeat
M2
"""
COMPENSATOR_INPUT = 'mill/compensator: compensation_applied'


class Loop:
    """A thermal error that lasts, a compensator and a bridge against it, a LinuxCNC that cuts."""

    def __init__(self, graph, observer, controller, folder):
        self.graph, self.observer, self.controller = graph, observer, controller
        self._folder = folder
        self._clock = folder / 'clock'
        self.set_clock(0)
        self.applied = observer.records('compensation_applied', CompensationApplied)
        self.commands = observer.records('compensation', Compensation)
        observer.watch_diagnostics()
        self._publisher = observer.node.create_publisher(
            message_class(ThermalError.TYPE), 'thermal_error', publisher_qos(Durability.STREAM)
        )
        observer.node.create_timer(0.1, self._tell_error)
        self._traces = []

    def set_clock(self, forward):
        """Set the clock of all nodes forward [s], against the true one."""
        new = self._folder / 'clock.new'
        new.write_text(str(int(1e9 * forward)))
        new.replace(self._clock)

    def _tell_error(self):
        ahead = 1e-9 * int(self._clock.read_text())
        record = thermal_error(time.time() + ahead, (0.0, -WANTED))
        self._publisher.publish(encode(record, RCLPY))

    def cut(self):
        """Switch LinuxCNC on, home it, and let it cut circles; its offsets are sampled."""
        self._traces.append(OffsetTrace(self.controller, self._folder))
        self.controller.ready()
        self.controller.run(self.controller.write_program('circles', CIRCLES))

    def bridge(self):
        return self.graph.start_by(self._clock, 'linuxcnc_bridge', BRIDGE)

    def compensator(self):
        return self.graph.start_by(self._clock, 'compensator', COMPENSATOR)

    @property
    def offset(self):
        """What was read back last [m]."""
        return self.applied[-1].offset[self.applied[-1].axis.index('Z')] if self.applied else 0.0

    def until(self, condition, what, timeout=60.0):
        def text():
            return f'{what}; last {self.applied[-1] if self.applied else None}'

        try:
            self.observer.until(condition, what, timeout)
        except AssertionError as error:
            raise AssertionError(f'{error}: {text()}') from None

    def midway(self):
        self.until(lambda: self.offset > MIDWAY, 'on the way')

    def arrives(self):
        self.until(lambda: abs(self.offset - WANTED) < CLOSE, 'all of it in force')

    def stands(self):
        """What LinuxCNC applies, asked of itself [m]."""
        return 1e-3 * float(self.controller.halcmd('gets', 'fuzzycnc-applied-z').split()[-1])

    def check(self):
        """Nothing stepped, neither in a servo period nor from one read-back to the next."""
        assert self.controller.state()['running']
        for trace in self._traces:
            offsets = trace.stop()
            print(
                f'largest change in 1 ms {1e6 * np.abs(np.diff(offsets)).max():.3f} um, fastest '
                f'{1e6 * fastest(offsets):.2f} um/s, from {1e6 * offsets.min():.2f} to '
                f'{1e6 * offsets.max():.2f} um in {len(offsets)} periods'
            )
            assert fastest(offsets) <= 2 * SLEW + 4 * COUNT / 0.05
            assert np.abs(np.diff(offsets)).max() <= 10 * COUNT
            assert offsets.max() <= WANTED + CLOSE
            assert offsets.min() >= -CLOSE

    def close(self):
        for trace in self._traces:
            trace.close()


@pytest.fixture(params=[False, True], ids=['counts', 'slopes'])
def loop(graph, observer, request):
    """Everything runs, and half of the offset is in force."""
    with exclusive(slopes=request.param), contextlib.ExitStack() as stack:
        folder = Path(tempfile.mkdtemp(prefix='fuzzycnc-linuxcnc-'))
        stack.callback(shutil.rmtree, folder, ignore_errors=True)
        controller = LinuxcncMachine(folder, slopes=request.param, **HAL)
        stack.callback(controller.end)
        controller.start()
        found = Loop(graph, observer, controller, folder)
        stack.callback(found.close)
        found.cut()
        yield found


def test_killed_compensator(loop):
    """Its last command expires, the bridge goes to zero, and a new one joins on the way there."""
    loop.bridge()
    first = loop.compensator()
    loop.midway()
    loop.graph.kill(first)
    loop.until(lambda: loop.applied[-1].status == OffsetStatus.EXPIRED, 'expired')
    top = loop.offset
    loop.until(lambda: MICRON < loop.offset < top - 3 * MICRON, 'on the way to zero')
    assert 'expired; going to zero' in loop.applied[-1].reason
    epoch, told = loop.commands[-1].epoch, len(loop.commands)
    loop.compensator()
    loop.arrives()
    joined = loop.commands[told]
    assert joined.epoch > epoch
    assert loop.commands[-1].epoch == loop.applied[-1].epoch
    # it goes on from the read-back that it had heard, at most a report ago
    assert joined.offset[1] < WANTED / 2 + 3 * MICRON
    loop.check()


def test_killed_bridge(loop):
    """The offset stands; the compensator says that nobody owns it; a new bridge takes it up.

    The next one is killed too, and the one after it comes when HAL has taken the offset to zero.
    """
    first = loop.bridge()
    loop.compensator()
    loop.midway()
    loop.graph.kill(first)
    unowned = 'stood then, which nobody may own now'
    loop.until(lambda: loop.observer.told(COMPENSATOR_INPUT, unowned), 'told')
    standing = loop.stands()
    assert standing > MIDWAY
    heard = len(loop.applied)
    second = loop.bridge()
    loop.until(lambda: len(loop.applied) > heard, 'a new bridge')
    assert loop.offset == pytest.approx(standing, abs=CLOSE)
    loop.arrives()
    loop.graph.kill(second)
    loop.until(lambda: loop.stands() < CLOSE, 'taken to zero by HAL', HOLD + 60.0)
    loop.bridge()
    loop.arrives()
    loop.check()


def test_killed_linuxcnc(loop):
    """The bridge says so at once, finds the new one by itself, and starts from its zero."""
    loop.bridge()
    loop.compensator()
    loop.midway()
    loop.controller.kill()
    loop.until(lambda: loop.applied[-1].status == OffsetStatus.REFUSED, 'told')
    assert 'LinuxCNC' in loop.applied[-1].reason
    assert not loop.applied[-1].offset.any()
    refused = 'refused by the machine: LinuxCNC'
    loop.until(lambda: loop.observer.told('mill/compensator: read-back', refused), 'told on')
    loop.controller.start()
    loop.cut()
    loop.arrives()
    loop.check()


@pytest.mark.parametrize('step', [-86_400, -3_600, 3_600])
def test_clock_is_set_while_offsets_move(loop, step):
    """Both nodes begin a new series, and the offset arrives without a step."""
    loop.bridge()
    loop.compensator()
    loop.midway()
    loop.set_clock(step)
    for node in ('compensator', 'linuxcnc_bridge'):
        said = partial(loop.observer.told, f'mill/{node}: clock', 'the clock stepped by')
        loop.until(said, f'{node} says it')
    loop.arrives()
    assert loop.applied[-1].status == OffsetStatus.FOLLOWING
    loop.check()


@pytest.mark.parametrize('step', [-86_400, 3_600])
def test_clock_is_set_while_nobody_commands(loop, step):
    """The last command expires by the monotonic clock, wherever the wall clock goes."""
    loop.bridge()
    compensator = loop.compensator()
    loop.arrives()
    loop.graph.kill(compensator)
    loop.set_clock(step)
    loop.until(lambda: loop.applied[-1].status == OffsetStatus.EXPIRED, 'expired')
    loop.until(lambda: loop.stands() < CLOSE, 'taken to zero')
    loop.set_clock(0)
    loop.compensator()
    loop.arrives()
    loop.check()

# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""A real LinuxCNC that probes: faults of the probe, and a day on which nobody lends a hand."""

import json
import shutil
import tempfile
import time
from math import pi
from pathlib import Path

import numpy as np
import pytest
from benches.probe_rig import reference_at
from equipment.linuxcnc_machine import exclusive
from equipment.linuxcnc_probe import FILE, NEVER, ON_A_SIDE, LinuxcncWithProbe
from rosgraph_msgs.msg import Clock as ClockMessage

from fuzzycnc_ros.adapters.probing.probe_file import read_plan
from fuzzycnc_ros.adapters.probing.programs import write_programs
from fuzzycnc_ros.cli.demo.linuxcnc import COUNT, SLEW
from fuzzycnc_ros.cli.live.graph_processes import GraphProcesses
from fuzzycnc_ros.cli.live.operator_client import OperatorClient
from fuzzycnc_ros.components.machine.simulated_body import SimulatedBody, SimulatedBodyConfig
from fuzzycnc_ros.graph.bring_up import LEARNING, NodeSpec
from fuzzycnc_ros.ros.clocks import CLOCK_PERIOD, Pace, wall_timer
from fuzzycnc_ros.ros.topics import (
    RCLPY,
    create_publisher,
    create_subscription,
    message_class,
    publisher_qos,
    subscription_qos,
)
from fuzzycnc_ros.runtime.component import LATCHED, STREAM
from fuzzycnc_ros.runtime.convert import decode, encode
from fuzzycnc_ros.runtime.records import (
    CompensationApplied,
    Displacement,
    MachineState,
    ProbeCycleState,
    Temperatures,
    ThermalReference,
)
from fuzzycnc_ros.simulation.thermal.duties import DUTIES

pytestmark = [pytest.mark.ros, pytest.mark.qualify]

MICRON = 1e-6
RATE = 60.0
"""Machine time over that of LinuxCNC while it cuts."""
HOURS = 9
LAP = 300.0
"""Machine time between two looks whether a cycle is due [s]."""
TIMEOUT = 90.0


@pytest.fixture
def machine(tmp_path):
    """A LinuxCNC with a probe, switched on and homed, and the file of its cycle."""
    file = tmp_path / 'probe.yaml'
    file.write_text(FILE)
    with exclusive():
        folder = Path(tempfile.mkdtemp(prefix='fuzzycnc-linuxcnc-'))
        programs = write_programs(read_plan(file), 'linuxcnc')
        rate = 2.0 * RATE * SLEW / COUNT
        controller = LinuxcncWithProbe(folder, programs, COUNTS_PER_SECOND=rate)
        try:
            controller.start()
            controller.ready()
            yield controller, file
        finally:
            controller.end()
            shutil.rmtree(folder, ignore_errors=True)


def call(controller):
    """Run the cycle as a program does; return what it returned and where the machine is then."""
    lines = ['G21 G90', 'G53 G0 Z0', 'G53 G0 X20 Y-20', 'o<fuzzycnc_probe> call']
    lines += ['M68 E3 Q[#<_value>]', 'M2', '']
    controller.run(controller.write_program('one', '\n'.join(lines)))
    until = time.monotonic() + TIMEOUT
    while controller.state()['running']:
        assert time.monotonic() < until, controller.log
    return float(controller.halcmd('getp', 'motion.analog-out-03')), controller.state()['position']


def test_a_faulty_probe_teaches_nothing_false_and_ends_the_cycle_above(machine, graph, observer):
    controller, file = machine
    references = observer.node.create_publisher(
        message_class(ThermalReference.TYPE), 'thermal_reference', publisher_qos(LATCHED)
    )
    probes = observer.records('displacement', Displacement)
    states = observer.records('probe_cycle_state', ProbeCycleState, LATCHED)
    graph.start('linuxcnc_bridge', {'axes': ['Y', 'Z']})
    parameters = {'interval_min': 0.0, 'failures_max': 9}
    graph.start('probe_cycle', {'probe_file': str(file), **parameters})
    observer.until(lambda: states, 'the plan')
    references.publish(encode(reference_at(time.time_ns()), RCLPY))
    observer.until(lambda: states[-1].due, 'due after the reference')
    due = 'motion.digital-in-00'
    observer.until(lambda: controller.halcmd('getp', due) == 'TRUE', 'shown in the control')

    def cycle(text='', **errors):
        """Run a cycle, wait for what is told of it; return the newest displacement [um]."""
        controller.error(**errors)
        before = states[-1].stamp
        value, place = call(controller)
        observer.until(lambda: states[-1].stamp > before and states[-1].outcome == text, text)
        assert place[2] == pytest.approx(-64.0, abs=0.1), 'above at the end'
        return value, probes[-1].displacement / MICRON if probes else None

    value, found = cycle()
    assert value == 0.0
    np.testing.assert_allclose(found, 0.0, atol=1e-9)
    assert controller.halcmd('getp', due) == 'FALSE'
    # chips: one that falls off at the first touch, one that stays for two, one on a side
    controller.chips(1)
    _, found = cycle(Y=12.0, Z=-31.0)
    np.testing.assert_allclose(found, [12.0, -31.0], atol=1.0)
    controller.chips(0, 1, 2)
    value, _ = call(controller)
    observer.until(lambda: 'touches differ' in states[-1].outcome, 'a chip for two touches')
    assert (value, len(probes), states[-1].accepted) == (0.0, 2, False)
    controller.chips(*range(ON_A_SIDE), positive=True)
    value, _ = call(controller)
    observer.until(lambda: 'further apart' in states[-1].outcome, 'a chip on a side')
    np.testing.assert_allclose(probes[-1].displacement / MICRON, [np.nan, -31.0], atol=1.0)
    controller.chips()

    # broken stylus, missed sphere: it touches nothing
    controller.reach(NEVER)
    missed = (
        'ball, Y: no touch where one was expected, or one on the way; look at the probe and at '
        'what it should touch'
    )
    value, _ = cycle(missed, Y=50.0, Z=50.0)
    assert value == 1.0
    # something is in the way down
    controller.reach(18.0)
    value, _ = cycle(missed, Y=60.0)
    assert value == 1.0
    assert len(probes) == 3
    # a probe that trips a millimetre early, and one that trips early by 0.1 mm on all sides
    controller.reach(14.0)
    controller.halcmd('sets', 'reach', '13.6')
    value, _ = call(controller)
    observer.until(lambda: 'touched at' in states[-1].outcome, 'touched too early')
    controller.reach(13.1)
    value, _ = call(controller)
    observer.until(lambda: 'further apart' in states[-1].outcome, 'larger than before')
    for probe in probes[3:]:
        assert np.isnan(probe.displacement[0])
        assert not probe.displacement[1] / MICRON > 60.0
    # repaired
    controller.reach()
    _, found = cycle(Y=-5.0, Z=8.0)
    np.testing.assert_allclose(found, [-5.0, 8.0], atol=1.0)
    assert states[-1].failures == 0


def day_program(duration):
    """Return a program that works through duties, and probes when that is due."""
    circle = 40.0 * pi
    lines = ['G21 G90 G94 G17 G64 P0.01', 'G53 G0 Z0', 'G53 G0 X20 Y-20']
    lines.append(f'F{circle / (LAP / RATE / 60.0):.3f}')
    # The zero, before the spindle warms anything: the cycle is due right after the reference.
    lines += ['M66 P0 L3 Q20', 'o<fuzzycnc_probe> call', 'G53 G0 Z0', 'G53 G0 X20 Y-20']
    blocks = [block for name in ('T1', 'T2', 'D0', 'D0b') for block in DUTIES[name].blocks]
    passed, number = 0.0, 100
    while passed < duration:
        for block in blocks:
            laps = max(round(block.duration / LAP), 1)
            passed += laps * LAP
            speed = round(block.spindle_speed * 60.0 / (2.0 * pi))
            spindle = f'S{speed} M3' if speed else 'M5'
            number += 2
            lines += [
                f'o{number} repeat [{laps}]',
                'M66 P0 L0',
                f'o{number + 1} if [#5399 EQ 1]',
                '  M5',
                '  o<fuzzycnc_probe> call',
                '  G53 G0 Z0',
                '  G53 G0 X20 Y-20',
                f'o{number + 1} endif',
                spindle,
                'G91 G2 X0 Y0 I20 J0',
                'G90',
                f'o{number} endrepeat',
            ]
            if passed >= duration:
                break
    return '\n'.join([*lines, 'M5', 'M2', ''])


def listen(node, kind, topic, take):
    """Let a node hand on what is published of a kind."""

    def heard(message):
        take(decode(kind, message))

    create_subscription(node, kind.TYPE, topic, heard, subscription_qos(STREAM))


class Workshop:
    """The simulated mill behind LinuxCNC, its heat and its clock; part of a node of the graph.

    Its time passes `RATE` times as fast as LinuxCNC's while that cuts, and as fast as LinuxCNC's
    while it probes: a cycle of some seconds would else take some minutes, with the spindle off.
    """

    def __init__(self, controller, node, duration):
        self._controller, self._node = controller, node
        self._body = SimulatedBody(
            SimulatedBodyConfig(
                duty='T1',
                duration=duration,
                seed=3,
                tick_period=3.0,
                displacement_interval=15.0,
                displacement_noise=1e-9,
            )
        )
        self._clock = node.create_publisher(ClockMessage, '/clock', publisher_qos(STREAM))
        self._readings = create_publisher(node, Temperatures.TYPE, 'sensor_readings', STREAM)
        listen(node, MachineState, 'machine_state', self._body.on_machine_state)
        listen(node, CompensationApplied, 'compensation_applied', self._applied)
        self.cuts = False
        self.left = []
        """Rows of time [ns] and what is left of the error [um], Y and Z."""
        self._offset = {}
        self._rate, self._pace = 1.0, Pace(1.0, self._body.next_tick, time.monotonic())
        self._timer = wall_timer(node, CLOCK_PERIOD, self._on_timer)

    @property
    def over(self):
        """True once the day is over."""
        return self._body.next_tick is None

    def _applied(self, applied):
        self._offset = dict(zip(applied.axis, applied.offset, strict=True))
        self._body.on_compensation_applied(applied)

    def _on_timer(self):
        stamp, now = self._body.next_tick, time.monotonic()
        if stamp is None:
            return
        # It cuts above all that the cycle has to do with.
        rate = RATE if self.cuts and self._controller.state()['position'][2] > -1.0 else 1.0
        if rate != self._rate:
            self._rate, self._pace = rate, Pace(rate, self._pace.time(now), now)
        if self._pace.due(stamp) > now:
            self._tell_time(self._pace.time(now))
            return
        self._pace.count(stamp, now)
        self._tell_time(stamp)
        for emission in self._body.tick():
            record = emission.record
            if emission.output == 'sensor_readings':
                self._readings.publish(encode(record, RCLPY))
                continue
            self.left.append((stamp, *record.displacement / MICRON))
            newest = zip(record.axis, record.displacement, strict=True)
            error = {axis: (v - self._offset.get(axis, 0.0)) / MICRON for axis, v in newest}
            self._controller.error(**error)

    def _tell_time(self, stamp):
        self._clock.publish(ClockMessage(clock=RCLPY.time(stamp)))


def live_day(machine, folder, duration):
    """Let the program run; return what was left, and what was told of cycles.

    Rows of what was left are (time [s], Y, Z [um]).
    """
    controller, file = machine
    common = {'use_sim_time': True}
    active = {**common, 'autostart': True}
    bridge = {'axes': ['Y', 'Z'], 'slew_max': SLEW, 'lead_max': 60.0, 'report_period': 10.0}
    predictor = {**common, **LEARNING.get('thermal_predictor', {}), 'learn_axes': ['Y', 'Z']}
    compensator = {**active, **LEARNING.get('compensator', {}), 'axes': ['Y', 'Z']}
    specs = [
        NodeSpec('linuxcnc_bridge', {**active, **bridge}),
        NodeSpec('temperature_acquisition', common),
        NodeSpec('probe_cycle', {**common, 'probe_file': str(file)}),
        NodeSpec('thermal_predictor', predictor),
        NodeSpec('compensator', compensator),
        NodeSpec('recorder', {**common, 'output': str(folder / 'bag')}),
    ]
    states, probes = [], []
    program = controller.write_program('day', day_program(duration))
    with GraphProcesses('mill', folder=folder / 'log') as graph:
        for spec in specs:
            graph.start(spec)
        with OperatorClient('mill', graph.check) as operator:
            listen(operator.node, ProbeCycleState, 'probe_cycle_state', states.append)
            listen(operator.node, Displacement, 'displacement', probes.append)
            workshop = Workshop(controller, operator.node, duration)
            until = time.monotonic() + TIMEOUT
            while not operator.newest(MachineState, 'machine_state').offsets_allowed:
                assert time.monotonic() < until
            operator.newest(Temperatures, 'sensor_readings')
            operator.set_reference('operator')
            controller.run(program)
            workshop.cuts = True
            while not workshop.over:
                operator.spin_once(0.05)
                graph.check()
    left = np.array(workshop.left)
    left[:, 0] = 1e-9 * (left[:, 0] - left[0, 0])
    return left, states, probes


@pytest.mark.realtime
def test_a_day_from_a_cold_start_without_a_hand_on_it(machine, tmp_path):
    left, states, probes = live_day(machine, tmp_path, 3600.0 * HOURS)
    told = {
        'cycles': len(probes),
        'failures': max(state.failures for state in states),
        'left by hour, rms [um]': [
            np.sqrt(np.mean(left[(left[:, 0] // 3600) == hour, 1:] ** 2.0, axis=0))
            .round(2)
            .tolist()
            for hour in range(HOURS)
        ],
    }
    print(json.dumps(told))
    assert told['failures'] == 0
    assert 3 <= len(probes) <= 20
    assert max(told['left by hour, rms [um]'][-1]) < 2.5

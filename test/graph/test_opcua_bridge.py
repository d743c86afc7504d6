# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The bridge and a real OPC UA server that behaves as a control, with faults on either side."""

import signal
import time

import numpy as np
import pytest
from tiers import rest_slow

pytest.importorskip('asyncua')


from equipment.bridge_rig import ACTIVATE, CONFIGURE, DEACTIVATE, MICRON, BridgeRig
from equipment.field_servers import LOCAL, Field, Route
from equipment.opcua_machine import AXES, FILE, ControlServer, LineControl, control_file
from equipment.secured_server import PINNING, secured, user_file

from fuzzycnc_ros.core.inputs.offset_input import OffsetStatus
from fuzzycnc_ros.runtime.enums import MachineMode
from fuzzycnc_ros.runtime.records import (
    MachineState,
)

pytestmark = pytest.mark.ros
watched = pytest.mark.realtime
"""The bridge and the control watch each other by the clock."""

SLEW = 200 * MICRON
STOPS = 4
"""How often a bridge is stopped: where it stands still is left to chance."""
CLOSE = 0.05 * MICRON


class Shop:
    """The control of all tests of this file, and the way to it."""

    def __init__(self):
        self.field = Field()
        self.server = self.field.add(ControlServer(LineControl()))
        self.route = self.field.add(Route(self.server))

    @property
    def control(self):
        return self.server.control

    def reset(self):
        control = LineControl()
        control.slew = SLEW
        self.fault('')
        self.field.call(self.server.reset(control))

    def fault(self, fault):
        """Begin a fault of the way, or end it."""
        self.field.call(self.route.set(fault))

    def put(self, name, value):
        """Write as another client would."""
        self.field.call(self.server.put(name, value))

    def restart(self):
        """Restart the server; what the control applies stands meanwhile."""
        self.field.call(self.server.stop())
        self.field.call(self.server.start())


@pytest.fixture(scope='module')
def shop():
    """A control with its server; it takes seconds to start."""
    opened = Shop()
    yield opened
    opened.field.close()


class Rig(BridgeRig):
    """A bridge on the control of the shop."""

    NODE = 'opcua_bridge'
    AXES = AXES
    CLOSE = CLOSE

    def __init__(self, graph, observer, shop, folder):
        super().__init__(graph, observer)
        self.shop, self.folder = shop, folder

    @property
    def control(self):
        return self.shop.control

    def controls(self):
        return str(vars(self.control))

    def start(self, *, active=True, text=FILE, **parameters):
        path = control_file(self.folder, self.shop.route.port, text, timeout=1.0)
        own = {
            'control_file': str(path),
            'axes': list(AXES),
            'slew_max': SLEW,
            'cycle_period': 0.05,
            'acknowledge_time': 1.0,
            'takeover_time': 0.5,
            'validity': 4.0,
        }
        return self.launch({**own, **parameters}, active=active, wait=True)

    def at(self, offset):
        """Whether these offsets [um] are in force, and told."""
        there = np.abs(self.control.applied - MICRON * np.array(offset)) <= self.CLOSE
        return super().at(offset) and np.all(there)


@pytest.fixture
def rig(graph, observer, shop, tmp_path):
    """A control that is on, homed and at zero."""
    shop.reset()
    return Rig(graph, observer, shop, tmp_path)


@watched
def test_follows_a_line_tells_and_ramps_to_zero(rig):
    rig.control.spindle_speed = 3000.0
    rig.start(active=False)
    assert (rig.last.status, rig.last.reason) == (OffsetStatus.IDLE, '')
    rig.command((5, 5))
    assert rig.change(CONFIGURE)
    assert rig.change(ACTIVATE)
    rig.until(lambda: rig.allowed, 'allowed')
    assert rig.states[-1].spindle_speed == pytest.approx(3000 * 2 * np.pi / 60)
    assert rig.states[-1].state == MachineMode.ON
    assert '/mill/opcua_bridge' in rig.control.owner
    rig.settle((10, -20))
    assert rig.last.status == OffsetStatus.FOLLOWING
    rig.command((10, -20), slope=(1e-4, 0), reference=(0.1, 0))
    rig.until(lambda: rig.at((0, -20)), 'the line at zero')
    rig.control.position = np.array([0.3, 0.0])
    rig.until(lambda: rig.at((30, -20)), 'the line at 300 mm')
    rig.until(lambda: abs(rig.states[-1].position[0] - 0.3) < 1e-9, 'position')
    assert rig.control.slope[0] == pytest.approx(1e-4)
    assert rig.change(DEACTIVATE)
    rig.until(lambda: rig.at((0, 0)) and rig.last.status == OffsetStatus.IDLE, 'at zero')
    rig.until(lambda: rig.control.sequence == 0 and not rig.control.owner, 'given back')
    assert not rig.allowed


@watched
def test_the_control_forbids_and_limits(rig):
    rig.start()
    rig.settle((10, 20))
    rig.control.homed = False
    rig.refused('machine is not homed')
    rig.until(lambda: rig.at((0, 0)), 'at zero')
    rig.control.homed, rig.control.estop = True, True
    rig.refused('machine is in emergency stop')
    rig.until(lambda: rig.states[-1].state == MachineMode.ESTOP, 'state')
    rig.control.estop, rig.control.allowed = False, False
    rig.refused('does not allow offsets')
    rig.control.allowed = True
    rig.until(lambda: rig.allowed, 'allowed again')
    rig.control.limit = np.array([60e-6, 12e-6])
    rig.observer.spin_for(0.3)
    rig.command((10, 40))
    rig.until(lambda: rig.at((10, 12)), 'cut at the smaller limit')
    assert rig.last.at_limit.tolist() == [False, True]
    assert 'cut at the limit of Z 12.00 um' in rig.last.reason
    rig.command((70, 0), valid=1.0)
    rig.until(lambda: rig.at((60, 0)) and rig.last.at_limit[0], 'cut at our limit')
    rig.until(lambda: rig.last.status == OffsetStatus.EXPIRED and rig.at((0, 0)), 'expires')


@watched
@pytest.mark.slow
def test_frozen_acknowledgement(rig):
    rig.start()
    rig.settle((10, 20))
    rig.control.frozen = True
    rig.command((30, 20))
    rig.refused('has not been acknowledged within 1 s')
    assert not rig.allowed
    rig.until(lambda: not np.any(rig.control.applied), 'the set has expired in the control')
    rig.control.frozen = False
    rig.until(lambda: rig.allowed, 'taken up again')
    rig.settle((5, 5))


@watched
def test_second_writer_is_named(rig):
    rig.start()
    rig.settle((10, 20))
    rig.shop.put('owner', 'panel 7')
    rig.shop.put('sequence', 4711)
    rig.refused('two writers: the control is written by')
    rig.until(lambda: 'panel 7 (set 4711)' in rig.last.reason, 'named')
    assert not rig.allowed


def test_wrong_files_end_the_node(refusal, tmp_path):
    path = control_file(tmp_path, 4840, FILE.replace('unit: um', 'unit: ym'))
    text = refusal('opcua_bridge', {'control_file': str(path), 'axes': list(AXES)})
    assert f'parameter control_file: {path}: line 3: unit: expected one of um' in text
    path = control_file(tmp_path, 4840)
    text = refusal('opcua_bridge', {'control_file': str(path)})
    assert 'parameter axes: expected X, Z as in the control file but found X, Y, Z' in text


@watched
@pytest.mark.slow
def test_is_not_activated_beside_another_bridge(rig):
    rig.start()
    rig.settle((10, 0))
    first, rig.bridge = rig.bridge, None
    path = rig.folder / 'control.yaml'
    second = rig.graph.start(
        'opcua_bridge', {'control_file': str(path), 'axes': list(AXES)}, namespace='/lathe'
    )
    states = rig.observer.records('/lathe/machine_state', MachineState)
    rig.bridge = second
    rig.until(lambda: len(states) > 3, 'the second reads')
    rig.observer.spin_for(0.5)

    assert rig.change(CONFIGURE, 'lathe')
    assert not rig.change(ACTIVATE, 'lathe')
    assert 'the control is written by /mill/opcua_bridge' in second.output
    assert second.interrupt() == 0
    rig.bridge = first
    rig.settle((20, 0))
    assert first.interrupt(signal.SIGINT) == 0
    rig.until(lambda: rig.control.sequence == 0, 'given back at the end')
    rig.until(lambda: not np.any(rig.control.applied), 'at zero at once')


@watched
@pytest.mark.parametrize('fault', [pytest.param('refuse', marks=pytest.mark.slow), 'hang'])
def test_lost_connection_is_rebuilt_without_a_step(rig, fault):
    rig.start()
    rig.settle((10, -20))
    seen = len(rig.applied)
    rig.shop.fault(fault)
    rig.refused('connection' if fault == 'refuse' else 'no answer within')
    assert not rig.allowed
    rig.shop.fault('')
    rig.until(lambda: rig.allowed, 'rebuilt')
    rig.observer.spin_for(1.0)
    np.testing.assert_allclose(rig.control.applied, [10e-6, -20e-6], atol=CLOSE)
    told = [item.offset for item in rig.applied[seen:]]
    np.testing.assert_allclose(told, np.tile([10e-6, -20e-6], (len(told), 1)), atol=CLOSE)
    rig.settle((15, -20))


@watched
def test_killed_bridge_leaves_no_offset_and_a_new_one_goes_on(rig):
    rig.control.watchdog = 60.0
    rig.start(validity=60.0)
    rig.settle((10, 30))
    rig.graph.kill(rig.bridge)
    seen = len(rig.applied)
    rig.start()  # within the time of the watchdog, and of the set
    rig.control.watchdog = 1.5
    rig.observer.spin_for(3.0)
    told = [item.offset for item in rig.applied[seen:]]
    np.testing.assert_allclose(told, np.tile([10e-6, 30e-6], (len(told), 1)), atol=CLOSE)
    rig.epoch = 2
    rig.settle((10, 20))
    rig.graph.kill(rig.bridge)
    rig.until(lambda: not np.any(rig.control.applied), 'the watchdog of the control')
    rig.start()
    assert rig.at((0, 0))
    rig.epoch = 3
    rig.settle((5, 5))


@watched
@pytest.mark.slow
def test_stopped_bridge_does_not_send_a_control_back_that_let_the_offsets_go(rig):
    """The control is twenty times as fast as the bridge may be: an old set would be a step."""
    slow = SLEW / 20.0
    rig.control.watchdog = 1.5
    rig.start(text=FILE.replace('{timeout}', '60'), slew_max=slow, validity=60.0)
    for _ in range(STOPS):
        rig.settle((10, -20))
        rig.bridge.send(signal.SIGSTOP)
        rig.until(lambda: not np.any(rig.control.applied), 'the watchdog of the control')
        rig.bridge.send(signal.SIGCONT)
        begun, found = time.monotonic(), []
        while time.monotonic() < begun + 1.0:
            rig.observer.spin()
            found.append((time.monotonic() - begun, np.abs(rig.control.applied).max()))
        assert all(offset <= slow * (elapsed + 0.3) for elapsed, offset in found)
        rig.until(lambda: rig.allowed, 'the bridge goes on')
    rig.settle((10, -20))


@watched
@pytest.mark.slow
def test_server_starts_anew_with_offsets_standing(rig):
    rig.control.watchdog = 60.0
    rig.start(text=FILE.replace('{timeout}', '5'), validity=60.0)
    rig.settle((10, -20))
    seen = len(rig.applied)
    rig.shop.restart()
    rig.refused('connection')
    rig.until(lambda: rig.allowed, 'rebuilt')
    rig.observer.spin_for(1.0)
    told = [item.offset for item in rig.applied[seen:]]
    np.testing.assert_allclose(told, np.tile([10e-6, -20e-6], (len(told), 1)), atol=CLOSE)
    np.testing.assert_allclose(rig.control.applied, [10e-6, -20e-6], atol=CLOSE)
    rig.settle((0, 0))


def test_wrong_node_id_is_named(rig):
    rig.start(active=False, text=FILE.replace('ns=2;s=Z.limit', 'ns=2;s=Z.limmit'))
    rig.refused('Z.limit: node ns=2;s=Z.limmit: the server has no such node')


DEVICES = """\
devices:
  - name: control
    protocol: opc_ua
    url: opc.tcp://{host}:{port}/
    timeout: 30
    {security}
    credentials: user.yaml
    sensors: {{T1: ns=2;s=X.applied}}
"""


@pytest.mark.parametrize('node', rest_slow(['opcua_bridge', 'temperature_acquisition'], 0))
def test_certificates_are_pinned_in_the_state_directory(graph, observer, shop, tmp_path, node):
    server = shop.field.add(ControlServer(LineControl(), secured(tmp_path)))
    user_file(tmp_path)
    state = tmp_path / 'state'
    if node == 'opcua_bridge':
        text = f'{PINNING}\ncredentials: user.yaml\n'.replace('{', '{{').replace('}', '}}') + FILE
        path = control_file(tmp_path, server.port, text)
        parameters = {'control_file': str(path), 'axes': list(AXES)}
    else:
        path = tmp_path / 'devices.yaml'
        path.write_text(DEVICES.format(host=LOCAL, port=server.port, security=PINNING))
        parameters = {'source': 'devices', 'device_file': str(path)}
    graph.start(node, {**parameters, 'state_directory': str(state)})
    pin = state / f'opcua-{LOCAL}-{server.port}.pem'
    observer.until(pin.exists, 'the certificate is pinned')

# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The driver of devices in its node: real servers, faults on the way to them, and back again."""

from itertools import zip_longest
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip('asyncua')
pytest.importorskip('pymodbus')
pytest.importorskip('serial')
pytest.importorskip('paho')

from asyncua import ua
from bag_contents import contents
from equipment.field_servers import LOCAL, Field, ModbusServer, OpcUaServer, Route
from equipment.mqtt_broker import MOSQUITTO, PASSWORD, USER, MqttBroker, credentials
from equipment.mtconnect_agent import Agent
from equipment.serial_cable import Cable
from paho.mqtt.client import Client
from paho.mqtt.enums import CallbackAPIVersion
from processes import command_line
from sensor_msgs.msg import JointState

from fuzzycnc_ros.bags.reader import BagReader
from fuzzycnc_ros.runtime.enums import SpeedStatus, Status
from fuzzycnc_ros.runtime.host import RecorderProgress
from fuzzycnc_ros.runtime.records import MachineState, SpindleSpeed, Temperatures

pytestmark = pytest.mark.ros

SENSORS = ('T1', 'T2', 'T3', 'T4')
VALUES = {'T3': 23.5, 'T4': 24.0, 'S1': 3000}
OK, MISSING, OUT, STUCK = Status.OK, Status.MISSING, Status.OUT_OF_RANGE, Status.STUCK
FILE = """
devices:
  - name: rtd
    protocol: modbus_tcp
    host: {host}
    port: {modbus}
    period: {period}
    timeout: {timeout}
    table: input
    scale: 0.1
    open_circuit: [0x7FFF]
    sensors: {{T1: 0, T2: 1}}
  - name: control
    protocol: opc_ua
    url: opc.tcp://{host}:{opcua}/
    period: {period}
    timeout: {timeout}
    sensors:
      T3: ns=2;s=T3
      T4: {{path: "0:Objects/2:Mill/2:T4"}}
    spindle_speed: {{node: ns=2;s=S1, unit: rpm, max: 6000}}
"""


class Shop:
    """A device with Modbus, a control with OPC UA, and routes to both."""

    def __init__(self) -> None:
        self.field = Field()
        self.modbus = self.field.add(ModbusServer())
        self.opcua = self.field.add(OpcUaServer(VALUES))
        self.routes = [self.field.add(Route(self.modbus)), self.field.add(Route(self.opcua))]

    def reset(self) -> None:
        """Begin anew: good values, no fault."""
        self.modbus.delay, self.modbus.words = 0.0, {0: 215, 1: 220}
        self.opcua.values |= VALUES
        for device in (0, 1):
            self.fail(device, '')

    def parameters(
        self, folder: Path, period: float = 0.2, timeout: float = 1.0
    ) -> dict[str, Any]:
        """Write the device file; return the parameters of a node that reads it."""
        modbus, opcua = (route.port for route in self.routes)
        path = folder / 'devices.yaml'
        places = {'host': LOCAL, 'modbus': modbus, 'opcua': opcua}
        path.write_text(FILE.format(period=period, timeout=timeout, **places))
        return {
            'source': 'devices',
            'device_file': str(path),
            'interval': 0.5,
            'stuck_time': 0.0,
        }

    def fail(self, device: int, fault: str) -> None:
        """Begin a fault on the way to a device, or end it."""
        self.field.call(self.routes[device].set(fault))


@pytest.fixture(scope='module')
def servers():
    """The servers of all tests here: one for OPC UA takes seconds to start."""
    made = Shop()
    yield made
    made.field.close()


@pytest.fixture
def shop(servers):
    servers.reset()
    return servers


@pytest.fixture(scope='module')
def shared_node(shared_graph, servers, tmp_path_factory):
    """A node that the tests share which need no other parameters."""
    servers.reset()
    parameters = servers.parameters(tmp_path_factory.mktemp('shared'))
    return shared_graph.start('temperature_acquisition', parameters)


@pytest.fixture
def node(shared_node, shop):
    """The shared node, with good devices."""
    yield shared_node
    assert shared_node.process.poll() is None
    assert 'Traceback' not in shared_node.output


def good_samples(observer):
    """Wait for good samples; return all."""
    observer.watch_diagnostics()
    samples = observer.records('temperatures', Temperatures)
    observer.until(lambda: statuses(samples) == [OK] * 4, 'good samples')
    return samples


@pytest.fixture
def start(graph, observer, shop, tmp_path):
    """Start a node and wait for good samples; return them and the node."""

    def begin(period: float = 0.2, timeout: float = 1.0, **parameters):
        common = shop.parameters(tmp_path, period, timeout)
        node = graph.start('temperature_acquisition', {**common, **parameters})
        return good_samples(observer), node

    return begin


def statuses(samples):
    """Return the newest verdict on each sensor."""
    return samples[-1].status.tolist() if samples else None


@pytest.mark.usefixtures('node')
def test_devices_of_both_protocols_make_one_record(shared_observer):
    observer = shared_observer
    speeds = observer.records('spindle_speed', SpindleSpeed)
    states = observer.records('machine_state', MachineState)
    raw = observer.records('sensor_readings', Temperatures)
    samples = good_samples(observer)
    assert samples[-1].sensor == SENSORS
    assert samples[-1].temperature == pytest.approx([21.5, 22.0, 23.5, 24.0])
    observer.until(lambda: len(raw) > 3, 'sensor_readings')
    assert raw[-1].frame_id == 'mill/machine'
    stamps = [item.stamp for item in raw]
    assert all(np.diff(stamps) > 0)
    observer.until(lambda: speeds and speeds[-1].status == SpeedStatus.OK, 'spindle_speed')
    assert speeds[-1].speed == pytest.approx(100.0 * np.pi)
    assert speeds[-1].frame_id == 'mill/machine'
    name = 'mill/temperature_acquisition: device rtd'
    observer.until(lambda: observer.told(name, 'all values read'), 'health of the device')
    # The driver says nothing of the machine: that is for its controller.
    assert not states


@pytest.mark.usefixtures('node')
def test_spindle_speed_that_means_nothing_is_said_so(shared_observer, shop):
    observer = shared_observer
    speeds = observer.records('spindle_speed', SpindleSpeed)
    good_samples(observer)
    spindle = 'mill/temperature_acquisition: spindle_speed'
    observer.until(lambda: observer.told(spindle, '314.2 rad/s'), 'a good speed')
    shop.opcua.values['S1'] = 9000
    observer.until(lambda: observer.told(spindle, 'more than max = 628.3 rad/s'), 'out of range')
    observer.until(lambda: speeds[-1].status == SpeedStatus.OUT_OF_RANGE, 'its status')
    assert speeds[-1].speed == pytest.approx(300.0 * np.pi)
    shop.fail(1, 'refuse')
    observer.until(lambda: speeds[-1].status == SpeedStatus.MISSING, 'a lost control')
    assert np.isnan(speeds[-1].speed)
    observer.until(lambda: observer.told(spindle, 'no reading'), 'health of a lost control')


@pytest.mark.slow
@pytest.mark.parametrize('fault', ['refuse', 'cut', 'hang', 'garble'])
@pytest.mark.usefixtures('node')
def test_a_lost_device_is_missing_alone_and_comes_back(shared_observer, shop, fault):
    observer = shared_observer
    samples = good_samples(observer)
    for device, name in ((0, 'rtd'), (1, 'control')):
        shop.fail(device, fault)
        lost = [OK] * 4
        lost[2 * device : 2 * device + 2] = [MISSING] * 2
        observer.until(lambda lost=lost: statuses(samples) == lost, f'{name} is missing')
        assert np.isnan(samples[-1].temperature[2 * device])
        item = f'mill/temperature_acquisition: device {name}'
        observer.until(lambda item=item: observer.statuses[item][-1][0] == 2, 'an error')
        shop.fail(device, '')
        observer.until(lambda: statuses(samples) == [OK] * 4, f'{name} is back')
    # Both at once: the sensors are reported as missing, nobody waits for them.
    for device in (0, 1):
        shop.fail(device, fault)
    observer.until(lambda: statuses(samples) == [MISSING] * 4, 'all are missing')
    for device in (0, 1):
        shop.fail(device, '')
    observer.until(lambda: statuses(samples) == [OK] * 4, 'all are back')


@pytest.mark.usefixtures('node')
def test_wrong_values_have_the_right_status(shared_observer, shop):
    observer = shared_observer
    samples = good_samples(observer)
    rtd = 'mill/temperature_acquisition: device rtd'
    control = 'mill/temperature_acquisition: device control'

    shop.modbus.words[0] = 0x7FFF
    shop.opcua.values['T3'] = 500.0
    observer.until(
        lambda: (
            statuses(samples) == [MISSING, OK, OUT, OK] and samples[-1].temperature[2] == 500.0
        ),
        'open and out of range',
    )
    observer.until(lambda: observer.told(rtd, 'T1: open circuit (raw value 32767)'), 'open')

    shop.modbus.words[0] = 215
    shop.opcua.values['T3'] = 23.5
    long = 'x' * 100_000
    bad = ua.DataValue(StatusCode=ua.StatusCode(ua.StatusCodes.BadSensorFailure))
    values = (
        (np.nan, 'reads nan'),
        (np.inf, 'reads inf'),
        ('hot', "expected a number but the variable holds 'hot'"),
        ([1.0, 2.0], 'the variable holds [1.0, 2.0]'),
        (True, 'the variable holds True'),
        (long, 'the variable holds '),
        (bad, 'the server reports BadSensorFailure'),
    )
    for one, two in zip_longest(values[::2], values[1::2], fillvalue=(24.0, '')):
        shop.opcua.values |= {'T3': one[0], 'T4': two[0]}
        for text in (one[1], two[1]):
            observer.until(lambda text=text: observer.told(control, text), text)
        wanted = [OK, OK, MISSING, MISSING if two[1] else OK]
        observer.until(lambda wanted=wanted: statuses(samples) == wanted, f'{one[1]}, {two[1]}')
    shop.opcua.values |= VALUES
    observer.until(lambda: statuses(samples) == [OK] * 4, 'good again')
    assert max(len(message) for _, message in observer.statuses[control]) < 1000


@pytest.mark.slow
def test_frozen_values_are_stuck(graph, observer, shop, start):
    samples, _ = start(stuck_time=2.0)
    moving = iter(range(10**6))

    def three_live():
        step = next(moving) % 2
        shop.modbus.words |= {0: 215 + step, 1: 220 + step}
        shop.opcua.values['T3'] = 23.5 + 0.1 * step
        return statuses(samples) == [OK, OK, OK, STUCK]

    observer.until(three_live, 'the frozen one is stuck')
    shop.opcua.values['T4'] = 24.1
    observer.until(lambda: three_live() or statuses(samples)[3] == OK, 'it lives again')
    graph.stop()


@pytest.mark.slow
def test_slow_devices_are_no_error(graph, observer, shop, start):
    """Answers take five periods, as behind a busy gateway."""
    shop.modbus.delay = 0.5
    samples, node = start(period=0.1, timeout=30.0, interval=1.0)
    known = len(samples)
    observer.until(lambda: len(samples) >= known + 4, 'samples')
    assert {status for sample in samples for status in sample.status} == {OK}
    assert all(sample.readings >= 1 for sample in samples)
    assert 'mill/temperature_acquisition: device rtd' in observer.statuses
    shown = observer.statuses['mill/temperature_acquisition: device rtd']
    assert all(level == 0 or 'not connected yet' in text for level, text in shown)
    graph.stop()
    assert 'WARN' not in node.output


def test_bad_device_file_is_refused(refusal, tmp_path):
    line = refusal('temperature_acquisition', {'source': 'devices'})
    assert line == 'error: parameter device_file: expected a file for the source devices'
    path = tmp_path / 'devices.yaml'
    text = FILE.format(host=LOCAL, modbus=502, opcua=4840, period=0.2, timeout=1.0)
    path.write_text(text.replace('T1: 0', 'T1: 70000'))
    line = refusal('temperature_acquisition', {'source': 'devices', 'device_file': str(path)})
    assert line.startswith(f'error: parameter device_file: {path}: line 12: device rtd, sensor T1')
    assert 'expected a whole number from 0 to 65535 but found 70000; count from 0' in line


def test_device_slower_than_the_samples_is_refused(refusal, tmp_path):
    path = tmp_path / 'devices.yaml'
    path.write_text(FILE.format(host=LOCAL, modbus=502, opcua=4840, period=5.0, timeout=1.0))
    parameters = {'source': 'devices', 'device_file': str(path), 'interval': 2.0}
    line = refusal('temperature_acquisition', parameters)
    assert 'device rtd: period = 5 s is longer than the sampling interval = 2 s' in line


def test_lock_step_is_refused(refusal):
    line = refusal('temperature_acquisition', {'source': 'devices', 'lockstep': True})
    assert 'parameter source = devices: in lock-step readings come from the topic' in line


def test_a_serial_line_that_is_unplugged_comes_back(graph, observer, tmp_path):
    field = Field()
    port, path = tmp_path / 'ttyUSB0', tmp_path / 'devices.yaml'
    path.write_text(
        f'devices: [{{name: rtd, protocol: modbus_rtu, port: {port}, parity: none, period: 0.2, '
        'scale: 0.1, sensors: {T1: 0, T2: 1}}]'
    )
    try:
        cable = field.add(Cable(port, {0: 215, 1: 220}))
        samples = observer.records('temperatures', Temperatures)
        parameters = {'source': 'devices', 'device_file': str(path), 'interval': 0.5}
        node = graph.start('temperature_acquisition', {**parameters, 'stuck_time': 0.0})
        for _ in range(2):
            observer.until(lambda: statuses(samples) == [OK] * 2, 'good samples')
            assert samples[-1].temperature == pytest.approx([21.5, 22.0])
            field.call(cable.set('unplugged'))
            observer.until(lambda: statuses(samples) == [MISSING] * 2, 'missing samples')
            field.call(cable.set(''))
        observer.until(lambda: statuses(samples) == [OK] * 2, 'good samples')
        assert 'Traceback' not in node.output
    finally:
        field.close()


AGENT_FILE = """
devices:
  - name: control
    protocol: mtconnect
    url: http://{host}:{port}
    period: 0.1
    timeout: 0.5
    sensors: {{T1: t1}}
    positions: {{X: Xact, B: b1}}
    spindle_speed: {{item: s1}}
"""


def test_positions_of_an_agent_are_published_and_recorded(graph, observer, tmp_path):
    field = Field()
    path, bag = tmp_path / 'devices.yaml', tmp_path / 'bag'
    told = []
    observer.node.create_subscription(JointState, 'axis_positions', told.append, 100)
    speeds = observer.records('spindle_speed', SpindleSpeed)
    samples = observer.records('temperatures', Temperatures)

    def newest():
        """Return whether each position is known, and that of X in micrometres."""
        if not told:
            return None
        assert list(told[-1].name) == ['X', 'B']
        known = [not np.isnan(place) for place in told[-1].position]
        return [*known, round(1e6 * told[-1].position[0]) if known[0] else None]

    try:
        agent = Agent()
        agent.observations = [('t1', '21.5'), ('s1', '3000'), ('x1', '12.5'), ('b1', '90')]
        field.add(agent)
        path.write_text(AGENT_FILE.format(host=LOCAL, port=agent.port))
        recorded = observer.records('recorder/progress', RecorderProgress)
        graph.start('recorder', {'output': str(bag)})
        observer.until(lambda: recorded, 'a recorder')
        parameters = {'source': 'devices', 'device_file': str(path), 'interval': 0.5}
        node = graph.start('temperature_acquisition', {**parameters, 'stuck_time': 0.0})
        observer.until(lambda: newest() == [True, True, 12500], 'positions')
        assert told[-1].position[1] == pytest.approx(np.pi / 2.0)
        assert told[-1].header.frame_id == 'mill/machine'
        observer.until(lambda: statuses(samples) == [OK], 'a sample')
        observer.until(lambda: speeds and speeds[-1].status == SpeedStatus.OK, 'a speed')
        assert speeds[-1].speed == pytest.approx(100.0 * np.pi)
        observer.until(
            lambda: observer.node.count_subscribers('/mill/axis_positions') == 2,
            'the recorder listens',
        )
        observer.settle('temperature_acquisition', 'recorder')
        heard = len(told)
        field.call(agent.observe(x1=-3, b1='UNAVAILABLE'))
        observer.until(lambda: newest() == [True, False, -3000], 'the axis alone is missing')
        field.call(agent.stop())
        observer.until(lambda: newest() == [False, False, None], 'no position of a lost agent')
        observer.until(lambda: speeds[-1].status == SpeedStatus.MISSING, 'no speed either')
        observer.until(lambda: len(told) > heard + 2, 'three positions that the recorder hears')
        assert 'Traceback' not in node.output
        graph.stop()
    finally:
        field.close()
    with BagReader(bag) as reader:
        kept = list(reader.messages(['/mill/axis_positions']))
    assert len(kept) > 2
    places = [1e6 * item.message.position for item in kept]
    assert any(np.allclose(place, [-3000.0, np.nan], equal_nan=True) for place in places)
    assert np.isnan(places[-1]).all()


def test_a_secret_of_a_broker_is_in_no_bag_and_no_log(graph, observer, tmp_path):
    if MOSQUITTO is None:
        pytest.skip('no mosquitto here: apt-get install mosquitto')
    broker = MqttBroker(tmp_path, tls=True, password=PASSWORD)
    broker.start()
    credentials(tmp_path)
    path, bag = tmp_path / 'devices.yaml', tmp_path / 'bag'
    path.write_text(
        f'devices: [{{name: house, protocol: mqtt, host: {LOCAL}, port: {broker.port}, '
        'period: 0.1, tls: {ca: broker.pem}, credentials: broker-user.yaml, max_age: 2, '
        'timeout: 0.5, '
        'sensors: {T1: mill/front, bed: {topic: mill/bed, rate_max: 0.7, range_high: 130}}}]'
    )
    client = Client(CallbackAPIVersion.VERSION2)
    client.tls_set(str(tmp_path / 'broker.pem'))
    client.username_pw_set(USER, PASSWORD)
    client.connect(LOCAL, broker.port)
    client.loop_start()
    samples = observer.records('temperatures', Temperatures)
    try:
        recorder = graph.start('recorder', {'output': str(bag), 'topics': '.*', 'exclude': '^$'})
        parameters = {'source': 'devices', 'device_file': str(path), 'interval': 0.5}
        node = graph.start('temperature_acquisition', {**parameters, 'stuck_time': 0.0})

        def good():
            client.publish('mill/front', '21.5')
            client.publish('mill/bed', '125')
            return statuses(samples) == [OK] * 2

        observer.until(good, 'good samples, also of the bed by its own limits')
        broker.admit('another')
        broker.stop()
        observer.until(lambda: statuses(samples) == [MISSING] * 2, 'the loss')
        broker.start()
        name = 'mill/temperature_acquisition: device house'
        observer.watch_diagnostics()
        observer.until(lambda: observer.told(name, 'compare credentials'), 'the refusal')
        assert recorder.interrupt() == 0
        started = command_line(node.process.pid)
    finally:
        client.disconnect()
        client.loop_stop()
        broker.close()
    written = [item for part in bag.rglob('*') if part.is_file() for item in contents(part)]
    logs = [text.encode() for text in (node.output, recorder.output, started)]
    assert len(written) > 10
    assert not [t for t in (*written, *logs) for s in (USER, PASSWORD) if s.encode() in t]

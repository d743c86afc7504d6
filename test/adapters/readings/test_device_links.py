# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Connections to devices: what is asked, hostile and secured servers, nothing left behind."""

import asyncio
import random
import struct
import threading

import pytest

pytest.importorskip('rclpy')
pytest.importorskip('asyncua')
pytest.importorskip('pymodbus')

from asyncua import ua
from equipment.field_servers import LOCAL, Field, HostileServer, ModbusServer, OpcUaServer, Route
from equipment.polled import TIMEOUT, good, lost, wait
from equipment.secured_server import PINNING, SECURITY, secured, user_file

from fuzzycnc_ros.adapters.modbus import link as modbus
from fuzzycnc_ros.adapters.opcua import session as opcua_session
from fuzzycnc_ros.adapters.readings import polling
from fuzzycnc_ros.adapters.readings.device_file import read_devices
from fuzzycnc_ros.adapters.readings.device_source import DeviceHealth
from fuzzycnc_ros.adapters.readings.polling import TEXT_MAX
from fuzzycnc_ros.ros.parameters import ParameterError
from fuzzycnc_ros.runtime.component import Level

pytestmark = pytest.mark.ros

MODBUS = """
devices:
  - name: rtd
    protocol: modbus_tcp
    host: {host}
    port: {port}
    period: 0.02
    timeout: 0.3
    sensors: {sensors}
"""
OPC_UA = """
devices:
  - name: control
    protocol: opc_ua
    url: opc.tcp://{host}:{port}/
    period: 0.02
    timeout: {timeout}
    {more}
    sensors: {sensors}
"""


@pytest.fixture
def field():
    made = Field()
    yield made
    made.close()


@pytest.fixture
def poll(poll_file):
    """Poll the devices of a file; return what came as it comes."""

    def begin(template, server, sensors, timeout=3.0, more=''):
        return poll_file(
            template.format(
                host=LOCAL, port=server.port, sensors=sensors, timeout=timeout, more=more
            )
        )

    return begin


@pytest.fixture
def impatient(monkeypatch):
    """A lost device is asked again at once."""
    monkeypatch.setattr(polling, 'BACK_OFF_FIRST', 0.05)


def test_a_wrong_register_costs_only_itself(field, poll):
    server = field.add(ModbusServer({0: 10, 198: 11, 199: 12}))
    poller = poll(
        MODBUS, server, '{T1: 0, T2: 198, T3: 199, T4: 200, T5: {register: 199, type: int32}}'
    )
    polled = wait(poller, lambda item: good(item) and item.readings[2] == 12.0)
    one, two, three, four, five = polled.readings
    assert (one, two, three) == (10.0, 11.0, 12.0)
    assert four.startswith('register 200 of the table holding: the device has no such register')
    assert 'compare register, table and type with its manual; addresses count from 0' in four
    assert five.startswith('register 199 to 200 of the table holding')


def words_of(value, kind='f'):
    """Return the registers of a number in the usual order."""
    packed = struct.pack(f'>{kind}', value)
    return [int.from_bytes(packed[at : at + 2], 'big') for at in range(0, len(packed), 2)]


def swapped(word):
    return int.from_bytes(word.to_bytes(2, 'big'), 'little')


FLOATS = MODBUS.replace('    sensors', '    type: float32\n    sensors')


def test_numbers_in_a_wrong_order_are_no_reading_and_name_the_right_one(field, poll):
    high, low = words_of(21.5 + 1e-5)
    double = words_of(21.5, 'd')[::-1]
    words = [high, low, low, high, swapped(high), swapped(low), *double, 0, 0, swapped(235)]
    poller = poll(
        FLOATS,
        field.add(ModbusServer(dict(enumerate(words)))),
        '{right: 0, word: 2, byte: 4, double: {register: 6, type: float64}, off: 10, '
        'whole: {register: 12, type: int16}, kelvin: {register: 2, offset: -273.15}}',
    )
    right, word, byte, double, off, whole, kelvin = wait(poller, good).readings
    assert right == pytest.approx(21.5, abs=1e-4)
    for text in (word, byte, double, kelvin):
        assert ', which no sensor' in text
        assert 'compare word_order, byte_order, type and register with its manual' in text
    assert '21.5 with word_order little' in word
    assert '21.5 with byte_order little' in byte
    assert '21.5 with word_order little' in double
    assert '-251.65 with word_order little' in kelvin
    assert off.startswith('register 10 of the table holding has read 0 ever since')
    assert whole == (
        'reads -5376 degC, which no sensor of a machine does; compare byte_order, type and '
        'register with its manual (addresses count from 0); it would read 235 with byte_order '
        'little'
    )


def test_a_float_that_never_changes_is_no_reading_and_one_that_did_is(field, poll, monkeypatch):
    clock = [0.0]
    monkeypatch.setattr(modbus, 'monotonic', lambda: clock[0])
    server = field.add(ModbusServer(dict(enumerate([*words_of(21.5), *words_of(22.5)]))))
    poller = poll(FLOATS, server, '{T1: 0, T2: 2}')
    wait(poller, lambda item: good(item) and list(item.readings) == [21.5, 22.5])
    server.words[3] += 1
    wait(poller, lambda item: good(item) and item.readings[1] != 22.5)
    clock[0] = modbus.UNCHANGED_MAX
    polled = wait(poller, lambda item: good(item) and isinstance(item.readings[0], str))
    assert polled.readings[0].startswith('has not changed by a bit for 10 min')
    assert 'with word_order little' in polled.readings[0]
    assert isinstance(polled.readings[1], float)
    server.words[1] += 1
    wait(poller, lambda item: good(item) and item.readings[0] == pytest.approx(21.5, abs=1e-3))


def test_whole_numbers_in_a_wrong_order_jump_and_are_no_reading(field, poll):
    """A byte order that gives plausible temperatures at times: 27.0 degC reads 358.5."""
    server = field.add(ModbusServer({0: swapped(270), 1: 270, 2: 270 << 4}))
    whole = MODBUS.replace('    sensors', '    type: int16\n    scale: 0.1\n    sensors')
    left = '{register: 2, scale: 0.00625}'  # bits to the left, steps of a tenth too
    poller = poll(whole, server, f'{{T1: 0, T2: 1, T3: {left}}}')
    assert wait(poller, good).readings[0] == pytest.approx(358.5)
    for tenths in (271, 272, 271, 270, 269, 270, 271):
        server.words |= {0: swapped(tenths), 1: tenths, 2: tenths << 4}
        wait(poller, lambda item, now=tenths: good(item) and item.readings[1] == 0.1 * now)
    wrong, *right = wait(
        poller, lambda item: good(item) and isinstance(item.readings[0], str)
    ).readings
    assert wrong == (
        'jumps by 25.6 K from reading to reading, as no sensor does; compare byte_order, type and '
        'register with its manual (addresses count from 0); it would read 27.1 with byte_order '
        'little'
    )
    assert right == pytest.approx([27.1, 27.1])


def test_floats_in_a_wrong_order_that_stay_at_zero_are_no_reading(field, poll):
    """A byte order that gives plausible temperatures: 23.5 degC reads -0.012."""

    def registers(celsius):
        wrong = [swapped(word) for word in words_of(celsius)]
        return dict(enumerate([*wrong, *words_of(celsius / 1000.0)]))

    server = field.add(ModbusServer(registers(23.5)))
    poller = poll(FLOATS, server, '{T1: 0, T2: 2}')
    assert wait(poller, good).readings[0] == pytest.approx(-0.0118, abs=1e-4)
    for hundredths in range(2351, 2358):
        server.words |= registers(0.01 * hundredths)
        now = pytest.approx(1e-5 * hundredths)
        wait(poller, lambda item, now=now: good(item) and item.readings[1] == now)
    wrong, cold = wait(
        poller, lambda item: good(item) and isinstance(item.readings[0], str)
    ).readings
    assert wrong.startswith('stays at -0.012 degC; compare word_order, byte_order')
    assert '23.57 with byte_order little' in wrong
    assert cold == pytest.approx(0.02357)  # no order makes more of it


def test_many_registers_take_several_requests(field, poll):
    server = field.add(ModbusServer({k: k for k in range(200)}))
    sensors = '{' + ', '.join(f'T{k}: {k}' for k in range(200)) + '}'
    polled = wait(poll(MODBUS, server, sensors), good)
    assert list(polled.readings) == [float(k) for k in range(200)]


def frame(transaction, unit, body):
    """Return a Modbus TCP frame."""
    return struct.pack('>HHHB', transaction, 0, len(body) + 1, unit) + body


def of(request, body, unit=1):
    return frame(struct.unpack('>H', request[:2])[0], unit, body)


NOISE = random.Random(0).randbytes(5000)
HOSTILE = {
    'noise': lambda request: NOISE,
    'endless frame': lambda request: request[:4] + b'\xff\xff\x01' + NOISE,
    'empty frame': lambda request: request[:4] + b'\x00\x00\x01',
    'too few registers': lambda request: of(request, b'\x03\x02\x00\x07'),
    'too many registers': lambda request: of(request, b'\x03\xfa' + bytes(250)),
    'odd count': lambda request: of(request, b'\x03\x03\x00\x07\x01'),
    'count beyond the frame': lambda request: of(request, b'\x03\xff\x00\x07'),
    'another function': lambda request: of(request, b'\x04\x04\x00\x07\x00\x08'),
    'coils': lambda request: of(request, b'\x01\x01\x05'),
    'another unit': lambda request: of(request, b'\x03\x04\x00\x07\x00\x08', unit=9),
    'another transaction': lambda request: frame(999, 1, b'\x03\x04\x00\x07\x00\x08'),
    'unknown function': lambda request: of(request, b'\x63\x04\x00\x07\x00\x08'),
    'exception without code': lambda request: of(request, b'\x83'),
    'two answers': lambda request: 2 * of(request, b'\x03\x02\x00\x07'),
}


def is_lost_again_and_again(poller, server):
    """It goes on trying, whatever it is told."""
    asked = 0
    while asked < 2:
        asked = server.asked
        polled = poller.results.get(timeout=TIMEOUT)
        assert lost(polled), polled
        assert 0 < len(polled.trouble) <= TEXT_MAX


@pytest.mark.parametrize('answer', HOSTILE.values(), ids=HOSTILE)
@pytest.mark.usefixtures('impatient')
def test_hostile_modbus_servers_are_lost_devices(field, poll, answer):
    server = field.add(HostileServer(answer))
    poller = poll(MODBUS, server, '{T1: 0, T2: 1}')
    is_lost_again_and_again(poller, server)


@pytest.mark.parametrize('code', [1, 2, 3, 4, 6, 11, 77])
def test_every_exception_code_is_put_into_words(field, poll, code):
    server = field.add(HostileServer(lambda request: of(request, bytes([0x83, code]))))
    polled = wait(poll(MODBUS, server, '{T1: 7}'), good)
    assert polled.readings[0].startswith('register 7 of the table holding: the ')


ACKNOWLEDGE = b'ACKF' + struct.pack('<IIIIII', 28, 0, 65535, 65535, 0, 0)


@pytest.mark.parametrize(
    'answer',
    [
        lambda request: NOISE,
        lambda request: b'ACKF' + struct.pack('<I', 0xFFFFFFFF) + NOISE,
        lambda request: b'ACKF' + struct.pack('<I', 0),
        lambda request: b'ERRF' + struct.pack('<III', 16, 0x80010000, 0xFFFFFFFF),
        lambda request: ACKNOWLEDGE,
        lambda request: ACKNOWLEDGE if request[:3] == b'HEL' else b'OPNF' + NOISE,
        lambda request: ACKNOWLEDGE if request[:3] == b'HEL' else b'MSGC\x20\x00\x00\x00' + NOISE,
    ],
    ids=['noise', 'endless', 'empty', 'error', 'acknowledge', 'channel', 'chunks'],
)
@pytest.mark.usefixtures('impatient')
def test_hostile_opc_ua_servers_are_lost_devices(field, poll, answer):
    server = field.add(HostileServer(answer))
    poller = poll(OPC_UA, server, '{T1: ns=2;s=T1}', timeout=0.3)
    is_lost_again_and_again(poller, server)


def test_opc_ua_nodes_are_found_in_all_ways_and_missing_ones_named(field, poll):
    values = {'T1': 20.5, 'T2': 7, 'T3': ua.Variant(2**63, ua.VariantType.UInt64)}
    server = field.add(OpcUaServer(values))
    sensors = (
        '{A: ns=2;s=T1, B: "nsu=urn:fuzzycnc:test;s=T2", C: {path: "0:Objects/2:Mill/2:T1", '
        'scale: 2, offset: 1}, D: ns=2;s=T9, E: {path: "0:Objects/2:Mill/2:T9"}, '
        'F: nsu=urn:other;s=T1, G: {node: ns=2;s=T2, open_circuit: 7}}'
    )
    route = field.add(Route(server))
    poller = poll(OPC_UA, route, sensors)
    readings = wait(poller, good).readings
    assert list(readings[:3]) == [20.5, 7.0, 42.0]
    assert readings[3].startswith('node ns=2;s=T9: the server has no such node (BadNodeIdUnknown)')
    assert 'path 0:Objects/2:Mill/2:T9: the server has no such node (BadNoMatch)' in readings[4]
    assert 'nsu=urn:other;s=T1: the server has no such node (no namespace urn:oth' in readings[5]
    assert readings[6] == 'open circuit (raw value 7)'

    async def grow():
        mill = await server.server.nodes.objects.get_child(f'{server.index}:Mill')
        await mill.add_variable(ua.NodeId('T9', server.index), f'{server.index}:T9', 33.0)

    # Some servers fill their address space after the start.
    field.call(grow())
    wait(poller, lambda item: good(item) and list(item.readings[3:5]) == [33.0, 33.0])

    # A fresh client each time, and nothing of the old ones stays behind.
    def tasks():
        return asyncio.run_coroutine_threadsafe(count(), poller._loop).result(TIMEOUT)

    async def count():
        return len(asyncio.all_tasks())

    before, connections = tasks(), route.connections
    for _ in range(4):
        for fault in ('cut', ''):
            field.call(route.set(fault))
            wait(poller, lost if fault else good)
    assert route.connections >= connections + 4
    # One that asks just now may be among them.
    wait(poller, lambda item: good(item) and tasks() <= before)


def test_a_value_beyond_all_sizes_is_told(field, poll):
    server = field.add(OpcUaServer({'T1': 20.5, 'T2': 7.0}))
    poller = poll(OPC_UA, server, '{T1: ns=2;s=T1, T2: ns=2;s=T2}')
    wait(poller, good)
    server.values['T2'] = 'long' * (1 << 19)
    long = 'one of the nodes holds a long text or list'
    wait(poller, lambda item: lost(item) and long in item.trouble)
    server.values['T2'] = [8.0]
    assert wait(poller, good).readings[0] == 20.5


def test_wrong_node_id_is_refused_before_any_connection(tmp_path):
    path = tmp_path / 'devices.yaml'
    path.write_text(
        OPC_UA.format(host=LOCAL, port=1, sensors='{T1: ns=2;g=12-34}', timeout=1.0, more='')
    )
    (device,) = read_devices(path)
    with pytest.raises(ParameterError, match="sensor T1: expected a node id but found 'ns=2;g=12"):
        device.check()


@pytest.mark.slow
def test_the_first_certificate_of_a_server_is_pinned_and_another_refused(field, poll, tmp_path):
    server = field.add(OpcUaServer({'T1': 20.5}, secured(tmp_path)))
    user_file(tmp_path)
    more = f'credentials: user.yaml\n    {PINNING}'
    poller = poll(OPC_UA, server, '{T1: ns=2;s=T1}', more=more)
    assert wait(poller, good).readings == [20.5]
    pin = tmp_path / f'opcua-127.0.0.1-{server.port}.pem'
    assert pin.exists()
    asked, other = [], tmp_path / 'other'
    other.mkdir()
    field.call(server.stop())
    server._secure = secured(other, asked.append)
    field.call(server.start())
    changed = f'the server shows another certificate than {pin}; if it was given a new one'
    assert wait(poller, lambda found: changed in found.trouble).readings is None
    assert asked == []
    # The new one is accepted without a restart.
    pin.unlink()
    assert wait(poller, good).readings == [20.5]


@pytest.mark.slow
def test_secured_server_with_credentials(field, poll, tmp_path, monkeypatch):
    monkeypatch.setattr(opcua_session, 'REFUSED_PAUSE', 0.1)
    server = field.add(OpcUaServer({'T1': 20.5}, secured(tmp_path)))
    user = user_file(tmp_path, 'wrong')
    more = f'credentials: user.yaml\n    {SECURITY}'
    poller = poll(OPC_UA, server, '{T1: ns=2;s=T1}', more=more)
    trouble = wait(poller, lost).trouble
    assert trouble.startswith(f'the server refuses {user} (Bad')
    assert 'wrong' not in trouble
    # The right password is taken without a restart.
    user_file(tmp_path)
    assert wait(poller, good).readings == [20.5]
    user.unlink()
    # Without security the same server refuses the connection.
    plain = poll(OPC_UA, server, '{T1: ns=2;s=T1}')
    assert 'the server does not offer this connection' in wait(plain, lost).trouble


class Dropping(OpcUaServer):
    """A server that drops its clients on demand."""

    async def drop(self) -> None:
        """End all connections, without a word."""
        for transport in list(self.server.iserver.asyncio_transports):
            transport.abort()

    async def forget(self) -> None:
        """End all sessions; the connections stay."""
        for client in list(self.server.bserver.clients):
            await client.processor.session.close_session()


def held(poller):
    """Return what a poller holds: threads of the process, tasks, connections."""

    async def count():
        loop = asyncio.get_running_loop()
        open_ones = [item for item in loop._connections if item[0].fileno() >= 0]
        return len(asyncio.all_tasks()) - 1, len(open_ones), len(loop._connections)

    found = asyncio.run_coroutine_threadsafe(count(), poller._loop).result(TIMEOUT)
    return threading.active_count(), *found


ENDED = {'drop': 'connection lost', 'forget': 'the server has ended the session (BadSession'}
"""What is told of a client that was dropped."""


@pytest.mark.parametrize('how', ['drop', 'forget'])
@pytest.mark.parametrize('drops', [5, pytest.param(100, marks=pytest.mark.qualify)])
@pytest.mark.usefixtures('impatient')
def test_sessions_that_are_dropped_again_and_again_leave_nothing(field, poll, how, drops):
    server = field.add(Dropping({'T1': 0.5}))
    poller = poll(OPC_UA, server, '{T1: "ns=2;s=T1"}')
    stamps, before = [], None
    for number in range(drops):
        value = server.values['T1'] = number + 1.5
        stamps.append(
            wait(poller, lambda item, v=value: good(item) and item.readings == [v]).stamp
        )
        if number == 1:
            before = held(poller)
        field.call(getattr(server, how)())
        gone = wait(poller, lost)
        stamps.append(gone.stamp)
        assert gone.trouble.startswith(ENDED[how])
    value = server.values['T1'] = -1.5
    # What comes after a loss is what the server holds then.
    assert wait(poller, good).readings == [value]
    assert stamps == sorted(stamps)
    wait(poller, good)
    assert held(poller) == before


@pytest.mark.usefixtures('impatient')
def test_answers_after_the_timeout_are_never_read_and_leave_nothing(field, poll):
    server = field.add(OpcUaServer({'T1': 20.5}))
    route = field.add(Route(server))
    poller = poll(OPC_UA, route, '{T1: "ns=2;s=T1"}', timeout=0.4)
    for _ in range(2):
        wait(poller, good)
    before = held(poller)
    for value in (21.5, 22.5):
        field.call(route.set('late'))
        gone = wait(poller, lost)
        assert gone.trouble == 'no answer within 0.4 s'
        server.values['T1'] = value
        wait(poller, lost)
        field.call(route.set(''))
        assert wait(poller, good).readings == [value]
    wait(poller, good)
    assert held(poller) == before


def test_values_that_may_be_older_than_the_interval_are_said_to_be(field, poll):
    server = field.add(OpcUaServer({'T1': 20.5}))
    route = field.add(Route(server))
    poller = poll(OPC_UA, route, '{T1: "ns=2;s=T1"}', timeout=30.0)
    wait(poller, good)
    health = DeviceHealth(poller._devices[0], interval=0.2)
    route.delay = 0.3
    field.call(route.set('late'))
    polled = wait(poller, lambda item: good(item) and item.took >= route.delay)
    health.note(polled)
    told = health.news()
    assert told.level is Level.WARN
    assert 'longer than interval = 0.2 s, and its values may be as old' in told.message
    field.call(route.set(''))
    health.note(wait(poller, lambda item: good(item) and item.took < 0.2))
    assert health.news().level is Level.OK

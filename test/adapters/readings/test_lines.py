# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Plain lines over a pseudo-terminal and over TCP: what they mean, faults, and back again."""

import asyncio
import os
import tty

import pytest

pytest.importorskip('rclpy')
pytest.importorskip('serial')

from equipment.field_servers import LOCAL, Field, LocalServer
from equipment.polled import good, is_text, lost, wait
from hypothesis import given
from hypothesis import strategies as st

from fuzzycnc_ros.adapters.readings import polling
from fuzzycnc_ros.adapters.readings.device_file import DRIVERS, read_devices
from fuzzycnc_ros.adapters.readings.lines import value_in, values_of

pytestmark = pytest.mark.ros

FILE = """
devices:
  - name: board
    protocol: lines
    port: {port}
    period: 0.02
    timeout: {timeout}
    {more}
    sensors: {sensors}
"""
BACK_MAX = 5.0
"""Longest pause and wait that stand between the return of a device and its next reading [s]."""


class Board:
    """A board at the other end of a serial line, which sends a line again and again."""

    def __init__(self, port, line):
        self.port, self.line = port, line
        self.plugged = False

    async def start(self):
        await self.plug()
        self._task = asyncio.create_task(self._send())

    async def stop(self):
        self._task.cancel()
        await self.unplug()

    async def plug(self):
        self._near, self._far = os.openpty()
        tty.setraw(self._far)
        self.port.symlink_to(os.ttyname(self._far))
        self.plugged = True

    async def unplug(self):
        if self.plugged:
            self.plugged = False
            self.port.unlink()
            os.close(self._near)
            os.close(self._far)

    async def _send(self):
        os.set_blocking(self._near, False)
        while True:
            if self.plugged:
                try:
                    os.write(self._near, self.line)
                except BlockingIOError:
                    pass  # nobody reads
            await asyncio.sleep(0.01)


class LineServer(LocalServer):
    """A board behind TCP."""

    def __init__(self, line):
        super().__init__()
        self.line = line

    async def _serve(self, reader, writer):
        while True:
            writer.write(self.line)
            await writer.drain()
            await asyncio.sleep(0.01)


@pytest.fixture
def field():
    made = Field()
    yield made
    made.close()


@pytest.fixture
def board(field, tmp_path):
    return field.add(Board(tmp_path / 'ttyACM0', b'T1 21.5 T2 22.0\n'))


@pytest.fixture
def begin(poll_file):
    def of(port, sensors='{front: T1, rear: {key: T2, offset: -0.5}}', more='', timeout=0.5):
        return poll_file(FILE.format(port=port, sensors=sensors, more=more, timeout=timeout))

    return of


def test_a_board_on_a_serial_line_is_read_and_comes_back(field, board, begin):
    poller = begin(board.port)
    assert list(wait(poller, good).readings) == [21.5, 21.5]
    for _ in range(2):
        field.call(board.unplug())
        assert 'ttyACM0' in wait(poller, lost).trouble
        field.call(board.plug())
        assert list(wait(poller, good).readings) == [21.5, 21.5]


def test_a_silent_board_keeps_its_port_and_each_value_its_own_age(board, begin):
    poller = begin(board.port)
    wait(poller, good)
    board.line = b'T1 21.5\n'
    found = wait(poller, lambda item: good(item) and is_text(item.readings[1], 'nothing came'))
    assert found.readings[0] == 21.5
    board.line = b''
    wait(poller, lambda item: good(item) and is_text(item.readings[0], 'T1: nothing came for'))
    board.line = b'T1 21.5 T2 22.0\n'
    wait(poller, lambda item: good(item) and list(item.readings) == [21.5, 21.5])


def test_a_board_over_tcp_is_read_and_comes_back(field, begin):
    server = field.add(LineServer(b'{"T1": 21.5, "T2": 22}\n'))
    poller = begin(f'{LOCAL}:{server.port}')
    assert list(wait(poller, good).readings) == [21.5, 21.5]
    server.line = b'T7 1\n'  # heard, and of no use
    wait(poller, lambda item: good(item) and is_text(item.readings[0], "last line, b'T7 1'"))
    server.line = b'T1 21.5 T2 22\n'
    field.call(server.stop())
    wait(poller, lost)
    field.call(server.start())
    assert list(wait(poller, good).readings) == [21.5, 21.5]
    server.line = b''  # as where its cable was pulled out
    assert 'is the other end still there?' in wait(poller, lost).trouble


@pytest.mark.parametrize(
    ('line', 'parts'),
    [
        (b'T1 295.15', ()),
        (b'T1 10230', ('reads 10230 degC, which no sensor', 'counts or ohms say ntc')),
        (b'T1 nan', ("expected a number but found 'nan'",)),
        (b'T1 10.2kohm', ("expected a number but found '10.2kohm'",)),
        (b'T1 -127', ('open circuit (raw value -127',)),
        (b'T1 21,5', ("expected a number but found '21,5'",)),
        (b'{"T1": 1' + 400 * b'0' + b'}', ('expected a number but found 10000',)),
        (b'{"T1": 1e999}', ('reads inf, expected a finite number',)),
        (b'T7 21.5', ('nothing came', "the last line, b'T7 21.5'")),
        (b'\x80\xff\xfe\x01 21.5', ('nothing came', 'compare baud_rate')),
        (b'x' * 20_000, ('nothing came',)),
    ],
)
def test_what_is_no_temperature_is_told(board, begin, line, parts):
    board.line = line + b'\n'
    poller = begin(board.port, '{front: {key: T1, open_circuit: -127}}', timeout=0.2)
    if not parts:  # kelvin is within what sensors read; the node's range_high refuses it
        assert list(wait(poller, good).readings) == [295.15]
        return
    wait(poller, lambda item: good(item) and is_text(item.readings[0], *parts))


def test_columns_are_values_in_their_order_and_a_line_cut_short_is_none(board, begin):
    board.line = b'2026-11-28; 512; 22.0\n'
    ntc = '{beta: 3950, resistance: 10000, divider: {fixed: 10000, supply: 1024}}'
    poller = begin(board.port, f'{{front: {{key: A, ntc: {ntc}}}, rear: B}}', 'columns: [-, A, B]')
    found = wait(poller, good).readings
    assert list(found) == [pytest.approx(25.0), 22.0]
    board.line = b'512; 22.0\n'
    wait(poller, lambda item: good(item) and is_text(item.readings[0], 'compare baud_rate, key'))


@pytest.mark.parametrize(
    ('line', 'found'),
    [
        ('T1=21.5,T2=22', [('T1', 21.5), ('T2', 22.0)]),
        ('T1: 21.5 C; T2: 71.6 F', [('T1', 21.5), ('T2', pytest.approx(22.0))]),
        ('2026-11-28 12:30:11 T2 295.15K', [('T2', pytest.approx(22.0))]),
        ('T1 open T2 22', [('T1', 'open'), ('T2', 22.0)]),
        ('T1=21,5;T2=22', [('T1', '21,5'), ('T2', 22.0)]),
        ('T1 21,5', [('T1', '21,5')]),
        ('{"T1": 1' + 400 * '0' + '}', [('T1', 10**400)]),
        ('T1', []),
        ('hello', []),
        ('{"T1": null}', [('T1', None)]),
        ('{"T1": "70.7F"}', [('T1', pytest.approx(21.5))]),
        ('{"T1": 21.5', []),
        ('', []),
    ],
)
def test_pairs(line, found):
    assert list(values_of(line, ['T1', 'T2'], [])) == found


@given(st.text(max_size=60), st.sampled_from([(), ('T1', 'T2')]))
def test_any_line_is_taken_or_not(line, columns):
    for key, value in values_of(line, ['T1', 'T2'], columns):
        assert key in ('T1', 'T2')
        assert not isinstance(value, float) or abs(value) >= 0.0


def test_units_of_values():
    assert value_in('21.5\N{DEGREE SIGN}C') == 21.5
    assert value_in('-40F') == pytest.approx(-40.0)
    assert value_in('21.5V') == '21.5V'


def test_wrong_files_are_refused(refused_file):
    def line(old, new):
        text = FILE.format(port='/dev/ttyACM0', sensors='{front: T1}', more='', timeout=1)
        assert old in text
        return refused_file(text.replace(old, new))

    assert 'port: expected the file of a serial port, such as' in line('/dev/ttyACM0', 'COM3')
    assert "columns: expected 'T1' once among them but found T2" in line(
        'period: 0.02', 'columns: [T2]'
    )
    two = FILE.format(port='/dev/ttyACM0', sensors='{front: T1}', more='', timeout=1)
    both = two + two.partition('devices:\n')[2].replace('board', 'other').replace('front', 'rear')
    assert '/dev/ttyACM0 is already read by device board' in refused_file(both)


@pytest.mark.parametrize('protocol', sorted(DRIVERS))
def test_pauses_and_waits_leave_every_driver_back_in_time(protocol, tmp_path):
    """Figures, not the clock: an attempt that the fault spoils, and the pause after it."""
    places = {
        'modbus_tcp': 'host: h, sensors: {T1: 0}',
        'modbus_rtu': 'port: /dev/ttyUSB0, sensors: {T1: 0}',
        'opc_ua': 'url: "opc.tcp://h:1/", sensors: {T1: ns=2;s=T1}',
        'mtconnect': 'url: "http://h:1", sensors: {T1: t1}',
        'linuxcnc_hal': 'sensors: {T1: t1}',
        'lines': 'port: "h:1", sensors: {T1: t1}',
        'one_wire': 'sensors: {T1: 28-0316a2791cff}',
        'mqtt': 'host: h, sensors: {T1: t1}',
        'moonraker': 'url: "http://h:1", sensors: {T1: heater_bed}',
    }
    path = tmp_path / 'devices.yaml'
    path.write_text(f'devices: [{{name: d, protocol: {protocol}, {places[protocol]}}}]')
    (device,) = read_devices(path)
    assert device.timeout + polling.BACK_OFF_MAX < BACK_MAX

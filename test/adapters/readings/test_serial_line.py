# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Modbus RTU over a serial line: a real server on it, and what can happen to the line."""

import time

import pytest

pytest.importorskip('rclpy')
pytest.importorskip('pymodbus')
pytest.importorskip('serial')

from equipment import serial_cable
from equipment.field_servers import Field
from equipment.polled import close, lost
from equipment.serial_cable import Cable

from fuzzycnc_ros.adapters.modbus.serial_line import QUIET
from fuzzycnc_ros.adapters.readings import polling
from fuzzycnc_ros.adapters.readings.device_file import read_devices
from fuzzycnc_ros.adapters.readings.device_source import DeviceHealth
from fuzzycnc_ros.adapters.readings.polling import Poller
from fuzzycnc_ros.runtime.component import Level

pytestmark = pytest.mark.ros

TIMEOUT = 60.0
BACK_MAX = 5.0
"""Longest pause and wait that stand between the end of a fault and the next good reading [s]."""
DEVICE = """
  - name: rtd{unit}
    protocol: modbus_rtu
    port: {port}
    unit: {unit}
    parity: {parity}
    period: 0.02
    timeout: {timeout:g}
    sensors: {sensors}
"""
WORDS = {0: 215, 2: 220, 5: 230}
SENSORS = '{{{0}1: {{register: 0, scale: 0.1}}, {0}2: 2, {0}3: 5}}'
VALUES = [pytest.approx(21.5), 220.0, 230.0]


class Line:
    """A cable, and a poller that reads the units on it."""

    def __init__(self, folder, units, asked, parity, timeout):
        self.field = Field()
        port = folder / 'ttyUSB0'
        self.cable = self.field.add(Cable(port, WORDS, units, 0.6 * timeout))
        path = folder / 'devices.yaml'
        path.write_text(
            'devices:'
            + ''.join(
                DEVICE.format(
                    port=port,
                    unit=unit,
                    parity=parity,
                    timeout=timeout,
                    sensors=SENSORS.format('ABC'[place]),
                )
                for place, unit in enumerate(asked)
            )
        )
        devices = read_devices(path)
        self.health = [DeviceHealth(device, interval=60.0) for device in devices]
        self.poller = Poller(devices, time.monotonic_ns)

    def set(self, fault):
        self.field.call(self.cable.set(fault))

    def close(self):
        close(self.poller)
        self.field.close()

    def wait(self, wanted, device=0):
        """Wait for a result of a device that fulfils a condition; return it."""
        deadline = time.monotonic() + TIMEOUT
        polled = None
        while time.monotonic() < deadline:
            polled = self.poller.results.get(timeout=TIMEOUT)
            self.health[polled.device].note(polled)
            assert polled.readings is None or is_true(polled), polled
            if polled.device == device and wanted(polled):
                return polled
        raise AssertionError(f'the last result was {polled}')


def is_true(polled):
    """Whether no reading is another value than that of its register."""
    pairs = zip(polled.readings, VALUES, strict=True)
    return all(isinstance(found, str) or found == true for found, true in pairs)


def good(polled):
    return polled.readings is not None and not any(isinstance(r, str) for r in polled.readings)


def in_use(polled):
    return lost(polled) and 'cannot open' in polled.trouble


def disturbed(polled):
    return polled.readings is not None and 'unrequested bytes' in str(polled.readings[0])


@pytest.fixture
def lay(tmp_path):
    """Lay a cable to some units, and read some."""
    laid = []

    # A pseudo-terminal has no parity.
    def of(units=(1,), asked=(1,), parity='none', timeout=0.3):
        laid.append(Line(tmp_path, units, asked, parity, timeout))
        return laid[-1]

    yield of
    for line in laid:
        line.close()


FAULTS = {
    'unplugged': (lost, 'ttyUSB0', Level.ERROR),
    'held': (in_use, 'another program may hold it', Level.ERROR),
    'silent': (lost, 'no answer from unit 1 within 0.3 s; is it on', Level.ERROR),
    'garbled': (lost, 'bytes that are none; compare baud_rate, parity', Level.ERROR),
    'noise': (disturbed, 'another master, an answer that came too late, or noise', Level.WARN),
    'master': (disturbed, 'a line has one master', Level.WARN),
}


@pytest.mark.parametrize(('fault', 'outcome'), FAULTS.items(), ids=FAULTS)
def test_a_fault_is_told_as_what_it_is_and_leaves_nothing_behind(lay, fault, outcome):
    shown, text, level = outcome
    line = lay()
    line.wait(good)
    assert line.health[0].health().level is Level.OK
    for _ in range(2):
        line.set(fault)
        # What a busy computer gave up before the fault is told in other words.
        line.wait(lambda polled: shown(polled) and text in line.health[0].health().message)
        assert line.health[0].health().level is level
        line.set('')
        line.wait(good)
        assert line.health[0].health().level is Level.OK


def test_pauses_and_waits_after_a_fault_leave_a_line_back_in_time(tmp_path):
    """Figures, not the clock: what stands between the end of a fault and the next reading."""
    text = DEVICE.format(
        port='/dev/ttyUSB0', unit=1, parity='even', timeout=0.3, sensors='{T1: 0}'
    )
    path = tmp_path / 'devices.yaml'
    path.write_text(f'devices:{text.replace("timeout: 0.3", "")}')
    (device,) = read_devices(path)
    # A request that the fault spoils still, the pause after it, the request that is answered
    assert device.timeout + polling.BACK_OFF_MAX + device.timeout < BACK_MAX
    assert QUIET + device.timeout < BACK_MAX


def test_a_missing_port_is_waited_for(lay):
    line = lay()
    line.set('unplugged')
    found = line.wait(lambda polled: lost(polled) and 'no serial port' in polled.trouble)
    assert 'ttyUSB0; is the adapter plugged in?' in found.trouble
    line.set('')
    line.wait(good)


def test_an_answer_that_comes_too_late_is_never_taken_for_another(lay, monkeypatch):
    """Without numbers in the frames, the answer to the last request looks like that to this."""
    monkeypatch.setattr(polling, 'BACK_OFF_FIRST', 0.0)  # ask again at once
    line = lay()
    line.wait(good)
    line.set('late')
    for _ in range(6):
        line.wait(lambda polled: not good(polled))
    line.set('')
    line.wait(good)


@pytest.mark.slow
def test_a_unit_may_take_as_long_as_it_is_given(lay, monkeypatch):
    """The client's own limit is 3 s."""
    monkeypatch.setattr(serial_cable, 'LATE', 3.5)
    line = lay(timeout=60.0)
    line.set('late')
    line.wait(lambda polled: lost(polled) or good(polled))
    assert line.health[0].health().level is Level.OK


@pytest.mark.parametrize('place', ['before', 'behind', 'around'])
def test_a_short_glitch_between_frames_costs_nothing(lay, place):
    line = lay(timeout=5.0)  # also where the computer has others to serve
    line.wait(good)
    line.set(f'glitch {place}')
    for _ in range(5):
        assert good(line.wait(lambda polled: True))


def test_units_share_a_line_and_a_dead_one_stops_nobody(lay):
    line = lay(units=(1, 3), asked=(1, 2, 3))
    for _ in range(2):
        line.wait(lost, device=1)
        for device in (2, 0):
            line.wait(good, device=device)
    assert line.health[0].health().level is Level.OK
    line.set('unplugged')
    for device in (0, 2):
        line.wait(lost, device=device)
    line.set('')
    for device in (0, 2):
        line.wait(good, device=device)


def test_a_port_that_refuses_its_settings_is_told(lay):
    line = lay(parity='even')
    line.wait(lambda polled: lost(polled) and 'ttyUSB0 refuses its settings (' in polled.trouble)

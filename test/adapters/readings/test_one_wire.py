# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""1-Wire sensors by a folder as the kernel shows it: readings, faults, and back again."""

import shutil

import pytest

pytest.importorskip('rclpy')

from equipment.polled import good, is_text, lost, wait

pytestmark = pytest.mark.ros

FRONT, REAR, OTHER = '28-0316a2791cff', '28-0417c11e55ff', '28-0000000000aa'
SLAVE = '{bytes} : crc=57 {word}\n{bytes} t={value}\n'


class Bus:
    """A folder of sensors."""

    def __init__(self, folder):
        self.folder = folder

    def slave(self, name, value, word='YES', data='72 01 4b 46 7f ff 0e 10 57'):
        """Let a sensor have a value [0.001 degC], as the kernel's first file tells."""
        place = self.folder / name
        place.mkdir(parents=True, exist_ok=True)
        new = place / 'new'
        new.write_text(SLAVE.format(bytes=data, word=word, value=value))
        new.rename(place / 'w1_slave')

    def temperature(self, name, text):
        """Let a sensor have a text in the kernel's newer file."""
        place = self.folder / name
        place.mkdir(parents=True, exist_ok=True)
        (place / 'new').write_text(text)
        (place / 'new').rename(place / 'temperature')


@pytest.fixture
def bus(tmp_path):
    made = Bus(tmp_path / 'devices')
    made.slave(FRONT, 21500)
    made.temperature(REAR, '22000\n')
    return made


@pytest.fixture
def poller(bus, poll_file):
    return poll_file(
        'devices: [{name: w1, protocol: one_wire, period: 0.02, '
        f'folder: {bus.folder}, sensors: {{front: {FRONT}, rear: {{id: {REAR}, offset: 0.5}}}}}}]'
    )


def test_both_files_of_the_kernel_are_read(bus, poller):
    assert list(wait(poller, good).readings) == [21.5, 22.5]
    bus.slave(FRONT, -62)
    wait(poller, lambda item: good(item) and list(item.readings) == [-0.062, 22.5])


@pytest.mark.parametrize(
    ('change', 'parts'),
    [
        (lambda bus: bus.slave(FRONT, 21500, 'NO'), ('the checksum is wrong', 'cable length')),
        (
            lambda bus: bus.slave(FRONT, 0, data='00 00 00 00 00 00 00 00 00'),
            ('reads zeros', 'shorted'),
        ),
        (lambda bus: bus.slave(FRONT, 85000), ('reads 85 degC, as after power-on',)),
        (lambda bus: bus.slave(FRONT, 'x'), ('expected t=TEMPERATURE but found',)),
        (lambda bus: (bus.folder / FRONT / 'w1_slave').unlink(), ('no such sensor', OTHER)),
    ],
)
def test_a_fault_costs_its_sensor_alone_and_it_comes_back(bus, poller, change, parts):
    wait(poller, good)
    bus.temperature(OTHER, '1000')
    change(bus)
    found = wait(poller, lambda item: good(item) and is_text(item.readings[0], *parts))
    assert found.readings[0].startswith(FRONT)
    assert found.readings[1] == 22.5
    bus.slave(FRONT, 21625)
    wait(poller, lambda item: good(item) and list(item.readings) == [21.625, 22.5])


def test_85_degrees_are_believed_of_a_sensor_that_is_as_warm(bus, poller):
    bus.slave(FRONT, 84500)
    wait(poller, lambda item: good(item) and item.readings[0] == 84.5)
    bus.slave(FRONT, 85000)
    wait(poller, lambda item: good(item) and item.readings[0] == 85.0)
    bus.temperature(REAR, '-')
    wait(poller, lambda item: good(item) and is_text(item.readings[1], 'thousandths of a degree'))


def test_a_bus_that_has_gone_comes_back(bus, poller):
    wait(poller, good)
    aside = bus.folder.with_name('aside')
    bus.folder.rename(aside)
    assert 'load the driver of the bus' in wait(poller, lost).trouble
    aside.rename(bus.folder)
    assert list(wait(poller, good).readings) == [21.5, 22.5]
    shutil.rmtree(bus.folder)


def test_wrong_identifiers_are_refused(refused_file):
    text = refused_file('devices: [{name: w1, protocol: one_wire, sensors: {front: 28-xyz}}]')
    assert 'id: expected an identifier such as 28-0316a2791cff, as `ls /sys/bus/w1' in text

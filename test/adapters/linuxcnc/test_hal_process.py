# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The process with the HAL pins beside a LinuxCNC of another user."""

from types import SimpleNamespace
from unittest.mock import MagicMock

import pytest

from fuzzycnc_ros.adapters.linuxcnc import hal_process
from fuzzycnc_ros.adapters.linuxcnc.hal_process import (
    ARMING,
    LINE,
    NUMBERS,
    SERVER,
    TAKEN,
    VALID_FOR,
    Bridge,
    HalError,
    home_of_linuxcnc,
)

SIGNALS = [
    {'NAME': f'fuzzycnc-{name}'}
    for name in (
        *('homed', 'ready', 'alive', 'on', 'soft-limited', 'heartbeat', 'enable', 'rezero'),
        *(f'{n}-x' for n in ('position', 'applied', 'request', 'register', 'counts')),
    )
]


@pytest.fixture
def processes(tmp_path):
    """Add processes to a folder as the kernel shows them."""

    def add(number, name, environment):
        folder = tmp_path / str(number)
        folder.mkdir()
        (folder / 'comm').write_text(f'{name}\n')
        if environment is not None:
            (folder / 'environ').write_bytes(environment)
        return tmp_path

    return add


def test_home_is_that_of_the_user_of_linuxcnc(processes, monkeypatch):
    monkeypatch.setenv('HOME', '/srv/ros')
    found = processes(1, 'init', b'HOME=/\0')
    assert home_of_linuxcnc(found) == '/srv/ros'
    processes(7, SERVER, b'SHELL=/bin/sh\0HOME=/srv/cnc\0LANG=C\0')
    assert home_of_linuxcnc(found) == '/srv/cnc'


def test_home_is_our_own_where_that_of_linuxcnc_is_not_told(processes, monkeypatch):
    """Another user's environment cannot be read."""
    monkeypatch.setenv('HOME', '/srv/ros')
    assert home_of_linuxcnc(processes(7, SERVER, None)) == '/srv/ros'


def test_a_watchdog_that_let_go_is_armed_by_an_edge_now_and_then(monkeypatch):
    hal, now = MagicMock(), [100.0]
    pins = {}

    def newpin(name, kind, direction):
        return pins.setdefault(name, SimpleNamespace(value=0))

    hal.component.return_value.newpin = newpin
    hal.get_value.return_value = False
    hal.get_info_signals.return_value = SIGNALS
    monkeypatch.setattr(hal_process.time, 'monotonic', lambda: now[0])
    bridge = Bridge(hal, MagicMock(), ['x'])
    with pytest.raises(HalError, match='have not been claimed'):
        bridge.write({'offset': [5]}, False)
    bridge.claim()
    pins['alive'].value = True
    bridge.write({'offset': [5]}, True)
    assert (pins['counts-x'].value, pins['rezero'].value) == (5, True)
    assert (pins['heartbeat'].value, pins['enable'].value) == (True, False)
    pins['alive'].value, edges = False, []
    for step in range(50):
        now[0] = 100.0 + 0.1 * ARMING * step
        bridge.write({'offset': [5]}, False)
        edges.append(pins['enable'].value)
    changes = [at for at in range(1, 50) if edges[at] != edges[at - 1]]
    assert edges[0]
    assert changes == [11, 22, 33, 44]


class Servo:
    """HAL with fuzzycnc_offset, whose component takes sets only when it is told to."""

    def __init__(self):
        self.pins = {}
        names = [item['NAME'] for item in SIGNALS if 'counts-' not in item['NAME']]
        more = ('acknowledged', 'following', 'tracking', 'sequence', 'valid-for', 'limit')
        names += [f'fuzzycnc-{name}' for name in more]
        names += [f'fuzzycnc-{name}-x' for name in ('low', 'high', 'base', *LINE)]
        self.hal = MagicMock()
        self.hal.component.return_value.newpin = self._newpin
        self.hal.get_info_signals.return_value = [{'NAME': name} for name in names]
        self.bridge = Bridge(self.hal, MagicMock(), ['x'])

    def _newpin(self, name, kind, direction):
        return self.pins.setdefault(name, SimpleNamespace(value=0))

    def write(self, offset):
        line = {'offset': [offset], 'slope': [0.5], 'reference': [10.0], 'limit': 6000.0}
        self.bridge.write(line, False)

    def take(self):
        self.pins['acknowledged'].value = self.pins['sequence'].value
        self.pins['following'].value = True

    @property
    def stands(self):
        return [self.pins[f'{name}-x'].value for name in ('offset', 'slope', 'reference')]


def test_a_set_waits_until_the_one_before_was_taken(monkeypatch):
    """Values come before the number; while the servo thread may read them nothing is written."""
    now = [100.0]
    monkeypatch.setattr(hal_process.time, 'monotonic', lambda: now[0])
    servo = Servo()
    servo.pins['acknowledged'].value = NUMBERS
    servo.bridge.claim()
    assert servo.pins['sequence'].value == NUMBERS
    servo.write(5.0)
    assert (servo.stands, servo.pins['sequence'].value) == ([5.0, 0.5, 10.0], 1)
    servo.write(6.0)
    assert servo.stands[0] == 5.0
    servo.take()
    servo.write(6.0)
    assert (servo.stands[0], servo.pins['sequence'].value) == (6.0, 2)
    servo.take()
    servo.write(6.0)
    assert servo.pins['sequence'].value == 2
    servo.pins['following'].value = False  # it has let the set go
    servo.write(6.0)
    assert servo.pins['sequence'].value == 3
    servo.take()
    now[0] += VALID_FOR / 2
    servo.write(6.0)
    assert servo.pins['sequence'].value == 4
    now[0] += TAKEN - 0.1
    servo.write(7.0)
    now[0] += 0.2
    with pytest.raises(HalError, match='has not taken set 4 for 3 s'):
        servo.write(7.0)


def test_a_state_that_is_not_told_is_said_with_the_remedy(monkeypatch):
    """LinuxCNC's module raises SystemError where it found no tool table."""
    monkeypatch.setenv('HOME', '/srv/ros')
    hal = MagicMock()
    hal.get_info_signals.return_value = SIGNALS
    state = SimpleNamespace(poll=MagicMock(side_effect=SystemError('returned NULL')))
    module = SimpleNamespace(stat=lambda: state, error=RuntimeError)
    bridge = Bridge(hal, module, ['x'])
    with pytest.raises(HalError, match=r'cannot read /srv/ros/\.tool\.mmap; run this node as'):
        bridge.status()

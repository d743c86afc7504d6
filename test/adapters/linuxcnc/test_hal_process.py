# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The process with the HAL pins beside a LinuxCNC of another user."""

from types import SimpleNamespace
from unittest.mock import MagicMock

import pytest

from fuzzycnc_ros.adapters.linuxcnc.hal_process import SERVER, Bridge, HalError, home_of_linuxcnc


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


def test_a_state_that_is_not_told_is_said_with_the_remedy(monkeypatch):
    """LinuxCNC's module raises SystemError where it found no tool table."""
    monkeypatch.setenv('HOME', '/srv/ros')
    hal = MagicMock()
    names = ('homed', 'ready', 'alive', 'on', 'soft-limited', 'heartbeat', 'enable', 'rezero')
    hal.get_info_signals.return_value = [
        {'NAME': f'fuzzycnc-{name}'}
        for name in (
            *names,
            *(f'{n}-x' for n in ('position', 'applied', 'request', 'register', 'counts')),
        )
    ]
    state = SimpleNamespace(poll=MagicMock(side_effect=SystemError('returned NULL')))
    module = SimpleNamespace(stat=lambda: state, error=RuntimeError)
    bridge = Bridge(hal, module, ['x'])
    with pytest.raises(HalError, match=r'cannot read /srv/ros/\.tool\.mmap; run this node as'):
        bridge.status()

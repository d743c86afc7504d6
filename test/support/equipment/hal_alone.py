# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""A HAL of LinuxCNC without LinuxCNC, in a shared memory of its own beside any other."""

import json
import os
import shutil
import signal
import subprocess
from pathlib import Path
from typing import Any

import pytest
from equipment.mqtt_broker import wait

INTERPRETER = '/usr/bin/python3'
PROGRAM = r"""
import json, sys
sys.path.append('/usr/lib/python3/dist-packages')
import hal
card = hal.component('card')
pins = {'temp': hal.HAL_FLOAT, 'adc': hal.HAL_S32, 'open': hal.HAL_BIT, 'rps': hal.HAL_FLOAT}
pins = {name: card.newpin(name, kind, hal.HAL_OUT) for name, kind in pins.items()}
card.ready()
hal.new_sig('rear', hal.HAL_FLOAT)
hal.connect('card.temp', 'rear')
print('ready', flush=True)
for line in sys.stdin:
    for name, value in json.loads(line).items():
        pins[name].value = float(value) if isinstance(value, str) else value
    print('done', flush=True)
card.exit()
"""


def skip_without() -> None:
    """Skip where LinuxCNC is absent, or no shared memory of one's own is to be had."""
    if shutil.which('halcmd') is None:
        pytest.skip('LinuxCNC is not installed (Debian: apt-get install linuxcnc-uspace)')
    if subprocess.run(['unshare', '--ipc', 'true'], capture_output=True, check=False).returncode:
        pytest.skip('no namespace of its own to be had: unshare --ipc needs root')


class HalAlone:
    """A component `card` with the pins temp, adc, open and rps, and a signal `rear` from temp.

    Parameters
    ----------
    folder : Path
        Where its home lies, and the interpreter that sees it.
    """

    def __init__(self, folder: Path) -> None:
        self._home = folder
        self.interpreter = folder / 'python3'
        self._process: subprocess.Popen[str] | None = None

    def start(self) -> None:
        """Start it, with the memory empty."""
        self._process = subprocess.Popen(
            ['unshare', '--ipc', INTERPRETER, '-c', PROGRAM],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            env={**os.environ, 'HOME': str(self._home)},
        )
        self._hear('ready')
        self.interpreter.write_text(
            f'#!/bin/sh\nexec nsenter --ipc=/proc/{self._process.pid}/ns/ipc {INTERPRETER} "$@"\n'
        )
        self.interpreter.chmod(0o755)

    def set(self, **pins: Any) -> None:
        """Set pins; a text is a float that JSON has none for."""
        assert self._process is not None
        assert self._process.stdin is not None
        self._process.stdin.write(json.dumps(pins) + '\n')
        self._process.stdin.flush()
        self._hear('done')

    def stop(self) -> None:
        """End it, and all that see its memory, as LinuxCNC does."""
        if self._process is None:
            return
        namespace = os.readlink(f'/proc/{self._process.pid}/ns/ipc')
        for entry in Path('/proc').glob('[0-9]*'):
            try:
                mine = os.readlink(entry / 'ns' / 'ipc') == namespace
            except OSError:
                continue
            if mine and int(entry.name) != self._process.pid:
                os.kill(int(entry.name), signal.SIGTERM)
        self._process.communicate(timeout=60.0)
        self._process = None

    def _hear(self, word: str) -> None:
        stream = self._process.stdout if self._process is not None else None
        assert stream is not None
        wait(lambda: word in stream.readline(), f'{word} of HAL')

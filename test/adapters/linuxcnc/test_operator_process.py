# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The socket through which a LinuxCNC is operated, without one."""

import os
import socket
import stat
import sys
from pathlib import Path

from processes import HANG, start, wait_for

import fuzzycnc_ros.adapters.linuxcnc as package

SOURCE = Path(package.__file__).with_name('operator_process.py')
LINUXCNC = 'class command: pass\nstat = command\n'


def test_nobody_else_operates_the_machine(tmp_path):
    (tmp_path / 'linuxcnc.py').write_text(LINUXCNC)
    path = tmp_path / 'operator'
    environment = {**os.environ, 'PYTHONPATH': str(tmp_path), 'FUZZYCNC_OPERATOR': str(path)}
    process = start([sys.executable, str(SOURCE)], env=environment, umask=0)
    wait_for(lambda: path.exists() or process.poll() is not None, 'the socket is there')
    assert stat.S_IMODE(path.stat().st_mode) == 0o600
    with socket.socket(socket.AF_UNIX) as caller:
        wait_for(lambda: caller.connect_ex(str(path)) == 0, 'it listens')
    assert process.wait(HANG) == 0

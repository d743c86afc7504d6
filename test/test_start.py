# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Executables hear a wish to end while their modules are imported."""

import os
import signal
import subprocess
import sys
from importlib.util import find_spec

import pytest
from processes import HANG, start

SCRIPT = """
import sys
from fuzzycnc_ros.start import {0}
sys.exit({0}())
"""
"""What pip writes for an entry point."""
INTERRUPTS = """
import os, signal
os.kill(os.getpid(), signal.{0})
raise SystemExit('it went on')
"""
NODE = pytest.param(
    'compensator',
    'rclpy',
    marks=[
        pytest.mark.ros,
        pytest.mark.skipif(not find_spec('rclpy'), reason='rclpy is not installed here'),
    ],
)


def run(folder, root, executable, *arguments, interrupts='default'):
    """Run an executable with modules of a folder ahead of others; return code and output."""
    path = os.pathsep.join([str(folder), str(root), os.environ.get('PYTHONPATH', '')])
    process = start(
        [sys.executable, '-c', SCRIPT.format(executable), *arguments],
        interrupts=interrupts,
        env={**os.environ, 'PYTHONPATH': path},
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )
    output, _ = process.communicate(timeout=HANG)
    return process.returncode, output


@pytest.mark.parametrize('interrupts', ['default', 'ignored'])
@pytest.mark.parametrize('number', [signal.SIGINT, signal.SIGTERM], ids=lambda n: n.name)
@pytest.mark.parametrize(('executable', 'module'), [('fuzzycnc', 'typer'), NODE])
def test_an_end_while_importing(tmp_path, root, executable, module, number, interrupts):
    (tmp_path / f'{module}.py').write_text(INTERRUPTS.format(number.name))
    code = 128 + number if executable == 'fuzzycnc' else 0
    assert run(tmp_path, root, executable, interrupts=interrupts) == (code, '')


def test_the_command_runs(tmp_path, root):
    code, output = run(tmp_path, root, 'fuzzycnc', '--version')
    assert code == 0
    assert output.startswith('fuzzycnc ')

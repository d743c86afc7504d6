# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The command that records a machine in a process of its own."""

import json
import sys
from pathlib import Path


def recorder_command(
    out: Path, machine: str, *, topics: str = '', lockstep: bool = False
) -> list[str]:
    """Return the command of a recorder.

    Parameters
    ----------
    out : Path
        Directory of the new bag.
    machine : str
        Namespace of its topics; empty for none.
    topics : str
        Regular expression of the topics; empty for all of the machine.
    lockstep : bool
        Whether it takes turns.
    """
    parameters = {'output': str(out), 'topics': topics, 'lockstep': lockstep}
    command = [sys.executable, '-m', 'fuzzycnc_ros.nodes.recorder']
    command += ['--ros-args', '-r', f'__ns:=/{machine}']
    for name, value in parameters.items():
        # JSON is YAML: a bag named 2024 stays a text.
        command += ['-p', f'{name}:={json.dumps(value)}']
    return command

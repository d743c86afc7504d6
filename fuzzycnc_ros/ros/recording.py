# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The command that records a machine in a process of its own, and whether a recorder listens."""

import json
import sys
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from rclpy.node import Node


def recorder_command(
    out: Path, machine: str, parameters: Mapping[str, Any] = MappingProxyType({})
) -> list[str]:
    """Return the command of a recorder.

    Parameters
    ----------
    out : Path
        Directory of the new bag.
    machine : str
        Namespace of its topics; empty for none.
    parameters : mapping
        Further parameters of the node.
    """
    command = [sys.executable, '-m', 'fuzzycnc_ros.nodes.recorder']
    command += ['--ros-args', '-r', f'__ns:=/{machine}']
    for name, value in {'output': str(out), **parameters}.items():
        # JSON is YAML: a bag named 2024 stays a text.
        command += ['-p', f'{name}:={json.dumps(value)}']
    return command


def is_recorded(node: 'Node', machine: str) -> bool:
    """Return whether a recorder of a machine listens to what is done there.

    Parameters
    ----------
    node : Node
        Who looks.
    machine : str
        Name of the machine.
    """
    return any(
        (item.node_namespace, item.node_name) == (f'/{machine}', 'recorder')
        for item in node.get_subscriptions_info_by_topic(f'/{machine}/node_event')
    )

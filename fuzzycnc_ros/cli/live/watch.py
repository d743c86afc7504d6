# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""`fuzzycnc watch`: the operator's screen in a terminal."""

import time
from contextlib import closing
from typing import TYPE_CHECKING, Annotated

import typer
from rich.live import Live

from fuzzycnc_ros.cli.console import JsonFile, check_folder, check_ros, write_json
from fuzzycnc_ros.cli.live.watch_screen import HEIGHT, screen
from fuzzycnc_ros.cli.terminal import Terminal
from fuzzycnc_ros.graph.bring_up import machine_name
from fuzzycnc_ros.ros.presence import GraphError

if TYPE_CHECKING:
    from fuzzycnc_ros.cli.live.operator_client import OperatorClient
    from fuzzycnc_ros.components.dashboard.machine_view import MachineView
    from fuzzycnc_ros.ros.machine_watch import MachineWatch

FOUND_WITHIN = 8.0
"""Wall time [s] until a machine must be found, also on a busy host."""
COMPLETE_WITHIN = 8.0
"""Wall time [s] in which every node reports, once a second, also on a busy host."""
REFRESH = 0.5
"""Wall time [s] between two screens."""
KEYS = 'Ctrl-C ends; fuzzycnc operate acts on the machine'
"""Last line of the screen."""


def watch(
    machine: Annotated[
        str,
        typer.Option(
            help='Name of the machine: the namespace of its nodes; the only one if left out.'
        ),
    ] = '',
    once: Annotated[bool, typer.Option('--once', help='Print one screen and end.')] = False,
    json_file: JsonFile = None,
) -> None:
    """Watch a running machine in the terminal: state, offsets, sensors, probes, alarms.

    The screen shows what the live page shows, from the same sources, and fits into 80x24. Where
    nothing arrives it says so, and why. Nothing is changed at the machine.

        fuzzycnc watch --machine mill_1
        fuzzycnc watch --once
    """
    check_folder(json_file)
    check_ros('watch')
    from fuzzycnc_ros.cli.live.operator_client import OperatorClient
    from fuzzycnc_ros.ros.machine_watch import MachineWatch

    name = machine_name(machine) if machine else ''
    console = Terminal()
    with OperatorClient('') as operator, closing(MachineWatch(operator.node, name)) as watched:
        view = _found(operator, watched, name)
        if once or not console.is_terminal:
            _settle(operator, watched, view)
            document = view.document(time.monotonic())
            height = max(HEIGHT, console.height) if console.is_terminal else 10 * HEIGHT
            console.print(screen(document, console.width, height), soft_wrap=True)
            write_json(json_file, document)
            return
        with Live(console=console, auto_refresh=False, screen=True) as live:
            while True:
                document = view.document(time.monotonic())
                shown = screen(document, console.width, console.height - 1)
                shown.append(f'\n{KEYS}', style='dim')
                live.update(shown, refresh=True)
                _listen(operator, watched, REFRESH)


def _found(operator: 'OperatorClient', watched: 'MachineWatch', name: str) -> 'MachineView':
    """Return the view of the machine that is meant.

    Raises
    ------
    GraphError
        If there is none, or several and none is named.
    """
    until = time.monotonic() + FOUND_WITHIN
    while time.monotonic() < until:
        _listen(operator, watched, 0.1)
        if any(item.view.nodes for item in watched.machines.values()):
            break
    machines = sorted(watched.machines)
    if name:
        return watched.machines[name].view
    if len(machines) == 1:
        return watched.machines[machines[0]].view
    if machines:
        raise GraphError(f'expected one machine but found {", ".join(machines)}: name --machine')
    raise GraphError(
        'expected a machine but none is in the graph; are its nodes running, and is '
        'ROS_DOMAIN_ID theirs?'
    )


def _settle(operator: 'OperatorClient', watched: 'MachineWatch', view: 'MachineView') -> None:
    """Listen until every node has reported and there are data, one that works offsets out too.

    Those that are known may be all that discovery has found yet.
    """
    until = time.monotonic() + COMPLETE_WITHIN
    while time.monotonic() < until and not (view.complete and 'compensator' in view.nodes):
        _listen(operator, watched, 0.05)


def _listen(operator: 'OperatorClient', watched: 'MachineWatch', duration: float) -> None:
    """Take what comes within some wall time [s], and look who is there."""
    operator.pause(duration)
    watched.look()
    watched.read()

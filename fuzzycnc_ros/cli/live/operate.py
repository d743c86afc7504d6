# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""`fuzzycnc operate`: what a person does at a running machine."""

import os
import time
from collections.abc import Callable
from dataclasses import fields
from typing import TYPE_CHECKING, Annotated, Any, Optional

import typer

from fuzzycnc_ros.cli.console import JsonFile, check_ros, say, show, words, write_json
from fuzzycnc_ros.cli.options import node_parameters
from fuzzycnc_ros.cli.quantities import LENGTHS, quantity
from fuzzycnc_ros.ros.bring_up import GraphError, machine_name

if TYPE_CHECKING:
    from fuzzycnc_ros.cli.live.operator_client import Operator
    from fuzzycnc_ros.runtime.records import CompensationApplied

HELP = """Act at a running machine: look, activate, set limits, reference and probe.

    fuzzycnc operate status
    fuzzycnc operate reference --by anna
    fuzzycnc operate set compensator.offset_max=5e-6
    fuzzycnc operate activate
    fuzzycnc operate probe Y=-3um Z=12um
    fuzzycnc operate deactivate

`ros2 lifecycle`, `ros2 param` and `ros2 service` do the same where they are installed.
"""

PATIENCE = 6.0
"""Wall time [s] until a node must answer: those of this host are found within one."""
LISTENING = 2.5
"""Wall time [s] in which every node reports, once a second, also on a busy host."""
MICRO = 1e-6

MachineName = Annotated[
    str, typer.Option('--machine', help='Name of the machine: the namespace of its nodes.')
]
ManagedNode = Annotated[str, typer.Argument(metavar='[NODE]', help='A managed node.')]


def status(machine: MachineName = 'mill', json_file: JsonFile = None) -> None:
    """Show the nodes of a machine, what limits or troubles them, and the offsets in force.

    fuzzycnc operate status --machine mill_1
    """
    check_ros('operate')
    from fuzzycnc_ros.cli.live.supervision_monitor import Monitor
    from fuzzycnc_ros.runtime.records import CompensationApplied
    from fuzzycnc_ros.studies.page.table import Column, Table

    machine = machine_name(machine)
    monitor = Monitor([machine])
    try:
        applied = monitor.listen(machine, CompensationApplied, 'compensation_applied')
        monitor.settle(machine, LISTENING)
        nodes = sorted(
            node for (where, node), view in monitor.views.items() if where == machine and view.told
        )
        if not nodes:
            raise GraphError(_nobody(machine))
        if monitor.operator.has_publisher(f'/{machine}/compensation_applied'):
            monitor.operator.spin_until(
                lambda: bool(applied), PATIENCE, 'topic compensation_applied'
            )
    finally:
        monitor.close()
    rows = []
    for name in nodes:
        view = monitor.view(machine, name)
        rows.append(
            (
                name,
                view.lifecycle or 'running',
                view.activity.get('rate [1/s]', ''),
                view.activity.get('latency [ms]', ''),
                view.level.name.lower(),
                '; '.join(view.trouble),
            )
        )
    columns = ('Node', 'State', 'Rate [1/s]', 'Latency [ms]', 'Health', 'Limits and trouble')
    numbers = {'Rate [1/s]', 'Latency [ms]'}
    show(
        Table(
            f'/{machine}',
            tuple(Column(name, numeric=name in numbers) for name in columns),
            tuple(rows),
        )
    )
    if applied:
        newest = applied[-1]
        offsets = ', '.join(
            f'{axis} {offset / MICRO:+.2f} um'
            for axis, offset in zip(newest.axis, newest.offset, strict=True)
        )
        say(f'offsets in force: {offsets or "none"}')
    keys = ('node', 'state', 'rate', 'latency_ms', 'health', 'trouble')
    write_json(json_file, {'nodes': [dict(zip(keys, row, strict=True)) for row in rows]})


def activate(node: ManagedNode = 'compensator', machine: MachineName = 'mill') -> None:
    """Let a managed node act: the compensator if none is named.

    fuzzycnc operate activate compensator
    """
    with _operator(machine, node) as operator:
        state = operator.lifecycle(node)
        if state == 'active':
            say(f'{machine}/{node} is active already')
            return
        if state == 'unconfigured':
            _transition(operator, machine, node, 'configure')
        _transition(operator, machine, node, 'activate')
        say(f'{machine}/{node} is active')


def deactivate(node: ManagedNode = 'compensator', machine: MachineName = 'mill') -> None:
    """Let a managed node come to rest: offsets ramp to zero, axes stop.

    fuzzycnc operate deactivate compensator
    """
    with _operator(machine, node) as operator:
        if operator.lifecycle(node) != 'active':
            say(f'{machine}/{node} is not active')
            return
        _transition(operator, machine, node, 'deactivate')
        say(f'{machine}/{node} is inactive and goes on until it is at rest')


def set_values(
    values: Annotated[
        list[str],
        typer.Argument(metavar='NODE.NAME=VALUE...', help='See docs/reference/parameters.md.'),
    ],
    machine: MachineName = 'mill',
) -> None:
    """Set live parameters of running nodes, until they are started again.

    Values are checked by the rules of `docs/reference/parameters.md`, in SI units.

        fuzzycnc operate set compensator.offset_max=10e-6 compensator.slew_max=5e-8
    """
    check_ros('operate')
    from fuzzycnc_ros.registry import COMPONENTS
    from fuzzycnc_ros.studies.shift.thermal_shift import checked

    given = node_parameters('set', values)
    checked(given)
    for node, own in given.items():
        config = COMPONENTS[node].CONFIG
        fixed = [f.name for f in fields(config) if f.name in own and not f.metadata['live']]
        if fixed:
            raise ValueError(
                f'{node}.{fixed[0]}: expected a parameter that may change while the node runs; '
                'this one belongs into its parameter file, before it is started'
            )
        whole = config(**own)  # checks types and bounds
        given[node] = {name: getattr(whole, name) for name in own}
    for node, own in given.items():
        with _operator(machine, node, managed=False) as operator:
            refused = operator.set_parameters(node, own)
        if refused:
            raise GraphError(f'{machine}/{node}: {"; ".join(refused)}')
        for name, value in own.items():
            say(f'{machine}/{node}.{name} = {value}')


def reference(
    by: Annotated[str, typer.Option(help='Who says so; kept in recordings.')] = 'operator',
    force: Annotated[
        bool,
        typer.Option(
            '--force', help='Also while offsets are in force, which then change their zero.'
        ),
    ] = False,
    machine: MachineName = 'mill',
) -> None:
    """Declare the machine thermally at rest: what follows is counted from now on.

    Refused while offsets are in force: they would go to what the rises against the new reference
    say. Deactivate the compensator first, or say --force.

        fuzzycnc operate reference --by anna
    """
    with _operator(machine, 'temperature_acquisition', managed=False) as operator:
        say(operator.set_reference(by, force=force))


def probe(
    values: Annotated[
        list[str],
        typer.Argument(metavar='AXIS=LENGTH...', help='Such as Y=-3um Z=0.012mm.'),
    ],
    deviation: Annotated[
        Optional[str],  # noqa: UP045 - typer 0.9 does not read the newer form
        typer.Option(
            show_default=False, help='Standard deviation of the measurement, such as 1um.'
        ),
    ] = None,
    machine: MachineName = 'mill',
) -> None:
    """Tell a displacement that was measured just now, with an indicator or a touch probe.

    It is the actual minus the nominal position of the tool relative to the workpiece since the
    thermal reference, and says whether compensation was in force. Recordings of calibration runs
    can be made so, and the predictor takes it into account if its parameter `probing` says so.

        fuzzycnc operate probe Y=-3um Z=12um --deviation 1um
    """
    found = _displacements(values)
    spread = float('nan')
    if deviation is not None:
        spread = quantity('--deviation', deviation, LENGTHS, example='1um')
    check_ros('operate')
    from fuzzycnc_ros.cli.live.operator_client import Operator
    from fuzzycnc_ros.ros.probing import check_unprobed, probe_record

    with Operator(machine, patience=PATIENCE) as operator:
        operator.pause(LISTENING)
        check_unprobed(machine, operator.has_publisher)
        applied = _applied(operator)
        includes = applied is not None and bool(applied.offset.any())
        record = probe_record(machine, found, spread, compensated=includes)
        try:
            readers = operator.publish(record, 'displacement')
        except GraphError as error:
            raise GraphError(
                f'{error}; a recorder or the predictor of {machine} must be running'
            ) from error
    say(
        f'told {readers} node{"s" if readers > 1 else ""} of /{machine}, '
        f'{"with" if includes else "without"} compensation in force'
    )


def _displacements(values: list[str]) -> dict[str, float]:
    """Return displacements [m] by axis."""
    found: dict[str, float] = {}
    for text in words(values):
        axis, equals, length = text.partition('=')
        if not (equals and axis):
            raise ValueError(f'probe: expected AXIS=LENGTH such as Z=12um but found {text!r}')
        if axis in found:
            raise ValueError(f'probe: expected each axis once but found {axis} twice')
        sign = -1.0 if length.startswith('-') else 1.0
        size = quantity(axis, length.removeprefix('-'), LENGTHS, example='-3um', zero=True)
        found[axis] = sign * size
    return found


def _nobody(machine: str) -> str:
    return (
        f'expected nodes of /{machine} but none reports; are they running, is --machine right, '
        f'and is ROS_DOMAIN_ID theirs (here {os.environ.get("ROS_DOMAIN_ID", "0")})?'
    )


def _operator(machine: str, node: str, *, managed: bool = True) -> 'Operator':
    """Return an operator at a node that must exist, and have a lifecycle if it is managed."""
    check_ros('operate')
    from fuzzycnc_ros.cli.live.operator_client import Operator
    from fuzzycnc_ros.registry import COMPONENTS

    names = [name for name, item in COMPONENTS.items() if item.MANAGED or not managed]
    if node not in names:
        raise ValueError(f'expected a node of {", ".join(names)} but found {node!r}')

    machine = machine_name(machine)

    def alive() -> None:
        if time.monotonic() - began > PATIENCE / 2 and node not in seen():
            raise GraphError(_nobody(machine).replace('nodes', node, 1))

    operator = Operator(machine, alive, patience=PATIENCE)
    began = time.monotonic()

    def seen() -> list[str]:
        return [
            name
            for name, where in operator.node.get_node_names_and_namespaces()
            if where == f'/{machine}'
        ]

    return operator


def _transition(operator: 'Operator', machine: str, node: str, label: str) -> None:
    """Carry a transition out.

    Raises
    ------
    GraphError
        If the node refuses it; its diagnostics say why.
    """
    if operator.transition(node, label):
        return
    raise GraphError(f'{machine}/{node} refuses to {label}: {_why(machine, node)}')


def _why(machine: str, node: str) -> str:
    """Return what troubles a node."""
    from fuzzycnc_ros.cli.live.supervision_monitor import Monitor

    monitor = Monitor([machine])
    try:
        monitor.spin(LISTENING)
        return '; '.join(monitor.view(machine, node).trouble) or 'its log says why'
    finally:
        monitor.close()


def _applied(operator: 'Operator') -> 'CompensationApplied | None':
    """Return the read-back of the machine side, None if it has none."""
    from fuzzycnc_ros.runtime.records import CompensationApplied

    if not operator.has_publisher('compensation_applied'):
        return None
    found: Any = operator.newest(CompensationApplied, 'compensation_applied')
    return found


COMMANDS: dict[str, Callable[..., Any]] = {
    'status': status,
    'activate': activate,
    'deactivate': deactivate,
    'set': set_values,
    'reference': reference,
    'probe': probe,
}

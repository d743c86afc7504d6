# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""`fuzzycnc operate`: what a person does at a running machine."""

import os
import time
from collections.abc import Callable
from dataclasses import fields
from math import isnan
from typing import TYPE_CHECKING, Annotated, Any, Optional

import typer

from fuzzycnc_ros.cli.completion import live_settings, managed_nodes, one_of
from fuzzycnc_ros.cli.console import JsonFile, check_ros, say, show, words, write_json
from fuzzycnc_ros.cli.options import node_parameters
from fuzzycnc_ros.cli.quantities import quantity, signed_quantity
from fuzzycnc_ros.core.names import visible
from fuzzycnc_ros.core.units import LENGTHS, with_point
from fuzzycnc_ros.graph.bring_up import machine_name
from fuzzycnc_ros.ros.presence import GraphError

if TYPE_CHECKING:
    from fuzzycnc_ros.cli.live.operator_client import OperatorClient
    from fuzzycnc_ros.runtime.records import CompensationApplied

HELP = """Operate a running machine: status, activate, set limits, reference, probe and mark.

    fuzzycnc operate status
    fuzzycnc operate reference --by anna
    fuzzycnc operate set compensator.offset_max=5um
    fuzzycnc operate activate
    fuzzycnc operate probe Y=-3um Z=12um
    fuzzycnc operate mark "spindle 6000"
    fuzzycnc operate deactivate

`ros2 lifecycle`, `ros2 param` and `ros2 service` do the same where they are installed.
"""

POSITION_MAX = 100.0
"""Largest position of an axis [m]; beyond it a unit was mixed up."""
PATIENCE = 6.0
"""Wall time [s] until a node must answer: those of this host are found within one."""
LISTENING = 2.5
"""Wall time [s] in which every node reports, once a second, also on a busy host."""
FOUND = 0.5
"""Wall time [s] in which the topics of this host are found."""
PHASE_MAX, NAME_MAX = 80, 80
"""Longest name of a phase, and of a person [characters]."""
MICRO = 1e-6

MachineName = Annotated[
    str, typer.Option('--machine', help='Name of the machine: the namespace of its nodes.')
]
Person = Annotated[str, typer.Option('--by', help='Name of the person; kept in recordings.')]
ManagedNode = Annotated[
    str,
    typer.Argument(metavar='[NODE]', help='A managed node.', autocompletion=one_of(managed_nodes)),
]


def status(machine: MachineName = 'mill', json_file: JsonFile = None) -> None:
    """Show the nodes of a machine, what limits or troubles them, and the offsets in force.

    Rate [1/s] and latency [ms] are those of the last second.

        fuzzycnc operate status
        fuzzycnc operate status --machine mill_1 --json status.json
    """
    check_ros('operate')
    from fuzzycnc_ros.cli.live.supervision_monitor import Monitor
    from fuzzycnc_ros.runtime.records import CompensationApplied
    from fuzzycnc_ros.studies.page.table import Column, case_table

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
    table = case_table(
        f'/{machine}',
        ((name, monitor.view(machine, name)) for name in nodes),
        {
            Column('Node', numeric=False): lambda name, view: name,
            Column('State', numeric=False): lambda name, view: view.lifecycle or 'running',
            Column('Rate [1/s]'): lambda name, view: view.activity.get('rate [1/s]', ''),
            Column('Latency [ms]'): lambda name, view: view.activity.get('latency [ms]', ''),
            Column('Health', numeric=False): lambda name, view: view.level.name.lower(),
            Column('Limits and trouble', numeric=False): lambda _, view: '; '.join(view.trouble),
        },
    )
    show(table)
    if applied:
        say(offset_line(applied[-1]))
    for name in nodes:
        for text in monitor.view(machine, name).learning:
            say(f'{name}: {text}')
    keys = ('node', 'state', 'rate', 'latency_ms', 'health', 'trouble')
    write_json(json_file, {'nodes': [dict(zip(keys, row, strict=True)) for row in table.rows]})


def offset_line(applied: 'CompensationApplied') -> str:
    """Return a read-back in words; what was read last may be over where a machine refuses."""
    from fuzzycnc_ros.core.inputs.offset_input import OffsetStatus

    offsets = ', '.join(
        f'{axis} {offset / MICRO:+.2f} µm'
        for axis, offset in zip(applied.axis, applied.offset, strict=True)
    )
    if applied.status == OffsetStatus.REFUSED:
        return f'offsets read back last: {offsets or "none"}; refused: {visible(applied.reason)}'
    return f'offsets in force: {offsets or "none"}'


def activate(node: ManagedNode = 'compensator', machine: MachineName = 'mill') -> None:
    """Activate a managed node: the compensator if none is named.

    A node that is not configured yet is configured first.

        fuzzycnc operate activate
        fuzzycnc operate activate servo_controller --machine mill_1
    """
    from fuzzycnc_ros.runtime.host import FINALIZED, WAS_FINALIZED

    with _operator(machine, node) as operator:
        state = operator.lifecycle(node)
        if state == 'active':
            say(f'{machine}/{node} is active already')
            return
        if state == FINALIZED:
            raise GraphError(f'{machine}/{node} {WAS_FINALIZED}')
        if state == 'unconfigured':
            _transition(operator, machine, node, 'configure')
        _transition(operator, machine, node, 'activate')
        say(f'{machine}/{node} is active')


def deactivate(node: ManagedNode = 'compensator', machine: MachineName = 'mill') -> None:
    """Deactivate a managed node: offsets ramp to zero, axes stop.

    The node keeps running, and can be activated again.

        fuzzycnc operate deactivate
        fuzzycnc operate deactivate servo_controller --machine mill_1
    """
    with _operator(machine, node) as operator:
        if operator.lifecycle(node) != 'active':
            say(f'{machine}/{node} is not active')
            return
        _transition(operator, machine, node, 'deactivate')
        say(f'{machine}/{node} is inactive; what it moves comes to rest at its own rate')


def set_values(
    values: Annotated[
        list[str],
        typer.Argument(
            metavar='NODE.NAME=VALUE...',
            help='Numbers with their unit, such as 5um, or plain in SI; see '
            'docs/reference/parameters.md.',
            autocompletion=live_settings,
        ),
    ],
    machine: MachineName = 'mill',
) -> None:
    """Set live parameters of running nodes, until they are started again.

    Numbers may have a unit of the kind that `docs/reference/parameters.md` names; a plain number
    is in that unit itself. Values are checked by the rules of that page.

        fuzzycnc operate set compensator.offset_max=10um compensator.slew_max=0.05um/s
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
                'put this one into its parameter file and start the node again'
            )
        whole = config(**own)  # checks types and bounds
        given[node] = {name: getattr(whole, name) for name in own}
    for node, own in given.items():
        with _operator(machine, node, managed=False) as operator:
            refused = operator.set_parameters(node, own)
        if refused:
            raise GraphError(f'{machine}/{node}: {"; ".join(refused)}')
        for name, value in own.items():
            unit = COMPONENTS[node].CONFIG.__dataclass_fields__[name].metadata['unit']
            say(f'{machine}/{node}.{name} = {value}' + (f' {unit}' if unit != '-' else ''))


def reference(
    by: Person = 'operator',
    force: Annotated[
        bool,
        typer.Option('--force', help='Even while offsets are in force, which then change.'),
    ] = False,
    machine: MachineName = 'mill',
) -> None:
    """Declare the machine thermally at rest: what follows is counted from now on.

    Refused while offsets are in force: with the new reference they would change. Deactivate the
    compensator first, or add --force.

        fuzzycnc operate reference --by anna
    """
    with _operator(machine, 'temperature_acquisition', managed=False) as operator:
        say(operator.set_reference(by, force=force))


def probe(
    values: Annotated[
        list[str],
        typer.Argument(
            metavar='AXIS=LENGTH[@POSITION]...',
            help='Such as Y=-3um Z=0.012mm, or X=3um@-400mm X=-52um@0mm.',
        ),
    ],
    deviation: Annotated[
        Optional[str],  # noqa: UP045 - typer 0.9 does not read the newer form
        typer.Option(
            show_default=False, help='Standard deviation of the measurement, such as 1um.'
        ),
    ] = None,
    machine: MachineName = 'mill',
) -> None:
    """Publish a displacement that was measured just now, with an indicator or a touch probe.

    A displacement is the actual minus the nominal position of the tool relative to the workpiece,
    counted from the thermal reference, in machine coordinates: a probing cycle that sets a work
    offset or a tool length takes the error off by itself, and it would be taken off twice. The
    message says whether compensation was in force. A calibration run can be recorded this way,
    and the predictor learns from it if its parameter `learn` is set.

    Where the error of an axis depends on its position, say where that was measured, in machine
    coordinates: two places tell offset and slope, a third one between them how far that is from
    a line.

        fuzzycnc operate probe Y=-3um Z=12um --deviation 1um
        fuzzycnc operate probe X=3um@-400mm X=-52um@0mm
    """
    found = _displacements(values)
    spread = float('nan')
    if deviation is not None:
        spread = quantity('--deviation', deviation, LENGTHS, example='1um')
    check_ros('operate')
    from fuzzycnc_ros.cli.live.operator_client import OperatorClient
    from fuzzycnc_ros.ros.probing import check_unprobed, probe_record

    with OperatorClient(machine, patience=PATIENCE) as operator:
        operator.pause(LISTENING)
        check_unprobed(machine, operator.has_publisher)
        applied = _applied(operator)
        includes = applied is not None and bool(applied.offset.any() or applied.slope.any())
        record = probe_record(machine, found, spread, compensated=includes)
        try:
            readers = operator.publish(record, 'displacement')
        except GraphError as error:
            raise GraphError(
                f'{error}; a recorder or the predictor of {machine} must be running'
            ) from error
    for axis, _, place in found:
        if not isnan(place):
            say(f'{axis}: at {1e3 * place:g} mm in machine coordinates')
    say(
        f'sent to {readers} node{"s" if readers > 1 else ""} of /{machine}, '
        f'{"with" if includes else "without"} compensation in force'
    )


def forget(
    why: Annotated[
        str, typer.Option(help='The reason, kept in the recording, such as "new spindle".')
    ],
    undo: Annotated[
        bool, typer.Option('--undo', help='Restore the state before the last probe.')
    ] = False,
    everything: Annotated[
        bool,
        typer.Option('--all', help='Start learning from scratch.'),
    ] = False,
    by: Person = 'operator',
    machine: MachineName = 'mill',
) -> None:
    """Let the predictor know less than probes have taught it.

    Nothing sees that a machine was crashed or has got another spindle: say so. What was learnt
    then counts for less, and the band is wide until probes have taught it anew. Offsets never
    step.

        fuzzycnc operate forget --why "new spindle bearing"
        fuzzycnc operate forget --why "chip under the probe" --undo
        fuzzycnc operate forget --why "probe had the wrong sign" --all
    """
    from fuzzycnc_ros.runtime.enums import ForgetMode

    if undo and everything:
        raise ValueError('expected --undo or --all, but found both')
    if not why.strip():
        raise ValueError('--why: expected a reason but found none')
    mode = ForgetMode.UNDO if undo else ForgetMode.ALL if everything else ForgetMode.WIDEN
    with _operator(machine, 'thermal_predictor', managed=False) as operator:
        said = operator.forget(mode, why=visible(why), by=visible(by))
    say(f'{machine}: {said}')


def mark(
    phase: Annotated[
        str,
        typer.Argument(metavar='PHASE', help='The phase that begins, such as "spindle 6000".'),
    ],
    by: Person = 'operator',
    machine: MachineName = 'mill',
) -> None:
    """Write into the recording that a phase of a test begins now.

    A phase lasts until the next mark; the mark `end` ends one and begins none. A recorder must be
    running. `fuzzycnc report thermal` finds the phases in the bag.

        fuzzycnc operate mark "spindle 6000" --by anna
        fuzzycnc operate mark cooling --by anna
        fuzzycnc operate mark end
    """
    phase = visible(' '.join(phase.split()))
    for name, text, longest in (('PHASE', phase, PHASE_MAX), ('--by', by, NAME_MAX)):
        if not 0 < len(text) <= longest:
            raise ValueError(
                f'{name}: expected a text of 1 to {longest} characters but found {len(text)}'
            )
    check_ros('operate')
    from fuzzycnc_ros.cli.live.operator_client import OperatorClient
    from fuzzycnc_ros.ros.recording import is_recorded
    from fuzzycnc_ros.runtime.component import HISTORY
    from fuzzycnc_ros.runtime.provenance import machine_event
    from fuzzycnc_ros.studies.thermal_test.recording import MARK

    machine = machine_name(machine)
    with OperatorClient(machine, patience=PATIENCE) as operator:
        operator.pause(FOUND)
        said = {'phase': phase, 'by': visible(by)}
        node = operator.node.get_name()
        event = machine_event(machine, node, _now(operator), MARK, said)
        try:
            operator.publish(
                event, 'node_event', HISTORY, lambda: is_recorded(operator.node, machine)
            )
        except GraphError as error:
            raise GraphError(
                f'{machine}: expected a recorder that writes the mark down but found none '
                f'({error}); start one with `fuzzycnc record --machine {machine} --out NAME` or '
                'on the live page'
            ) from error
    say(f'{machine}: {phase} has begun, as the recorder has noted')


def _now(operator: 'OperatorClient') -> int:
    """Return the machine time [ns]: on a real machine that of the clock."""
    from fuzzycnc_ros.runtime.records import MachineState

    if operator.has_publisher('/clock') or operator.has_publisher('clock'):
        return operator.newest(MachineState, 'machine_state').stamp
    return time.time_ns()


def _displacements(values: list[str]) -> list[tuple[str, float, float]]:
    """Return axis, displacement [m] and position [m] of each value; NaN where none is told."""
    found: list[tuple[str, float, float]] = []
    for text in values:  # a decimal comma would be one between two values
        axis, _, rest = text.partition('=')
        for part in rest.split('@'):
            if remedy := with_point(part):
                raise ValueError(f'{axis}: expected a length but found {part!r}{remedy}')
    for text in words(values):
        axis, equals, rest = text.partition('=')
        if not (equals and axis):
            raise ValueError(f'probe: expected AXIS=LENGTH such as Z=12um but found {text!r}')
        length, at, where = rest.partition('@')
        place = float('nan')
        if at:
            place = signed_quantity(axis, where, LENGTHS, example='-400mm')
        if at and not abs(place) <= POSITION_MAX:
            raise ValueError(
                f'{axis}: expected a position within {POSITION_MAX:g} m in machine coordinates '
                f'but found {where!r}'
            )
        others = [item for item in found if item[0] == axis]
        if any(item[2] == place or not at or isnan(item[2]) for item in others):
            raise ValueError(
                f'probe: expected each axis once, or at places of its own such as '
                f'{axis}=3um@-400mm {axis}=-52um@0mm, but found {axis} twice'
            )
        found.append((axis, signed_quantity(axis, length, LENGTHS, example='-3um'), place))
    return found


def _nobody(machine: str) -> str:
    return (
        f'expected nodes of /{machine} but none reports; start them, or check --machine and '
        f'ROS_DOMAIN_ID (here {os.environ.get("ROS_DOMAIN_ID", "0")})'
    )


def _operator(machine: str, node: str, *, managed: bool = True) -> 'OperatorClient':
    """Return an operator at a node that must exist, and have a lifecycle if it is managed."""
    check_ros('operate')
    from fuzzycnc_ros.cli.live.operator_client import OperatorClient
    from fuzzycnc_ros.registry import COMPONENTS

    names = [name for name, item in COMPONENTS.items() if item.MANAGED or not managed]
    if node not in names:
        raise ValueError(f'expected a node of {", ".join(names)} but found {node!r}')

    machine = machine_name(machine)

    def alive() -> None:
        if time.monotonic() - began > PATIENCE / 2 and node not in seen():
            raise GraphError(_nobody(machine).replace('nodes', node, 1))

    operator = OperatorClient(machine, alive, patience=PATIENCE)
    began = time.monotonic()

    def seen() -> list[str]:
        return [
            name
            for name, where in operator.node.get_node_names_and_namespaces()
            if where == f'/{machine}'
        ]

    return operator


def _transition(operator: 'OperatorClient', machine: str, node: str, label: str) -> None:
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


def _applied(operator: 'OperatorClient') -> 'CompensationApplied | None':
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
    'forget': forget,
    'probe': probe,
    'mark': mark,
}

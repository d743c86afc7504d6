# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Nodes of a machine's graph, their parameters, and the treatment of those that end.

`fuzzycnc up` and the launch file both follow it, so that they start the same.
"""

import re
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Any

from fuzzycnc_ros.components.thermal.axis_trust import CAUTIOUS
from fuzzycnc_ros.core.names import file_word
from fuzzycnc_ros.ros.parameter_files import ParameterSection, parameter_files, sections, unread
from fuzzycnc_ros.ros.presence import BODY, MACHINE, RIVALS, TIME_SOURCES, GraphError

BANNER = (
    'fuzzycnc is not a safety function (ISO 13849): emergency stop, limit switches and drive '
    'limits stay in hardware.'
)
MOVERS = frozenset({'feedrate_scheduler', 'joint_trajectory_bridge'})
"""Nodes that publish `trajectory`; in lock-step a topic has one writer."""
THERMAL = ('temperature_acquisition', 'sensor_selector', 'thermal_predictor', 'compensator')
"""Nodes of thermal compensation."""
LEARNING: Mapping[str, dict[str, Any]] = {
    'thermal_predictor': {'learn': True},
    'compensator': CAUTIOUS,
    MACHINE: {'displacement_interval': 3600.0, 'displacement_compensated': True},
}
"""Parameters where the error is learnt from probes; a simulated machine is probed hourly."""
TOOLS = ('recorder', 'player', 'mqtt_publisher', 'mtconnect_adapter', 'opcua_server')
"""Nodes of a machine without a component."""
PAGE = 'dashboard'
"""Serves the live page of all machines; nobody waits for it, and it may fail alone."""
ACTIVE_TIMEOUT = 20.0
"""Wall time [s] until a managed node must be active."""
PROBING = 'probe_cycle'
"""Takes what the program of a control tells."""
AGAIN = '_again'
"""Suffix of the bag of a recorder that was started again; a number follows."""
NODE_STOP = 10.0
"""Wall time [s] that a node gets to end by itself before it is killed."""
RECORDER_STOP = 30.0
"""The same for a recorder, which writes what waits, and for a page, which waits for recorders."""


@dataclass(frozen=True)
class NodeSpec:
    """One node to start.

    Attributes
    ----------
    name : str
        Node, module and executable.
    parameters : mapping
        Values that differ from the node's defaults.
    """

    name: str
    parameters: Mapping[str, Any] = field(default_factory=dict)


def node_specs(
    *,
    nodes: Sequence[str] = THERMAL,
    duties: tuple[str, ...] = (),
    model: Path | None = None,
    force_model: bool = False,
    learn: bool = False,
    record: Path | None = None,
    lockstep: bool = False,
    autostart: bool = False,
    state_directory: Path | None = None,
    feedrate: bool = False,
    machine_parameters: dict[str, Any] | None = None,
    recorder_parameters: Mapping[str, Any] | None = None,
) -> list[NodeSpec]:
    """Return the nodes of a graph in the order of their turns, the simulated machine last.

    Parameters
    ----------
    nodes : sequence of str
        Any components; `recorder`, and `simulated_machine` without duties of its own.
    duties : tuple of str
        Duties of the simulated machine; empty leaves it out, for a real machine.
    model : Path, optional
        Model file of the predictor.
    force_model : bool
        Whether the predictor uses a model that is worse than none on some channel.
    learn : bool
        Whether the predictor learns from probes, and an axis is followed where it is known.
    record : Path, optional
        Bag to record; none if left out.
    lockstep : bool
        Whether the simulated machine gives turns instead of following the clock.
    autostart : bool
        Whether the managed nodes become active by themselves.
    state_directory : Path, optional
        Where nodes keep what must survive a restart.
    feedrate : bool
        Whether the feedrate scheduler takes part.
    machine_parameters : dict, optional
        Further parameters of the simulated machine.
    recorder_parameters : mapping, optional
        Further parameters of the recorder.

    Raises
    ------
    GraphError
        If a name is no node, or nodes do not go together.
    """
    from fuzzycnc_ros.registry import COMPONENTS

    wanted = {*nodes, *(('feedrate_scheduler',) if feedrate else ())}
    unknown = sorted(wanted - {*COMPONENTS, 'recorder'})
    if unknown or not wanted:
        raise GraphError(
            f'nodes: expected names among {", ".join(COMPONENTS)} but found '
            f'{", ".join(unknown) or "none"}'
        )
    simulated = bool(duties) or MACHINE in wanted
    if simulated and BODY in wanted:
        raise GraphError(f'nodes: expected {MACHINE} or {BODY}, since each makes time, not both')
    if lockstep and wanted >= MOVERS:
        raise GraphError(
            f'nodes: expected {" or ".join(sorted(MOVERS))} in lock-step, where one node '
            'publishes trajectory, but found both; without lock-step the machine takes one at a '
            'time'
        )
    if lockstep and PROBING in wanted:
        raise GraphError(
            f'nodes: expected no {PROBING} in lock-step: it works with a control, which keeps '
            'its own time; leave it or lock-step out'
        )
    common: dict[str, Any] = {'lockstep': lockstep}
    if (simulated or BODY in wanted) and not lockstep:
        common['use_sim_time'] = True
    specs = []
    for name, component in COMPONENTS.items():
        if name not in wanted or name in (MACHINE, BODY):
            continue
        parameters = dict(common)
        if state_directory is not None and any(item.persistent for item in component.OUTPUTS):
            parameters['state_directory'] = str(state_directory)
        if component.MANAGED:
            parameters['autostart'] = autostart
        if name == 'thermal_predictor' and model is not None:
            parameters['model'] = str(model)
        if name == 'thermal_predictor' and force_model:
            parameters['force'] = True
        if learn:
            parameters |= LEARNING.get(name, {})
        specs.append(NodeSpec(name, parameters))
    served = [spec.name for spec in specs]
    if record is not None:
        specs.append(
            NodeSpec('recorder', dict(common, output=str(record), **(recorder_parameters or {})))
        )
    elif 'recorder' in wanted:
        raise GraphError('nodes: recorder needs a bag to write; name it (`fuzzycnc up --record`)')
    if BODY in wanted:
        specs.append(NodeSpec(BODY, {'nodes': [spec.name for spec in specs]}))
    if simulated:
        machine = {
            **(LEARNING[MACHINE] if learn else {}),
            'lockstep': lockstep,
            'lockstep_nodes': served,
            'lockstep_recorder': record is not None,
            **({'duties': list(duties)} if duties else {}),
            **(machine_parameters or {}),
        }
        specs.append(NodeSpec(MACHINE, machine))
    return specs


def with_files(
    spec: NodeSpec, machine: str, read: Sequence[ParameterSection], yielding: Collection[str] = ()
) -> tuple[NodeSpec, list[str]]:
    """Return a node that leaves to files what nobody asked for, and lines on what it overrules.

    Parameters
    ----------
    spec : NodeSpec
        The node; its parameters win over those of files.
    machine : str
        Its namespace.
    read : sequence of ParameterSection
        What the files say; the last one that reaches the node counts.
    yielding : collection of str
        Parameters that nobody asked for.
    """
    from fuzzycnc_ros.registry import COMPONENTS
    from fuzzycnc_ros.ros.node_config import HostConfig, RecorderConfig

    component = COMPONENTS.get(spec.name)
    records = (RecorderConfig,) if component is None else (HostConfig, component.CONFIG)
    default = {item.name: item.default for record in records for item in fields(record)}
    found = {
        name: (value, part)
        for part in read
        if part.reaches(f'/{machine}/{spec.name}')
        for name, value in part.values.items()
    }
    parameters, said = dict(spec.parameters), []
    for name in parameters.keys() & found.keys():
        value, part = found[name]
        if _plain(value) in (_plain(parameters[name]), _plain(default.get(name))):
            continue
        if name in yielding:
            del parameters[name]
        else:
            said.append(
                f'{part.file}: line {part.line}: {name}: not read, as the command decides it: '
                f'{parameters[name]}'
            )
    return replace(spec, parameters=parameters), sorted(said)


def _plain(value: Any) -> Any:
    """Return a value in a form that equal ones of files and records share."""
    return [item for item in value if item != ''] if isinstance(value, (list, tuple)) else value


def known_nodes() -> tuple[str, ...]:
    """Return the names of all nodes that parameter files can be for."""
    from fuzzycnc_ros.registry import COMPONENTS

    return (*COMPONENTS, *TOOLS, PAGE)


def page_spec(
    port: int | None, record: Path | None = None, read: Sequence[ParameterSection] = ()
) -> NodeSpec:
    """Return the node of the live page, which stands outside of all machines.

    Parameters
    ----------
    port : int, optional
        Port to serve it at; its parameter where that is left out.
    record : Path, optional
        Bag of the run; those beside it are offered on the page unless a file names a folder.
    read : sequence of ParameterSection
        What parameter files say.
    """
    named = any('bags' in part.values for part in read if part.reaches(f'/{PAGE}'))
    bags = {} if record is None or named else {'bags': str(record.absolute().parent)}
    return NodeSpec(PAGE, bags if port is None else {'port': port, **bags})


@dataclass(frozen=True)
class RestartPolicy:
    """Policy for the restart of nodes that died or hang.

    Attributes
    ----------
    delay, delay_max : float
        Wall time [s] before the first restart of a row; it doubles with each, up to the latter.
    restarts_max : int
        Restarts within `window` after which a node is given up.
    window : float
        Wall time [s] that restarts count for.
    silence_max : float
        Wall time [s] without a word from a node, while others are heard, after which it is ended
        and started anew: the lease of the shipped discovery profile.
    """

    delay: float = 0.5
    delay_max: float = 30.0
    restarts_max: int = 5
    window: float = 120.0
    silence_max: float = 120.0

    def delay_after(self, begun: Sequence[float], now: float) -> float | None:
        """Return how long to wait before a node is started anew; None if it is given up.

        Parameters
        ----------
        begun : sequence of float
            When it was started anew [s of wall time].
        now : float
            Wall time [s].
        """
        count = sum(now - time < self.window for time in begun)
        if count >= self.restarts_max:
            return None
        return min(self.delay * 2**count, self.delay_max)


def again(spec: NodeSpec, restarts: int, *, resume: bool) -> NodeSpec:
    """Return a node as it is started anew.

    Parameters
    ----------
    spec : NodeSpec
        The node as it was started before.
    restarts : int
        How often it has been started anew, this time included.
    resume : bool
        Whether a managed node becomes active again: one that was taken out of its work does not.
    """
    parameters = dict(spec.parameters)
    if 'autostart' in parameters:
        parameters['autostart'] = resume
    if spec.name == 'recorder':
        first = str(parameters['output'])
        if restarts > 1:
            first = first.rpartition(AGAIN)[0]
        # A torn bag is left to `fuzzycnc info`, which repairs it.
        parameters['output'] = f'{first}{AGAIN}{restarts}'
    return replace(spec, parameters=parameters)


def clock_remapping(machines: Sequence[str]) -> tuple[str, ...]:
    """Return the remappings of all nodes: of several machines each has a time of its own."""
    return ('/clock:=clock',) if len(machines) > 1 else ()


def bag_of(machine: str, machines: Sequence[str], bag: Path | None) -> Path | None:
    """Return the bag of a machine: with several, its name follows that of the bag.

    Raises
    ------
    GraphError
        If another machine's bag has the name that this one gets after a restart of its recorder.
    """
    if bag is None or len(machines) < 2:
        return bag
    first, mark, number = machine.rpartition(AGAIN)
    if mark and number.isdecimal() and first in machines:
        raise GraphError(
            f'machine {machine}: expected a name without {mark}{number} beside {first}, since a '
            f'recorder of {first} that is started again records into the bag of that name; rename '
            'one, or run them apart'
        )
    return bag.with_name(f'{bag.name}_{file_word(machine)}')


def stop_timeout(nodes: Iterable[str]) -> float:
    """Return the wall time [s] that a process with these nodes gets to end by itself."""
    return NODE_STOP if {'recorder', PAGE}.isdisjoint(nodes) else RECORDER_STOP


@dataclass(frozen=True)
class LaunchArgument:
    """An argument of the launch file.

    Attributes
    ----------
    default, text : str
        Its default and its description.
    switch : bool
        Whether it is true or false.
    """

    default: str
    text: str
    switch: bool = False


ADDED = {
    'feedrate': 'feedrate_scheduler',
    'joint_trajectory': 'joint_trajectory_bridge',
    'servo': 'servo_controller',
    'deformation': 'deformation_compensator',
    'linuxcnc': 'linuxcnc_bridge',
    'opcua': 'opcua_bridge',
    'body': 'simulated_body',
    'probe': 'probe_cycle',
}
"""Launch arguments that add a node to those of thermal compensation."""

LAUNCH_ARGUMENTS = {
    'machine': LaunchArgument(
        'mill', 'Name of the machine: the namespace of its nodes; several with commas between'
    ),
    'simulated': LaunchArgument(
        'true', 'Start the simulated machine; false: a bridge of a real one runs', switch=True
    ),
    'duties': LaunchArgument('', 'Duties of the simulated machine; empty: as its parameters say'),
    'rate': LaunchArgument('', 'Speed of the simulated machine; empty: as its parameters say'),
    'model': LaunchArgument('', 'Model file of the predictor'),
    'force_model': LaunchArgument(
        'false', 'Use the model even where it left more than no compensation', switch=True
    ),
    'record': LaunchArgument('', 'New bag to record everything into; empty: none'),
    'page': LaunchArgument('', 'Port of the live page of all machines; empty: none'),
    'nodes': LaunchArgument('', 'Nodes in place of those of thermal compensation'),
    'params_dir': LaunchArgument(
        '', 'Folder with parameter files <node>.yaml; empty: those of the package'
    ),
    'state_directory': LaunchArgument(
        '',
        'Where nodes keep what must survive a restart; empty: in the log folder of this launch',
    ),
    'autostart': LaunchArgument(
        '', 'Configure and activate the managed nodes; empty: where the machine is simulated'
    ),
    'use_sim_time': LaunchArgument(
        '', 'Take the time from /clock; empty: where the machine is simulated'
    ),
    'lockstep': LaunchArgument(
        'false', 'Run the simulated machine as fast as all nodes answer', switch=True
    ),
    'takeover': LaunchArgument(
        'false', 'Start even where nodes of these names are at work', switch=True
    ),
    **{
        name: LaunchArgument('false', f'Start {node} too', switch=True)
        for name, node in ADDED.items()
    },
}
"""Arguments of the launch file by name."""


@dataclass(frozen=True)
class Launched:
    """A node that the launch file starts.

    Attributes
    ----------
    machine : str
        Namespace.
    spec : NodeSpec
        The node and its own parameters.
    files : tuple of Path
        Parameter files that it reads first.
    remap : tuple of str
        Remappings, `from:=to`.
    """

    machine: str
    spec: NodeSpec
    files: tuple[Path, ...]
    remap: tuple[str, ...]


def launched(given: Mapping[str, str], params: Path, log: Path) -> list[Launched]:
    """Return the nodes that launch arguments mean, machine by machine, in the order of `up`.

    Parameters
    ----------
    given : mapping of str to str
        Values of all `LAUNCH_ARGUMENTS`.
    params : Path
        Parameter files of the package.
    log : Path
        Folder of this launch.

    Raises
    ------
    GraphError
        If an argument is of no use; the text names it.
    """
    machines = tuple(
        dict.fromkeys(machine_name(name, 'machine') for name in _words(given['machine']))
    )
    if not machines:
        raise GraphError('machine: expected a name but found none')
    folder = Path(given['params_dir']) if given['params_dir'] else None
    files = parameter_files(folder, 'params_dir: ')
    found = sections(files)
    simulated = given['simulated'] == 'true'
    nodes = [*(_words(given['nodes']) or THERMAL)]
    nodes += [node for name, node in ADDED.items() if given[name] == 'true']
    nodes += [MACHINE] if simulated else []
    for group in RIVALS:
        if len(group & {*nodes}) > 1:
            raise GraphError(
                f'expected one of {", ".join(sorted(group & {*nodes}))} but found all; '
                'simulated:=false leaves the simulated machine out'
            )
    model = Path(given['model']) if given['model'] else None
    if model is not None and not model.is_file():
        raise GraphError(f'model: expected a file but nothing is at {model}')
    try:
        rate = {'rate': float(given['rate'])} if given['rate'] else {}
    except ValueError:
        raise GraphError(f'rate: expected a number but found {given["rate"]!r}') from None
    autostart = _switch(given, 'autostart', simulated)
    items = []
    for machine in machines:
        specs = node_specs(
            nodes=nodes,
            duties=tuple(_words(given['duties'])),
            model=model,
            force_model=given['force_model'] == 'true',
            record=bag_of(machine, machines, Path(given['record']) if given['record'] else None),
            lockstep=given['lockstep'] == 'true',
            autostart=autostart,
            state_directory=Path(given['state_directory'] or log / 'state' / machine),
            machine_parameters=rate or None,
        )
        yielding = () if given['state_directory'] else ('state_directory',)
        for spec in specs:
            spec, _ = with_files(spec, machine, found, yielding)
            if given['use_sim_time'] and spec.name not in TIME_SOURCES:
                clock = {'use_sim_time': _switch(given, 'use_sim_time', simulated)}
                spec = replace(spec, parameters={**spec.parameters, **clock})
            read = files or [params / f'{spec.name}.yaml']
            items.append(Launched(machine, spec, tuple(read), clock_remapping(machines)))
    if given['page']:
        bag = Path(given['record']) if given['record'] else None
        page = page_spec(_port(given['page']), bag, found)
        items.append(Launched('', page, tuple(files or [params / f'{PAGE}.yaml']), ()))
    return items


def unread_by(items: Sequence[Launched], folder: Path) -> list[str]:
    """Say which parameters in a folder no node reads that is launched, as `unread` does."""
    found = sections(parameter_files(folder))
    nodes = [f'/{item.machine}/{item.spec.name}'.replace('//', '/') for item in items]
    overruled = [text for item in items for text in with_files(item.spec, item.machine, found)[1]]
    return [*unread(folder, found, nodes, known_nodes()), *dict.fromkeys(overruled)]


def _port(text: str) -> int:
    if not (text.isascii() and text.isdigit() and 0 < int(text) < 1 << 16):
        raise GraphError(f'page: expected a port from 1 to 65535 but found {text!r}')
    return int(text)


def _words(text: str) -> list[str]:
    return [word.strip() for word in text.split(',') if word.strip()]


def _switch(given: Mapping[str, str], name: str, default: bool) -> bool:
    """Return a switch that may be left empty."""
    value = given[name].lower()
    if value not in ('', 'true', 'false'):
        raise GraphError(f'{name}: expected true or false but found {given[name]!r}')
    return value == 'true' if value else default


LENGTH_MAX = 100
"""Longest name [characters]: ROS takes 247 for a whole topic, and some of ours take 60."""
_NAME = re.compile(r'(?!\d)\w+(/(?!\d)\w+)*', re.ASCII)


def machine_name(text: str, option: str = '--machine') -> str:
    """Return the name of a machine without slashes at its ends.

    Raises
    ------
    ValueError
        If it can be no namespace.
    """
    name = text.strip('/')
    if not _NAME.fullmatch(name) or '__' in name or len(name) > LENGTH_MAX:
        shown = repr(text) if len(text) <= LENGTH_MAX else f'one of {len(text)} characters'
        raise ValueError(
            f'{option}: expected a name such as mill_1, of letters, digits and single _, no part '
            f'beginning with a digit, at most {LENGTH_MAX} characters, but found {shown}'
        )
    return name

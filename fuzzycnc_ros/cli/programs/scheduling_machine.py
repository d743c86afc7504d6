# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""A machine as the scheduling commands know it: a machine file, or a ROS parameter file."""

from __future__ import annotations

import difflib
import re
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TypeVar

from fuzzycnc_ros.cli.console import say
from fuzzycnc_ros.cli.options import OptionalText, given

if TYPE_CHECKING:
    from fuzzycnc_ros.components.motion.feedrate_scheduler_config import FeedrateSchedulerConfig
    from fuzzycnc_ros.core.config import Config
    from fuzzycnc_ros.core.machine.path_loop import ContouringConfig

    SomeConfig = TypeVar('SomeConfig', bound=Config)

Machine = Annotated[
    OptionalText,
    given(
        'Machine file, or mill, which is built in (see `fuzzycnc machine`); or a ROS '
        'parameter file with the section feedrate_scheduler, and simulated_machine for simulated '
        'errors.  Built-in defaults without it.',
        '--machine-file',
        '--machine',
        metavar='FILE.yaml',
    ),
]

_NODES = ('feedrate_scheduler', 'simulated_machine')
_CONSTANT = ('contour_constant.', 'loop.position_gain', 'loop.velocity_bandwidth')
"""Places in a machine file that say what the machine constant is."""


@dataclass(frozen=True)
class SchedulingMachine:
    """What is known of a machine for the scheduling of feeds.

    Parameters
    ----------
    scheduler : FeedrateSchedulerConfig
        Limits of the machine and settings of the schedulers.
    contouring : ContouringConfig
        The simulated machine on which contour errors are measured.
    constant_known : bool
        Whether the machine constant is that of the user's machine.
    """

    scheduler: FeedrateSchedulerConfig
    contouring: ContouringConfig
    constant_known: bool = False

    def say_constant(self) -> None:
        """Say whose machine constant is used, unless it is that of the user's machine."""
        if not self.constant_known:
            say(
                f'machine constant {self.scheduler.machine_constant:.3g} s² of the built-in '
                'simulated mill, not of your machine: name yours with --machine-file '
                '(`fuzzycnc machine identify` measures it)'
            )


@dataclass
class _Section:
    """Parameters of a node, and in which line each of them stands."""

    value: dict[str, Any] = field(default_factory=dict)
    line: dict[str, int] = field(default_factory=dict)


def read_machine(file: str | None) -> SchedulingMachine:
    """Read a machine file or a ROS parameter file; without one, return the defaults.

    Raises
    ------
    ValueError
        If it is neither; the message names file, line and parameter.
    """
    from fuzzycnc_ros.machine_file.reader import is_machine_file

    if file is not None and is_machine_file(file):
        return _of_machine_file(file)
    return _of_parameter_file(None if file is None else Path(file))


def _of_machine_file(file: str) -> SchedulingMachine:
    from fuzzycnc_ros.components.motion.feedrate_scheduler_config import FeedrateSchedulerConfig
    from fuzzycnc_ros.machine_file.feeds import scheduler_parameters, simulated_loop
    from fuzzycnc_ros.machine_file.reader import read_machine_file

    machine = read_machine_file(file)
    try:
        scheduler = FeedrateSchedulerConfig(**scheduler_parameters(machine))
        known = any(place.startswith(_CONSTANT) for place in machine.source)
        return SchedulingMachine(scheduler, simulated_loop(machine), known)
    except ValueError as error:
        raise ValueError(f'{file}: {error}') from error


def _of_parameter_file(path: Path | None) -> SchedulingMachine:
    """Read a ROS parameter file, as the nodes do."""
    from fuzzycnc_ros.components.machine.simulated_machine_config import (
        SimulatedMachineConfig,
        contouring_config,
    )
    from fuzzycnc_ros.components.motion.feedrate_scheduler_config import FeedrateSchedulerConfig
    from fuzzycnc_ros.runtime.host import HostConfig

    found = _sections(path) if path is not None else {}
    scheduler, simulated = (found.get(node, _Section()) for node in _NODES)
    nodes = _names(HostConfig) | {'use_sim_time'}
    machine = _made(SimulatedMachineConfig, simulated, nodes, path)
    try:
        contouring = contouring_config(machine)
    except ValueError as error:
        raise ValueError(f'{path}: {error}') from error
    settings = _made(FeedrateSchedulerConfig, scheduler, nodes, path)
    return SchedulingMachine(settings, contouring, 'machine_constant' in scheduler.value)


def _names(config: type[Config]) -> set[str]:
    return {item.name for item in fields(config)}


def _sections(path: Path) -> dict[str, _Section]:
    """Return the parameters of both nodes."""
    from fuzzycnc_ros.bags.yaml_file import compose

    root = compose(path, 'a ROS parameter file of the machine')
    found: dict[str, _Section] = {}
    for name, _, section in _items(path, root, 'sections such as feedrate_scheduler'):
        node = name.rpartition('/')[2]
        if node not in _NODES:
            continue
        for key, line, parameters in _items(path, section, 'ros__parameters'):
            if key != 'ros__parameters':
                raise ValueError(
                    f'{path}: line {line}: expected ros__parameters in the section {name} but '
                    f'found {key}'
                )
            target = found.setdefault(node, _Section())
            for parameter, place, value in _items(path, parameters, 'parameters'):
                target.value[parameter] = _value(path, value)
                target.line[parameter] = place
    if not found:
        raise ValueError(
            f'{path}: expected a section feedrate_scheduler or simulated_machine, as in '
            'params/feedrate_scheduler.yaml, but found none'
        )
    return found


def _items(path: Path, node: Any, wanted: str) -> list[tuple[str, int, Any]]:
    """Return names, lines and nodes of a mapping."""
    import yaml

    if not isinstance(node, yaml.MappingNode):
        place = '' if node is None else f' line {node.start_mark.line + 1}:'
        raise ValueError(f'{path}:{place} expected {wanted} but found no mapping')
    return [(str(key.value), key.start_mark.line + 1, value) for key, value in node.value]


def _value(path: Path, node: Any) -> Any:
    """Return a value; 20e-6 is a number here as in ROS, though not in YAML 1.1."""
    import yaml

    from fuzzycnc_ros.bags.yaml_file import construct

    if isinstance(node, yaml.SequenceNode):
        return [_value(path, item) for item in node.value]
    value = construct(path, node)
    if isinstance(value, str) and node.style is None:
        try:
            return float(value)
        except ValueError:
            return value
    return value


def _made(
    kind: type[SomeConfig], section: _Section, others: set[str], path: Path | None
) -> SomeConfig:
    """Return the configuration of a section; `others` are parameters for somebody else."""
    known = _names(kind)
    for name, line in section.line.items():
        if name not in known | others:
            near = difflib.get_close_matches(name, known | others, 1)
            meant = f'; did you mean {near[0]}?' if near else '; see params/*.yaml for all of them'
            raise ValueError(f'{path}: line {line}: unknown parameter {name}{meant}')
    try:
        return kind(**{name: value for name, value in section.value.items() if name in known})
    except ValueError as error:
        raise ValueError(f'{path}:{_place(section.line, str(error))} {error}') from error


def _place(lines: Mapping[str, int], message: str) -> str:
    """Return the line of the first parameter that a message names."""
    named = [lines[word] for word in re.findall(r'\w+', message) if word in lines]
    return f' line {named[0]}:' if named else ''

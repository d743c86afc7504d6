# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""A machine as the scheduling commands know it: a machine file, or a ROS parameter file."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, TypeVar

from fuzzycnc_ros.cli.console import say
from fuzzycnc_ros.cli.options import OptionalText, given

if TYPE_CHECKING:
    from fuzzycnc_ros.components.motion.feedrate_scheduler_config import FeedrateSchedulerConfig
    from fuzzycnc_ros.core.config import Config
    from fuzzycnc_ros.core.machine.path_loop import ContouringConfig
    from fuzzycnc_ros.files.yaml_file import Entry, YamlReading
    from fuzzycnc_ros.simulation.controller.blends import ControllerLimits

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
    """Machine for the scheduling of feeds.

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


def controller_limits(machine: SchedulingMachine) -> ControllerLimits:
    """Return the limits of the axes as LinuxCNC has them."""
    from fuzzycnc_ros.simulation.controller.blends import ControllerLimits

    config = machine.scheduler
    return ControllerLimits(
        velocity=_three('axis_velocity', config.axis_velocity, config.path_velocity),
        acceleration=_three(
            'axis_acceleration', config.axis_acceleration, config.path_acceleration
        ),
        path_velocity=config.path_velocity,
        period=machine.contouring.interpolation_period,
    )


def _three(name: str, values: tuple[float, ...], absent: float) -> tuple[float, float, float]:
    """Return a limit of X, Y and Z: an axis without one has that of the path."""
    found = [value or absent for value in values] or [absent]
    x, y, z = (found * 3)[:3] if len(found) == 1 else (*found, *([absent] * 3))[:3]
    if not min(x, y, z) > 0.0:
        raise ValueError(f'{name}: expected limits above 0 but found {values}')
    return x, y, z


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
    from fuzzycnc_ros.files.yaml_file import YamlReading

    reading = YamlReading(
        path or Path(), f'a ROS parameter file with sections such as {_NODES[0]}', noun='parameter'
    )
    found = _sections(reading) if path is not None else {}
    scheduler, simulated = (found.get(node, {}) for node in _NODES)
    machine = _made(reading, SimulatedMachineConfig, simulated)
    try:
        contouring = contouring_config(machine)
    except ValueError as error:
        raise ValueError(f'{path}: {error}') from error
    settings = _made(reading, FeedrateSchedulerConfig, scheduler)
    return SchedulingMachine(settings, contouring, 'machine_constant' in scheduler)


def _sections(reading: YamlReading) -> dict[str, dict[str, Entry]]:
    """Return the parameters of both nodes."""
    found: dict[str, dict[str, Entry]] = {}
    for name, section in reading.pairs(reading.root(), '', f'sections such as {_NODES[0]}'):
        node = name.rpartition('/')[2]
        if node not in _NODES:
            continue
        for key, parameters in reading.pairs(section, name):
            if key != 'ros__parameters':
                raise reading.wrong(
                    parameters.line, name, f'expected ros__parameters but found {key}'
                )
            # As in ROS, of what stands there twice the last counts.
            found.setdefault(node, {}).update(reading.pairs(parameters, f'{name}.{key}'))
    if not found:
        raise ValueError(
            f'{reading.path}: expected a section feedrate_scheduler or simulated_machine, as in '
            'params/feedrate_scheduler.yaml, but found none'
        )
    return found


def _made(
    reading: YamlReading, kind: type[SomeConfig], section: Mapping[str, Entry]
) -> SomeConfig:
    """Return the configuration of a section; parameters of every node are for somebody else."""
    from fuzzycnc_ros.ros.node_config import HostConfig

    own, others = ({item.name for item in fields(one)} for one in (kind, HostConfig))
    reading.known(
        section, own | others | {'use_sim_time'}, '', 'see params/*.yaml for all of them'
    )
    mine = {name: entry for name, entry in section.items() if name in own}
    return reading.config(kind, mine, '', units=False)

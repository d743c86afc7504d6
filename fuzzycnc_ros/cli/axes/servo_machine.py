# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Axes of machine files for the commands on controllers: found, tuned, compared."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from fuzzycnc_ros.cli.console import progress_bar, remark, say, show, write_json, write_text

if TYPE_CHECKING:
    from collections.abc import Sequence

    from fuzzycnc_ros.cli.workers import Progress
    from fuzzycnc_ros.core.machine.machine_data import AxisData, MachineData
    from fuzzycnc_ros.core.servo.controller import AxisController
    from fuzzycnc_ros.simulation.servo.axis_trials import Drive
    from fuzzycnc_ros.simulation.servo.axis_tuning import TunedController
    from fuzzycnc_ros.studies.servo.c_text import ExportOrigin


@dataclass(frozen=True)
class Effort:
    """Effort of a search: seed, generations, candidates per setting."""

    search: tuple[str, ...]
    seed: int
    generations: int
    population: int


def machine_axis(file: str, axis: str) -> tuple[MachineData, str, AxisData]:
    """Return a machine, and the name and data of one of its axes that has a model.

    Parameters
    ----------
    file : str
        Machine file.
    axis : str
        Its name; empty for the only one.

    Raises
    ------
    ValueError
        If the file cannot be read, or which axis is meant is not clear.
    """
    from fuzzycnc_ros.machine_file.reader import read_machine_file

    machine = read_machine_file(file)
    known = [name for name, data in machine.axes.items() if data.plant is not None]
    if not known:
        raise ValueError(
            f'{file}: expected an axis with a model (plant) but found limits alone; '
            '`fuzzycnc machine identify` finds one from a recording'
        )
    if axis and axis not in known:
        raise ValueError(
            f'--axis: expected one of {", ".join(known)}, which have a model in {file}, but '
            f'found {axis!r}'
        )
    if not axis and len(known) > 1:
        raise ValueError(f'--axis: expected one of {", ".join(known)} but found none')
    name = axis or known[0]
    data = machine.axes[name]
    if data.knowledge.not_fit_for_control:
        raise ValueError(
            f'{file}: axes.{name}: expected a model that is fit for control but found one that is '
            f'marked `not_fit_for_control`: {data.knowledge.not_fit_for_control}'
        )
    return machine, name, data


def own_controller(data: AxisData, params: Path | None) -> str:
    """Return the controller that an axis has without an option, with learnt rules or without."""
    from fuzzycnc_ros.core.servo.axis_control import UNTUNED_CONTROLLER, WITH_RULES

    return data.controller or (UNTUNED_CONTROLLER if params is None else WITH_RULES)


def machine_controller(
    data: AxisData, axis: str, name: str, params: Path | None
) -> AxisController:
    """Return a controller for an axis of a machine file.

    Parameters
    ----------
    data, axis
        The axis and its name.
    name : str
        The controller; empty for the one that the file names.  Another one is untuned.
    params : Path, optional
        Rules that `servo learn` wrote.

    Raises
    ------
    ValueError
        If the controller is unknown, or the file has no rules for it and this axis.
    """
    from fuzzycnc_ros.core.servo.axis_control import make_axis_controller
    from fuzzycnc_ros.studies.servo.servo_settings import read_settings

    if params is None:
        return make_axis_controller(data, name)
    settings = read_settings(params)
    if settings.numbers or settings.rules is None:
        raise ValueError(
            f'{params}: expected rules alone, as the settings are in the machine file, but found '
            'settings; `servo learn --machine-file` writes rules'
        )
    if settings.axis not in ('', axis):
        raise ValueError(
            f'{params}: expected rules for the axis {axis} but found those for {settings.axis}'
        )
    return make_axis_controller(data, name, rules=settings.rules)


def exported_controller(
    file: str,
    axis: str,
    data: AxisData,
    name: str,
    params: Path | None,
    to: str,
    component: str,
) -> str:
    """Return a controller in C.

    Parameters
    ----------
    file, axis, data
        The machine file, and name and data of the axis.
    name : str
        The controller.
    params : Path, optional
        Rules that `servo learn` wrote.
    to : {'c', 'hal'}
        A file of its own, or a component of LinuxCNC's HAL.
    component : str
        Name of the component, or beginning of the names of the file.

    Raises
    ------
    ValueError
        If the controller cannot be exported, or the name is none of C.
    """
    from fuzzycnc_ros.studies.servo.c_export import c_controller, hal_controller

    made = machine_controller(data, axis, name, params)
    origin = _origin(file, axis, data, component, f'{name} of the axis {axis}')
    return c_controller(made, origin) if to == 'c' else hal_controller(made, origin)


def exported_plant(file: str, axis: str, data: AxisData, component: str) -> str:
    """Return an axis as a component of LinuxCNC's HAL, of that name."""
    from fuzzycnc_ros.studies.servo.plant_export import hal_plant

    origin = _origin(file, axis, data, component, f'Simulated axis {axis}')
    return hal_plant(data.known_plant(), origin)


def _origin(file: str, axis: str, data: AxisData, name: str, title: str) -> ExportOrigin:
    from fuzzycnc_ros.core.machine.machine_data import axis_hash
    from fuzzycnc_ros.studies.servo.c_text import ExportOrigin

    return ExportOrigin(name, title, Path(file).name, axis_hash(axis, data))


def analysed_controller(
    file: str, axis: str, name: str, params: Path | None
) -> tuple[str, str, AxisController]:
    """Return the name of an axis, and name and controller of its loop for `servo stability`.

    Raises
    ------
    ValueError
        If it is not clear which, or the controller is of a kind without such an analysis.
    """
    from fuzzycnc_ros.core.servo.variable_universe import VariableUniverseController

    _, axis, data = machine_axis(file, axis)
    chosen = name or own_controller(data, params)
    controller = machine_controller(data, axis, chosen, params)
    if not isinstance(controller, VariableUniverseController):
        raise ValueError(
            f'--controller: expected variable_universe or linear_tangent for {axis} but found '
            f'{chosen}, for which there is no such analysis; `fuzzycnc servo compare '
            f'--machine-file {file} --axis {axis}` drives it with gains from half to twice'
        )
    assert data.plant is not None
    if data.plant.delay:
        say(f'note: the dead time of {1e3 * data.plant.delay:g} ms is left out; it costs margin')
    return axis, chosen, controller


def learning_controller(file: str, axis: str) -> tuple[str, AxisData, AxisController]:
    """Return name and data of an axis whose rules are learnt, and its controller.

    Raises
    ------
    ValueError
        If it is not clear which axis, or its controller has no rules.
    """
    from fuzzycnc_ros.core.servo.axis_control import WITH_RULES

    _, axis, data = machine_axis(file, axis)
    if data.controller not in ('', WITH_RULES):
        raise ValueError(
            f'{file}: expected the controller {WITH_RULES} for {axis} but found '
            f'{data.controller}, which has no rules to learn; `fuzzycnc servo tune '
            f'--machine-file {file} --axis {axis}` tunes it'
        )
    return axis, data, machine_controller(data, axis, WITH_RULES, None)


def tune_machine_axis(
    file: str, axis: str, out: Path, effort: Effort, jobs: int, json_file: Path | None
) -> None:
    """Tune all controllers of an axis, and write the machine file with the one that suits it."""
    from fuzzycnc_ros.cli.workers import in_workers
    from fuzzycnc_ros.core.servo.axis_control import AXIS_CONTROLLERS, SETTINGS, WITH_PARAMS
    from fuzzycnc_ros.simulation.servo.axis_tuning import (
        AxisTuning,
        axis_cases,
        loop_limit,
        untuned_controllers,
    )
    from fuzzycnc_ros.studies.servo.axis_tuning_tables import (
        axis_tuning_document,
        axis_tuning_remarks,
        axis_tuning_table,
    )

    machine, name, data = machine_axis(file, axis)
    # Only they have the numbers of universes.
    able = AXIS_CONTROLLERS if set(effort.search) <= set(SETTINGS) else WITH_PARAMS
    kinds = [kind for kind in AXIS_CONTROLLERS if kind in able]
    pieces = [(data, kind, effort) for kind in kinds]
    with progress_bar('searching') as tell:
        controllers = in_workers(_tuned, pieces, kinds, jobs, tell)
    # What has won on a model alone may be worse on the axis than no tuning at all.
    plain = untuned_controllers(data, kinds, seed=effort.seed)
    cases = axis_cases(data, held_out=True, seed=effort.seed)
    found = AxisTuning((*controllers, *plain), cases)
    show(axis_tuning_table(found, f'Axis {name} of {machine.name}'))
    for line in axis_tuning_remarks(found):
        remark(line)
    winner = found.winner
    tuned = found.tuned(data)
    if winner.margin is not None:
        say(f'what limits it: {loop_limit(data, winner)}')
    about = f'controller of {name}: untuned, as tuning made it no better'
    if winner.trials:
        about = (
            f'controller of {name}: tuned, seed {effort.seed}, {winner.trials} trials for each of '
            f'{len(controllers)} kinds'
        )
    _write_tuned(out, machine, name, tuned, about)
    write_json(json_file, axis_tuning_document(found))


def tune_on_machine(
    file: str, axis: str, out: Path, trials: int, machine_name: str, json_file: Path | None
) -> None:
    """Tune the controller of an axis by trials on it, and write the machine file with it.

    Raises
    ------
    ValueError
        If no controller makes its way.
    GraphError
        If the node refuses the trials, or is lost.
    """
    from fuzzycnc_ros.cli.live.held_trials import HeldKey, HeldTrials
    from fuzzycnc_ros.cli.live.operator_client import OperatorClient
    from fuzzycnc_ros.core.machine.machine_data import axis_hash
    from fuzzycnc_ros.core.servo.axis_control import AXIS_CONTROLLERS

    machine, name, data = machine_axis(file, axis)
    with OperatorClient(machine_name) as operator, HeldKey() as key:
        drive = HeldTrials(operator, key, name, axis_hash(name, data))
        _tune_by_trials(machine, name, drive, AXIS_CONTROLLERS, out, trials, json_file)


def tune_in_linuxcnc(
    file: str, axis: str, out: Path, trials: int, bag: Path, json_file: Path | None
) -> None:
    """Tune the settings of an axis of a running LinuxCNC, and write the machine file with them.

    Raises
    ------
    ValueError
        If no settings make their way, or LinuxCNC refuses the trials or is lost.
    """
    from fuzzycnc_ros.cli.live.held_trials import HeldKey
    from fuzzycnc_ros.cli.live.linuxcnc_axis import component_of
    from fuzzycnc_ros.cli.live.linuxcnc_trials import LinuxcncTrials

    machine, name, data = machine_axis(file, axis)
    prefix = component_of(name).replace('_', '-')
    with HeldKey() as key, LinuxcncTrials(key, machine, name, bag, prefix) as drive:
        kinds = (own_controller(data, None),)
        _tune_by_trials(machine, name, drive, kinds, out, trials, json_file)


def _tune_by_trials(
    machine: MachineData,
    name: str,
    drive: Drive,
    kinds: Sequence[str],
    out: Path,
    trials: int,
    json_file: Path | None,
) -> None:
    from fuzzycnc_ros.simulation.servo.axis_trials import TrialSearch
    from fuzzycnc_ros.studies.servo.axis_tuning_tables import (
        axis_trials_table,
        axis_tuning_document,
    )

    data = machine.axes[name]
    say(f'{name} is about to move. Hold the space bar; let it go to stop.')
    with progress_bar('trying on the axis') as tell:
        search = TrialSearch(
            data,
            drive,
            trials=trials,
            kinds=kinds,
            progress=lambda done, total: tell(name, done, total),
        )
        found = search.run()
    show(axis_trials_table(found, f'Axis {name} of {machine.name}'))
    for reason in dict.fromkeys(search.reasons):
        say(f'{search.reasons.count(reason)} given up: {reason}')
    about = f'controller of {name}: as it was, as trials on the axis made it no better'
    if found.winner.trials:
        about = f'controller of {name}: tuned by {found.winner.trials} trials on the axis'
    _write_tuned(out, machine, name, found.tuned(data), about)
    write_json(json_file, axis_tuning_document(found))


def _write_tuned(out: Path, machine: MachineData, name: str, data: AxisData, about: str) -> None:
    """Write a machine file with the tuned controller of an axis."""
    from fuzzycnc_ros.machine_file.writer import machine_text

    axes = {**machine.axes, name: data}
    ini = machine.source.get('linuxcnc.ini', '')
    write_text(out, machine_text(replace(machine, axes=axes), ini=ini, about=about))
    say(f'{out}: the machine file with it, for `fuzzycnc position --machine-file {out}`')


def compare_machine_axis(file: str, axis: str, seed: int, json_file: Path | None) -> None:
    """Put all controllers on the same cases of an axis, with its settings or untuned."""
    from fuzzycnc_ros.core.servo.axis_control import AXIS_CONTROLLERS
    from fuzzycnc_ros.simulation.servo.axis_tuning import AxisTuning, axis_cases, judged_controller
    from fuzzycnc_ros.studies.servo.axis_tuning_tables import (
        axis_tuning_document,
        axis_tuning_remarks,
        axis_tuning_table,
    )

    machine, name, data = machine_axis(file, axis)
    controllers = []
    with progress_bar('driving') as tell:
        for number, kind in enumerate(AXIS_CONTROLLERS):
            tell(kind, number, len(AXIS_CONTROLLERS))
            own = data.settings if kind == data.controller else {}
            controllers.append(judged_controller(data, kind, own, seed=seed))
    found = AxisTuning(tuple(controllers), axis_cases(data, held_out=True, seed=seed))
    show(axis_tuning_table(found, f'Axis {name} of {machine.name}'))
    tuned = data.controller or 'none'
    say(f'settings from the file: {tuned}; the others untuned')
    for line in axis_tuning_remarks(found):
        remark(line)
    write_json(json_file, axis_tuning_document(found))


def _tuned(piece: Any, progress: Progress) -> TunedController:
    from fuzzycnc_ros.simulation.servo.axis_tuning import tune_controller

    data, kind, effort = piece
    return tune_controller(
        data,
        kind,
        search=effort.search,
        seed=effort.seed,
        generations=effort.generations,
        population=effort.population,
        progress=lambda done, total: progress('searching', kind, done, total),
    )

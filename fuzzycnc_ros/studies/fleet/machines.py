# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Models trained and compared machine by machine, each on bags of its own."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from fuzzycnc_ros.bags.finding import NamedBag
from fuzzycnc_ros.core.thermal.candidate import UNCOMPENSATED
from fuzzycnc_ros.core.thermal.fit import train_model
from fuzzycnc_ros.core.thermal.fit.comparison import Comparison, HeldOut, judge, splits
from fuzzycnc_ros.core.thermal.fit.training import training_interval
from fuzzycnc_ros.core.thermal.run import ThermalDataError, ThermalRun
from fuzzycnc_ros.core.threads import single_threaded
from fuzzycnc_ros.papers.thermal import ALL_CONTENDERS
from fuzzycnc_ros.studies.fleet.evaluation import Problem, Tell
from fuzzycnc_ros.studies.fleet.in_flight import Crew, InFlight, Killed
from fuzzycnc_ros.studies.fleet.judging import (
    Document,
    bag_facts,
    machine_name,
    one_at_a_time,
    one_line,
)
from fuzzycnc_ros.studies.thermal.comparison import comparison_document
from fuzzycnc_ros.studies.thermal.missing_readings import read_usable


@dataclass(frozen=True)
class MachineRun:
    """The run of a machine in a bag, whose path is absolute."""

    path: str
    name: str
    namespace: str
    begin: int


@dataclass(frozen=True)
class MachineBags:
    """A machine and the runs that are used of it, oldest first."""

    machine: str
    runs: tuple[MachineRun, ...]


@dataclass(frozen=True)
class MachineResult:
    """Results of a machine.

    Parameters
    ----------
    machine : str
        Its name.
    runs : tuple of str
        Names of the runs that were used.
    result : dict or None
        What came of it, as `train_machine` or `compare_machine` says; None if nothing.
    problems : tuple of Problem
        What could not be used, and why.
    """

    machine: str
    runs: tuple[str, ...] = ()
    result: Document | None = None
    problems: tuple[Problem, ...] = ()


def group(
    bags: Sequence[NamedBag],
    machine_by: str,
    runs_max: int,
    crew: Crew | None,
    tell: Tell,
) -> tuple[list[MachineBags], list[Problem]]:
    """Return the machines that bags are of, by name, with their runs.

    Parameters
    ----------
    bags : sequence of NamedBag
        The bags.
    machine_by : {'bag', 'folder'}
        What names the machine of a bag.
    runs_max : int
        Most runs of a machine; of more, as many are taken, evenly spread from the oldest to the
        newest.
    crew : Crew, optional
        Who opens the bags.
    tell : callable
        Told how far it is.
    """
    runs: dict[str, list[MachineRun]] = {}
    problems: dict[int, Problem] = {}
    pieces = [(at, str(bag.path.absolute())) for at, bag in enumerate(bags)]
    for done, ((at, path), facts) in enumerate(InFlight(_facts, crew).done(pieces), start=1):
        name = bags[at].name
        tell(f'looking into {len(bags)} bags', done, len(bags))
        if isinstance(facts, Killed):
            problems[at] = Problem(name, f'{path}: its process was killed while it was opened')
        elif 'problem' in facts:
            problems[at] = Problem(name, facts['problem'].replace(path, str(bags[at].path)))
        else:
            for space in facts['machines']:
                run = MachineRun(path, name, space, facts['begin'])
                runs.setdefault(machine_name(space, path, machine_by), []).append(run)
    machines = [
        MachineBags(machine, _spread(sorted(own, key=_by_time), runs_max))
        for machine, own in sorted(runs.items())
    ]
    return machines, [problems[at] for at in sorted(problems)]


def each_machine(
    work: Callable[[MachineBags], MachineResult],
    machines: Sequence[MachineBags],
    crew: Crew | None,
    tell: Tell,
    keep: Callable[[MachineResult], None] = lambda found: None,
) -> list[MachineResult]:
    """Return what comes of machines, in their order.

    Parameters
    ----------
    work : callable
        `train_machine` or `compare_machine` with its options.
    machines : sequence of MachineBags
        The machines.
    crew : Crew, optional
        Who does the work.
    tell : callable
        Told how far it is.
    keep : callable
        Takes what came of a machine, as soon as it is there.
    """
    found: dict[str, MachineResult] = {}
    tell(f'{len(machines)} machines', 0, len(machines))
    for piece, result in InFlight(work, crew).done(machines):
        if isinstance(result, Killed):
            reason = (
                f'{piece.machine}: its process was killed each time; if memory ran out, take '
                'fewer workers or fewer runs'
            )
            result = MachineResult(piece.machine, problems=(Problem(piece.machine, reason),))
        keep(result)
        found[piece.machine] = result
        tell(f'{len(machines)} machines', len(found), len(machines))
    return [found[piece.machine] for piece in machines]


@single_threaded
def train_machine(
    piece: MachineBags, *, options: Mapping[str, Any], sensor_limits: Sequence[str] = ()
) -> MachineResult:
    """Train the model of a machine; options as in `train_model`, limits as in `read_run`.

    Returns
    -------
    MachineResult
        `result`: `model`, the text of its file; `channel`, `default`, `held_out_rms_um` and
        `uncompensated_rms_um` by channel.
    """
    with one_at_a_time:
        runs, problems = _runs(piece, options['interval'], sensor_limits)
        try:
            model = train_model(runs, **options) if runs else None
        except ValueError as error:
            return _failed(piece, runs, problems, error)
    if model is None:
        return MachineResult(piece.machine, problems=tuple(problems))
    bare = model.candidates[UNCOMPENSATED].held_out_rms
    result = {
        'model': model.to_json(),
        'channel': list(model.channel),
        'default': list(model.default),
        'held_out_rms_um': [1e6 * float(value) for value in model.held_out_rms],
        'uncompensated_rms_um': [1e6 * float(value) for value in bare],
    }
    return MachineResult(piece.machine, _names(runs), result, tuple(problems))


@single_threaded
def compare_machine(
    piece: MachineBags, *, options: Mapping[str, Any], sensor_limits: Sequence[str] = ()
) -> MachineResult:
    """Hold each run of a machine out in turn; options as in `judge`, limits as in `read_run`.

    Returns
    -------
    MachineResult
        `result`: what `comparison_document` returns.
    """
    with one_at_a_time:
        runs, problems = _runs(piece, options['interval'], sensor_limits)
        held_out: list[HeldOut] = []
        try:
            interval = training_interval(runs, options['interval']) if runs else None
            parts = splits(runs, (), interval) if runs else ()
            options = {**options, 'interval': interval}
        except ValueError as error:
            return _failed(piece, runs, problems, error)
        for part in parts:
            try:
                held_out.append(judge(part, contenders=ALL_CONTENDERS, **options))
            except ThermalDataError as error:
                problems.append(Problem(part.name, f'{part.name} held out: {one_line(error)}'))
    result = comparison_document(Comparison(tuple(held_out))) if held_out else None
    return MachineResult(piece.machine, _names(runs), result, tuple(problems))


def _facts(piece: tuple[int, str]) -> Document:
    try:
        return bag_facts(Path(piece[1]))
    except (OSError, ValueError) as error:
        return {'problem': one_line(error)}


def _runs(
    piece: MachineBags, interval: float | None, sensor_limits: Sequence[str]
) -> tuple[list[ThermalRun], list[Problem]]:
    """Read the runs of a machine; what cannot be used is named."""
    runs, problems = [], []
    for item in piece.runs:
        read = partial(
            read_usable,
            item.path,
            interval,
            namespace=item.namespace,
            name=item.name,
            sensor_limits=sensor_limits,
        )
        try:
            runs.append(read())
        except (OSError, ValueError) as error:
            problems.append(Problem(item.name, one_line(error)))
    return runs, problems


def _failed(
    piece: MachineBags, runs: Sequence[ThermalRun], problems: list[Problem], error: ValueError
) -> MachineResult:
    found = Problem(piece.machine, f'{piece.machine}: {one_line(error)}')
    return MachineResult(piece.machine, _names(runs), None, (*problems, found))


def _names(runs: Sequence[ThermalRun]) -> tuple[str, ...]:
    return tuple(run.name for run in runs)


def _by_time(run: MachineRun) -> tuple[int, str]:
    return run.begin, run.path


def _spread(runs: Sequence[MachineRun], most: int) -> tuple[MachineRun, ...]:
    """Return no more than `most` runs, the first and the last among them."""
    if len(runs) <= most:
        return tuple(runs)
    rows = np.unique(np.rint(np.linspace(0, len(runs) - 1, most)).astype(int))
    return tuple(runs[row] for row in rows)

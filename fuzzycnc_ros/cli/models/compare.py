# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""`fuzzycnc compare`: all models side by side on what none of them has seen."""

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Optional

import typer

from fuzzycnc_ros.bags.finding import NamedBag, find_bags
from fuzzycnc_ros.cli.completion import one_of, some_of
from fuzzycnc_ros.cli.console import (
    JsonFile,
    check_at_least,
    check_folder,
    progress_bar,
    remark,
    say,
    show,
    write_json,
    write_report,
)
from fuzzycnc_ros.cli.models.many_bags import (
    BadBag,
    Jobs,
    check_some_left,
    jobs_of,
    say_bad,
    with_each,
    without_odd,
)
from fuzzycnc_ros.cli.models.recorded_runs import (
    bridged_gaps,
    doubt_lines,
    gap_lines,
    sensors_but,
)
from fuzzycnc_ros.cli.options import (
    ALL,
    Clusters,
    DropSensor,
    End,
    Interval,
    OptionalText,
    Report,
    SensorLimits,
    Sensors,
    Speed,
    Start,
    given,
    names_of,
)
from fuzzycnc_ros.cli.quantities import number_in
from fuzzycnc_ros.core.thermal.candidate import COMPARED_ONLY, DRIVES_SUFFIX, SPEED_SUFFIX
from fuzzycnc_ros.core.units import TIMES
from fuzzycnc_ros.papers.names import COMPARED

if TYPE_CHECKING:
    from collections.abc import Sequence

    from fuzzycnc_ros.cli.workers import Progress
    from fuzzycnc_ros.core.thermal.fit.comparison import Comparison, HeldOut, Split
    from fuzzycnc_ros.core.thermal.run import ThermalRun
    from fuzzycnc_ros.studies.grinder.grinder_comparison import GrinderComparison, Trial

MACHINES = ('grinder',)
"""Simulated machines that a comparison may be made on."""

NOT_WITH_MACHINE = (
    'bags',
    'interval',
    'sensors',
    'clusters',
    'drop_sensor',
    'sensor_limits',
    'speed',
    'start',
    'end',
    'hold_out',
)
"""Parameters that say how recorded runs are treated."""


def compare(
    context: typer.Context,
    bags: Annotated[
        Optional[list[Path]],  # noqa: UP045 - typer 0.9 does not read the newer form
        typer.Argument(
            metavar='[BAG...]',
            show_default=False,
            help='Bags of runs, each from a cold start; folders of bags; patterns in quotes.',
        ),
    ] = None,
    machine: Annotated[
        OptionalText,
        given(
            f'Simulated machine instead of bags: {", ".join(MACHINES)}.',
            metavar='NAME',
            complete=one_of(MACHINES),
        ),
    ] = None,
    models: Annotated[
        list[str],
        typer.Option(
            metavar='NAME,...',
            help=f'Models to compare, or {ALL}: {", ".join(COMPARED)}. '
            'A simulated machine has a list of its own.',
            autocompletion=some_of((ALL, *COMPARED)),
        ),
    ] = [ALL],  # noqa: B006 - typer copies it
    interval: Interval = None,
    sensors: Sensors = 'auto',
    clusters: Clusters = 5,
    drop_sensor: DropSensor = None,
    sensor_limits: SensorLimits = None,
    speed: Speed = True,
    start: Start = None,
    end: End = None,
    hold_out: Annotated[
        Optional[list[str]],  # noqa: UP045
        typer.Option(
            metavar='START:END',
            show_default=False,
            help='Stretch of a single bag to hold out, in s unless with units, such as 16h:24h; '
            'repeat for more.',
        ),
    ] = None,
    jobs: Jobs = None,
    seed: Annotated[
        int, typer.Option(help="Seed of the clustering, and of a simulated machine's noise.")
    ] = 0,
    report: Report = None,
    json_file: JsonFile = None,
) -> None:
    """Compare all models on runs that none of them has seen.

    Each run is held out in turn: sensors, settings and models come from the other runs alone. A
    single bag is cut into its thermal cycles where its spindle speed shows them; without, its
    later part is predicted from what came before. The row `default` is what `fuzzycnc train`
    would have chosen by itself, without the held-out run. What is not to be trusted is marked.

    Some models are only compared: they cannot be saved or deployed. They are listed last, with a
    mark, and never count as best. A line says where one of them has a smaller error, and where
    the default has a much larger error than plain least squares.

    No compensation competes too: the best candidate is none where nothing beats the machine as it
    is. A channel in which the default leaves more than that is marked and named. The exit code is
    0 all the same: scripts test `worse_than_none` in the figures of --json, a list of channels.

    --start, --end and --hold-out say which samples count, in seconds from the bag's first sample.
    They never move the reference: temperatures and displacements stay referred to the first
    samples of the bag.

    A bag that cannot be used is named and left out of everything; the command then ends with 1.
    The figures do not depend on --jobs.

        fuzzycnc compare monday tuesday wednesday
        fuzzycnc compare recordings 'archive/2026-*' --json figures.json
        fuzzycnc compare shift --models static_ridge,lag_ridge,stable_grey --json figures.json
        fuzzycnc compare shift --hold-out 57600:86400 --report comparison.html
        fuzzycnc compare --machine grinder --report grinder.html
    """
    from fuzzycnc_ros.core.thermal.fit.training import training_interval

    processes = jobs_of(jobs)
    check_at_least('--seed', seed, 0)
    check_folder(report, json_file)
    if machine is not None:
        _check_machine(context, machine)
        _compare_on_grinder(models, processes, seed, report, json_file)
        return
    if not bags:
        raise ValueError(f'expected bags or --machine {"|".join(MACHINES)} but found neither')
    names = names_of('--models', models, COMPARED)
    windows = [_window(text) for text in hold_out or []]
    there = find_bags(bags)
    wanted = sensors_but(drop_sensor, [bag.path for bag in there])
    work = partial(
        usable_run,
        interval=interval,
        start=start,
        stop=end,
        sensors=wanted,
        sensor_limits=sensor_limits or (),
    )
    with progress_bar('reading') as tell:
        read = with_each(work, there, processes, tell)
    named = read.used(there)
    alike = without_odd(named, read.results)
    runs = alike.results
    interval = training_interval(runs, interval)
    no_speed = '--no-speed' if not speed else speed_missing(runs, interval)
    if no_speed:
        names = _without_speed(names, no_speed)
    comparison, failed = _compared(
        runs,
        windows,
        processes,
        candidates=names,
        interval=interval,
        sensors=sensors,
        n_clusters=clusters,
        spindle_speed=not no_speed,
        random_state=seed,
    )
    lines = _show(comparison, brief=report is None)
    if no_speed:
        lines.append(f'spindle speed: not used, {no_speed}')
    bridged = {run.name: bridged_gaps(run, interval) for run in runs}
    for name, gaps in bridged.items():
        lines += gap_lines(name, gaps, interval)
    doubts = doubt_lines(runs)
    lines += [f'warning: {line}' for line in doubts]
    for line in lines:
        say(line)
    bad = (*read.bad, *alike.bad, *failed)
    say_bad(bad)
    if report is not None:
        from fuzzycnc_ros.studies.page.recorded import recording_facts
        from fuzzycnc_ros.studies.thermal.comparison_page import comparison_page

        used = {run.name for run in runs}
        facts = {
            **recording_facts([bag.path for bag in named if bag.name in used]),
            'Runs': ', '.join(run.name for run in runs),
            'Sampling interval': f'{interval:g} s',
            'Spindle speed': f'not used, {no_speed}' if no_speed else 'used where named',
            'Seed': str(seed),
        }
        write_report(report, comparison_page(comparison, facts))
    from fuzzycnc_ros.studies.thermal.comparison import comparison_document
    from fuzzycnc_ros.studies.thermal.many_runs import overall_document

    write_json(
        json_file,
        {
            **comparison_document(comparison),
            'overall': overall_document([item.evaluation for item in comparison.held_out]),
            'left_out': {item.bag.name: item.reason for item in bad},
            'warnings': doubts,
            'bridged': bridged,
        },
    )
    if bad:
        raise typer.Exit(1)


def usable_run(
    bag: NamedBag, progress: 'Progress', *, interval: float | None, **options: Any
) -> 'ThermalRun':
    """Read the run of a bag under the name that tells it from the others.

    Raises
    ------
    ValueError
        If it cannot be read, is too slow, or lacks readings for longer than is bridged.
    """
    from fuzzycnc_ros.studies.thermal.missing_readings import read_usable

    progress('reading', bag.name, 0, 1)
    return read_usable(bag.path, interval, name=bag.name, **options)


def speed_missing(runs: 'Sequence[ThermalRun]', interval: float) -> str:
    """Return why the spindle speed cannot be used in all runs; empty if it can."""
    from fuzzycnc_ros.core.thermal.fit.training import at_interval
    from fuzzycnc_ros.core.thermal.run import drivers_of

    even = [at_interval(run, interval) for run in runs]
    lacking = [run.name for run in even if run.spindle_speed is None]
    if lacking:
        return f'since it is not recorded in {", ".join(lacking)}'
    return '' if drivers_of(even) else 'since it has gaps or never changes'


def judge_split(split: 'Split', progress: 'Progress', **options: Any) -> 'HeldOut | BadBag':
    """Judge one held-out run; what is wrong names it."""
    from fuzzycnc_ros.core.thermal.fit.comparison import judge
    from fuzzycnc_ros.core.thermal.run import ThermalDataError
    from fuzzycnc_ros.papers.thermal import ALL_CONTENDERS

    try:
        return judge(split, contenders=ALL_CONTENDERS, progress=progress, **options)
    except ThermalDataError as error:
        held_out = NamedBag(Path(split.held_out.name), split.name)
        return BadBag(held_out, f'{split.name} held out: {error}')


def judge_trial(
    trial: 'Trial', progress: 'Progress', *, models: tuple[str, ...], seed: int
) -> 'GrinderComparison':
    """Judge some models in one trial on the simulated grinder."""
    from fuzzycnc_ros.studies.grinder.grinder_comparison import compare_on_grinder
    from fuzzycnc_ros.studies.grinder.grinder_rivals import RIVALS

    return compare_on_grinder(
        seed=seed,
        rivals=[rival for rival in RIVALS if rival.name in models],
        trials=(trial,),
        progress=lambda _, name, done, total: progress('fit', name, done, total),
    )


def _compared(
    runs: 'Sequence[ThermalRun]',
    windows: list[tuple[float, float]],
    jobs: int,
    **options: Any,
) -> 'tuple[Comparison, tuple[BadBag, ...]]':
    """Hold everything out in turn; return also what could not be judged."""
    from fuzzycnc_ros.cli.workers import in_workers
    from fuzzycnc_ros.core.thermal.fit.comparison import Comparison, HeldOut, splits

    held_out = splits(runs, windows, options['interval'])
    names = [split.name for split in held_out]
    with progress_bar('comparing') as tell:
        found = in_workers(partial(judge_split, **options), held_out, names, jobs, tell)
    bad = tuple(item for item in found if isinstance(item, BadBag))
    judged = tuple(item for item in found if isinstance(item, HeldOut))
    check_some_left(len(judged), bad)
    return Comparison(judged), bad


def _show(comparison: 'Comparison', *, brief: bool) -> list[str]:
    """Print tables, of each run only if there is one; return the lines that close them."""
    from fuzzycnc_ros.studies.thermal import comparison as shown
    from fuzzycnc_ros.studies.thermal.many_runs import runs_table

    held_out = comparison.held_out
    if len(held_out) == 1:
        (item,) = held_out
        show(shown.held_out_table(item))
        say(f'default: {shown.choice_text(item)}')
        for line in shown.held_out_remarks(item):
            remark(line)
        for text in (*shown.refusal_lines(item), ''):
            say(text)
    else:
        for line in (line for item in held_out for line in shown.held_out_remarks(item)):
            if line.warning:
                remark(line)
    if len(held_out) > 1:
        judged = [item.evaluation for item in held_out]
        show(runs_table(judged))
        choices = ((item.evaluation.run, shown.choice_text(item)) for item in held_out)
        say(f'default: {"; ".join(f"{run}: {choice}" for run, choice in choices)}')
        say('all models on each run: --report FILE' if brief else '')
        show(shown.pooled_table(comparison))
        for text in shown.pooled_refusal_lines(comparison):
            say(text)
        for line in shown.pooled_remarks(comparison):
            remark(line)
    if any(name in COMPARED_ONLY for name in comparison.names):
        say(shown.COMPARED_LINE)
    return shown.best_lines(comparison)


def _compare_on_grinder(
    models: list[str], jobs: int, seed: int, report: Path | None, json_file: Path | None
) -> None:
    from fuzzycnc_ros.cli.workers import in_workers
    from fuzzycnc_ros.studies.grinder.grinder_comparison import (
        GrinderComparison,
        grinder_page,
        grinder_remarks,
        grinder_trials,
    )
    from fuzzycnc_ros.studies.grinder.grinder_rivals import RIVALS

    names = names_of('--models', models, [rival.name for rival in RIVALS])
    trials = grinder_trials(seed)
    with progress_bar('comparing') as tell:
        parts = in_workers(
            partial(judge_trial, models=names, seed=seed),
            trials,
            [trial.name for trial in trials],
            jobs,
            tell,
        )
    comparison = GrinderComparison(seed, tuple(trial for part in parts for trial in part.trials))
    for table, result in zip(comparison.tables(), comparison.trials, strict=True):
        show(table)
        for line in (*grinder_remarks(result), ''):
            say(line)
    if report is not None:
        write_report(report, grinder_page(comparison))
    write_json(json_file, comparison.document())


def _check_machine(context: typer.Context, machine: str) -> None:
    """Refuse an unknown machine, and options that say nothing on a simulated one."""
    if machine not in MACHINES:
        raise ValueError(f'--machine: expected {" or ".join(MACHINES)} but found {machine!r}')
    for name in NOT_WITH_MACHINE:
        source = context.get_parameter_source(name)
        if source is not None and source.name == 'COMMANDLINE':
            option = 'BAG' if name == 'bags' else '--' + name.replace('_', '-')
            raise ValueError(
                f'--machine {machine}: expected no {option}, which is for recorded runs; '
                'leave one of them out'
            )


def _window(text: str) -> tuple[float, float]:
    """Return START:END as two numbers."""
    start, _, end = text.partition(':')
    read = number_in(TIMES, 'a time')
    try:
        window = read(start), read(end)
    except typer.BadParameter:
        window = 0.0, 0.0
    if not window[0] < window[1]:
        raise ValueError(
            '--hold-out: expected START:END in s, such as 57600:86400 or 16h:24h, but found '
            f'{text!r}'
        )
    return window


def _without_speed(names: tuple[str, ...], reason: str) -> tuple[str, ...]:
    kept = tuple(name for name in names if not name.endswith((SPEED_SUFFIX, DRIVES_SUFFIX)))
    if not kept:
        raise ValueError(
            f'--models: expected a model that does without the spindle speed, as it is not used '
            f'({reason}), but found {", ".join(names)}'
        )
    return kept

# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""`fuzzycnc servo`: position controllers compared, learnt, tuned and judged."""

import warnings
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from fuzzycnc_ros.cli.axes.servo_axis import (
    AXES,
    CHOICES,
    DEFAULT,
    FOR_ANY_AXIS,
    TUNABLE,
    Axis,
    Out,
    check_axis,
    check_controller,
    make_controller,
    warnings_said,
)
from fuzzycnc_ros.cli.completion import some_of
from fuzzycnc_ros.cli.console import (
    JsonFile,
    check_at_least,
    check_folder,
    check_new,
    check_ros,
    progress_bar,
    say,
    show,
    words,
    write_json,
    write_report,
    write_text,
)
from fuzzycnc_ros.cli.models.many_bags import Jobs, jobs_of
from fuzzycnc_ros.cli.options import (
    ALL,
    MachineFile,
    OptionalPath,
    OptionalText,
    Report,
    choice,
    given,
    names_of,
)
from fuzzycnc_ros.core.units import LENGTHS

if TYPE_CHECKING:
    from fuzzycnc_ros.core.servo.rule_table import RuleTable
    from fuzzycnc_ros.studies.servo.servo_settings import ServoSettings

HELP = """Compare, learn, tune and judge controllers that position an axis.

    fuzzycnc servo compare --report controllers.html
    fuzzycnc servo learn run --out rules.yaml
    fuzzycnc servo tune --machine-file mill.yaml --axis X --out tuned.yaml
    fuzzycnc servo tune --on-machine --machine-file mill.yaml --axis X --out tuned.yaml
    fuzzycnc servo stability --machine-file tuned.yaml --axis X
    fuzzycnc servo export --machine-file tuned.yaml --axis X --out axis_x.c

`fuzzycnc position` moves an axis with what they find.
"""

SETTINGS = ('bandwidth', 'damping', 'estimator')
"""Settings of all controllers of an axis; where they are made would load numpy."""

SEARCHED = (
    *SETTINGS,
    'error_range',
    'rate_range',
    'error_exponent',
    'rate_exponent',
    'error_floor',
    'rate_floor',
    'output_gain',
    'disturbance',
)
"""Settings that `servo tune` searches; those after the first three are of the rules' universes."""

EXPORTS = ('c', 'hal', 'plant')
"""Forms of what `servo export` writes."""

MachineAxis = Annotated[
    str, typer.Option(metavar='NAME', show_default=False, help='Axis of the machine file.')
]

Params = Annotated[
    OptionalPath, given('Rules as `servo learn` writes them, or settings.', metavar='FILE')
]


def compare(
    controllers: Annotated[
        list[str],
        typer.Option(
            metavar='NAME,...',
            help=f'Controllers to compare, or {ALL}: {", ".join(CHOICES)}.',
            autocompletion=some_of((ALL, *CHOICES)),
        ),
    ] = [ALL],  # noqa: B006 - typer copies it
    moves: Annotated[
        int, typer.Option(help='Random moves with moderate and as many with hard friction.')
    ] = 200,
    seed: Annotated[int, typer.Option(help='Seed of noise and random moves.')] = 0,
    machine_file: MachineFile = None,
    axis: MachineAxis = '',
    report: Report = None,
    json_file: JsonFile = None,
) -> None:
    """Compare all position controllers on the same cases of the lathe axis, or of a machine's.

    Steps and profiles with and without friction, the gain halved and one and a half times, a step
    of load, a sine, a circle of two axes, and random moves whose gain, load, noise and friction
    are drawn. Ten seconds with --moves 0, about a minute and a half with 200.

        fuzzycnc servo compare --moves 0
        fuzzycnc servo compare --controllers pid,variable_universe --json figures.json
        fuzzycnc servo compare --report controllers.html

    With a machine file: the four controllers for any axis, on the cases of `servo tune`.

        fuzzycnc servo compare --machine-file mill.yaml --axis X
    """
    check_at_least('--seed', seed, 0)
    if machine_file is not None:
        from fuzzycnc_ros.cli.axes.servo_machine import compare_machine_axis

        if report is not None:
            raise ValueError('--report: expected none with --machine-file; use --json')
        check_folder(json_file)
        compare_machine_axis(machine_file, axis, seed, json_file)
        return
    from fuzzycnc_ros.studies.servo import positioning_compare as shown
    from fuzzycnc_ros.studies.servo.positioning_page import LABELS
    from fuzzycnc_ros.studies.servo.servo_cases import compare_controllers

    names = names_of('--controllers', controllers, tuple(LABELS))
    check_at_least('--moves', moves, 0)
    check_folder(report, json_file)
    with progress_bar('driving') as tell:
        found = compare_controllers(names, moves=moves, seed=seed, progress=tell)
    tables, lines = (
        (shown.moves_table(found), shown.others_table(found)),
        shown.comparison_remarks(found),
    )
    for table in tables:
        show(table)
        say('')
    for line in lines:
        say(line)
    if report is not None:
        facts = {
            'Axis': 'lathe, simulated: 286 mm/s at full duty, grating of 0.625 µm, noise 0.1 µm',
            'Control period': '1 ms',
            'Profile': '200 mm/s, 1.5 m/s², 30 m/s³',
            'Random moves': f'{moves} with moderate and {moves} with hard friction',
            'Seed': str(seed),
        }
        write_report(report, shown.comparison_page(found, tables, lines, facts))
    write_json(json_file, shown.comparison_document(found))


def tune(
    out: Annotated[Path, typer.Option(metavar='FILE', help='Machine file to write.')],
    axis: Axis = '',
    machine_file: MachineFile = None,
    generations: Annotated[
        int, typer.Option(help='Generations of the search after the first population.')
    ] = 8,
    population: Annotated[int, typer.Option(help='Candidates per setting.')] = 6,
    search: Annotated[
        list[str],
        typer.Option(
            metavar='NAME,...',
            help=f'Settings to search: {", ".join(SETTINGS)} of every controller, which {ALL} '
            f'means, or of the rules and their tangent {", ".join(SEARCHED[len(SETTINGS) :])}.',
            autocompletion=some_of((ALL, *SEARCHED)),
        ),
    ] = [ALL],  # noqa: B006
    seed: Annotated[int, typer.Option(help='Seed of the search.')] = 0,
    on_machine: Annotated[
        bool,
        typer.Option(
            '--on-machine',
            help='Try controllers on the axis itself, which servo_controller drives.',
        ),
    ] = False,
    trials: Annotated[int, typer.Option(help='Controllers that --on-machine tries at most.')] = 48,
    machine: Annotated[
        str, typer.Option(help='Name of the machine for --on-machine: the namespace of its nodes.')
    ] = 'mill',
    linuxcnc: Annotated[
        OptionalPath,
        given(
            'With --on-machine: the axis is one of a LinuxCNC that runs here under an exported '
            'component; bag to write.',
            metavar='BAG',
        ),
    ] = None,
    jobs: Jobs = None,
    json_file: JsonFile = None,
) -> None:
    """Search for the controller that suits an axis of a machine file, and for its settings.

    Four controllers - PID with feedforward, cascade, linear tangent, variable universe - are tuned
    by differential evolution with the same number of trials, with gains from half to twice,
    loads and friction within the file's limits, and judged on other cases. The best one,
    or a simpler one that is as good to 5 %, is written into --out, a new machine file. It takes
    about two minutes.

        fuzzycnc servo tune --machine-file mill.yaml --axis X --out tuned.yaml

    Without a machine file the built-in one of --axis is tuned.

        fuzzycnc servo tune --out tuned.yaml
        fuzzycnc servo tune --search output_gain,disturbance --generations 10 --out few.yaml

    With --on-machine the controllers drive the axis itself, through the running servo_controller:
    short ways there and back, for as long as the space bar is held. What swings is ended at once,
    and the controller that was there comes back.

        fuzzycnc servo tune --on-machine --machine-file mill.yaml --axis X --out tuned.yaml

    With --linuxcnc the axis is that of the same name of a LinuxCNC that runs here, under the
    component that `fuzzycnc linuxcnc install` exports. Other settings of the same controller are
    tried, and recorded in a bag.

        fuzzycnc servo tune --on-machine --linuxcnc run --machine-file mill.yaml --out tuned.yaml
    """
    from fuzzycnc_ros.cli.axes.servo_machine import (
        Effort,
        tune_in_linuxcnc,
        tune_machine_axis,
        tune_on_machine,
    )

    check_at_least('--population', population, 1)
    check_at_least('--seed', seed, 0)
    check_at_least('--generations', generations, 1)
    check_new(out)
    check_folder(json_file)
    if linuxcnc is not None and not on_machine:
        raise ValueError('--linuxcnc: expected --on-machine with it but found none')
    if on_machine:
        check_at_least('--trials', trials, 1)
        if machine_file is None:
            raise ValueError(
                '--machine-file: expected the one that servo_controller was started with, for '
                '--on-machine, but found none'
            )
        if linuxcnc is not None:
            check_new(linuxcnc)
            tune_in_linuxcnc(machine_file, axis, out, trials, linuxcnc, json_file)
            return
        check_ros('servo tune --on-machine')
        tune_on_machine(machine_file, axis, out, trials, machine, json_file)
        return
    if machine_file is None:
        machine_file, axis = axis or AXES[0], ''
        check_axis(machine_file)
    names = SETTINGS if words(search) == (ALL,) else names_of('--search', search, SEARCHED)
    if population * len(names) < 5:
        raise ValueError(
            f'--population: expected five candidates or more in all but found {population} for '
            f'each of {len(names)} settings'
        )
    work = Effort(names, seed, generations, population)
    tune_machine_axis(machine_file, axis, out, work, jobs_of(jobs), json_file)


def stability(
    axis: Axis = '',
    machine_file: MachineFile = None,
    controller: Annotated[
        str,
        choice(
            f'Controller of the lathe axis, {DEFAULT} without it; with a machine file '
            'variable_universe or linear_tangent, its own without it.',
            (*TUNABLE, 'linear_tangent'),
            default=False,
            others=True,
        ),
    ] = '',
    params: Params = None,
    gains: Annotated[
        list[str],
        typer.Option(metavar='FACTOR,...', help="Factors on the axis' gain to look at."),
    ] = ['0.5,0.75,1,1.25,1.5,1.75'],  # noqa: B006
    report: Report = None,
    json_file: JsonFile = None,
) -> None:
    """Show how far a position loop is from swinging.

    The tables have the gains near the target, gain and phase margin, the spectral radius of the
    sampled loop with its observer for several gains of the axis, and the amplitude of a lasting
    oscillation as the describing function of the contracted surface predicts it.

        fuzzycnc servo stability
        fuzzycnc servo stability --params settings.yaml --gains 0.5,1,1.5,2 --report margins.html
        fuzzycnc servo stability --machine-file tuned.yaml --axis X
    """
    from fuzzycnc_ros.core.servo.stability import stability_report
    from fuzzycnc_ros.studies.servo.positioning_rules import (
        stability_page,
        stability_table,
    )

    factors = _factors(gains)
    check_folder(report, json_file)
    with warnings_said():
        chosen: Any
        if machine_file is not None:
            from fuzzycnc_ros.cli.axes.servo_machine import analysed_controller

            axis, controller, chosen = analysed_controller(machine_file, axis, controller, params)
        else:
            axis, controller = axis or AXES[0], controller or DEFAULT
            chosen = _built_in(axis, controller, params)
    found = stability_report(chosen, gains=factors)
    table = stability_table(found, f'{controller} on the {axis} axis')
    show(table)
    if report is not None:
        fine = sorted({*(0.05 * k for k in range(2, 51)), *factors})
        course = stability_report(chosen, gains=fine).spectral_radius
        facts = {'Axis': axis, 'Settings': str(params) if params else 'built-in defaults'}
        page = stability_page(found, course, table, facts)
        write_report(report, page)
    write_json(json_file, found)


def _built_in(axis: str, controller: str, params: Path | None) -> Any:
    """Return a controller of a built-in axis, even one that swings."""
    from fuzzycnc_ros.studies.servo.servo_settings import read_settings

    check_axis(axis)
    if controller not in TUNABLE:
        raise ValueError(
            f'--controller: expected one of {", ".join(TUNABLE)} but found {controller!r}'
        )
    settings = read_settings(params) if params is not None else None
    check_controller(controller, axis, settings)
    return make_controller(controller, axis, settings, unstable=True)


def _factors(texts: list[str]) -> tuple[float, ...]:
    """Return factors on the gain, from the smallest."""
    found = []
    for text in words(texts):
        try:
            factor = float(text)
        except ValueError:
            factor = 0.0
        if not 0.0 < factor < 100.0:
            raise ValueError(f'--gains: expected factors above 0, below 100 but found {text!r}')
        found.append(factor)
    if not found:
        raise ValueError('--gains: expected factors such as 0.5,1,1.5 but found none')
    return tuple(sorted(set(found)))


OUTER = [0, 1, -2, -1]
"""Rows of the rules that are for errors beyond the innermost sets."""


def learn(
    source: Annotated[
        Path,
        typer.Argument(
            metavar='BAG|CSV',
            help='Bag of a run with servo_controller, or .csv with the columns t [s], reference, '
            'position, duty [-1 to 1].',
        ),
    ],
    out: Out,
    axis: Axis = '',
    machine_file: MachineFile = None,
    name: Annotated[
        OptionalText, given('Axis of the bag, if it drives several.', metavar='AXIS')
    ] = None,
    unit: Annotated[
        OptionalText, choice('Unit of the lengths of a .csv.', tuple(LENGTHS), default=False)
    ] = None,
    method: Annotated[
        str, choice('Least squares, or Wang-Mendel as published.', ('lsq', 'wm'))
    ] = 'lsq',
    sets: Annotated[
        int,
        choice('Sets of error and rate: the six published, or one about zero too.', ('6', '7')),
    ] = 6,
    reversed_axis: Annotated[
        bool,
        typer.Option('--reversed', help='Positive duty drives to negative positions.'),
    ] = False,
    json_file: JsonFile = None,
) -> None:
    """Learn the rules of the controller from recorded moves of any controller.

    The table shows where the rule of every cell comes from: records, the opposite cell, or its
    neighbours. `fuzzycnc position --params` and `fuzzycnc servo stability --params` read the file.

        fuzzycnc servo learn run --out rules.yaml
        fuzzycnc servo learn moves.csv --unit mm --method wm --out rules.json
        fuzzycnc servo learn run --sets 7 --out finer.yaml
        fuzzycnc servo learn run --machine-file tuned.yaml --axis X --out rules.yaml
    """
    from fuzzycnc_ros.core.servo.rule_learning import learn_rules
    from fuzzycnc_ros.core.servo.rule_table import CENTRES, CENTRES_WITH_ZERO, SETS, SETS_WITH_ZERO
    from fuzzycnc_ros.studies.servo.positioning_rules import rules_document, rules_table
    from fuzzycnc_ros.studies.servo.recorded_moves import read_bag, read_csv, records_of
    from fuzzycnc_ros.studies.servo.servo_settings import ServoSettings, rules_text

    if machine_file is None:
        axis = axis or AXES[0]
        check_axis(axis)
    elif reversed_axis:
        raise ValueError('--reversed: expected none with --machine-file, which has the direction')
    names, centres = (SETS, CENTRES) if sets == len(SETS) else (SETS_WITH_ZERO, CENTRES_WITH_ZERO)
    table_file = source.suffix.lower() == '.csv'
    if table_file != (unit is not None):
        raise ValueError(
            f'--unit: expected the unit of the lengths of a .csv, one of {", ".join(LENGTHS)}, '
            f'and none for a bag, but found {unit!r} for {source}'
        )
    check_new(out)
    check_folder(json_file)
    if not source.exists():
        raise ValueError(f'{source}: expected a bag or a .csv but nothing is there')
    controller: Any
    with_rules: Callable[[RuleTable], Any]
    if machine_file is not None:
        from fuzzycnc_ros.cli.axes.servo_machine import learning_controller
        from fuzzycnc_ros.core.servo.axis_control import WITH_RULES, make_axis_controller

        axis, data, controller = learning_controller(machine_file, axis)
        own = data.settings
        with_rules = lambda rules: make_axis_controller(data, WITH_RULES, own, rules)  # noqa: E731
    else:
        direction = -1.0 if reversed_axis else 1.0
        controller = make_controller(DEFAULT, axis, direction=direction)
        with_rules = lambda rules: make_controller(  # noqa: E731
            DEFAULT,
            axis,
            ServoSettings(out, axis, rules=rules),
            direction=direction,
            unstable=True,
        )
    moves = read_csv(source, LENGTHS[unit]) if unit is not None else read_bag(source, name)
    size = controller.watch.limits.error_max
    if abs(moves.position).max() > size:
        raise ValueError(
            f'{source}: expected positions within {1e3 * size:g} mm but found '
            f'{1e3 * abs(moves.position).max():g} mm; is the unit right?'
        )
    records = records_of(moves, controller, source)
    learned = learn_rules(records, method, centres=centres).complete()
    show(rules_table(learned, names))
    with warnings_said():
        rules = learned.table()
    cells = learned.values.size
    say(
        f'{learned.used:,} records; data in {round(learned.coverage * cells)} of {cells} cells, '
        f'{int(learned.conflicts.sum()):,} records that contradict the rule of their cell'
    )
    if not learned.count[OUTER].any():
        say(
            'note: no record is further off its target than the innermost sets reach, so most '
            'rules are guesses; record moves that step, by servo_controller with velocity_max, '
            'acceleration_max and jerk_max at their upper bounds'
        )
    for line in _unsettled(ServoSettings(out, axis, rules=rules), with_rules):
        say(line)
    about = f'rules learnt from {source.name}, method {method}'
    write_text(out, rules_text(out, axis, rules, about))
    of_file = f' --machine-file {machine_file} --axis {axis}' if machine_file else ''
    say(f'{out}: the rules; move with them by `fuzzycnc position{of_file} --params {out}`')
    write_json(json_file, rules_document(learned))


def _unsettled(settings: 'ServoSettings', with_rules: Callable[['RuleTable'], Any]) -> list[str]:
    """Return what is to be said of rules with which the axis does not settle, or hardly."""
    from fuzzycnc_ros.studies.servo.positioning_rules import swinging

    assert settings.rules is not None
    with warnings.catch_warnings():
        warnings.simplefilter('ignore')
        controller = with_rules(settings.rules)
    try:
        settings.check(controller)
    except ValueError as error:
        return [f'note: {error}; `fuzzycnc position` refuses these rules']
    return swinging(controller)


def export(
    machine_file: Annotated[str, typer.Option(metavar='FILE', help='Machine file of the axis.')],
    out: Annotated[Path, typer.Option(metavar='FILE', help='File to write.')],
    axis: MachineAxis = '',
    to: Annotated[
        str,
        choice(
            "One C99 file, a component of LinuxCNC's HAL, or one that simulates the axis itself.",
            EXPORTS,
        ),
    ] = 'c',
    controller: Annotated[
        str,
        choice(
            'Controller, untuned if it is not that of the machine file.',
            FOR_ANY_AXIS,
            default=False,
        ),
    ] = '',
    params: Params = None,
) -> None:
    """Write the controller of an axis in C, for a control's own thread.

    Every duty is that of the Python controller to the last bit, if it is compiled with
    -ffp-contract=off. The file needs no library, allocates nothing and has no global state; with
    -DSELF_TEST it repeats recorded steps and says how many differ.

        fuzzycnc servo export --machine-file tuned.yaml --axis X --out axis_x.c
        cc -DSELF_TEST -std=c99 -O2 -ffp-contract=off axis_x.c -lm && ./a.out

    With --to hal it is the source of a component that takes the place of LinuxCNC's pid, with
    --to plant one of the simulated axis, to try it without hardware. Their files bear the names of
    the components; LinuxCNC's halcompile builds and installs them.

        fuzzycnc servo export --machine-file tuned.yaml --to hal --out fuzzycnc_axis_x.comp
        fuzzycnc servo export --machine-file tuned.yaml --to plant --out fuzzycnc_plant_x.comp
    """
    from fuzzycnc_ros.cli.axes.servo_machine import (
        exported_controller,
        exported_plant,
        machine_axis,
        own_controller,
    )

    if to != 'c' and out.suffix != '.comp':
        raise ValueError(
            f'--out: expected the name of the component with .comp, such as fuzzycnc_axis_x.comp, '
            f'but found {out.name}'
        )
    check_new(out)
    _, axis, data = machine_axis(machine_file, axis)
    if to == 'plant':
        if controller or params is not None:
            raise ValueError('--controller, --params: expected none with --to plant')
        write_text(out, exported_plant(machine_file, axis, data, out.stem))
        say(f'{out}: the simulated axis {axis}; build it with halcompile --install')
        return
    chosen = controller or own_controller(data, params)
    name = f'axis_{axis.lower()}' if to == 'c' else out.stem
    with warnings_said():
        text = exported_controller(machine_file, axis, data, chosen, params, to, name)
    write_text(out, text)
    compiled = 'compile it with -ffp-contract=off' if to == 'c' else 'build it with halcompile'
    say(f'{out}: {chosen} of {axis}; {compiled}')


COMMANDS: dict[str, Callable[..., Any]] = {
    'compare': compare,
    'learn': learn,
    'tune': tune,
    'stability': stability,
    'export': export,
}
"""The subcommands in the order of the help."""

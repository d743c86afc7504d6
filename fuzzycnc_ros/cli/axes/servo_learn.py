# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""`fuzzycnc servo learn`: rules of the controller from recorded moves."""

import warnings
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Optional

import typer

from fuzzycnc_ros.cli.axes.servo_axis import (
    AXES,
    DEFAULT,
    Axis,
    Out,
    check_axis,
    make_axis,
    make_controller,
    warnings_said,
)
from fuzzycnc_ros.cli.console import JsonFile, check_folder, check_new, say, show, write_json
from fuzzycnc_ros.cli.options import MachineFile
from fuzzycnc_ros.cli.quantities import LENGTHS

if TYPE_CHECKING:
    from fuzzycnc_ros.cli.axes.servo_settings import ServoSettings
    from fuzzycnc_ros.core.servo.rule_table import RuleTable

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
        Optional[str],  # noqa: UP045
        typer.Option(
            metavar='AXIS', show_default=False, help='Axis of the bag, if it drives several.'
        ),
    ] = None,
    unit: Annotated[
        Optional[str],  # noqa: UP045
        typer.Option(
            metavar='|'.join(LENGTHS), show_default=False, help='Unit of the lengths of a .csv.'
        ),
    ] = None,
    method: Annotated[
        str, typer.Option(metavar='lsq|wm', help='Least squares, or Wang-Mendel as published.')
    ] = 'lsq',
    sets: Annotated[
        int,
        typer.Option(
            metavar='6|7', help='Sets of error and rate: the six published, or one about zero too.'
        ),
    ] = 6,
    reversed_axis: Annotated[
        bool,
        typer.Option('--reversed', help='Positive duty drives to negative positions.'),
    ] = False,
    json_file: JsonFile = None,
) -> None:
    """Learn the rules of the controller from recorded moves of any controller.

    Shown is where every cell is from: records, the opposite cell, or its neighbours. The file is
    for `fuzzycnc position --params` and `fuzzycnc servo stability --params`.

        fuzzycnc servo learn run --out rules.yaml
        fuzzycnc servo learn moves.csv --unit mm --method wm --out rules.json
        fuzzycnc servo learn run --sets 7 --out finer.yaml
        fuzzycnc servo learn run --machine-file tuned.yaml --axis X --out rules.yaml
    """
    from fuzzycnc_ros.cli.axes.servo_bag import read_bag
    from fuzzycnc_ros.cli.axes.servo_records import read_csv, records_of
    from fuzzycnc_ros.cli.axes.servo_settings import ServoSettings, write_settings
    from fuzzycnc_ros.core.servo.rule_learning import learn_rules
    from fuzzycnc_ros.core.servo.rule_table import CENTRES, CENTRES_WITH_ZERO, SETS, SETS_WITH_ZERO
    from fuzzycnc_ros.studies.servo.positioning_rules import rules_document, rules_table

    if machine_file is None:
        axis = axis or AXES[0]
        check_axis(axis)
    elif reversed_axis:
        raise ValueError('--reversed: expected none with --machine-file, which has the direction')
    if method not in ('lsq', 'wm'):
        raise ValueError(f'--method: expected lsq or wm but found {method!r}')
    if sets not in (len(SETS), len(SETS_WITH_ZERO)):
        raise ValueError(f'--sets: expected {len(SETS)} or {len(SETS_WITH_ZERO)} but found {sets}')
    names, centres = (SETS, CENTRES) if sets == len(SETS) else (SETS_WITH_ZERO, CENTRES_WITH_ZERO)
    table_file = source.suffix.lower() == '.csv'
    if table_file != (unit is not None):
        raise ValueError(
            f'--unit: expected the unit of the lengths of a .csv, one of {", ".join(LENGTHS)}, '
            f'and none for a bag, but found {unit!r} for {source}'
        )
    if unit is not None and unit not in LENGTHS:
        raise ValueError(f'--unit: expected one of {", ".join(LENGTHS)} but found {unit!r}')
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
        plant = make_axis(axis, {'direction': ('--reversed', direction)})
        controller = make_controller(DEFAULT, axis, plant)
        with_rules = lambda rules: make_controller(  # noqa: E731
            DEFAULT, axis, plant, ServoSettings(out, axis, rules=rules), unstable=True
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
        f'{int(learned.conflicts.sum()):,} records of another set than their cell'
    )
    if not learned.count[OUTER].any():
        say(
            'note: no record is further off its target than the innermost sets reach, so most '
            'rules are guesses; record moves that step, by servo_controller with velocity_max, '
            'acceleration_max and jerk_max at their upper bounds'
        )
    for line in _unsettled(ServoSettings(out, axis, rules=rules), with_rules):
        say(line)
    write_settings(
        out, axis, rules=rules, about=f'rules learnt from {source.name}, method {method}'
    )
    of_file = f' --machine-file {machine_file} --axis {axis}' if machine_file else ''
    say(f'{out}: the rules; move with them by `fuzzycnc position{of_file} --params {out}`')
    write_json(json_file, rules_document(learned))


def _unsettled(settings: 'ServoSettings', with_rules: Callable[['RuleTable'], Any]) -> list[str]:
    """Return what is to be said of rules with which the axis does not settle, or hardly."""
    from fuzzycnc_ros.cli.axes.servo_search import swinging

    assert settings.rules is not None
    with warnings.catch_warnings():
        warnings.simplefilter('ignore')
        controller = with_rules(settings.rules)
    try:
        settings.check(controller)
    except ValueError as error:
        return [f'note: {error}; `fuzzycnc position` refuses these rules']
    return swinging(controller)

# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""`fuzzycnc position`: one move of a simulated axis."""

import dataclasses
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Optional

import typer

from fuzzycnc_ros.cli.console import (
    JsonFile,
    check_at_least,
    check_folder,
    say,
    show,
    write_json,
    write_text,
)
from fuzzycnc_ros.cli.options import Report
from fuzzycnc_ros.cli.quantities import LENGTHS, SHARES, quantity
from fuzzycnc_ros.cli.servo_axis import (
    CHOICES,
    DEFAULT,
    TIMES,
    TRAVEL,
    Axis,
    check_axis,
    make_axis,
    make_controller,
    signed,
    warnings_said,
)

if TYPE_CHECKING:
    from fuzzycnc_ros.core.servo import Reference

DURATION_MIN, DURATION_MAX = 0.05, 120.0
"""Lengths of a run that are simulated [s]."""

GAIN_MIN, GAIN_MAX = 0.01, 100.0
"""Factors on the gain that are simulated."""

STEP_MIN = 1e-6
"""Least way of a move [m]."""

BESIDE_LOAD = 0.12
"""What friction takes beside the load [-], as duty."""


def position(
    to: Annotated[
        str,
        typer.Option(metavar='LENGTH', help='Where the axis goes from 0, such as -50mm.'),
    ],
    axis: Axis = 'lathe',
    controller: Annotated[
        str,
        typer.Option(
            metavar='NAME',
            help=f'One of {", ".join(CHOICES)}; the ballscrew has {DEFAULT} alone.',
        ),
    ] = DEFAULT,
    params: Annotated[
        Optional[Path],  # noqa: UP045 - typer 0.9 does not read the newer form
        typer.Option(
            metavar='FILE',
            show_default=False,
            help='Settings of the controller, as `servo tune` and `servo learn` write them.',
        ),
    ] = None,
    profile: Annotated[
        Optional[bool],  # noqa: UP045
        typer.Option(
            '--profile/--step',
            show_default=False,
            help='Whether the reference goes there by a jerk-limited profile (200 mm/s, '
            '1.5 m/s^2, 30 m/s^3), which is fed forward, or steps there; by default it steps on '
            'the lathe alone.',
        ),
    ] = None,
    gain: Annotated[float, typer.Option(metavar='FACTOR', help="Factor on the axis' gain.")] = 1.0,
    friction: Annotated[
        float,
        typer.Option(metavar='FACTOR', help="Factor on the axis' friction; 0 for none."),
    ] = 1.0,
    breakaway: Annotated[
        Optional[float],  # noqa: UP045
        typer.Option(
            metavar='RATIO',
            show_default=False,
            help='Friction at the onset of motion over that in motion; 1.5 on the lathe and 1 on '
            'the ballscrew without it.',
        ),
    ] = None,
    load: Annotated[
        str, typer.Option(metavar='SHARE', help='Load against it, as share of the drive.')
    ] = '0%',
    load_at: Annotated[str, typer.Option(metavar='TIME', help='When the load sets in.')] = '0s',
    sensor: Annotated[
        Optional[str],  # noqa: UP045
        typer.Option(
            metavar='grating|encoder',
            show_default=False,
            help='Linear grating or encoder on the screw; by default the lathe has a grating.',
        ),
    ] = None,
    noise: Annotated[
        Optional[str],  # noqa: UP045
        typer.Option(
            metavar='LENGTH',
            show_default=False,
            help='RMS of the noise of the readings; 0.1um on the lathe, none on the ballscrew.',
        ),
    ] = None,
    duration: Annotated[str, typer.Option(metavar='TIME', help='Length of the run.')] = '3s',
    seed: Annotated[int, typer.Option(help='Seed of the noise.')] = 0,
    report: Report = None,
    json_file: JsonFile = None,
) -> None:
    """Move a simulated axis to a position and judge how it gets there.

    The lathe axis has a motor, friction with breakaway and a grating of 0.625 um; the ballscrew
    axis is the published EMPS benchmark. Judged is the true position, not what the sensor says.
    Exit code 1 if the controller gave up.

        fuzzycnc position --axis lathe --to -50mm
        fuzzycnc position --to 170mm --profile --gain 1.5 --load 10% --report move.html
        fuzzycnc position --axis ballscrew --to 100mm --friction 2
    """
    from fuzzycnc_ros.core.servo import position as moved
    from fuzzycnc_ros.report import positioning as shown

    check_axis(axis)
    target = signed('--to', to, LENGTHS, example='-50mm')
    if not STEP_MIN <= abs(target) <= TRAVEL:
        raise ValueError(
            f'--to: expected {1e6 * STEP_MIN:g} um to {1e3 * TRAVEL:g} mm either way, the travel '
            f'of the axis, but found {to!r}'
        )
    length = quantity('--duration', duration, TIMES, example='3s')
    if not DURATION_MIN <= length <= DURATION_MAX:
        raise ValueError(
            f'--duration: expected {DURATION_MIN:g} s to {DURATION_MAX:g} s but found {duration!r}'
        )
    if not GAIN_MIN <= gain <= GAIN_MAX:
        raise ValueError(f'--gain: expected {GAIN_MIN:g} to {GAIN_MAX:g} but found {gain:g}')
    check_at_least('--seed', seed, 0)
    check_at_least('--friction', friction, 0.0)
    check_at_least('--breakaway', breakaway, 1.0)
    for path in (report, json_file):
        check_folder(path)
    knobs = _knobs(axis, gain, friction, breakaway)
    knobs |= _load(axis, load, load_at)
    knobs['seed'] = ('--seed', seed)
    if sensor is not None:
        if sensor not in ('grating', 'encoder'):
            raise ValueError(f'--sensor: expected grating or encoder but found {sensor!r}')
        knobs['sensor'] = ('--sensor', sensor)
    if noise is not None:
        rms = quantity('--noise', noise, LENGTHS, example='0.1um', zero=True)
        knobs['noise'] = ('--noise', rms)
    if profile is None:
        profile = axis == 'ballscrew'
    plant = make_axis(axis, knobs)
    with warnings_said():
        chosen = make_controller(controller, axis, plant, _settings(params))
    # It is told of the load, as a machine's data tell of it, or it would take it for a run-away.
    limits = chosen.watch.limits
    pull = abs(signed('--load', load, SHARES, example='10%')) + BESIDE_LOAD
    chosen.watch.limits = dataclasses.replace(limits, load=max(limits.load, min(pull, 1.0)))
    run = moved(chosen, plant, _reference(target, profile, plant.period), length)
    table = shown.positioning_table(run, controller, _title(axis, to, profile))
    show(table)
    for line in shown.positioning_remarks(run):
        say(line)
    given = {name: value for name, (_, value) in knobs.items()}
    if report is not None:
        from fuzzycnc_ros.report.sections import render_page

        facts = {
            'Axis': axis,
            'Reference': 'jerk-limited profile' if profile else 'step',
            'Settings': str(params) if params is not None else 'built-in defaults',
            **{name.replace('_', ' '): str(value) for name, value in given.items()},
        }
        page = shown.positioning_page(run, controller, table, facts)
        write_text(report, render_page(page))
        say(f'{report}: the report; open it in a browser')
    settings = {'axis': axis, 'profile': profile, 'params': params, **given}
    write_json(json_file, shown.positioning_document(run, controller, settings))
    if run.fault:
        raise typer.Exit(1)


def _title(axis: str, to: str, profile: bool) -> str:
    return f'{axis} axis to {to}, by {"profile" if profile else "step"}'


def _settings(params: Path | None) -> Any:
    """Return the settings of a file, or none."""
    if params is None:
        return None
    from fuzzycnc_ros.cli.servo_settings import read_settings

    return read_settings(params)


def _reference(target: float, profile: bool, period: float) -> 'Reference | float':
    """Return where the axis is to be."""
    if not profile:
        return target
    from fuzzycnc_ros.core.servo import point_to_point

    return point_to_point(0.0, target).sample(period)


def _knobs(
    axis: str, gain: float, friction: float, breakaway: float | None
) -> dict[str, tuple[str, Any]]:
    """Return gain and friction as parameters of the axis."""
    from fuzzycnc_ros.core.machine import BallscrewAxisConfig, LatheAxisConfig

    knobs: dict[str, tuple[str, Any]] = {'gain_factor': ('--gain', gain)}
    if axis == 'lathe':
        plain = LatheAxisConfig()
        ratio = plain.breakaway / plain.coulomb if breakaway is None else breakaway
        knobs['coulomb'] = ('--friction', friction * plain.coulomb)
        knobs['breakaway'] = ('--friction', friction * plain.coulomb * ratio)
        return knobs
    screw = BallscrewAxisConfig()
    if friction:
        knobs['friction_factor'] = ('--friction', friction)
    else:  # the viscous part stays: it is what the model's lag is about
        knobs['coulomb_forward'] = knobs['coulomb_backward'] = ('--friction', 0.0)
    ratio = screw.breakaway_ratio if breakaway is None else breakaway
    knobs['breakaway_ratio'] = ('--breakaway', ratio)
    return knobs


def _load(axis: str, load: str, load_at: str) -> dict[str, tuple[str, Any]]:
    """Return the load as parameters of the axis."""
    share = signed('--load', load, SHARES, example='10%')
    if not -1.0 <= share <= 1.0:
        raise ValueError(f'--load: expected -100% to 100% of the drive but found {load!r}')
    if axis == 'ballscrew':
        from fuzzycnc_ros.core.machine import BallscrewAxisConfig

        share *= BallscrewAxisConfig().force_max
    time = quantity('--load-at', load_at, TIMES, example='2s', zero=True)
    return {'load': ('--load', share), 'load_time': ('--load-at', time)}

# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""`fuzzycnc position`: one move of a simulated axis."""

from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Optional

import typer

from fuzzycnc_ros.cli.axes.servo_axis import (
    AXES,
    CHOICES,
    DEFAULT,
    Axis,
    check_axis,
    check_controller,
    made_with,
    make_controller,
    warnings_said,
)
from fuzzycnc_ros.cli.completion import one_of
from fuzzycnc_ros.cli.console import (
    JsonFile,
    check_at_least,
    check_folder,
    say,
    show,
    write_json,
    write_report,
)
from fuzzycnc_ros.cli.options import (
    MachineFile,
    OptionalNumber,
    OptionalPath,
    OptionalText,
    Report,
    choice,
    given,
)
from fuzzycnc_ros.cli.quantities import quantity, signed_quantity
from fuzzycnc_ros.core.units import LENGTHS, SHARES, TIMES

if TYPE_CHECKING:
    from fuzzycnc_ros.core.machine.machine_data import AxisData, PlantConfig
    from fuzzycnc_ros.core.servo.controller import AxisController
    from fuzzycnc_ros.core.servo.profile import Reference
    from fuzzycnc_ros.simulation.servo.axes import AxisPlant

MACHINE_CHOICES = ('pid', 'cascade', 'linear_tangent', 'variable_universe')
"""Controllers of an axis of a machine file."""

SENSORS = ('grating', 'encoder')
"""Sensors of the position of an axis."""

DURATION_MIN, DURATION_MAX = 0.05, 120.0
"""Lengths of a run that are simulated [s]."""

GAIN_MIN, GAIN_MAX = 0.01, 100.0
"""Factors on the gain that are simulated."""

STEP_MIN = 1e-6
"""Least way of a move [m]."""

BESIDE_LOAD = 0.12
"""Friction beside the load [-], as duty."""


def position(
    to: Annotated[
        str,
        typer.Option(metavar='LENGTH', help='Where the axis goes from 0, such as -50mm.'),
    ],
    axis: Axis = '',
    machine_file: MachineFile = None,
    controller: Annotated[
        str,
        typer.Option(
            metavar='NAME',
            show_default=False,
            help=f'One of {", ".join(CHOICES)}; {DEFAULT} without this. The ballscrew has pid '
            f'without this, which won on it, and {DEFAULT}. With a machine file '
            f'{", ".join(MACHINE_CHOICES)}; its own without this.',
            autocompletion=one_of((*CHOICES, *MACHINE_CHOICES)),
        ),
    ] = '',
    params: Annotated[
        OptionalPath,
        given(
            'Rules as `servo learn` writes them, or settings of the controller.',
            metavar='FILE',
        ),
    ] = None,
    profile: Annotated[
        Optional[bool],  # noqa: UP045
        typer.Option(
            '--profile/--step',
            show_default=False,
            help='Whether the reference goes there by a jerk-limited profile (200 mm/s, '
            '1.5 m/s^2, 30 m/s^3, or the limits of the machine file), which is fed forward, or '
            'steps there; by default it steps on the lathe alone.',
        ),
    ] = None,
    gain: Annotated[float, typer.Option(metavar='FACTOR', help="Factor on the axis' gain.")] = 1.0,
    friction: Annotated[
        float,
        typer.Option(metavar='FACTOR', help="Factor on the axis' friction; 0 for none."),
    ] = 1.0,
    breakaway: Annotated[
        OptionalNumber,
        given(
            'Friction at the onset of motion over that in motion; 1.5 on the lathe and 1 on '
            'the ballscrew without it.',
            metavar='RATIO',
        ),
    ] = None,
    load: Annotated[
        str, typer.Option(metavar='SHARE', help='Load against it, as share of the drive.')
    ] = '0%',
    load_at: Annotated[str, typer.Option(metavar='TIME', help='When the load sets in.')] = '0s',
    sensor: Annotated[
        OptionalText,
        choice(
            'Linear grating or encoder on the screw; by default the lathe has a grating.',
            SENSORS,
            default=False,
        ),
    ] = None,
    noise: Annotated[
        OptionalText,
        given(
            'RMS of the noise of the readings; 0.1um on the lathe, none on the ballscrew.',
            metavar='LENGTH',
        ),
    ] = None,
    duration: Annotated[str, typer.Option(metavar='TIME', help='Length of the run.')] = '3s',
    seed: Annotated[int, typer.Option(help='Seed of the noise.')] = 0,
    report: Report = None,
    json_file: JsonFile = None,
) -> None:
    """Move a simulated axis to a position and judge how it gets there.

    The lathe axis has a motor, friction with breakaway and a grating of 0.625 µm; the ballscrew
    axis is the published EMPS benchmark. Judged is the true position, not what the sensor says.
    Exit code 1 if the controller gave up.

        fuzzycnc position --axis lathe --to -50mm
        fuzzycnc position --to 170mm --profile --gain 1.5 --load 10% --report move.html
        fuzzycnc position --axis ballscrew --to 100mm --friction 2
        fuzzycnc position --machine-file tuned.yaml --axis X --to 100mm --load 10%
    """
    from fuzzycnc_ros.simulation.servo.axes import simulated_axis
    from fuzzycnc_ros.simulation.servo.positioning import position as moved
    from fuzzycnc_ros.studies.servo import positioning_page as shown
    from fuzzycnc_ros.studies.servo.axis_tuning_tables import LABELS

    known = _known(machine_file, axis)
    axis, data = known.name, known.data
    target = signed_quantity('--to', to, LENGTHS, example='-50mm')
    low, high = data.limits.travel_low, data.limits.travel_high
    if not (STEP_MIN <= abs(target) and low <= target <= high):
        raise ValueError(
            f'--to: expected {1e6 * STEP_MIN:g} µm or more, from {1e3 * low:g} to {1e3 * high:g} '
            f'mm, the travel of the axis, but found {to!r}'
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
    check_folder(report, json_file)
    plain = known.plant
    knobs = _knobs(plain, gain, friction, breakaway)
    knobs |= _load(plain, load, load_at)
    knobs['seed'] = ('--seed', seed)
    if sensor is not None:
        knobs['sensor'] = ('--sensor', sensor)
    if noise is not None:
        rms = quantity('--noise', noise, LENGTHS, example='0.1um', zero=True)
        knobs['noise'] = ('--noise', rms)
    if profile is None:
        profile = axis != 'lathe'
    plant = made_with(partial(simulated_axis, data), knobs)
    controller = controller or known.controller(params)
    with warnings_said():
        chosen = _controller(known, controller, plant, params)
    # It is told of the load, as a machine's data tell of it, or it would take it for a run-away.
    limits = chosen.watch.limits
    pull = abs(signed_quantity('--load', load, SHARES, example='10%')) + BESIDE_LOAD
    chosen.watch.limits = replace(limits, load=max(limits.load, min(pull, 1.0)))
    reference = _reference(target, profile, plant.period, data.limits.positioning)
    run = moved(chosen, plant, reference, length)
    # An axis of a machine file has controllers of its own.
    label = (LABELS if known.machine else shown.LABELS)[controller]
    table = shown.positioning_table(run, label, _title(axis, to, profile))
    show(table)
    for line in shown.positioning_remarks(run):
        say(line)
    given = {name: value for name, (_, value) in knobs.items()}
    if report is not None:
        facts = {
            'Axis': axis,
            'Reference': 'jerk-limited profile' if profile else 'step',
            'Settings': str(params) if params is not None else 'built-in defaults',
            **{name.replace('_', ' '): str(value) for name, value in given.items()},
        }
        page = shown.positioning_page(run, label, table, facts)
        write_report(report, page)
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
    from fuzzycnc_ros.studies.servo.servo_settings import read_settings

    return read_settings(params)


def _reference(
    target: float, profile: bool, period: float, limits: tuple[float, float, float]
) -> 'Reference | float':
    """Return where the axis is to be."""
    if not profile:
        return target
    from fuzzycnc_ros.core.servo.profile import ProfileLimits, point_to_point

    velocity, acceleration, jerk = limits
    bounds = ProfileLimits(velocity=velocity, acceleration=acceleration, jerk=jerk)
    return point_to_point(0.0, target, bounds).sample(period)


@dataclass(frozen=True)
class KnownAxis:
    """The axis that is moved, and whether a machine file knows it."""

    name: str
    data: 'AxisData'
    machine: str

    @property
    def plant(self) -> 'PlantConfig':
        """Its model."""
        assert self.data.plant is not None
        return self.data.plant

    def controller(self, params: Path | None) -> str:
        """Return the controller that is taken without an option, with settings or without."""
        from fuzzycnc_ros.cli.axes.servo_machine import own_controller

        # Settings of a built-in axis are those of the variable universe.
        plain = self.machine or params is None
        return own_controller(self.data, params) if plain else DEFAULT


def _known(machine_file: str | None, axis: str) -> KnownAxis:
    """Return the axis that is meant: of a machine file, or one that is built in."""
    from fuzzycnc_ros.cli.axes.servo_machine import machine_axis

    if machine_file is not None:
        machine, name, data = machine_axis(machine_file, axis)
        return KnownAxis(name, data, machine.name)
    axis = axis or AXES[0]
    check_axis(axis)
    _, _, data = machine_axis(axis, '')
    return KnownAxis(axis, data, '')


def _controller(
    known: KnownAxis, name: str, plant: 'AxisPlant', params: Path | None
) -> 'AxisController':
    if not known.machine:
        settings = _settings(params)
        check_controller(name, known.name, settings)
        return make_controller(name, known.name, settings)
    from fuzzycnc_ros.cli.axes.servo_machine import machine_controller

    return machine_controller(known.data, known.name, name, params)


def _knobs(
    plain: 'PlantConfig', gain: float, friction: float, breakaway: float | None
) -> dict[str, tuple[str, Any]]:
    """Return gain and friction as parameters of the axis."""
    from fuzzycnc_ros.core.machine.axis_models import LatheAxisConfig

    knobs: dict[str, tuple[str, Any]] = {'gain_factor': ('--gain', gain)}
    if isinstance(plain, LatheAxisConfig):
        own = plain.breakaway / plain.coulomb if plain.coulomb else 1.0
        ratio = own if breakaway is None else breakaway
        knobs['coulomb'] = ('--friction', friction * plain.coulomb)
        knobs['breakaway'] = ('--friction', friction * plain.coulomb * ratio)
        return knobs
    if friction:
        knobs['friction_factor'] = ('--friction', friction)
    else:  # the viscous part stays: it is what the model's lag is about
        knobs['coulomb_forward'] = knobs['coulomb_backward'] = ('--friction', 0.0)
    ratio = plain.breakaway_ratio if breakaway is None else breakaway
    knobs['breakaway_ratio'] = ('--breakaway', ratio)
    return knobs


def _load(plain: 'PlantConfig', load: str, load_at: str) -> dict[str, tuple[str, Any]]:
    """Return the load as parameters of the axis."""
    share = signed_quantity('--load', load, SHARES, example='10%')
    if not -1.0 <= share <= 1.0:
        raise ValueError(f'--load: expected -100% to 100% of the drive but found {load!r}')
    if hasattr(plain, 'force_max'):
        share *= plain.force_max
    time = quantity('--load-at', load_at, TIMES, example='2s', zero=True)
    return {'load': ('--load', share), 'load_time': ('--load-at', time)}

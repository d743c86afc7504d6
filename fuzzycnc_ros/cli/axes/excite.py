# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""`fuzzycnc machine excite`: the program that an axis is recorded with."""

from pathlib import Path
from typing import Annotated

import typer

from fuzzycnc_ros.cli.console import check_new, say, write_text
from fuzzycnc_ros.cli.options import MachineFile, OptionalText, given
from fuzzycnc_ros.cli.quantities import in_declared_unit, quantity
from fuzzycnc_ros.core.units import SHARES, TIMES


def excite(
    out: Annotated[
        Path,
        typer.Argument(
            metavar='FILE.ngc|FILE.csv', help='G-code for LinuxCNC, or a table of set points.'
        ),
    ],
    machine_file: MachineFile = None,
    axis: Annotated[str, typer.Option(metavar='NAME', help='Axis that is recorded.')] = 'X',
    low: Annotated[
        OptionalText,
        given('Lowest position; that of the machine file without it.', metavar='LENGTH'),
    ] = None,
    high: Annotated[OptionalText, given('Highest position, likewise.', metavar='LENGTH')] = None,
    speed: Annotated[OptionalText, given('Largest speed, likewise.', metavar='SPEED')] = None,
    acceleration: Annotated[
        OptionalText, given('Largest acceleration, likewise, in mm/s^2.', metavar='ACCELERATION')
    ] = None,
    duty: Annotated[
        OptionalText,
        given(
            'Write duties that are added to what holds the axis, up to this share of the drive, '
            'instead of positions. The axis must be free to move and watched by hand.',
            metavar='SHARE',
        ),
    ] = None,
    to: Annotated[
        str, typer.Option(metavar='FREQUENCY', help='Frequency that the chirp ends at.')
    ] = '200Hz',
    seconds: Annotated[
        str, typer.Option(metavar='TIME', help='How long the chirp takes.')
    ] = '16s',
    period: Annotated[
        str, typer.Option(metavar='TIME', help='Control period of a table.')
    ] = '1ms',
) -> None:
    """Write the program that an axis is recorded with, for `fuzzycnc machine identify`.

    Moves of several lengths tell gain and friction, slow reversals what sticks, a chirp on a slow
    motion dead time and resonance. It stays within nine tenths of the travel and within speed and
    acceleration, or the duty. Record command (duty, torque or current), position and set point
    every millisecond while it runs; on LinuxCNC with `halsampler`.

        fuzzycnc machine excite x.ngc --machine-file mill.yaml --axis X
        fuzzycnc machine excite x.csv --low 0mm --high 300mm --speed 100mm/s
        --acceleration 500mm/s^2
        fuzzycnc machine excite duty.csv --machine-file mill.yaml --duty 40%
    """
    from dataclasses import replace

    from fuzzycnc_ros.core.identify.excitation import ExcitationLimits
    from fuzzycnc_ros.studies.servo.recording_program import (
        BLOCK,
        PER_BLOCK,
        gcode_program,
        table_program,
    )

    check_new(out)
    gcode = out.suffix.lower() in ('.ngc', '.nc', '.gcode')
    if not gcode and out.suffix.lower() != '.csv':
        raise ValueError(f'{out}: expected a name that ends in .ngc or .csv')
    if gcode and duty is not None:
        raise ValueError(
            f'--duty: expected none for {out}, as G-code commands positions; write a .csv'
        )
    known = _known(machine_file, axis)

    def value(option: str, text: str | None, unit: str, place: str) -> float:
        if text is not None:
            return in_declared_unit(option, text, unit)
        if place not in known:
            raise ValueError(
                f'{option}: expected a value such as {EXAMPLES[option]}, or a --machine-file that '
                'has the axis, but found none'
            )
        return known[place]

    ends = (
        value('--low', low, 'm', 'travel_low'),
        value('--high', high, 'm', 'travel_high'),
    )
    if not ends[0] < ends[1]:
        raise ValueError(
            f'--high: expected more than --low, {1e3 * ends[0]:g} mm, but found '
            f'{1e3 * ends[1]:g} mm'
        )
    room = 0.05 * (ends[1] - ends[0])
    limits = ExcitationLimits(
        low=ends[0] + room,
        high=ends[1] - room,
        velocity=value('--speed', speed, 'm/s', 'velocity'),
        acceleration=value('--acceleration', acceleration, 'm/s^2', 'acceleration'),
        frequency=in_declared_unit('--to', to, 'Hz'),
        seconds=quantity('--seconds', seconds, TIMES, example='16s'),
    )
    every = quantity('--period', period, TIMES, example='1ms')
    top = limits.frequency
    if gcode:
        top = min(top, 1.0 / (PER_BLOCK * BLOCK))
        about = (
            f'Recording program of fuzzycnc for axis {axis}: moves, slow reversals, chirp to '
            f'{top:g} Hz\nkeeps to {1e3 * limits.low:g} to {1e3 * limits.high:g} mm, '
            f'{1e3 * limits.velocity:g} mm/s, {1e3 * limits.acceleration:g} mm/s^2\n'
            'spindle off, nothing clamped, a hand at the emergency stop'
        )
        write_text(out, gcode_program(axis, limits, about))
        say(f'{out}: G-code; record command, position and set point while it runs')
    else:
        if not top < 0.4 / every:
            raise ValueError(
                f'--to: expected less than {0.4 / every:g} Hz at a period of {1e3 * every:g} ms '
                f'but found {to!r}'
            )
        if duty is not None:
            limits = replace(limits, duty=quantity('--duty', duty, SHARES, example='40%'))
        text, length = table_program(limits, every, duty=duty is not None)
        write_text(out, text)
        what = 'duties [-]' if duty is not None else 'set points [mm]'
        say(f'{out}: {what} for {length:.0f} s, one every {1e3 * every:g} ms')
    say(
        f'what it is worth: dead time and a resonance up to about {0.8 * top:.0f} Hz become known '
        'where the chirp moves the axis beyond the noise; gain and friction within some per cent'
    )
    say(
        'then: fuzzycnc machine identify recording.csv --columns t=...,command=...,position=...,'
        f'reference=... --axis {axis} --out axis.yaml'
    )


EXAMPLES = {
    '--low': '-100mm',
    '--high': '100mm',
    '--speed': '100mm/s',
    '--acceleration': '500mm/s^2',
}
"""Good values of options."""


def _known(machine_file: str | None, axis: str) -> dict[str, float]:
    """Return the limits of an axis of a machine file, by name."""
    if machine_file is None:
        return {}
    from fuzzycnc_ros.machine_file.reader import read_machine_file

    axes = read_machine_file(machine_file).axes
    if axis not in axes:
        raise ValueError(
            f'--axis: expected one of {", ".join(axes) or "(none)"}, as {machine_file} has them, '
            f'but found {axis!r}'
        )
    limits = axes[axis].limits
    names = ('travel_low', 'travel_high', 'velocity', 'acceleration')
    return {name: float(getattr(limits, name)) for name in names}

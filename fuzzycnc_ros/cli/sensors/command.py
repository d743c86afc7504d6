# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""`fuzzycnc sensors`: read the devices of a file once, and compare sensors at rest."""

from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from fuzzycnc_ros.cli.console import (
    JsonFile,
    check_folder,
    progress_bar,
    say,
    show,
    words,
    write_json,
)
from fuzzycnc_ros.cli.options import DropSensor, given
from fuzzycnc_ros.cli.quantities import number_in
from fuzzycnc_ros.core.units import DECLARED, TIMES

if TYPE_CHECKING:
    from fuzzycnc_ros.cli.sensors.readings import Recorded
    from fuzzycnc_ros.core.thermal.sensor_check import RestCheck

HELP = """Read sensors for the first time, and find those that are off.

    fuzzycnc sensors read devices.yaml
    fuzzycnc sensors check night

docs/how-to/your-sensors.md has a device file for each kind of sensor.
"""

DeviceFile = Annotated[
    Path, typer.Argument(metavar='FILE.yaml', help='Device file, as of temperature_acquisition.')
]
Duration = Annotated[
    float,
    given(
        'How long a device file is read, in s unless it has a unit [default: 5 min].',
        metavar='TIME',
        read=number_in(TIMES, 'a time'),
    ),
]
Tolerance = Annotated[
    float,
    given(
        'Difference that is none [default: 0.3 K].',
        metavar='KELVIN',
        read=number_in(DECLARED['K'][1], 'a temperature difference'),
    ),
]
HOUR = 3600.0


def read(file: DeviceFile, json_file: JsonFile = None) -> None:
    """Read each device of a file once, and show what each sensor reads or why it does not.

    Nothing is started or published, and no other program may hold the devices meanwhile. The exit
    code is 1 if a sensor has no reading.

        fuzzycnc sensors read devices.yaml
    """
    from fuzzycnc_ros.cli.sensors.readings import read_once
    from fuzzycnc_ros.studies.page.table import Column, Table

    check_folder(json_file)
    found = read_once(file)
    columns = (Column('Sensor', numeric=False), Column('degC'), Column('why not', numeric=False))
    rows = tuple(
        (
            name,
            '' if isinstance(value, str) else f'{value:.2f}',
            value if isinstance(value, str) else '',
        )
        for name, value in found.items()
    )
    show(Table('Readings', columns, rows))
    write_json(json_file, found)
    if any(isinstance(value, str) for value in found.values()):
        raise typer.Exit(1)


def check(
    recording: Annotated[
        Path,
        typer.Argument(
            metavar='RECORDING',
            help='Bag, CSV table (a time column in s and sensors in degC), or device file '
            '(.yaml), which is read for a while.',
        ),
    ],
    reference: Annotated[
        str, typer.Option(metavar='SENSOR', help='Sensor that is right [default: median].')
    ] = '',
    drop_sensor: DropSensor = None,
    time: Annotated[str, typer.Option(metavar='COLUMN', help='Time column of a table.')] = 'time',
    duration: Duration = 300.0,
    tolerance: Tolerance = 0.3,
    json_file: JsonFile = None,
) -> None:
    """Compare sensors of a machine that is at one temperature, as after a night.

    The quietest half hour of the recording counts. Sensors that read the median of all within
    the tolerance and their uncertainty agree; for the others the table says what to add to
    `offset` in the device file. It is refused where the machine plainly was not at rest. The exit
    code is 1 if sensors differ.

        fuzzycnc sensors check night
        fuzzycnc sensors check night.csv --time t --drop-sensor cabinet
        fuzzycnc sensors check devices.yaml --duration 10min --reference ambient
    """
    from fuzzycnc_ros.cli.sensors.readings import read_for, read_recording
    from fuzzycnc_ros.core.thermal.sensor_check import NotAtRestError, check_at_rest

    check_folder(json_file)
    if recording.suffix in ('.yaml', '.yml'):
        with progress_bar('Reading') as tell:
            recorded = read_for(recording, duration, tell)
    else:
        recorded = read_recording(recording, time)
    recorded = recorded.without(words(drop_sensor or []))
    try:
        found = check_at_rest(
            recorded.time,
            recorded.temperature,
            recorded.sensor,
            recorded.speed,
            reference,
            tolerance,
        )
    except NotAtRestError as error:
        raise NotAtRestError(f'{recording}: {error}') from error
    _show(found, recorded)
    write_json(json_file, {**asdict(found), 'offsets': _offsets(found, recorded)})
    if any(item.verdict != 'agrees' for item in found.sensors):
        raise typer.Exit(1)


def _offsets(found: 'RestCheck', recorded: 'Recorded') -> dict[str, float]:
    """Return the offset to write of each sensor that differs [K]; what to add if none is known."""
    return {
        item.sensor: recorded.offset.get(item.sensor, 0.0) + item.offset
        for item in found.sensors
        if item.offset
    }


def _show(found: 'RestCheck', recorded: 'Recorded') -> None:
    from fuzzycnc_ros.studies.page.table import Column, case_table

    offsets = _offsets(found, recorded)
    heading = 'offset to write' if recorded.offset else 'add to offset'
    source = found.reference_sensor or 'the median of those that agree'
    table = case_table(
        f'Sensors against {source}, {found.reference:.2f} degC',
        zip(found.sensors),
        {
            Column('Sensor', numeric=False): lambda item: item.sensor,
            Column('mean [degC]'): lambda item: f'{item.temperature:.2f}',
            Column('difference [K]'): lambda item: f'{item.difference:+.2f}',
            Column('uncertainty [K]'): lambda item: f'{item.uncertainty:.2f}',
            Column('drift [K/h]'): lambda item: f'{item.drift:+.2f}',
            Column('verdict', numeric=False): lambda item: item.verdict,
            Column(f'{heading} [K]'): lambda item: (
                f'{offsets[item.sensor]:+.2f}' if item.sensor in offsets else ''
            ),
        },
        lambda item: () if item.verdict == 'agrees' else (2,),
    )
    show(table)
    say(
        f'Evidence: {found.readings} readings from {found.start / HOUR:.2f} h to '
        f'{found.stop / HOUR:.2f} h, the quietest time of the recording.'
    )
    if found.quiet == found.quiet:
        say(f'The spindle is known to have been at rest for {found.quiet / HOUR:.1f} h by then.')
    else:
        say('Nothing is known of the spindle: that the machine was off for a night is your word.')


COMMANDS: dict[str, Callable[..., Any]] = {'read': read, 'check': check}

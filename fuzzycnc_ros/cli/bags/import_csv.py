# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""`fuzzycnc import-csv`: a table of a real machine becomes a bag."""

import re
from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Optional

import typer

from fuzzycnc_ros.cli.completion import one_of
from fuzzycnc_ros.cli.console import JsonFile, check_folder, progress_bar, say, words, write_json
from fuzzycnc_ros.cli.options import OptionalPath, SensorLimits, given
from fuzzycnc_ros.cli.quantities import number_in
from fuzzycnc_ros.core.units import TIMES

if TYPE_CHECKING:
    from fuzzycnc_ros.files.yaml_file import Entry, YamlReading

OptionalText = Optional[str]  # noqa: UP045 - typer 0.9 does not read the newer form
OptionalNumber = Optional[float]  # noqa: UP045
Texts = Optional[list[str]]  # noqa: UP045


def import_csv(
    file: Annotated[Path, typer.Argument(metavar='FILE', help='Table with a header line.')],
    out: Annotated[Path, typer.Option(metavar='BAG', help='Directory of the new bag.')],
    time: Annotated[
        OptionalText,
        typer.Option(
            show_default=False,
            help='Time column, or two as DATE+TIME [default: time].',
        ),
    ] = None,
    time_unit: Annotated[
        OptionalText,
        given(
            's, ms, min, h, d or iso8601 [default: s].',
            metavar='UNIT',
            complete=one_of(('s', 'ms', 'min', 'h', 'd', 'iso8601')),
        ),
    ] = None,
    time_format: Annotated[
        OptionalText,
        typer.Option(
            show_default=False,
            help='Form of dates or times of day, such as %d.%m.%Y %H:%M:%S or '
            'dd.mm.yyyy hh:mm:ss [default: usual ones are recognised].',
        ),
    ] = None,
    time_zone: Annotated[
        OptionalText,
        given(
            'Zone of dates that name none, such as Europe/Berlin, UTC or +01:00 [default: that '
            'of this computer].',
            metavar='ZONE',
        ),
    ] = None,
    temperature: Annotated[
        Texts,
        typer.Option(
            show_default=False,
            help="Temperature columns: names or patterns such as 't*', or re: and a regular "
            'expression; repeat it, or put commas between.',
        ),
    ] = None,
    temperature_unit: Annotated[
        OptionalText,
        given(
            'degC, K or degF [default: degC].',
            metavar='UNIT',
            complete=one_of(('degC', 'K', 'degF')),
        ),
    ] = None,
    displacement: Annotated[
        Texts,
        typer.Option(
            show_default=False,
            metavar='COLUMN=AXIS:UNIT',
            help='Displacement columns with ISO 841 axis and unit (um, mm, m, nm), such as '
            'ch1=Z:um, or ch1=-Z:um for a probe that counts against the axis; repeat it, or put '
            'commas between.',
        ),
    ] = None,
    speed: Annotated[
        OptionalText, typer.Option(show_default=False, help='Spindle-speed column.')
    ] = None,
    speed_unit: Annotated[
        OptionalText,
        given('rpm or rad/s [default: rpm].', metavar='UNIT', complete=one_of(('rpm', 'rad/s'))),
    ] = None,
    sensor_limits: SensorLimits = None,
    rename: Annotated[
        Texts,
        typer.Option(
            show_default=False,
            metavar='COLUMN=NAME',
            help='Another name for a sensor or channel; repeat.',
        ),
    ] = None,
    encoding: Annotated[
        OptionalText,
        typer.Option(
            show_default=False,
            help='Encoding of the file, such as cp1252 of a German Excel, latin-1 or utf-16 '
            '[default: utf-8].',
        ),
    ] = None,
    header: Annotated[
        Optional[bool],  # noqa: UP045
        typer.Option(
            '--header/--no-header',
            show_default=False,
            help='Whether the first line names the columns; if not, they are called c1, c2 and '
            'so on [default: header].',
        ),
    ] = None,
    delimiter: Annotated[
        OptionalText,
        typer.Option(show_default=False, help='Character between columns [default: found out].'),
    ] = None,
    decimal: Annotated[
        OptionalText, typer.Option(show_default=False, help='Decimal sign [default: .].')
    ] = None,
    rows: Annotated[
        OptionalText,
        typer.Option(
            show_default=False,
            metavar='FIRST:LAST',
            help='Rows to import, counted from 0, both included.',
        ),
    ] = None,
    zero: Annotated[
        bool, typer.Option('--zero', help='Take displacements against their first three minutes.')
    ] = False,
    resample: Annotated[
        OptionalNumber,
        given(
            'Put uneven rows on an even grid of this interval, in s unless it has a unit.',
            metavar='TIME',
            read=number_in(TIMES, 'a time'),
        ),
    ] = None,
    machine: Annotated[
        OptionalText,
        typer.Option(show_default=False, help='Namespace of the topics [default: machine].'),
    ] = None,
    epoch: Annotated[
        OptionalNumber,
        given(
            'Stamp of the first sample, in s unless it has a unit [default: 1 s].',
            metavar='TIME',
            read=number_in(TIMES, 'a time'),
        ),
    ] = None,
    mapping: Annotated[
        OptionalPath,
        given(
            'File with these settings: keys time, time_unit, time_format, time_zone, '
            'temperatures, temperature_unit, sensor_limits, displacements, spindle_speed, '
            'spindle_speed_unit, drives, rename, encoding, header, delimiter, decimal, rows, '
            'zero, resample, machine, epoch. '
            'Options overrule it.',
            metavar='FILE.yaml',
        ),
    ] = None,
    json_file: JsonFile = None,
) -> None:
    r"""Import the recording of a real machine from a CSV table into a bag.

    The bag gets the topics `temperatures`, `displacement`, `machine_state` (with --speed) and
    `thermal_reference` (from the first three minutes) and can be trained on, evaluated and
    played. Every row is checked first: nothing is written if a cell, a time or a unit is wrong.
    What can be imported but looks like a mistake is a warning with its remedy: another unit, a
    value far off its neighbours.

        fuzzycnc import-csv spindle_thermal.csv --out spindle --time t \
            --temperature 't*' --speed rpm \
            --displacement ch1=X:um,ch2=X:um,ch3=Y:um,ch4=Y:um,ch5=Z:um
        fuzzycnc import-csv Export.csv --out export --encoding cp1252 --decimal , \
            --time Zeit --temperature 'T*' --displacement 'Y [mm]=Y:mm'
        fuzzycnc import-csv log.csv --out log --mapping log.yaml --resample 60
    """
    from fuzzycnc_ros.bags.csv_import import import_csv as convert
    from fuzzycnc_ros.bags.csv_mapping import CsvMapping

    check_folder(json_file)
    given = {
        'time': time,
        'time_unit': time_unit,
        'time_format': time_format,
        'time_zone': time_zone,
        'temperatures': list(words(temperature)) if temperature else None,
        'temperature_unit': temperature_unit,
        'sensor_limits': sensor_limits or None,
        'displacements': list(words(displacement)) if displacement else None,
        'spindle_speed': speed,
        'spindle_speed_unit': speed_unit,
        'rename': _pairs(rename) if rename else None,
        'encoding': encoding,
        'header': header,
        'delimiter': delimiter,
        'decimal': decimal,
        'rows': _row_range(rows) if rows else None,
        'zero': zero or None,
        'resample': resample,
        'machine': machine,
        'epoch': epoch,
    }
    known = [item.name for item in fields(CsvMapping)]
    settings = _read_mapping(mapping, known) if mapping is not None else {}
    settings |= {key: value for key, value in given.items() if value is not None}
    chosen = CsvMapping(**settings)
    with progress_bar(f'importing {file.name}'):
        report = convert(file, out, chosen)
    say(
        f'{report.path}: {report.samples} samples, one every {report.interval:g} s, '
        f'{len(report.sensors)} sensors, {len(report.channels)} displacement channels'
    )
    if report.missing:
        say(f'{report.missing} temperature readings are missing and marked so')
    for line in report.remarks:
        say(line)
    for line in report.doubts:
        say(f'warning: {line}')
    write_json(
        json_file,
        {
            'bag': str(report.path),
            'samples': report.samples,
            'interval_s': report.interval,
            'start_s': report.start,
            'sensors': report.sensors,
            'channels': report.channels,
            'missing': report.missing,
            'remarks': report.remarks,
            'warnings': report.doubts,
        },
    )


def _pairs(texts: list[str]) -> dict[str, str]:
    pairs = [text.partition('=') for text in words(texts)]
    wrong = [''.join(pair) for pair in pairs if not (pair[0] and pair[2])]
    if wrong:
        raise ValueError(f'--rename: expected COLUMN=NAME but found {wrong[0]!r}')
    return {column: name for column, _, name in pairs}


def _row_range(text: str) -> tuple[int, int]:
    first, _, last = text.partition(':')
    try:
        return int(first), int(last)
    except ValueError:
        raise ValueError(
            f'--rows: expected FIRST:LAST such as 0:5790 but found {text!r}'
        ) from None


def _read_mapping(path: Path, known: list[str]) -> dict[str, Any]:
    """Return the settings of a mapping file.

    Raises
    ------
    ValueError
        If it is no mapping of the known settings.
    """
    from fuzzycnc_ros.files.yaml_file import YamlReading

    reading = YamlReading(path, 'a mapping of columns', noun='setting')
    settings = reading.top('settings such as `time: t`')
    reading.known(settings, known, '', f'expected {", ".join(known)}')
    return {key: _setting(reading, key, entry) for key, entry in settings.items()}


def _setting(reading: 'YamlReading', key: str, entry: 'Entry') -> Any:
    """Return a setting in the form that `CsvMapping` takes; YAML types it by its looks."""
    if key in ('rename', 'drives'):
        pairs = reading.mapping(entry, key, 'pairs such as column: name')
        return {column: str(reading.value(name)) for column, name in pairs.items()}
    if key in ('resample', 'epoch'):
        return reading.number(entry, key, 's')
    value = reading.value(entry)
    if key in ('temperatures', 'displacements', 'sensor_limits'):
        return [str(item) for item in (value if isinstance(value, list) else [value])]
    wanted = ''
    if key == 'rows':
        if isinstance(value, str) and re.fullmatch(r'\d{1,9}:\d{1,9}', value):
            return _row_range(value)
        if isinstance(value, list) and [type(item) for item in value] == [int, int]:
            return tuple(value)
        wanted = '[first, last] or FIRST:LAST'
    elif key in ('zero', 'header'):
        if isinstance(value, bool):
            return value
        wanted = 'true or false'
    if wanted:
        raise reading.wrong(entry.line, key, f'expected {wanted} but found {value!r}')
    return str(value)

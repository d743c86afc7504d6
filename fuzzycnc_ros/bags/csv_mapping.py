# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Meaning of the columns of a CSV recording."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from fnmatch import fnmatchcase
from pathlib import Path

from fuzzycnc_ros.bags.csv_table import CsvTable, read_table
from fuzzycnc_ros.bags.csv_time import ISO8601, strptime_form, zone_of
from fuzzycnc_ros.bags.errors import CsvError
from fuzzycnc_ros.core.thermal.run import DRIVE_NAME, DRIVE_NAMES
from fuzzycnc_ros.core.units import LENGTHS, SPEEDS, TIMES

LENGTH_UNITS = {**{unit: LENGTHS[unit] for unit in ('um', 'mm', 'm')}, 'nm': 1e-9}
TEMPERATURE_UNITS = {'degC': (1.0, 0.0), 'K': (1.0, -273.15), 'degF': (5.0 / 9.0, -160.0 / 9.0)}
AXES = 'XYZABCUVW'

_CHANNEL = re.compile(
    r'(?P<column>.+)=(?P<sign>[+-]?)(?P<axis>\w+):(?P<unit>\w+)'
    r'(@(?P<position>[-+]?[\d.]+)(?P<position_unit>[a-z]+)|@(?P<place>.+):(?P<place_unit>\w+))?'
)
_MACHINE = re.compile(r'[A-Za-z][A-Za-z0-9_]*')


@dataclass(frozen=True)
class DisplacementColumn:
    """A displacement column.

    Parameters
    ----------
    column : str
        Its name in the file.
    axis : str
        ISO 841 axis.
    unit : {'um', 'mm', 'm', 'nm'}
        Its unit.
    sign : {1, -1}
        -1 for a probe that counts against the axis.
    position : float, optional
        Where on the axis it was measured, machine coordinates [m].
    place : str
        Column that tells the position of each row instead; empty if none does.
    place_unit : {'mm', 'm', 'um', 'nm'}
        Unit of that column.
    """

    column: str
    axis: str
    unit: str = 'um'
    sign: int = 1
    position: float | None = None
    place: str = ''
    place_unit: str = 'mm'

    def __post_init__(self) -> None:
        """Refuse axes and units that do not exist."""
        if self.axis not in AXES or len(self.axis) != 1:
            raise CsvError(
                f'column {self.column!r}: expected an axis of {", ".join(AXES)} '
                f'but found {self.axis!r}'
            )
        _word(f'unit of column {self.column!r}', self.unit, LENGTH_UNITS)
        _word(f'unit of column {self.place!r}', self.place_unit, LENGTH_UNITS)
        if self.sign not in (1, -1):
            raise CsvError(f'column {self.column!r}: expected sign 1 or -1, found {self.sign}')

    @property
    def scale(self) -> float:
        """Metres per unit of the column, with its sign."""
        return self.sign * LENGTH_UNITS[self.unit]


def parse_channel(text: str) -> DisplacementColumn:
    """Return the channel that a text such as `ch1=X:um` or `probe 2=-Y:mm` describes.

    Behind an `@` it says where on the axis that is: `ch1=X:um@-400mm`, or in which column of the
    file, `ch1=X:um@pos:mm`.

    Raises
    ------
    CsvError
        If the text has another form, or axis or unit do not exist.

    Examples
    --------
    >>> found = parse_channel('ch1=-X:um@-400mm')
    >>> found.column, found.axis, found.unit, found.sign, found.position
    ('ch1', 'X', 'um', -1, -0.4)
    """
    match = _CHANNEL.fullmatch(text)
    if match is None:
        raise CsvError(
            'displacement: expected COLUMN=AXIS:UNIT such as ch1=X:um, or ch1=X:um@-400mm, '
            f'but found {text!r}'
        )
    position = None
    if match['position'] is not None:
        _word(f'position of column {match["column"]!r}', match['position_unit'], LENGTH_UNITS)
        try:
            position = float(match['position']) * LENGTH_UNITS[match['position_unit']]
        except ValueError:
            raise CsvError(
                f'displacement: expected a number behind @ but found {text!r}'
            ) from None
    return DisplacementColumn(
        match['column'],
        match['axis'],
        match['unit'],
        -1 if match['sign'] == '-' else 1,
        position,
        match['place'] or '',
        match['place_unit'] or 'mm',
    )


@dataclass(frozen=True, kw_only=True)
class CsvMapping:
    """Meaning of the columns of a CSV recording.

    Parameters
    ----------
    time : str
        Time column, or those of date and time of day with a `+` between.
    time_unit : {'s', 'ms', 'min', 'h', 'iso8601'}
        Its unit, or `iso8601` for dates such as 2024-05-01T08:00:00Z.  Dates and times of day
        in a usual form are recognised, whatever the unit.
    time_format : str, optional
        Form of dates or times of day, as `strptime` or a spreadsheet writes it.
    time_zone : str, optional
        Zone of dates that name none: a name of the IANA such as `Europe/Berlin`, or an offset
        such as `+01:00`; that of this computer if absent.
    temperatures : sequence of str
        Temperature columns: names, patterns such as `t*`, or regular expressions after `re:`.
        Columns that have another meaning are never matched by a pattern.
    temperature_unit : {'degC', 'K', 'degF'}
        Unit of the temperatures.
    displacements : sequence of DisplacementColumn or str
        Displacement columns, as texts in the form of `parse_channel`.
    spindle_speed : str, optional
        Spindle-speed column.
    spindle_speed_unit : {'rpm', 'rad/s'}
        Its unit.
    drives : mapping
        Drives that the control told, to their columns: `axis_speed/X` [m/s],
        `axis_square_speed/X` [m2/s2], `axis_moment/X` [m2/s], `axis_second_moment/X` [m3/s],
        `spindle_load` [-] and `coolant` [0 or 1], each the mean since the row before.
    sensor_limits : sequence of str
        Limits of sensors that are not those of a machine's metal, such as `bed:range_high:250`;
        the names are those of the columns.
    rename : mapping
        Column name to the name of the sensor or channel in the bag.
    encoding : str
        Encoding of the file.
    header : bool
        Whether the first line names the columns; if not, they are called c1, c2 and so on.
    delimiter : str, optional
        Character between columns; found out if absent.  Where it is the decimal sign too, the
        file puts its numbers in quotation marks.
    decimal : {'.', ','}
        Decimal sign.
    rows : (int, int), optional
        First and last row that are imported, counted from 0 below the header.
    zero : bool
        Whether displacements are meant against their mean over the thermal reference.
    resample : float, optional
        Interval of the samples in the bag [s]; as in the file if absent.
    machine : str
        Name of the machine: the namespace of the topics and the first part of `frame_id`.
    epoch : float, optional
        Stamp of the first sample [s]; 1 if absent, since stamp 0 means unknown in messages;
        with dates the first one itself.
    """

    time: str = 'time'
    time_unit: str = 's'
    time_format: str | None = None
    time_zone: str | None = None
    temperatures: Sequence[str] = ()
    temperature_unit: str = 'degC'
    sensor_limits: Sequence[str] = ()
    displacements: Sequence[DisplacementColumn | str] = ()
    spindle_speed: str | None = None
    spindle_speed_unit: str = 'rpm'
    drives: Mapping[str, str] = field(default_factory=dict)
    rename: Mapping[str, str] = field(default_factory=dict)
    encoding: str = 'utf-8'
    header: bool = True
    delimiter: str | None = None
    decimal: str = '.'
    rows: tuple[int, int] | None = None
    zero: bool = False
    resample: float | None = None
    machine: str = 'machine'
    epoch: float | None = None

    def __post_init__(self) -> None:
        """Refuse what contradicts itself."""
        _word('time_unit', self.time_unit, {**TIMES, ISO8601: 1.0})
        _word('temperature_unit', self.temperature_unit, TEMPERATURE_UNITS)
        _word('spindle_speed_unit', self.spindle_speed_unit, SPEEDS)
        for name in self.drives:
            if not DRIVE_NAME.fullmatch(name):
                raise CsvError(f'drives: expected {DRIVE_NAMES} but found {name!r}')
        if self.time_format is not None:
            try:
                object.__setattr__(self, 'time_format', strptime_form(self.time_format))
            except ValueError as error:
                raise CsvError(f'time_format: {error}') from error
        zone_of(self.time_zone)
        try:
            ''.encode(self.encoding)
        except LookupError as error:
            raise CsvError(
                f'encoding: expected a text encoding such as utf-8, cp1252, latin-1 or utf-16 but '
                f'found {self.encoding!r}'
            ) from error
        if self.decimal not in ('.', ','):
            raise CsvError(f"decimal: expected '.' or ',' but found {self.decimal!r}")
        if self.delimiter is not None and (len(self.delimiter) != 1 or self.delimiter in '"\r\n'):
            raise CsvError(f'delimiter: expected one character but found {self.delimiter!r}')
        if self.rows is not None and not 0 <= self.rows[0] <= self.rows[1]:
            raise CsvError(f'rows: expected 0 <= first <= last but found {self.rows}')
        if self.resample is not None and not 0.0 < self.resample < 1e6:
            raise CsvError(f'resample: expected an interval above 0 s but found {self.resample}')
        if self.epoch is not None and not 0.0 <= self.epoch < 2**31:
            raise CsvError(f'epoch: expected 0 to 2^31 s but found {self.epoch}')
        if not _MACHINE.fullmatch(self.machine):
            raise CsvError(f'machine: expected letters, digits and _ but found {self.machine!r}')
        channels = [
            c if isinstance(c, DisplacementColumn) else parse_channel(c)
            for c in self.displacements
        ]
        object.__setattr__(self, 'displacements', tuple(channels))

    @property
    def channels(self) -> tuple[DisplacementColumn, ...]:
        """The displacement columns."""
        return tuple(c for c in self.displacements if isinstance(c, DisplacementColumn))

    def table(self, path: Path) -> CsvTable:
        """Read the rows of a file that the mapping selects.

        Raises
        ------
        CsvError
            If the file cannot be read as `read_table` says.
        """
        return read_table(
            path,
            encoding=self.encoding,
            delimiter=self.delimiter,
            decimal=self.decimal,
            header=self.header,
            rows=self.rows,
        )

    def sensor_columns(self, header: Sequence[str]) -> list[str]:
        """Return the temperature columns of a file in its own order.

        Raises
        ------
        CsvError
            If a name or pattern fits no column.
        """
        taken = {self.time, self.spindle_speed, *self.drives.values()}
        taken.update(channel.column for channel in self.channels)
        chosen: set[str] = set()
        names = frozenset(header)
        for pattern in self.temperatures:
            if pattern in names:
                chosen.add(pattern)
                continue
            fits = [name for name in header if name not in taken and _matches(name, pattern)]
            if not fits:
                raise CsvError(
                    f'expected a temperature column {pattern!r} but the file has '
                    f'{", ".join(header)}; name one with --temperature'
                )
            chosen.update(fits)
        return [name for name in header if name in chosen]


def _matches(name: str, pattern: str) -> bool:
    if not pattern.startswith('re:'):
        return fnmatchcase(name, pattern)
    try:
        return re.fullmatch(pattern[3:], name) is not None
    except re.error as error:
        raise CsvError(
            f'temperatures: expected a regular expression after re: but found {pattern[3:]!r} '
            f'({error})'
        ) from error


def _word(name: str, value: str, words: Mapping[str, object]) -> None:
    if value not in words:
        raise CsvError(f'{name}: expected {", ".join(words)} but found {value!r}')

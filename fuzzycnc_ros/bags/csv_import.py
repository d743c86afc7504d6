# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""CSV recordings of real machines, read as records and imported into bags."""

import os
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from math import nan
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fuzzycnc_ros.bags.csv_mapping import (
    LENGTH_UNITS,
    TEMPERATURE_UNITS,
    CsvMapping,
    DisplacementColumn,
)
from fuzzycnc_ros.bags.csv_table import CsvTable, Times
from fuzzycnc_ros.bags.csv_time import ISO8601, known_forms
from fuzzycnc_ros.bags.errors import CsvError
from fuzzycnc_ros.bags.metadata import LATCHED, STREAM
from fuzzycnc_ros.bags.runs import thermal_run
from fuzzycnc_ros.bags.typestore import ROSBAGS
from fuzzycnc_ros.bags.writer import BagWriter
from fuzzycnc_ros.components.thermal.control_drives import COUNTERS
from fuzzycnc_ros.components.thermal.predictor_stream import STATE
from fuzzycnc_ros.core.names import repeated_names
from fuzzycnc_ros.core.thermal.no_reading import FAR, values_without_reading
from fuzzycnc_ros.core.thermal.plausibility import (
    DISPLACEMENT_STEP,
    TEMPERATURE_STEP,
    WARMING_MAX,
    WARMING_MIN,
    Outlier,
    lone_values,
    odd_pace,
    offset_channels,
)
from fuzzycnc_ros.core.thermal.run import (
    DISPLACEMENT_MAX,
    REFERENCE_SAMPLES,
    SAMPLES_MIN,
    TEMPERATURE_MAX,
    TEMPERATURE_MIN,
    ThermalRun,
    temperature_range,
)
from fuzzycnc_ros.core.thermal.sensor_limits import SensorLimits
from fuzzycnc_ros.core.thermal.spacing import block_means, reference_rows, sample_interval
from fuzzycnc_ros.core.units import SPEEDS, TIMES
from fuzzycnc_ros.runtime.convert import encode
from fuzzycnc_ros.runtime.enums import Coolant, MachineMode, Status
from fuzzycnc_ros.runtime.records import (
    Displacement,
    MachineState,
    Record,
    Temperatures,
    ThermalReference,
)

DISPLACEMENT_MIN = 0.5e-6
"""A machine that warms by `WARM` moves by more than this on some channel [m]."""

WARM = 5.0
"""Rise that is bound to move a machine [K]."""

GRID_MAX = 10_000_000
"""Most samples that resampling makes; a week at 10 Hz has 6 million."""

COLD_MIN, COLD_MAX = 5.0, 45.0
"""Temperatures between which a machine is started [degC]."""

EMPTY_SHARE = 0.1
"""Share of samples without a reading from which an interval is doubted [-]."""

LINES_MAX = 3
"""Single values of a file that are named."""

_BRACKETED = re.compile(r'[\[(]\s*([^\s\])]+)\s*[\])]\s*$')
_APPENDED = re.compile(r'[_ /](°?[A-Za-z]{2,})\s*$')  # a single letter may as well be a place
_NAMES: Mapping[str, Mapping[str, str]] = {
    '--time-unit': {
        's': 's', 'sec': 's', 'ms': 'ms', 'msec': 'ms', 'min': 'min', 'h': 'h', 'hours': 'h',
        'd': 'd', 'days': 'd',
    },
    '--temperature-unit': {
        '°C': 'degC', 'degC': 'degC', 'C': 'degC', '°F': 'degF', 'degF': 'degF', 'F': 'degF',
        'K': 'K',
    },
    '--displacement': {
        'um': 'um', '\xb5m': 'um', '\u03bcm': 'um', 'mm': 'mm', 'm': 'm', 'nm': 'nm',
    },
}  # fmt: skip


PLACES_MAX = 20
"""Most places along an axis that a column may tell."""


@dataclass(frozen=True)
class ImportReport:
    """Result of an import.

    Parameters
    ----------
    path : Path
        The bag.
    samples : int
        Samples on each topic.
    interval : float
        Time between samples [s].
    start : float
        Stamp of the first sample [s].
    sensors, channels : tuple of str
        Names in the bag.
    missing : int
        Temperature readings that the file lacks.
    remarks : tuple of str
        What was recognised in the file, a sentence each.
    doubts : tuple of str
        What looks like a mistake though it was imported, a sentence each with the remedy.
    """

    path: Path
    samples: int
    interval: float
    start: float
    sensors: tuple[str, ...]
    channels: tuple[str, ...]
    missing: int
    remarks: tuple[str, ...] = ()
    doubts: tuple[str, ...] = ()


@dataclass(frozen=True)
class _ColumnData:
    """The columns in SI units; `speed` and `drives` have no columns where none is mapped."""

    time: NDArray[np.float64]
    temperature: NDArray[np.float64]
    displacement: NDArray[np.float64]
    speed: NDArray[np.float64]
    drives: NDArray[np.float64]
    readings: int = 0


@dataclass(frozen=True)
class CsvRecording:
    """A CSV recording in SI units, as the records that a machine would have published.

    Parameters
    ----------
    path : Path
        The file.
    mapping : CsvMapping
        Meaning of its columns.
    data : _ColumnData
        Its columns.
    stamps : ndarray, shape (n,)
        Stamps of the samples [ns].
    start : float
        Stamp of the first sample [s].
    sensors, channels : tuple of str
        Names of temperatures and displacements.
    facts : mapping
        Metadata of a bag that holds it.
    remarks, doubts : tuple of str
        See `ImportReport`.
    """

    path: Path
    mapping: CsvMapping
    data: _ColumnData
    stamps: NDArray[np.int64]
    start: float
    sensors: tuple[str, ...]
    channels: tuple[str, ...]
    facts: Mapping[str, str]
    remarks: tuple[str, ...]
    doubts: tuple[str, ...]

    @property
    def types(self) -> dict[str, str]:
        """Topic below the machine's name -> its type."""
        found: dict[str, str] = {'temperatures': Temperatures.TYPE}
        if self.channels:
            found['displacement'] = Displacement.TYPE
        if self._has_states:
            found['machine_state'] = MachineState.TYPE
        return found | {'thermal_reference': ThermalReference.TYPE}

    @property
    def _has_states(self) -> bool:
        return self.mapping.spindle_speed is not None or bool(self.mapping.drives)

    def run(self) -> ThermalRun:
        """Return it as a thermal run, the one that `read_run` finds in a bag of it.

        Raises
        ------
        CsvError
            If no displacements are mapped.
        RunError
            If it holds no thermal run; see `read_run`.
        """
        if not self.channels:
            raise CsvError(
                f'{self.path}: expected at least one column of displacements but none is mapped; '
                'name them with --displacement'
            )
        topics = ('temperatures', 'displacement', {STATE: STATE})
        return thermal_run(self.path, topics, self.records())

    def records(self) -> Iterator[tuple[str, Record]]:
        """Yield topic and record in the order of the stamps."""
        machine, mapping, data = self.mapping.machine, self.mapping, self.data
        cold_since = int(self.stamps[0])
        first_rows = reference_rows(data.time)
        position = np.array(
            [np.nan if item.position is None else item.position for item in mapping.channels]
        )
        told = _told(mapping, data)
        for k, stamp in enumerate(self.stamps.tolist()):
            temperature = data.temperature[k]
            if self._has_states:
                speed = float(data.speed[k, 0]) if mapping.spindle_speed is not None else nan
                state = _machine_state(machine, stamp, cold_since, speed)
                yield 'machine_state', replace(state, **{n: v[k] for n, v in told.items()})
            yield (
                'temperatures',
                Temperatures(
                    stamp=stamp,
                    frame_id=f'{machine}/machine',
                    sensor=self.sensors,
                    temperature=temperature,
                    status=np.where(np.isnan(temperature), Status.MISSING, Status.OK),
                    readings=min(data.readings, 2**16 - 1),
                ),
            )
            if self.channels:
                yield (
                    'displacement',
                    Displacement(
                        stamp=stamp,
                        frame_id=f'{machine}/workpiece',
                        axis=tuple(channel.axis for channel in mapping.channels),
                        channel=self.channels,
                        displacement=data.displacement[k],
                        # How well they were measured no CSV file says.
                        standard_deviation=np.full(len(self.channels), np.nan),
                        includes_compensation=False,
                        position=position,
                    ),
                )
            if k == first_rows - 1:
                yield (
                    'thermal_reference',
                    ThermalReference(
                        stamp=stamp,
                        frame_id=f'{machine}/machine',
                        cold_since=cold_since,
                        set_by='recording',
                        sensor=self.sensors,
                        # NaN for a sensor that lacks one of the first samples.
                        temperature=data.temperature[:first_rows].mean(axis=0),
                        samples=min(first_rows, 2**16 - 1),
                    ),
                )


def import_csv(
    file: str | os.PathLike[str], out: str | os.PathLike[str], mapping: CsvMapping
) -> ImportReport:
    """Write a CSV recording into a new bag.

    Parameters
    ----------
    file : path
        The recording: a header line, then one row per sample.
    out : path
        Directory of the new bag, which must not exist.
    mapping : CsvMapping
        What the columns mean.

    Returns
    -------
    ImportReport
        What was imported.

    Raises
    ------
    CsvError
        If the file cannot be used; the message names line and column.  No bag is written then.
    BagExistsError
        If `out` exists.

    Notes
    -----
    Topics, below the name of the machine: `temperatures`, `displacement` if columns are mapped,
    `machine_state` if the spindle speed or a drive is, and latched `thermal_reference`: the mean
    of the first three samples, readings faster than one a minute counting as samples of one
    minute (as `ThermalRun.rise` takes it), stamped with the last of them.
    The stamps are the time since the first imported row plus the epoch; log times equal them.
    """
    read = read_csv(file, mapping)
    with BagWriter(Path(out), flush_interval=None, custom=read.facts) as writer:
        for topic, type_name in read.types.items():
            latched = topic == 'thermal_reference'
            writer.add_topic(
                f'/{mapping.machine}/{topic}', type_name, LATCHED if latched else STREAM
            )
        for topic, record in read.records():
            writer.write_message(
                f'/{mapping.machine}/{topic}', encode(record, ROSBAGS), record.stamp
            )
    time = read.data.time
    return ImportReport(
        path=Path(out),
        samples=len(time),
        interval=float((time[-1] - time[0]) / (len(time) - 1)),
        start=read.start,
        sensors=read.sensors,
        channels=read.channels,
        missing=int(np.isnan(read.data.temperature).sum()),
        remarks=read.remarks,
        doubts=read.doubts,
    )


def read_csv(file: str | os.PathLike[str], mapping: CsvMapping) -> CsvRecording:
    """Read a CSV recording.

    Parameters
    ----------
    file : path
        The recording: a header line, then one row per sample.
    mapping : CsvMapping
        Meaning of the columns.

    Raises
    ------
    CsvError
        If the file cannot be used; the message names line and column.
    """
    path = Path(file)
    table = mapping.table(path).with_joined(mapping.time)
    sensors = _sensor_columns(table, mapping)
    table.require([mapping.time], '--time')
    table.require([channel.column for channel in mapping.channels], '--displacement')
    mapping = _placed(table, mapping)
    if mapping.spindle_speed is not None:
        table.require([mapping.spindle_speed], '--speed')
    table.require(list(mapping.drives.values()), 'drives')
    names = _names(table, mapping, sensors)
    channels = _channel_names(table, mapping)
    times = table.time(mapping.time, mapping.time_unit, mapping.time_format, mapping.time_zone)
    time, date = times.seconds, times.date
    recording, unread, unsure = _read(table, mapping, sensors, time)
    _check_temperatures(table, mapping, sensors, recording.temperature)
    if mapping.zero and mapping.channels:
        recording = _zeroed(recording)
    _check_displacements(table, mapping, recording)
    doubts = unsure + _doubts(table, mapping, sensors, recording, clock=bool(times.form))
    if mapping.resample is None:
        table.check_even(mapping.time, time)
    else:
        recording = _resampled(path, recording, mapping.resample)
        doubts += _emptied_line(path, time, recording, mapping.resample)
    start = mapping.epoch if mapping.epoch is not None else (1.0 if date is None else date)
    if start < 0.0 or start + time[-1] >= 2**31:
        raise CsvError(
            f'{path}: expected times between 1970 and 2038 but the recording lasts from '
            f'{start:.6g} to {start + time[-1]:.6g} s; check the unit of {mapping.time!r}'
        )
    stamps = np.rint((start + recording.time) * 1e9).astype(np.int64)
    if date is not None:  # a date in ns has more digits than a float
        stamps = round(start * 1e6) * 1000 + np.rint(recording.time * 1e9).astype(np.int64)
    facts = {'imported_by': 'import-csv'}
    if times.zone is not None:
        facts['time_zone'] = times.zone.name
    return CsvRecording(
        path=path,
        mapping=mapping,
        data=recording,
        stamps=stamps,
        start=start,
        sensors=tuple(names),
        channels=tuple(channels),
        facts=facts,
        remarks=_remarks(table, mapping, times) + unread,
        doubts=doubts,
    )


def _remarks(table: CsvTable, mapping: CsvMapping, times: Times) -> tuple[str, ...]:
    """Return what was recognised in a file."""
    remarks = []
    if table.units:
        said = ', '.join(unit for unit in table.units.values() if unit)
        remarks.append(f'line {table.lines[0] - 1} read as units of the columns: {said}')
    if times.form and not (mapping.time_format or mapping.time_unit == ISO8601):
        others = [form for form in known_forms(table.cells(mapping.time)) if form != times.form]
        also = f', which could be {" or ".join(others)}: see --time-format' if others else ''
        remarks.append(f'times of {mapping.time!r} read as {times.form}{also}')
    if times.zone is not None:
        own = '' if times.zone.chosen else ', the zone of this computer; --time-zone names another'
        remarks.append(
            f'times of {mapping.time!r} that name no zone read as {times.zone.name}{own}'
        )
    if times.midnights:
        lines = ', '.join(str(table.lines[row]) for row in times.midnights[:5])
        remarks.append(f'the clock passes midnight before line {lines}: a day was added')
    return tuple(remarks)


def _doubts(
    table: CsvTable,
    mapping: CsvMapping,
    sensors: list[str],
    recording: _ColumnData,
    *,
    clock: bool,
) -> tuple[str, ...]:
    """Return what looks like a mistake."""
    temperature = recording.temperature
    lone = list(lone_values(temperature, TEMPERATURE_STEP, FAR))
    doubts = _named_unit_lines(table, mapping, sensors)
    if not doubts:
        doubts = _temperature_line(mapping, temperature)
        if not clock:
            true = temperature.copy()
            for item in lone:
                readings = true[item.row :, item.column]
                readings[np.flatnonzero(np.isfinite(readings))[: item.held]] = np.nan
            # What may warm faster than metal says nothing of the machine's pace.
            own = SensorLimits.of(mapping.sensor_limits).values('rate_max', sensors, np.nan)
            true[:, np.isfinite(own)] = np.nan
            doubts += _time_line(mapping, recording, true)
    columns = [channel.column for channel in mapping.channels]
    doubts += _lone_lines(table, sensors, lone, 1.0, 'degC')
    jumps = lone_values(recording.displacement, DISPLACEMENT_STEP)
    doubts += _lone_lines(table, columns, jumps, 1e6, 'µm')
    if not mapping.zero:
        doubts += _offset_line(columns, recording)
    return tuple(f'{table.path}{doubt}' for doubt in doubts)


def _named_unit_lines(table: CsvTable, mapping: CsvMapping, sensors: Sequence[str]) -> list[str]:
    """Return which columns name another unit than they are read in."""
    asked = [(name, mapping.temperature_unit, '--temperature-unit') for name in sensors]
    asked += [(item.column, item.unit, '--displacement') for item in mapping.channels]
    if mapping.time_unit in TIMES:
        asked.append((mapping.time, mapping.time_unit, '--time-unit'))
    odd: dict[tuple[str, str, str], list[str]] = {}
    for column, unit, option in asked:
        found = _BRACKETED.search(column) or _APPENDED.search(column)
        told = table.units.get(column, '').strip('[]() ') or (found[1] if found else '')
        named = _NAMES[option].get(told)
        if named is not None and named != unit:
            odd.setdefault((option, unit, named), []).append(column)
    lines = []
    for (option, unit, named), columns in odd.items():
        more = f' and {len(columns) - 1} more' if len(columns) > 1 else ''
        value = f"'{columns[0]}=AXIS:{named}'" if option == '--displacement' else named
        lines.append(
            f', column {columns[0]!r}{more}: read in {unit} but named {named}; if the name is '
            f'right, import with {option} {value}'
        )
    return lines


def _temperature_line(mapping: CsvMapping, temperature: NDArray[np.float64]) -> list[str]:
    """Return whether another unit would make the machine start at a temperature of a shop."""
    first = temperature[:REFERENCE_SAMPLES]
    if not np.isfinite(first).any():
        return []
    start = float(np.nanmedian(first))
    if COLD_MIN <= start <= COLD_MAX:
        return []
    factor, offset = TEMPERATURE_UNITS[mapping.temperature_unit]
    raw = (start - offset) / factor
    for unit, (scale, zero) in TEMPERATURE_UNITS.items():
        if COLD_MIN <= raw * scale + zero <= COLD_MAX:
            return [
                f': the machine starts at {start:.3g} degC, which no shop has; if the numbers are '
                f'in {unit}, it starts at {raw * scale + zero:.3g} degC: import with '
                f'--temperature-unit {unit}'
            ]
    return []


def _time_line(
    mapping: CsvMapping, recording: _ColumnData, temperature: NDArray[np.float64]
) -> list[str]:
    """Return whether another unit would make the machine warm up as fast as machines do."""
    pace = odd_pace(recording.time, temperature, recording.displacement)
    if pace is None:
        return []
    factor = TIMES[mapping.time_unit]
    for unit in ('s', 'min', 'ms', 'h', 'd'):
        other = pace.time / factor * TIMES[unit]
        if WARMING_MIN <= other <= WARMING_MAX:
            sure = (
                f'{pace.agreeing} of {pace.witnesses} sensors and probes agree'
                if pace.witnesses > 1
                else 'one sensor alone says so, which may be a fast one'
            )
            return [
                f': half of the warming takes {_duration(pace.time)}, which no machine does '
                f'({sure}); if the times are in {unit}, it takes {_duration(other)}: import with '
                f'--time-unit {unit}'
            ]
    return []


def _duration(seconds: float) -> str:
    for unit, length in (('d', 86400.0), ('h', 3600.0), ('min', 60.0)):
        if seconds >= 2.0 * length:
            return f'{seconds / length:.3g} {unit}'
    return f'{seconds:.3g} s'


def _offset_line(columns: Sequence[str], recording: _ColumnData) -> list[str]:
    """Return which displacements do not begin at zero, though temperatures are meant so."""
    found = offset_channels(recording.displacement, reference_rows(recording.time))
    if not found:
        return []
    said = ', '.join(
        f'{columns[column]!r} at {first * 1e6:.3g} µm of a range of {span * 1e6:.3g} µm'
        for column, first, span in found
    )
    return [
        f': displacements begin at {said}, while temperatures count from their first minutes; if '
        'the machine was cold then, import with --zero'
    ]


def _lone_lines(
    table: CsvTable, columns: Sequence[str], lone: Iterable[Outlier], scale: float, unit: str
) -> list[str]:
    """Return the values that stand alone, with line and column."""
    found = sorted(lone)
    lines = [
        f', line {table.lines[item.row]}, column {columns[item.column]!r}: '
        f'{item.value * scale:.4g} {unit}{f" in {item.held} rows" if item.held > 1 else ""} '
        f'stands alone {item.neighbours(scale)}; if nothing of the kind happened, empty the '
        f'cell{"s" if item.held > 1 else ""}'
        for item in found[:LINES_MAX]
    ]
    if len(found) > LINES_MAX:
        lines.append(f': {len(found) - LINES_MAX} more values in {unit} stand alone like these')
    return lines


def _sensor_columns(table: CsvTable, mapping: CsvMapping) -> list[str]:
    try:
        columns = mapping.sensor_columns(table.header)
    except CsvError as error:
        raise CsvError(f'{table.path}: {error}') from error
    if not columns:
        raise CsvError(
            f'{table.path}: expected at least one temperature column but none is mapped; the '
            f'file has {", ".join(table.header)}; name them with --temperature'
        )
    return columns


def _names(table: CsvTable, mapping: CsvMapping, columns: list[str]) -> list[str]:
    names = [mapping.rename.get(column, column) for column in columns]
    repeated = repeated_names(names)
    if repeated:
        raise CsvError(
            f'{table.path}: expected each sensor and channel name once but found '
            f'{", ".join(repr(name) for name in repeated)} more than once; change the renaming'
        )
    return names


def _read(
    table: CsvTable, mapping: CsvMapping, sensors: list[str], time: NDArray[np.float64]
) -> tuple[_ColumnData, tuple[str, ...], tuple[str, ...]]:
    """Return the columns, what was taken for no reading in them, and what looks like it."""
    factor, offset = TEMPERATURE_UNITS[mapping.temperature_unit]
    speed = [mapping.spindle_speed] if mapping.spindle_speed is not None else []
    raw = _columns(table, sensors)
    temperature = raw * factor + offset
    unread, unsure = [], []
    for item in values_without_reading(raw, temperature):
        lines = [table.lines[row] for row in item.rows[:LINES_MAX]]
        more = f' and {len(item.rows) - LINES_MAX} more' if len(item.rows) > LINES_MAX else ''
        where = f'line {", ".join(map(str, lines))}{more}, column {sensors[item.column]!r}'
        if item.clear:
            temperature[item.rows, item.column] = np.nan
            unread.append(f'{where}: {item.value:g} is {item.meaning}; taken as missing')
        else:
            unsure.append(
                f'{table.path}, column {sensors[item.column]!r}: {item.value:g} throughout is '
                f'{item.meaning}; see whether the sensor is connected, or leave it out'
            )
    displacement = _columns(table, [channel.column for channel in mapping.channels])
    for column, channel in enumerate(mapping.channels):
        if channel.place:
            elsewhere = _places(table, channel) != channel.position
            displacement[elsewhere, column] = np.nan
    recording = _ColumnData(
        time=time,
        temperature=temperature,
        displacement=displacement * np.array([channel.scale for channel in mapping.channels]),
        speed=_columns(table, speed) * SPEEDS[mapping.spindle_speed_unit],
        drives=_columns(table, list(mapping.drives.values())),
    )
    return recording, tuple(unread), tuple(unsure)


def _placed(table: CsvTable, mapping: CsvMapping) -> CsvMapping:
    """Return the mapping with a channel for each place that a column of positions tells."""
    channels: list[DisplacementColumn] = []
    for channel in mapping.channels:
        if not channel.place:
            channels.append(channel)
            continue
        table.require([channel.place], '--displacement')
        found = _places(table, channel)
        known = np.unique(found[np.isfinite(found)])
        if not 1 <= len(known) <= PLACES_MAX:
            raise CsvError(
                f'{table.path}, column {channel.place!r}: expected positions of 1 to '
                f'{PLACES_MAX} places, to the millimetre, but found {len(known)}'
            )
        channels += [replace(channel, position=float(place)) for place in known]
    return replace(mapping, displacements=tuple(channels))


def _places(table: CsvTable, channel: DisplacementColumn) -> NDArray[np.float64]:
    """Return the position of each row, to the millimetre [m]."""
    position = _columns(table, [channel.place])[:, 0] * LENGTH_UNITS[channel.place_unit]
    return np.asarray(np.round(position, 3) + 0.0)  # no minus zero


def _channel_names(table: CsvTable, mapping: CsvMapping) -> list[str]:
    """Return the name of each channel; one of several places of a column tells which it is."""
    columns = [channel.column for channel in mapping.channels]
    once = list(dict.fromkeys(columns))
    names = dict(zip(once, _names(table, mapping, once), strict=True))
    return [
        names[channel.column]
        if columns.count(channel.column) == 1 or channel.position is None
        else f'{names[channel.column]}@{1e3 * channel.position:.6g}mm'
        for channel in mapping.channels
    ]


def _columns(table: CsvTable, names: list[str]) -> NDArray[np.float64]:
    if not names:
        return np.empty((len(table.rows), 0))
    values = np.stack([table.column(name) for name in names], axis=1)
    infinite = np.argwhere(np.isinf(values))
    if len(infinite):
        row, column = (int(index) for index in infinite[0])
        raise CsvError(
            f'{table.place(row, names[column])}: expected a finite number but found '
            f'{values[row, column]}'
        )
    return values


def _check_temperatures(
    table: CsvTable, mapping: CsvMapping, sensors: list[str], values: NDArray[np.float64]
) -> None:
    """Refuse temperatures that no machine has, and name the unit that would fit."""
    low, high = temperature_range(SensorLimits.of(mapping.sensor_limits), sensors)
    outside = np.argwhere((values < low) | (values > high))
    if not len(outside):
        return
    row, column = (int(index) for index in outside[0])
    factor, offset = TEMPERATURE_UNITS[mapping.temperature_unit]
    raw = (values - offset) / factor
    fits = [
        unit
        for unit, (f, o) in TEMPERATURE_UNITS.items()
        if np.nanmin(raw * f + o) >= TEMPERATURE_MIN and np.nanmax(raw * f + o) <= TEMPERATURE_MAX
    ]
    remedy = (
        f'in {fits[0]} they would fit: --temperature-unit {fits[0]}'
        if fits
        else 'leave the sensor out, or empty the cell where it failed'
    )
    remedy = f'a heated bed has limits of its own (--sensor-limits); {remedy}'
    raise CsvError(
        f'{table.place(row, sensors[column])}: expected {low[column]:g} to {high[column]:g} degC '
        f'but found {values[row, column]:.6g} degC; {remedy}'
    )


def _check_displacements(table: CsvTable, mapping: CsvMapping, recording: _ColumnData) -> None:
    """Refuse displacements that no machine makes, and name the unit that would fit."""
    values = recording.displacement
    far = np.argwhere(np.abs(values) > DISPLACEMENT_MAX)
    if len(far):
        row, column = (int(index) for index in far[0])
        channel = mapping.channels[column]
        largest = float(np.nanmax(np.abs(values[:, column]))) / LENGTH_UNITS[channel.unit]
        fits = [u for u, s in LENGTH_UNITS.items() if largest * s <= DISPLACEMENT_MAX]
        best = max(fits, key=lambda unit: LENGTH_UNITS[unit], default='')
        remedy = (
            f'in {best} the largest would be {largest * LENGTH_UNITS[best] * 1e6:.4g} µm'
            if best
            else 'the column does not hold displacements'
        )
        raise CsvError(
            f'{table.place(row, channel.column)}: expected displacements up to '
            f'{DISPLACEMENT_MAX * 1e6:g} µm but found {values[row, column] * 1e6:.6g} µm; '
            f'{remedy}; where the probe has an offset, import with --zero'
        )
    if not np.isfinite(values).any() or not np.isfinite(recording.temperature).any():
        return
    rise = _span(recording.temperature)
    moved = _span(values)
    if rise >= WARM and moved < DISPLACEMENT_MIN:
        unit = mapping.channels[0].unit
        raise CsvError(
            f'{table.path}: expected displacements above {DISPLACEMENT_MIN * 1e6:g} µm where the '
            f'machine warms by {rise:.3g} K but found at most {moved * 1e6:.3g} µm; they are '
            f'not in {unit}: check the unit (in mm the largest would be '
            f'{moved / LENGTH_UNITS[unit] * 1e3:.4g} µm)'
        )


def _span(values: NDArray[np.float64]) -> float:
    """Return the largest range of all columns that hold a number."""
    held = values[:, np.isfinite(values).any(axis=0)]
    return float((np.nanmax(held, axis=0) - np.nanmin(held, axis=0)).max())


def _zeroed(recording: _ColumnData) -> _ColumnData:
    first = recording.displacement[: reference_rows(recording.time)]
    count = np.isfinite(first).sum(axis=0)
    total = np.nansum(first, axis=0)
    zero = np.divide(total, count, out=np.zeros_like(total), where=count > 0)
    return replace(recording, displacement=recording.displacement - zero)


def _resampled(path: Path, recording: _ColumnData, interval: float) -> _ColumnData:
    """Return samples on an even grid, each the mean of the readings up to it."""
    time = recording.time
    block = max(1, round(interval / float(np.median(np.diff(time)))))
    samples = time[-1] / interval
    if samples > GRID_MAX:
        raise CsvError(
            f'{path}: expected a recording without long gaps but --resample {interval:g} would '
            f'make {samples:.0f} samples of {len(time)} rows; import the parts one by one with '
            '--rows'
        )
    block = max(1, min(block, int(GRID_MAX / max(samples, 1.0))))
    fine = interval / block
    # A tenth of a step of slack keeps a last reading that came a little early.
    count = (int((time[-1] + 0.1 * fine) / fine) + 1) // block
    if count < SAMPLES_MIN:
        raise CsvError(
            f'{path}: expected at least {SAMPLES_MIN} samples but --resample {interval:g} leaves '
            f'{count} of {time[-1]:.6g} s'
        )
    columns = (recording.temperature, recording.displacement, recording.speed, recording.drives)
    temperature, displacement, speed, drives = (
        block_means(time, values, interval, block, count) for values in columns
    )
    return _ColumnData(
        time=fine * (block * np.arange(1, count + 1, dtype=np.float64) - 1.0),
        temperature=temperature,
        displacement=displacement,
        speed=speed,
        drives=drives,
        readings=max(1, round(len(time) / count)),
    )


def _emptied_line(
    path: Path, time: NDArray[np.float64], samples: _ColumnData, interval: float
) -> tuple[str, ...]:
    """Return that the asked interval leaves samples without readings, which come more rarely."""
    longer = sample_interval(time)
    empty = int(np.isnan(samples.temperature).all(axis=1).sum())
    if longer <= interval or empty < EMPTY_SHARE * len(samples.time):
        return ()
    return (
        f'{path}: {empty} of {len(samples.time)} samples are without a reading, as readings come '
        f'every {longer:.4g} s; import with --resample {longer:.4g}',
    )


def _told(mapping: CsvMapping, recording: _ColumnData) -> dict[str, Any]:
    """Return fields of `machine_state` by row that say what else the control told.

    Motion is told as counters; what is told as it is holds from one row to the next.
    """
    if not mapping.drives:
        return {}
    columns = dict(zip(mapping.drives, recording.drives.T, strict=True))
    steps = np.diff(recording.time, prepend=recording.time[:1])
    axes = sorted({name.partition('/')[2] for name in columns if '/' in name})
    rows = len(recording.time)
    found: dict[str, Any] = {'axis': [tuple(axes)] * rows}
    found['position'] = np.full((rows, len(axes)), np.nan)
    for field, name in COUNTERS.items():
        means = [columns.get(f'{name}/{axis}', np.full(rows, np.nan)) for axis in axes]
        growth = np.stack(means, axis=1) * steps[:, np.newaxis] if axes else np.zeros((rows, 0))
        found[field] = np.where(np.isnan(growth), np.nan, np.nancumsum(growth, axis=0))
    later = np.minimum(np.arange(rows) + 1, rows - 1)
    if 'spindle_load' in columns:
        found['spindle_load'] = columns['spindle_load'][later].tolist()
    if 'coolant' in columns:
        on = columns['coolant'][later]
        names = np.where(on >= 0.5, Coolant.ON, Coolant.OFF)
        found['coolant'] = np.where(np.isnan(on), Coolant.UNKNOWN, names).tolist()
    return found


def _machine_state(machine: str, stamp: int, cold_since: int, speed: float) -> MachineState:
    """Return the state as far as the spindle tells; a recording takes no offsets."""
    return MachineState(
        stamp=stamp,
        frame_id=f'{machine}/machine',
        state=MachineMode.RUNNING if abs(speed) > 0.0 else MachineMode.ON,
        homed=False,
        offsets_allowed=False,
        cold_since=cold_since,
        spindle_speed=speed,
        axis=(),
        position=np.empty(0),
    )

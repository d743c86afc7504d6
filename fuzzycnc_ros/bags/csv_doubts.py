# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""What looks like a mistake in a CSV recording that can be imported: units, single values."""

import re
from collections.abc import Iterable, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from fuzzycnc_ros.bags.csv_mapping import TEMPERATURE_UNITS, TIME_UNITS, CsvMapping
from fuzzycnc_ros.bags.csv_table import Table
from fuzzycnc_ros.core.thermal.plausibility import Lone, half_rise_time
from fuzzycnc_ros.core.thermal.run import REFERENCE_SAMPLES

COLD_MIN, COLD_MAX = 5.0, 45.0
"""Temperatures between which a machine is started [degC]."""

WARMING_MIN, WARMING_MAX = 180.0, 3.0 * 86400.0
"""Times between which a machine gains half of its rise [s]."""

LINES_MAX = 3
"""Single values of a file that are named."""

_BRACKETED = re.compile(r'[\[(]\s*([^\s\])]+)\s*[\])]\s*$')
_APPENDED = re.compile(r'[_ /](°?[A-Za-z]{2,})\s*$')  # a single letter may as well be a place
_NAMES: Mapping[str, Mapping[str, str]] = {
    '--time-unit': {
        's': 's', 'sec': 's', 'ms': 'ms', 'msec': 'ms', 'min': 'min', 'h': 'h', 'hours': 'h',
    },
    '--temperature-unit': {
        '°C': 'degC', 'degC': 'degC', 'C': 'degC', '°F': 'degF', 'degF': 'degF', 'F': 'degF',
        'K': 'K',
    },
    '--displacement': {
        'um': 'um', '\xb5m': 'um', '\u03bcm': 'um', 'mm': 'mm', 'm': 'm', 'nm': 'nm',
    },
}  # fmt: skip


def named_unit_lines(table: Table, mapping: CsvMapping, sensors: Sequence[str]) -> list[str]:
    """Return which columns name another unit than they are read in."""
    asked = [(name, mapping.temperature_unit, '--temperature-unit') for name in sensors]
    asked += [(item.column, item.unit, '--displacement') for item in mapping.channels]
    if mapping.time_unit in TIME_UNITS:
        asked.append((mapping.time, mapping.time_unit, '--time-unit'))
    odd: dict[tuple[str, str, str], list[str]] = {}
    for column, unit, option in asked:
        found = _BRACKETED.search(column) or _APPENDED.search(column)
        named = _NAMES[option].get(found[1]) if found else None
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


def temperature_line(mapping: CsvMapping, temperature: NDArray[np.float64]) -> list[str]:
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


def time_line(
    mapping: CsvMapping, time: NDArray[np.float64], temperature: NDArray[np.float64]
) -> list[str]:
    """Return whether another unit would make the machine warm up as fast as machines do."""
    taken = half_rise_time(time, temperature)
    if np.isnan(taken) or WARMING_MIN <= taken <= WARMING_MAX:
        return []
    factor = TIME_UNITS[mapping.time_unit]
    for unit in ('s', 'min', 'ms', 'h'):
        other = taken / factor * TIME_UNITS[unit]
        if WARMING_MIN <= other <= WARMING_MAX:
            return [
                f': half of the warming takes {_duration(taken)}, which no machine does; if the '
                f'times are in {unit}, it takes {_duration(other)}: import with --time-unit {unit}'
            ]
    return []


def _duration(seconds: float) -> str:
    for unit, length in (('d', 86400.0), ('h', 3600.0), ('min', 60.0)):
        if seconds >= 2.0 * length:
            return f'{seconds / length:.3g} {unit}'
    return f'{seconds:.3g} s'


def lone_lines(
    table: Table, columns: Sequence[str], lone: Iterable[Lone], scale: float, unit: str
) -> list[str]:
    """Return the values that stand alone, with line and column."""
    found = sorted(lone)
    lines = [
        f', line {table.lines[item.row]}, column {columns[item.column]!r}: '
        f'{item.value * scale:.4g} {unit} stands alone between {item.before * scale:.4g} and '
        f'{item.behind * scale:.4g}; if nothing of the kind happened, empty the cell'
        for item in found[:LINES_MAX]
    ]
    if len(found) > LINES_MAX:
        lines.append(f': {len(found) - LINES_MAX} more values in {unit} stand alone like these')
    return lines

# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The file that says where a control is, and which of its variables take part in compensation.

docs/opcua-output.md describes it with examples.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from fuzzycnc_ros.adapters.opcua.control import ControlFile
from fuzzycnc_ros.adapters.opcua.file_fields import read_address, read_server
from fuzzycnc_ros.adapters.opcua.offset_lines import Travel
from fuzzycnc_ros.adapters.opcua.session import node_id_trouble
from fuzzycnc_ros.adapters.opcua.variables import ControlVariable, Kind
from fuzzycnc_ros.adapters.readings.device_file import SPEED_UNITS
from fuzzycnc_ros.adapters.yaml_section import Section
from fuzzycnc_ros.components.thermal.compensator import AXES
from fuzzycnc_ros.ros.parameters import ParameterError

LENGTHS = {'um': 1e-6, 'mm': 1e-3, 'm': 1.0, 'inch': 25.4e-3}
TRAVEL_MAX = 1000.0
"""Largest position [m]."""


@dataclass(frozen=True)
class _Field:
    """A variable that a file may name."""

    kind: Kind
    written: bool = False
    needed: bool = True
    unit: str = ''
    """Which unit of the file its values have: unit or position_unit."""


_HAND_SHAKE = {
    'sequence': _Field(Kind.COUNT, written=True),
    'heartbeat': _Field(Kind.COUNT, written=True),
    'valid_for': _Field(Kind.QUANTITY, written=True),
    'acknowledged': _Field(Kind.COUNT),
    'owner': _Field(Kind.TEXT, written=True, needed=False),
}
_STATE = {
    'on': _Field(Kind.SWITCH),
    'homed': _Field(Kind.SWITCH),
    **{
        name: _Field(Kind.SWITCH, needed=False)
        for name in ('allowed', 'running', 'estop', 'fault', 'alive')
    },
    'slew': _Field(Kind.QUANTITY, needed=False, unit='unit'),
    'spindle_speed': _Field(Kind.QUANTITY, needed=False),
}
_AXIS = {
    'offset': _Field(Kind.QUANTITY, written=True, unit='unit'),
    'slope': _Field(Kind.QUANTITY, written=True, needed=False),
    'reference_position': _Field(Kind.QUANTITY, written=True, needed=False, unit='position_unit'),
    'applied': _Field(Kind.QUANTITY, unit='unit'),
    'limit': _Field(Kind.QUANTITY, needed=False, unit='unit'),
    'position': _Field(Kind.QUANTITY, needed=False, unit='position_unit'),
}


def read_control(path: Path, state_directory: str = '') -> ControlFile:
    """Read and check a control file.

    Parameters
    ----------
    path : Path
        The file.
    state_directory : str
        Where a certificate is pinned on first use; empty: beside the file.

    Raises
    ------
    ParameterError
        If something in it is missing, unknown, out of bounds or there twice; the text names
        file, line and field.
    """
    whole = Section.read(path, 'a file of a control')
    server = read_server(whole, state_directory)
    words = tuple(LENGTHS)
    units = {
        'unit': LENGTHS[whole.word('unit', words)],
        'position_unit': LENGTHS[whole.word('position_unit', words, 'mm')],
    }
    variables: dict[str, ControlVariable] = {}
    for name, fields in (('hand_shake', _HAND_SHAKE), ('state', _STATE)):
        section = whole.section(name)
        if section is None:
            raise whole.error(f'expected the field {name!r} but it is missing')
        variables |= _variables(section, fields, units, '')
        section.done()
    axes: list[str] = []
    low: list[float] = []
    high: list[float] = []
    for axis, section in whole.named('axes', 'axis', 'offset', ()):
        if axis not in AXES:
            raise section.error(f'expected one of {", ".join(AXES)} but found {axis!r}')
        variables |= _variables(section, _AXIS, units, f'{axis}.')
        ends = _travel(section, units['position_unit'])
        axes.append(axis)
        low.append(ends[0])
        high.append(ends[1])
        section.done()
    whole.done()
    if not axes:
        raise whole.error('expected axes, as axes: {X: ...}, but found none')
    _refuse_shared(whole, variables)
    return ControlFile(
        server=server,
        axes=tuple(axes),
        travel=Travel(low=np.array(low), high=np.array(high)),
        variables=variables,
    )


def _variables(
    section: Section, fields: Mapping[str, _Field], units: Mapping[str, float], prefix: str
) -> dict[str, ControlVariable]:
    """Return the variables that a section names."""
    found = {}
    for name, field in fields.items():
        entry = section.entry(name, 'node')
        if entry is None:
            if field.needed:
                raise section.error(f'expected the variable {name!r} but it is missing')
            continue
        address = read_address(entry)
        trouble = node_id_trouble(address)
        if trouble:
            raise entry.line_error('node', trouble)
        scale, scaled = 1.0, False
        if field.kind is Kind.QUANTITY:
            scaled = 'scale' in entry
            scale = entry.number('scale', -1e9, 1e9, 1.0)
            if scale == 0.0:
                raise entry.line_error('scale', 'expected another number than 0')
            if name == 'spindle_speed':
                scale *= SPEED_UNITS[entry.word('unit', tuple(SPEED_UNITS), 'rpm')]
            scale *= units.get(field.unit, 1.0)
        entry.done()
        found[prefix + name] = ControlVariable(
            **vars(address), kind=field.kind, written=field.written, scale=scale, scaled=scaled
        )
    return found


def _travel(section: Section, unit: float) -> tuple[float, float]:
    """Return the ends of an axis [m], both zero if its control takes no slope."""
    names = ('slope', 'reference_position', 'travel')
    there = [name for name in names if name in section]
    if not there:
        return 0.0, 0.0
    if len(there) < len(names):
        missing = ', '.join(name for name in names if name not in there)
        raise section.error(
            f'expected slope, reference_position and travel, or none of them, but {missing} is '
            'missing; without travel nobody can tell how large an offset a slope makes'
        )
    ends = [unit * float(end) for end in section.numbers('travel')]
    if len(ends) != 2 or not -TRAVEL_MAX <= ends[0] < ends[1] <= TRAVEL_MAX:
        raise section.line_error(
            'travel',
            'expected the two ends of the axis in position_unit, the lower one first, such as '
            '[-100, 500]',
        )
    return ends[0], ends[1]


def _refuse_shared(whole: Section, variables: Mapping[str, ControlVariable]) -> None:
    """Refuse a variable that is written under two names, or written and read."""
    seen: dict[str, str] = {}
    for name, item in variables.items():
        other = seen.setdefault(item.place, name)
        if other != name and (item.written or variables[other].written):
            raise whole.error(f'{name} and {other} are the same variable, {item.place}')


def check_axes(file: ControlFile, axes: tuple[str, ...]) -> None:
    """Refuse a parameter `axes` that does not fit the file.

    Raises
    ------
    ParameterError
        If it names others, or in another order.
    """
    if file.axes != axes:
        raise ParameterError(
            f'parameter axes: expected {", ".join(file.axes)} as in the control file but found '
            f'{", ".join(axes)}'
        )

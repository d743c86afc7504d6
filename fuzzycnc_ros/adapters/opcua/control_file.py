# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The file that says where a control is, and which of its variables take part in compensation.

docs/how-to/opcua-output.md describes it with examples.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np

from fuzzycnc_ros.adapters.opcua.control import ControlFile
from fuzzycnc_ros.adapters.opcua.file_fields import PlaceFields, ServerFields, pin_folder
from fuzzycnc_ros.adapters.opcua.session import Address, node_id_trouble
from fuzzycnc_ros.adapters.opcua.variables import ControlVariable, VariableType
from fuzzycnc_ros.adapters.readings.device_fields import Scale, SpeedUnit
from fuzzycnc_ros.adapters.yaml_model import (
    Choice,
    Field,
    Fields,
    Numbers,
    Shorthand,
    model_validator,
    read_file,
    wrong,
)
from fuzzycnc_ros.core.inputs.lines import Travel
from fuzzycnc_ros.core.inputs.offsets import AXES
from fuzzycnc_ros.core.units import LENGTHS, SPEEDS
from fuzzycnc_ros.ros.parameters import ParameterError

TRAVEL_MAX = 1000.0
"""Largest position [m]."""


class _Place(PlaceFields):
    @model_validator(mode='after')
    def _check_node_id(self) -> '_Place':
        trouble = node_id_trouble(Address(node=self.node))
        if trouble:
            raise wrong(trouble, 'node')
        return self


class _Quantity(_Place):
    scale: Scale = Field(1.0, description='Units of one count')


class _Speed(_Quantity):
    unit: SpeedUnit = Field('rpm', description='Unit of the speed')


@dataclass(frozen=True)
class _Role:
    """Role of a variable."""

    kind: VariableType
    written: bool = False
    unit: str = ''
    """Which unit of the file its values have: unit or position_unit."""


_Named = Annotated[_Place, Shorthand('node')]
_Scaled = Annotated[_Quantity, Shorthand('node')]
_READ, _WRITTEN = _Role(VariableType.QUANTITY), _Role(VariableType.QUANTITY, written=True)
_COUNT = _Role(VariableType.COUNT, written=True)
_Switch = Annotated[_Named | None, _Role(VariableType.SWITCH)]


class _HandShake(Fields):
    sequence: Annotated[_Named, _COUNT] = Field(description='Number of the set; 0: none')
    heartbeat: Annotated[_Named, _COUNT] = Field(description='Changes with every exchange')
    valid_for: Annotated[_Scaled, _WRITTEN] = Field(description='How long a set holds [s]')
    acknowledged: Annotated[_Named, _Role(VariableType.COUNT)] = Field(
        description='Number of the set that the control follows'
    )
    owner: Annotated[_Named | None, _Role(VariableType.TEXT, written=True)] = Field(
        None, description='Who writes, to be shown'
    )


class _StateFields(Fields):
    on: Annotated[_Named, _Role(VariableType.SWITCH)] = Field(description='The machine is on')
    homed: Annotated[_Named, _Role(VariableType.SWITCH)] = Field(description='The axes are homed')
    allowed: _Switch = Field(None, description='The control takes offsets now')
    running: _Switch = Field(None, description='A program runs')
    estop: _Switch = Field(None, description='Emergency stop')
    fault: _Switch = Field(None, description='The machine has a fault')
    alive: _Switch = Field(None, description='The watchdog of the control hears the bridge')
    slew: Annotated[_Scaled | None, _Role(VariableType.QUANTITY, unit='unit')] = Field(
        None, description='Largest change per second, in `unit`'
    )
    spindle_speed: Annotated[Annotated[_Speed, Shorthand('node')] | None, _READ] = Field(
        None, description='Spindle speed'
    )
    spindle_load: Annotated[_Scaled | None, _READ] = Field(
        None, description='Load of the spindle drive; 1 is its rated one'
    )
    coolant: _Switch = Field(None, description='Coolant is on')


class _ProbeVariables(Fields):
    due: Annotated[_Named | None, _Role(VariableType.SWITCH, written=True)] = Field(
        None, description='A probing cycle is due: a program may call it'
    )
    code: Annotated[_Scaled | None, _READ] = Field(
        None, description='Code that the cycle tells last, after its number'
    )
    value: Annotated[_Scaled | None, _READ] = Field(
        None, description='Number that the cycle tells, a coordinate in mm'
    )

    @model_validator(mode='after')
    def _check_pair(self) -> '_ProbeVariables':
        if (self.code is None) != (self.value is None):
            raise wrong('expected code and value, or none of them')
        return self


class _Axis(Fields):
    offset: Annotated[_Scaled, _Role(VariableType.QUANTITY, written=True, unit='unit')] = Field(
        description='K0, in `unit`'
    )
    slope: Annotated[_Scaled | None, _WRITTEN] = Field(None, description='Slope [-]')
    reference_position: Annotated[
        _Scaled | None, _Role(VariableType.QUANTITY, written=True, unit='position_unit')
    ] = Field(None, description='P0, in `position_unit`')
    applied: Annotated[_Scaled, _Role(VariableType.QUANTITY, unit='unit')] = Field(
        description='Offset in force now, in `unit`'
    )
    limit: Annotated[_Scaled | None, _Role(VariableType.QUANTITY, unit='unit')] = Field(
        None, description='Largest offset of the control, in `unit`'
    )
    position: Annotated[_Scaled | None, _Role(VariableType.QUANTITY, unit='position_unit')] = (
        Field(None, description='Commanded position without the offset, in `position_unit`')
    )
    travel: Annotated[tuple[float, ...], Numbers()] = Field(
        (), description='Ends of the axis in `position_unit`, the lower one first'
    )

    @model_validator(mode='after')
    def _check_slope(self) -> '_Axis':
        names = ('slope', 'reference_position', 'travel')
        there = self.model_fields_set.intersection(names)
        if there and len(there) < len(names):
            missing = ', '.join(name for name in names if name not in there)
            raise wrong(
                f'expected slope, reference_position and travel, or none of them, but {missing} '
                'is missing; without travel the offset of a slope is not bounded'
            )
        return self


class ControlFields(ServerFields):
    """Server of a control, and its variables that take part in compensation."""

    unit: Annotated[str, Choice(('um', 'mm', 'm', 'inch'))] = Field(description='Unit of offsets')
    position_unit: Annotated[str, Choice(('um', 'mm', 'm', 'inch'))] = Field(
        'mm', description='Unit of positions'
    )
    hand_shake: _HandShake = Field(description='Variables by which sets are handed over')
    state: _StateFields = Field(description='Variables with the state of the machine')
    probe: _ProbeVariables | None = Field(
        None, description='Variables of a probing cycle, if there is one'
    )
    axes: dict[str, _Axis] = Field(
        {},
        description='Axes that take offsets, by their letters',
        json_schema_extra={'propertyNames': {'enum': list(AXES)}, 'minProperties': 1},
    )

    @model_validator(mode='after')
    def _check_axes(self) -> 'ControlFields':
        if not self.axes:
            raise wrong('expected axes, as axes: {X: ...}, but found none')
        unit = LENGTHS[self.position_unit]
        for name, axis in self.axes.items():
            if name not in AXES:
                raise wrong(f'expected one of {", ".join(AXES)} but found {name!r}', 'axes', name)
            ends = [unit * end for end in axis.travel]
            if 'travel' in axis.model_fields_set and not (
                len(ends) == 2 and -TRAVEL_MAX <= ends[0] < ends[1] <= TRAVEL_MAX
            ):
                raise wrong(
                    'expected the two ends of the axis in position_unit, the lower one first, '
                    'such as [-100, 500]',
                    *('axes', name, 'travel'),
                )
        seen: dict[str, str] = {}
        variables = self.variables()
        for name, item in variables.items():  # written under two names, or written and read
            other = seen.setdefault(item.place, name)
            if other != name and (item.written or variables[other].written):
                raise wrong(f'{name} and {other} are the same variable, {item.place}')
        return self

    def variables(self) -> Mapping[str, ControlVariable]:
        """Return the variables; those of an axis as `X.offset`."""
        units = {'': 1.0, 'unit': LENGTHS[self.unit]}
        units['position_unit'] = LENGTHS[self.position_unit]
        found = {}
        sections: list[tuple[str, Fields]] = [('', self.hand_shake), ('', self.state)]
        if self.probe is not None:
            sections.append(('probe_', self.probe))
        for prefix, section in [*sections, *((f'{a}.', axis) for a, axis in self.axes.items())]:
            for name, item in type(section).model_fields.items():
                role = next((m for m in item.metadata if isinstance(m, _Role)), None)
                place = getattr(section, name)
                if role is None or place is None:
                    continue
                scale = units[role.unit] * getattr(place, 'scale', 1.0)
                if isinstance(place, _Speed):
                    scale *= SPEEDS[place.unit]
                found[prefix + name] = ControlVariable(
                    node=place.node,
                    path=place.path,
                    kind=role.kind,
                    written=role.written,
                    scale=scale,
                    scaled='scale' in place.model_fields_set,
                )
        return found


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
    file = read_file(path, ControlFields, 'a file of a control')
    unit = LENGTHS[file.position_unit]
    # Both ends are zero if the control takes no slope.
    ends = unit * np.array([axis.travel or (0.0, 0.0) for axis in file.axes.values()])
    return ControlFile(
        server=file.server(pin_folder(path, state_directory)),
        axes=tuple(file.axes),
        travel=Travel(low=ends[:, 0], high=ends[:, 1]),
        variables=file.variables(),
    )


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

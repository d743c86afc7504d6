# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The file that says of a thermal test what no bag knows.

docs/how-to/thermal-test.md describes it with an example.
"""

from math import nan
from pathlib import Path
from typing import Annotated, Any

from fuzzycnc_ros.adapters.yaml_model import (
    BeforeValidator,
    Field,
    Fields,
    Text,
    model_validator,
    read_file,
    scalar,
    wrong,
)
from fuzzycnc_ros.cli.quantities import signed_quantity
from fuzzycnc_ros.core.units import LENGTHS
from fuzzycnc_ros.studies.thermal_test.set_up import PROBES, TestSetUp


def _length(node: Any) -> float:
    """Return a length [m] of a text with a unit."""
    text = scalar(node, 'a length with its unit')
    try:
        return signed_quantity('length', text, LENGTHS, example='0.2um')
    except ValueError as error:
        raise wrong(str(error).removeprefix('length: ')) from None


Length = Annotated[
    float,
    BeforeValidator(_length, json_schema_input_type=str),
]
"""A length as text with its unit [m]."""
Words = Annotated[str, Text()]


class _ProbeFields(Fields):
    """A probe."""

    channel: Words = Field(description='Channel of the bag')
    place: Words = Field('', description='Where it is, in words')


class _InstrumentFields(Fields):
    """Instrument of a measurement."""

    name: Words = Field('', description='Make, type, number')
    uncertainty: Length | None = Field(None, description='Expanded (k = 2), such as 0.6um')
    repeatability: Length | None = Field(
        None, description='Standard deviation at rest, such as 0.05um'
    )
    resolution: Length | None = Field(
        None, description='Smallest step that is shown, such as 0.01um'
    )


class ThermalTestFile(Fields):
    """Facts of a thermal test that no bag has."""

    machine: Words = Field('', description='Make, type, number')
    operator: Words = Field('', description='Who did the test')
    date: Words = Field('', description='When it was done, if the bag does not say')
    history: Words = Field('', description='History before the test, such as 12 h switched off')
    ambient: Words = Field('', description='Sensor that reads the temperature of the air')
    instrument: _InstrumentFields | None = Field(None, description='What measured')
    probes: dict[str, _ProbeFields] = Field(
        default_factory=dict, description=f'Probes by name: {", ".join(PROBES)}'
    )
    distance: dict[str, Length] = Field(
        default_factory=dict,
        description='How much farther in +Z probe 1 of X or Y is than probe 2, such as 100mm',
    )

    @model_validator(mode='after')
    def _check_probes(self) -> 'ThermalTestFile':
        for name in self.probes:
            if name not in (*PROBES, 'X', 'Y'):
                raise wrong(
                    f'expected probes {", ".join(PROBES)}, X or Y but found {name!r}', 'probes'
                )
        for axis in self.distance:
            if axis not in ('X', 'Y'):
                raise wrong(f'expected axes X and Y but found {axis!r}', 'distance')
        return self


def read_thermal_test_file(path: Path) -> TestSetUp:
    """Read and check the file of a thermal test.

    Raises
    ------
    ParameterError
        If something is unknown or not valid; the text names file, line and field.
    """
    found = read_file(path, ThermalTestFile, 'a file of a thermal test')
    instrument = found.instrument or _InstrumentFields.model_validate({})

    def stated(length: float | None) -> float:
        return nan if length is None else length

    return TestSetUp(
        machine=found.machine,
        instrument=instrument.name,
        operator=found.operator,
        history=found.history,
        date=found.date,
        uncertainty=stated(instrument.uncertainty),
        repeatability=stated(instrument.repeatability),
        resolution=stated(instrument.resolution),
        ambient=found.ambient,
        probes={name: probe.channel for name, probe in found.probes.items()},
        places={name: probe.place for name, probe in found.probes.items() if probe.place},
        distance=found.distance,
    )

# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Fields of files for any device and its sensors; each protocol adds its own."""

import math
import re
from collections.abc import Mapping
from dataclasses import fields, replace
from pathlib import Path
from typing import Annotated, Any, ClassVar

from fuzzycnc_ros.adapters.readings.devices import SPINDLE, Device, DeviceChannel
from fuzzycnc_ros.adapters.yaml_model import (
    AfterValidator,
    Choice,
    Field,
    Fields,
    Number,
    Numbers,
    Text,
    full,
    model_validator,
    wrong,
)
from fuzzycnc_ros.core.thermal.ntc import Ntc
from fuzzycnc_ros.core.thermal.sensor_limits import LIMIT_BOUNDS
from fuzzycnc_ros.core.units import SPEEDS

HOST = r'[A-Za-z0-9._:%-]+'
PORT = r'/[^:]+'


def nonzero(value: float) -> float:
    """Refuse a scale of 0."""
    if value == 0.0:
        raise wrong('expected another number than 0')
    return value


Scale = Annotated[float, Number(-1e9, 1e9), AfterValidator(nonzero)]
SpeedUnit = Annotated[str, Choice(tuple(SPEEDS))]
Positive = Number(1e-9, 1e12)


class Scaling(Fields):
    """A value of a device; a protocol says in `CHANNEL` where it finds one, and adds fields."""

    CHANNEL: ClassVar[type[DeviceChannel]]

    scale: Scale = Field(1.0, description='degC = scale * raw + offset')
    offset: Annotated[float, Number(-1e9, 1e9)] = Field(
        0.0, description='degC = scale * raw + offset; -273.15 for kelvin'
    )
    open_circuit: Annotated[tuple[int | float, ...], Numbers()] = Field(
        (), description='Raw values that mean no sensor, before the scale'
    )

    def channel(self, name: str, unit: float, largest: float = math.inf) -> DeviceChannel:
        """Return the channel, by the fields that have the names of its own."""
        own = {item.name for item in fields(self.CHANNEL)} - {
            item.name for item in fields(DeviceChannel)
        }
        return self.CHANNEL(
            name=name,
            largest=largest,
            scale=unit * self.scale,
            offset=unit * self.offset,
            open_circuit=self.open_circuit,
            **self.own(own),
        )

    def own(self, names: set[str]) -> dict[str, Any]:
        """Return what the channel has beside what all have."""
        return {name: getattr(self, name) for name in names}


class _Divider(Fields):
    fixed: Annotated[float, Positive] = Field(description='The other resistor [ohm]')
    supply: Annotated[float, Positive] = Field(
        description='Raw value of the supply: 5 with volts, 1023 with counts of 10 bits'
    )
    ntc: Annotated[str, Choice(('low', 'high'))] = Field(
        'low', description='low: between input and ground; high: between input and supply'
    )


class NtcFields(Fields):
    """A thermistor: beta and resistance, or the three coefficients of Steinhart and Hart."""

    beta: Annotated[float, Number(100.0, 20_000.0, 'K')] = Field(
        default_factory=lambda: math.nan, description='Beta [K]'
    )
    resistance: Annotated[float, Positive] = Field(
        10_000.0, description='Resistance at the temperature `at` [ohm], with beta'
    )
    at: Annotated[float, Number(-80.0, 400.0, 'degC')] = Field(
        25.0, description='Temperature of that resistance [degC]'
    )
    steinhart_hart: Annotated[tuple[float, ...], Numbers()] = Field(
        (), description='Coefficients a, b, c of 1/T = a + b ln R + c (ln R)^3, T in K, R in ohm'
    )
    divider: _Divider | None = Field(
        None, description='Where the raw value is a voltage or a count, not the resistance'
    )

    @model_validator(mode='after')
    def _check_curve(self) -> 'NtcFields':
        given = self.model_fields_set & {'beta', 'resistance', 'at'}
        if bool(self.steinhart_hart) == bool(given) or (given and 'beta' not in given):
            raise wrong('expected either beta, with resistance and at, or steinhart_hart')
        if self.steinhart_hart and len(self.steinhart_hart) != 3:
            raise wrong(
                f'expected the three coefficients a, b, c but found {len(self.steinhart_hart)}',
                'steinhart_hart',
            )
        if math.isnan(self.made().temperature(self.middle())):
            raise wrong(
                'expected a curve of a thermistor, but at its middle it gives no temperature from '
                '-80 to 400 degC; compare the coefficients, and their unit, with its data sheet'
            )
        return self

    def middle(self) -> float:
        """Return a raw value at which any thermistor of the kind has a temperature."""
        if self.divider is not None:
            return 0.5 * self.divider.supply
        return 10_000.0 if self.steinhart_hart else self.resistance

    def made(self) -> Ntc:
        """Return the thermistor."""
        divider: dict[str, Any] = {}
        if self.divider is not None:
            divider = {
                'fixed': self.divider.fixed,
                'supply': self.divider.supply,
                'low_side': self.divider.ntc == 'low',
            }
        if self.steinhart_hart:
            a, b, c = self.steinhart_hart
            return Ntc(a, b, c, **divider)
        return Ntc.of_beta(self.beta, self.resistance, self.at, **divider)


class Conversion(Scaling):
    """From a raw value, which may be that of a thermistor, to degC."""

    ntc: NtcFields | None = Field(None, description='Thermistor that raw values come from')


CONVERSION = tuple(Conversion.model_fields)
"""Fields that a device may state for all of its sensors."""

LIMITS = {name: Number(*bounds) for name, bounds in LIMIT_BOUNDS.items()}


class SensorFields(Fields):
    """Limits of a sensor in place of the parameters of these names."""

    range_low: Annotated[float, LIMITS['range_low']] = Field(
        default_factory=lambda: math.nan, description='Lowest plausible reading [degC]'
    )
    range_high: Annotated[float, LIMITS['range_high']] = Field(
        default_factory=lambda: math.nan, description='Highest plausible reading [degC]'
    )
    rate_max: Annotated[float, LIMITS['rate_max']] = Field(
        default_factory=lambda: math.nan, description='Fastest plausible change [K/s]'
    )
    noise_band: Annotated[float, LIMITS['noise_band']] = Field(
        default_factory=lambda: math.nan,
        description='Change between two readings that is never an error [K]',
    )

    def limits(self) -> tuple[tuple[str, float], ...]:
        """Return those that are stated."""
        found = ((name, getattr(self, name)) for name in LIMIT_BOUNDS)
        return tuple((name, value) for name, value in found if not math.isnan(value))


class SpeedFields(Fields):
    """Unit and bound of a spindle speed."""

    unit: SpeedUnit = Field('rpm', description='Unit of the speed')
    max: Annotated[float, Number(0.0, 1e6)] = Field(
        default_factory=lambda: math.inf, description='Greatest speed of the spindle, in `unit`'
    )


class DeviceFields(Fields):
    """A device; a protocol says in `DEVICE` what it makes of one, and adds fields and sensors."""

    DEVICE: ClassVar[type[Device]]
    INHERITED: ClassVar[tuple[str, ...]]
    SHORTHAND: ClassVar[str]

    name: Annotated[str, Text()] = Field(description='Name in messages')
    period: Annotated[float, Number(0.005, 3600.0, 's')] = Field(
        1.0, description='Time between two readings [s]'
    )
    timeout: Annotated[float, Number(0.05, 60.0, 's')] = Field(
        2.0, description='Longest wait for an answer [s]'
    )

    @model_validator(mode='before')
    @classmethod
    def _inherit(cls, data: Any) -> Any:
        """Give the sensors what the device says for all of them."""
        sensors = data.get('sensors') if isinstance(data, dict) else None
        if not isinstance(sensors, dict):
            return data
        common = {name: data[name] for name in cls.INHERITED if name in data}
        inner = {name: full(entry, cls.SHORTHAND) for name, entry in sensors.items()}
        return data | {
            'sensors': {
                name: common | entry if isinstance(entry, dict) else entry
                for name, entry in inner.items()
            }
        }

    def values(self) -> dict[str, Any]:
        """Return what all devices have, the spindle speed as the last channel."""
        spindle = self.spindle
        channels = [
            replace(entry.channel(name, 1.0), limits=entry.limits(), ntc=_ntc(entry))
            for name, entry in self.measured.items()
        ]
        axes = self.axes()
        channels += axes.values()
        if spindle is not None:
            unit = SPEEDS[spindle.unit]
            channels.append(spindle.channel(SPINDLE, unit, spindle.max * unit))
        return {
            'name': self.name,
            'period': self.period,
            'channels': tuple(channels),
            'has_spindle': spindle is not None,
            'axes': tuple(axes),
        }

    def axes(self) -> dict[str, DeviceChannel]:
        """Return the channels of axes by the names of these; most protocols have none."""
        return {}

    @model_validator(mode='after')
    def _check_channels(self) -> 'DeviceFields':
        if not self.values()['channels']:
            raise wrong('expected sensors, as sensors: {T1: ...}, but found none')
        return self

    @property
    def measured(self) -> Mapping[str, Any]:
        """Sensors by name."""
        found: Mapping[str, Any] = getattr(self, 'sensors')  # noqa: B009
        return found

    @property
    def spindle(self) -> Any:
        """The spindle speed, None if it has none."""
        return getattr(self, SPINDLE, None)

    def device(self, folder: Path) -> Device:
        """Return the device, by the fields that have the names of its own.

        Parameters
        ----------
        folder : Path
            Where a certificate is pinned on first use.
        """
        values = self.values()
        own = {item.name for item in fields(self.DEVICE)} - values.keys() - {'timeout'}
        return self.DEVICE(
            **values, timeout=self.timeout, **{name: getattr(self, name) for name in own}
        )

    def clash(self, other: 'DeviceFields') -> str:
        """Return why this and another device of the file do not go together; most always do."""
        return ''


def _ntc(entry: Any) -> Ntc | None:
    found = getattr(entry, 'ntc', None)
    return None if found is None else found.made()


def host_name(text: str) -> str:
    """Refuse what is no name or address of a host."""
    if not re.fullmatch(HOST, text):
        raise wrong(f'expected a name or address but found {text!r}')
    return text


def serial_port(text: str) -> str:
    """Refuse what is no file of a serial port."""
    if not re.fullmatch(PORT, text):
        raise wrong(
            f'expected the file of a serial port, such as /dev/ttyUSB0, but found {text!r}'
        )
    return text

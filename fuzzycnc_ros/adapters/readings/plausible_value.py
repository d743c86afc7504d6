# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Values as devices give them, brought to degC, and the reasons why one is no temperature."""

import math
import re

from fuzzycnc_ros.adapters.readings.devices import SPINDLE, DeviceChannel
from fuzzycnc_ros.adapters.readings.link import Reading
from fuzzycnc_ros.components.thermal.temperature_acquisition import TINY

COLDEST, HOTTEST = -273.15, 1000.0
"""Bounds of what a sensor of a machine reads [degC]; those of `range_low` and `range_high`."""
SHOWN_MAX = 40
"""Most characters of a value that a message shows: it comes from the device."""
NUMBER = re.compile(r'[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?', re.ASCII)
"""A number as devices write it in a text."""


def shown(raw: object) -> str:
    """Return a value as messages show it."""
    text = repr(raw)
    return text if len(text) <= SHOWN_MAX else f'{text[:SHOWN_MAX]}...'


def reading_of(
    channel: DeviceChannel, raw: object, place: str, remedy: str, holder: str = 'found'
) -> Reading:
    """Return the quantity in a raw value, or why there is none.

    Parameters
    ----------
    channel : DeviceChannel
        What the raw value means.
    raw : object
        What the device gave.
    place : str
        Where it was read, for messages.
    remedy : str
        What to compare where a number is no temperature.
    holder : str
        Words before what was found in place of a number.

    Examples
    --------
    >>> reading_of(DeviceChannel(name='T1', scale=0.1), 215, 'line', '')
    21.5
    """
    # A document may hold a whole number that no float takes.
    huge = isinstance(raw, int) and raw.bit_length() > 1000
    if isinstance(raw, bool) or not isinstance(raw, (int, float)) or huge:
        return f'{place}: expected a number but {holder} {shown(raw)}'
    if raw in channel.open_circuit:
        return f'open circuit (raw value {raw})'
    value = scaled(channel, raw)
    if channel.name != SPINDLE and (trouble := no_temperature(raw, value)):
        return f'{place}: {trouble}; {remedy}'
    return value


def no_temperature(raw: int | float, value: Reading) -> str:
    """Return why a raw value and the temperature [degC] in it are none; empty if they may be."""
    if isinstance(value, str):
        return value
    if isinstance(raw, float) and 0.0 < abs(raw) < TINY:
        return f'reads {raw:.3g}, which no sensor does'
    if not COLDEST < value <= HOTTEST:
        return f'reads {value:.5g} degC, which no sensor of a machine does'
    return ''


def scaled(channel: DeviceChannel, raw: int | float) -> Reading:
    """Return scale * raw + offset, raw that of a thermistor in degC; or why that is none."""
    if channel.ntc is not None:
        found = channel.ntc.temperature(raw)
        if math.isnan(found):
            return (
                f'raw value {raw:.6g} is none of its thermistor: broken wire, short circuit, or '
                'compare resistance and divider (supply in the unit of the raw value)'
            )
        raw = found
    value = channel.scale * raw + channel.offset
    return value if math.isfinite(value) else f'reads {value}, expected a finite number'

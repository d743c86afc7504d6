# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Values as devices give them, scaled, and the reasons why one is no temperature."""

import math

from fuzzycnc_ros.components.thermal.temperature_acquisition import TINY

COLDEST, HOTTEST = -273.15, 1000.0
"""Bounds of what a sensor of a machine reads [degC]; those of `range_low` and `range_high`."""


def no_temperature(raw: int | float, value: float | str) -> str:
    """Return why a raw value and the temperature [degC] in it are none; empty if they may be."""
    if isinstance(value, str):
        return value
    if isinstance(raw, float) and 0.0 < abs(raw) < TINY:
        return f'reads {raw:.3g}, which no sensor does'
    if not COLDEST < value <= HOTTEST:
        return f'reads {value:.5g} degC, which no sensor of a machine does'
    return ''


def scaled(scale: float, offset: float, raw: int | float) -> float | str:
    """Return scale * raw + offset, or why that is no temperature."""
    value = scale * raw + offset
    return value if math.isfinite(value) else f'reads {value}, expected a finite number'

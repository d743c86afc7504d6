# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Values of machine files: a plain number is SI, a text carries its unit."""

import re
from collections.abc import Mapping
from math import isfinite, pi
from types import MappingProxyType

_MINUTE = 60.0

UNITS: Mapping[str, Mapping[str, float]] = MappingProxyType(
    {
        '-': {'': 1.0, '%': 0.01},
        'm': {'mm': 1e-3, 'um': 1e-6, 'm': 1.0, 'inch': 25.4e-3},
        's': {'ms': 1e-3, 's': 1.0},
        'm/s': {
            'mm/s': 1e-3,
            'mm/min': 1e-3 / _MINUTE,
            'm/s': 1.0,
            'm/min': 1.0 / _MINUTE,
            'inch/min': 25.4e-3 / _MINUTE,
        },
        'm/s^2': {'m/s^2': 1.0, 'mm/s^2': 1e-3},
        'm/s^3': {'m/s^3': 1.0, 'mm/s^3': 1e-3},
        '1/s': {'1/s': 1.0},
        's^2': {'s^2': 1.0},
        'rad/s': {'rad/s': 1.0, 'Hz': 2.0 * pi},
        'Hz': {'Hz': 1.0},
        'kg': {'kg': 1.0},
        'N': {'N': 1.0},
        'N s/m': {'N s/m': 1.0},
        'N/V': {'N/V': 1.0},
        'V': {'V': 1.0},
    }
)
"""What 1 of each unit is in SI, by the SI unit; the first is the one that is written."""

NUMBER = r'[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?'
"""Pattern of a number before its unit."""

_NUMBER = re.compile(rf'({NUMBER})\s*(.*)')
_SPELLINGS = MappingProxyType({'µm': 'um', 'μm': 'um', 'in': 'inch', 'in/min': 'inch/min'})


def unit_names(unit: str) -> list[str]:
    """Return every way to write a unit of the kind of an SI unit.

    Examples
    --------
    >>> unit_names('m/s^3')
    ['m/s^3', 'mm/s^3', 'm/s³', 'mm/s³']
    """
    plain = [name for name in UNITS[unit] if name]
    spelt = [name for name, meant in _SPELLINGS.items() if meant in plain]
    raised = [name.replace('^2', '²').replace('^3', '³') for name in plain if '^' in name]
    return [*plain, *spelt, *raised]


def si_value(value: object, unit: str) -> object:
    """Return a value of a machine file in SI units.

    Parameters
    ----------
    value : object
        What stands there; a text with a number and a unit is converted, all else kept.
    unit : str
        SI unit of the parameter.

    Raises
    ------
    ValueError
        If a text is no number with a unit of that kind.

    Examples
    --------
    >>> si_value('250 mm/s', 'm/s'), si_value('12 %', '-'), si_value(0.25, 'm/s')
    (0.25, 0.12, 0.25)
    """
    if not isinstance(value, str):
        return value
    text = value.strip().replace('²', '^2').replace('³', '^3')
    match = _NUMBER.fullmatch(text)
    known = UNITS[unit]
    units = ', '.join(name or 'no unit' for name in known)
    if match is None or not isfinite(float(match[1])):
        raise ValueError(f'expected a number ({units}) but found {value!r}')
    name = _SPELLINGS.get(match[2], match[2])
    if name not in known and name:
        raise ValueError(f'expected a number in {units} but found {value!r}')
    number = float(match[1]) * known.get(name, 1.0)  # without a unit it is SI
    return float(f'{number:.15g}')  # 250 mm/s is 0.25 m/s, not 0.25000000000000006


def written(value: float, unit: str) -> float | str:
    """Return a number as machine files write it: with the unit that is usual on the shop floor.

    Examples
    --------
    >>> written(0.25, 'm/s'), written(2.5e-7, 'm'), written(0.02, '-'), written(0.0, 'm/s^3')
    ('250 mm/s', '0.25 um', 0.02, '0 m/s^3')
    """
    if unit == '-':
        return value
    name, factor = next(iter(UNITS[unit].items()))
    if unit == 'm' and 0.0 < abs(value) < 1e-4:
        name, factor = 'um', 1e-6
    if unit == 's' and abs(value) >= 1.0:
        name, factor = 's', 1.0
    return f'{value / factor:.10g} {name}'

# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Units that people write behind numbers, in files and on the command line alike."""

import re
from collections.abc import Mapping
from math import isfinite, pi
from types import MappingProxyType

MILLIMETRE, INCH, MINUTE = 1e-3, 25.4e-3, 60.0  # those of programs would load numpy for the help

LENGTHS: Mapping[str, float] = MappingProxyType(
    {'mm': MILLIMETRE, 'um': 1e-6, 'm': 1.0, 'inch': INCH}
)
"""Units of length [m]."""

FEEDS: Mapping[str, float] = MappingProxyType(
    {
        'mm/min': MILLIMETRE / MINUTE,
        'mm/s': MILLIMETRE,
        'm/min': 1.0 / MINUTE,
        'm/s': 1.0,
        'inch/min': INCH / MINUTE,
    }
)
"""Units of feed [m/s]."""

TIMES: Mapping[str, float] = MappingProxyType(
    {'s': 1.0, 'ms': 1e-3, 'min': MINUTE, 'h': 60.0 * MINUTE, 'd': 1440.0 * MINUTE}
)
"""Units of time [s]."""

SPEEDS: Mapping[str, float] = MappingProxyType({'rpm': 2.0 * pi / MINUTE, 'rad/s': 1.0})
"""Units of spindle speed [rad/s]."""

FORCES: Mapping[str, float] = MappingProxyType({'N': 1.0, 'kN': 1e3})
"""Units of force [N]."""

SHARES: Mapping[str, float] = MappingProxyType({'%': 0.01})
"""Units of shares [-]."""

DECLARED: Mapping[str, tuple[str, Mapping[str, float]]] = MappingProxyType(
    {
        'm': ('a length', LENGTHS),
        'm/s': ('a velocity', {'um/s': 1e-6, 'um/min': 1e-6 / MINUTE, **FEEDS}),
        'm/s^2': ('an acceleration', {'m/s^2': 1.0, 'mm/s^2': MILLIMETRE}),
        'm/s^3': ('a jerk', {'m/s^3': 1.0, 'mm/s^3': MILLIMETRE}),
        '1/m': ('a curvature', {'1/m': 1.0, '1/mm': 1.0 / MILLIMETRE}),
        's': ('a time', TIMES),
        's^2': ('a time squared', {'s^2': 1.0, 'ms^2': 1e-6}),
        '1/s': ('a rate', {'1/s': 1.0, '1/min': 1.0 / MINUTE}),
        'Hz': ('a frequency', {'Hz': 1.0}),
        'K': ('a temperature difference', {'K': 1.0, 'mK': 1e-3}),
        'degC': ('a temperature', {'degC': 1.0}),
        'K/s': ('a rate of temperature', {'K/s': 1.0, 'K/min': 1.0 / MINUTE, 'K/h': 1.0 / 3600.0}),
        'rad': ('an angle', {'rad': 1.0, 'deg': pi / 180.0}),
        'rad/s': (
            'an angular velocity', {'rad/s': 1.0, **SPEEDS, 'Hz': 2.0 * pi},
        ),
        'kg': ('a mass', {'kg': 1.0}),
        'N': ('a force', FORCES),
        'N s/m': ('a viscous friction', {'N s/m': 1.0}),
        'N/V': ('a force per voltage', {'N/V': 1.0}),
        'V': ('a voltage', {'V': 1.0}),
        '-': ('a pure number', SHARES),
    }
)  # fmt: skip
"""Name and units of a quantity, by its SI unit."""

NUMBER = r'[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?'
"""Pattern of a number before its unit."""

SPELLINGS = MappingProxyType({'µm': 'um', 'μm': 'um', 'in': 'inch', 'in/min': 'inch/min'})
"""Other ways to write some units."""

_QUANTITY = re.compile(rf'\s*({NUMBER}|[-+]?(?:nan|inf))\s*(.*?)\s*', re.IGNORECASE)

_DECIMAL_COMMA = re.compile(r'[-+]?\d+,\d+(?:[eE][-+]?\d+)?\s*(?:[^\d\s,][^,]*)?')

_WRITTEN = MappingProxyType({'m': 'mm', 's': 'ms', 'm/s': 'mm/s'})
"""Units that are usual on the shop floor, by the SI unit."""


def split_quantity(text: str) -> tuple[float, str] | None:
    """Return a number and the unit behind it, empty for none; None if it is no number.

    Examples
    --------
    >>> split_quantity('20 µm'), split_quantity('1500 mm/s²'), split_quantity('far')
    ((20.0, 'um'), (1500.0, 'mm/s^2'), None)
    """
    match = _QUANTITY.fullmatch(text.replace('²', '^2').replace('³', '^3'))
    if match is None:
        return None
    unit = match[2]
    return float(match[1]), SPELLINGS.get(unit.lower(), unit)


def in_si(text: str, units: Mapping[str, float]) -> float | None:
    """Return a number in SI, with a unit or without; None if it is none or of another unit.

    Examples
    --------
    >>> in_si('5 um', LENGTHS), in_si('0.25', LENGTHS), in_si('5 s', LENGTHS)
    (5e-06, 0.25, None)
    """
    found = split_quantity(text)
    if found is None or not found[1]:
        return found and found[0]
    number, unit = found
    scale = {name.lower(): value for name, value in units.items()}.get(unit.lower())
    # 5 um are 5e-06 m, and not 4.9999999999999996e-06 m.
    return None if scale is None else float(f'{number * scale:.15g}')


def with_point(text: str) -> str:
    """Return the remedy of a number with a decimal comma; empty if it is none.

    Examples
    --------
    >>> with_point('0,01mm'), with_point('far')
    ('; decimals take a point, as in 0.01mm', '')
    """
    plain = text.strip()
    if not _DECIMAL_COMMA.fullmatch(plain):
        return ''
    return f'; decimals take a point, as in {plain.replace(",", ".", 1)}'


def listed(units: Mapping[str, float]) -> str:
    """Return units as words.

    Examples
    --------
    >>> listed(LENGTHS)
    'mm, um, m or inch'
    """
    *names, last = units
    return f'{", ".join(names)} or {last}' if names else last


def unit_names(unit: str) -> list[str]:
    """Return every way to write a unit of the kind of an SI unit.

    Examples
    --------
    >>> unit_names('m/s^3')
    ['m/s^3', 'mm/s^3', 'm/s³', 'mm/s³']
    """
    plain = list(DECLARED[unit][1])
    spelt = [name for name, meant in SPELLINGS.items() if meant in plain]
    raised = [name.replace('^2', '²').replace('^3', '³') for name in plain if '^' in name]
    return [*plain, *spelt, *raised]


def si_value(value: object, unit: str) -> object:
    """Return a value of a file in SI units.

    Parameters
    ----------
    value : object
        What stands there; a text with a number and a unit is converted, all else kept.
    unit : str
        SI unit of the parameter, of `DECLARED`.

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
    kind, units = DECLARED[unit]
    found = in_si(value, units)
    if found is None or not isfinite(found):
        raise ValueError(
            f'expected {kind} in {listed(units)} but found {value!r}{with_point(value)}'
        )
    return found


def written(value: float, unit: str) -> float | str:
    """Return a number as machine files write it: with the unit that is usual on the shop floor.

    Examples
    --------
    >>> written(0.25, 'm/s'), written(2.5e-7, 'm'), written(0.02, '-'), written(0.0, 'm/s^3')
    ('250 mm/s', '0.25 um', 0.02, '0 m/s^3')
    """
    if unit == '-':
        return value
    name = _WRITTEN.get(unit, unit)
    if unit == 'm' and 0.0 < abs(value) < 1e-4:
        name = 'um'
    if unit == 's' and abs(value) >= 1.0:
        name = 's'
    return f'{value / DECLARED[unit][1][name]:.10g} {name}'

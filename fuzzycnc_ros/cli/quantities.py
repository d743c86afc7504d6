# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Numbers with their units as people write them."""

import re
from collections.abc import Callable, Mapping, Sequence
from math import isfinite, pi
from os.path import exists
from types import MappingProxyType

import typer

MILLIMETRE, INCH, MINUTE = 1e-3, 25.4e-3, 60.0  # those of programs would load numpy for the help

LENGTHS: Mapping[str, float] = MappingProxyType(
    {'mm': MILLIMETRE, 'um': 1e-6, 'm': 1.0, 'inch': INCH}
)
"""What a length of 1 is, by unit [m]."""

FEEDS: Mapping[str, float] = MappingProxyType(
    {
        'mm/min': MILLIMETRE / MINUTE,
        'mm/s': MILLIMETRE,
        'm/min': 1.0 / MINUTE,
        'm/s': 1.0,
        'inch/min': INCH / MINUTE,
    }
)
"""What a feed of 1 is, by unit [m/s]."""

DURATIONS: Mapping[str, float] = MappingProxyType({'s': 1.0, 'min': MINUTE, 'h': 60.0 * MINUTE})
"""What a duration of 1 is, by unit [s]."""

TIMES: Mapping[str, float] = MappingProxyType(
    {'s': 1.0, 'ms': 1e-3, 'min': MINUTE, 'h': 60.0 * MINUTE, 'd': 1440.0 * MINUTE}
)
"""What a time is where a plain number means seconds [s]."""

FORCES: Mapping[str, float] = MappingProxyType({'N': 1.0, 'kN': 1e3})
"""What a force of 1 is, by unit [N]."""

SHARES: Mapping[str, float] = MappingProxyType({'%': 0.01})
"""What a share of 1 is, by unit [-]."""

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
        'K': ('a temperature difference', {'K': 1.0, 'mK': 1e-3}),
        'degC': ('a temperature', {'degC': 1.0}),
        'K/s': ('a rate of temperature', {'K/s': 1.0, 'K/min': 1.0 / MINUTE, 'K/h': 1.0 / 3600.0}),
        'rad': ('an angle', {'rad': 1.0, 'deg': pi / 180.0}),
        'rad/s': ('an angular velocity', {'rad/s': 1.0, 'rpm': 2.0 * pi / MINUTE}),
        '-': ('a pure number', SHARES),
    }
)
"""What is said of a parameter and its units, by the unit of its declaration."""

_QUANTITY = re.compile(r'\s*([-+]?(?:\d+\.?\d*|\.\d+)(?:e[-+]?\d+)?|[-+]?(?:nan|inf))\s*(\S*)\s*')
_OTHER_NAMES = MappingProxyType({'µm': 'um', 'μm': 'um', 'in': 'inch', 'in/min': 'inch/min'})


def quantity(
    option: str, text: str, units: Mapping[str, float], *, example: str, zero: bool = False
) -> float:
    """Return a number with its unit in SI.

    Parameters
    ----------
    option : str
        Where it was given, for errors.
    text : str
        Such as `0.01mm` or `6000 mm/min`.
    units : mapping
        What 1 of each unit is.
    example : str
        A good value, for errors.
    zero : bool
        Whether 0 is allowed.

    Returns
    -------
    float
        Its value, above 0 unless `zero`.

    Raises
    ------
    ValueError
        If it is no number, has no unit or another one, or is out of range.

    Examples
    --------
    >>> f"{quantity('--tolerance', '10um', LENGTHS, example='0.01mm'):g} m"
    '1e-05 m'
    >>> f"{quantity('--feed', '6000 mm/min', FEEDS, example='12000mm/min'):g} m/s"
    '0.1 m/s'
    >>> quantity('--tolerance', '0.01', LENGTHS, example='0.01mm')
    Traceback (most recent call last):
    ValueError: --tolerance: expected a unit, one of mm, um, m, inch, but found '0.01'; \
such as 0.01mm
    """
    known = ', '.join(units)
    match = _QUANTITY.fullmatch(text.lower())
    if match is None:
        raise ValueError(
            f'{option}: expected a number with a unit ({known}) but found {text!r}; such as '
            f'{example}'
        )
    unit = _OTHER_NAMES.get(match[2], match[2])
    if unit not in units:
        wanted = f'expected a unit, one of {known},' if len(units) > 1 else f'expected {known}'
        raise ValueError(f'{option}: {wanted} but found {text!r}; such as {example}')
    value = float(match[1]) * units[unit]
    if not isfinite(value) or value < 0.0 or (value == 0.0 and not zero):
        wanted = 'a number of 0 or more' if zero else 'a number above 0'
        raise ValueError(f'{option}: expected {wanted} but found {text!r}; such as {example}')
    return value


def in_declared_unit(name: str, text: str, unit: str) -> float:
    """Return the value of a parameter in the unit of its declaration.

    Parameters
    ----------
    name : str
        Name of the parameter, for errors.
    text : str
        Number, alone or with a unit of the same kind.
    unit : str
        Unit of the declaration, of `DECLARED`.

    Returns
    -------
    float
        Its value in that unit.

    Raises
    ------
    ValueError
        If it is no number, or its unit is of another kind.

    Examples
    --------
    >>> in_declared_unit('compensator.offset_max', '5 um', 'm')
    5e-06
    >>> in_declared_unit('compensator.offset_max', '5s', 'm')
    Traceback (most recent call last):
    ValueError: compensator.offset_max: expected a length in mm, um, m or inch but found '5s'
    """
    kind, units = DECLARED[unit]
    value = _value(text, units)
    if value is None:
        raise ValueError(f'{name}: expected {kind} in {_listed(units)} but found {text!r}')
    return value


def number_in(units: Mapping[str, float], kind: str) -> Callable[[str | float], float]:
    """Return what reads the value of an option whose plain numbers are in SI.

    Parameters
    ----------
    units : mapping
        What 1 of each unit is.
    kind : str
        What it is, for errors, such as `a time`.
    """

    def read(text: str | float) -> float:
        value = _value(str(text), units)
        if value is None:
            raise typer.BadParameter(
                f'expected {kind} in {_listed(units)} but found {str(text)!r}'
            )
        return value

    return read


def _value(text: str, units: Mapping[str, float]) -> float | None:
    """Return a number in SI, with a unit or without; None if it is none."""
    match = _QUANTITY.fullmatch(text.lower())
    if match is None:
        return None
    number, written = float(match[1]), _OTHER_NAMES.get(match[2], match[2])
    if not written:
        return number
    scale = {name.lower(): value for name, value in units.items()}.get(written)
    # 5 um are 5e-06 m, and not 4.9999999999999996e-06 m.
    return None if scale is None else float(f'{number * scale:.15g}')


def _listed(units: Mapping[str, float]) -> str:
    *names, last = units
    return f'{", ".join(names)} or {last}' if names else last


_UNITS = frozenset(
    name.lower()
    for units in (*(units for _, units in DECLARED.values()), FORCES, _OTHER_NAMES)
    for name in units
)
_NUMBER = re.compile(r'(?:-{0,2}[\w.-]+=)?[-+]?[\d.]+(?:e[-+]?\d+)?(?:x[\d.]+)?', re.IGNORECASE)


def with_their_units(words: Sequence[str]) -> list[str]:
    """Return the words of a command line, with `20 um` as one word where two were typed.

    A number takes the unit behind it if it is the value of an option or stands behind a sign of
    equality, unless there is a file of that name.

    Examples
    --------
    >>> with_their_units(['advise', 'part.ngc', '--tolerance', '20', 'um', '--load=40', '%'])
    ['advise', 'part.ngc', '--tolerance', '20 um', '--load=40 %']
    """
    found: list[str] = []
    for place, word in enumerate(words):
        before = words[place - 1] if place else ''
        option = words[place - 2] if place > 1 else ''
        if (
            word.lower() in _UNITS
            and _NUMBER.fullmatch(before)
            and ('=' in before or (option.startswith('-') and '=' not in option))
            and not exists(word)
        ):
            found[-1] = f'{before} {word}'
        else:
            found.append(word)
    return found

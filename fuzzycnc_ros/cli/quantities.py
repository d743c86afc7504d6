# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Numbers with their units as people write them."""

import re
from collections.abc import Callable, Mapping, Sequence
from math import isfinite
from os.path import exists
from types import MappingProxyType

import typer

from fuzzycnc_ros.core.units import (
    DECLARED,
    FORCES,
    MINUTE,
    SPELLINGS,
    in_si,
    listed,
    split_quantity,
    with_point,
)

DURATIONS: Mapping[str, float] = MappingProxyType({'s': 1.0, 'min': MINUTE, 'h': 60.0 * MINUTE})
"""Units of duration [s]."""

SIZES: Mapping[str, float] = MappingProxyType(
    {'B': 1.0, 'kB': 1e3, 'MB': 1e6, 'GB': 1e9, 'TB': 1e12}
)
"""Units of size [bytes]."""


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
    >>> from fuzzycnc_ros.core.units import FEEDS, LENGTHS
    >>> f"{quantity('--tolerance', '10um', LENGTHS, example='0.01mm'):g} m"
    '1e-05 m'
    >>> f"{quantity('--feed', '6000 mm/min', FEEDS, example='12000mm/min'):g} m/s"
    '0.1 m/s'
    >>> quantity('--tolerance', '0.01', LENGTHS, example='0.01mm')
    Traceback (most recent call last):
    ValueError: --tolerance: expected a unit, one of mm, um, m, inch, but found '0.01'; \
such as 0.01mm
    """
    return _quantity(option, text, text, units, example, zero)


def signed_quantity(
    option: str, text: str, units: Mapping[str, float], *, example: str, zero: bool = True
) -> float:
    """Return a number with its unit and sign in SI; all else as `quantity`.

    Examples
    --------
    >>> from fuzzycnc_ros.core.units import LENGTHS
    >>> signed_quantity('Y', '-2um', LENGTHS, example='-3um')
    -2e-06
    >>> signed_quantity('Y', '-2', LENGTHS, example='-3um')
    Traceback (most recent call last):
    ValueError: Y: expected a unit, one of mm, um, m, inch, but found '-2'; such as -3um
    """
    plain = text.strip()
    sign = -1.0 if plain.startswith('-') else 1.0
    return sign * _quantity(option, text, plain.removeprefix('-'), units, example, zero)


def _quantity(
    option: str, text: str, plain: str, units: Mapping[str, float], example: str, zero: bool
) -> float:
    """Return the value of `plain`, which is what counts of the text that was given."""
    known = ', '.join(units)
    found = split_quantity(plain)
    told = f'but found {text!r}{with_point(text) or f"; such as {example}"}'
    if found is None:
        raise ValueError(f'{option}: expected a number with a unit ({known}) {told}')
    number, unit = found[0], found[1].lower()
    if unit not in units:
        wanted = f'expected a unit, one of {known},' if len(units) > 1 else f'expected {known}'
        raise ValueError(f'{option}: {wanted} {told}')
    value = number * units[unit]
    if not isfinite(value) or value < 0.0 or (value == 0.0 and not zero):
        wanted = 'a number of 0 or more' if zero else 'a number above 0'
        raise ValueError(f'{option}: expected {wanted} {told}')
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
    value = in_si(text, units)
    if value is None:
        raise ValueError(
            f'{name}: expected {kind} in {listed(units)} but found {text!r}{with_point(text)}'
        )
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
        value = in_si(str(text), units)
        if value is None:
            raise typer.BadParameter(
                f'expected {kind} in {listed(units)} but found {str(text)!r}'
                f'{with_point(str(text))}'
            )
        return value

    return read


_UNITS = frozenset(
    name.lower()
    for units in (*(units for _, units in DECLARED.values()), FORCES, SIZES, SPELLINGS)
    for name in units
)
_NUMBER = re.compile(r'(?:-{0,2}[\w.-]+=)?[-+]?[\d.,]+(?:e[-+]?\d+)?(?:x[\d.]+)?', re.IGNORECASE)


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

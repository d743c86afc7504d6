# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Lengths, feeds, durations and shares as people write them: a number with its unit."""

import re
from collections.abc import Mapping
from math import isfinite
from types import MappingProxyType

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

SHARES: Mapping[str, float] = MappingProxyType({'%': 0.01})
"""What a share of 1 is, by unit [-]."""

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

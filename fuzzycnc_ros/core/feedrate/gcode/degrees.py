# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Angles in degrees with the 64 digits of x86's long numbers, the same on every processor.

LinuxCNC turns degrees into radians and back with long numbers: at 90 degrees that decides the
sign of a cosine.  Such numbers differ between processors, so they are whole ones here, with a
power of two.
"""

import math
from functools import lru_cache

_DIGITS = 64
_PI = 0xC90FDAA22168C235  # long number nearest to pi, times 2^62
_SPARE = 192
"""Digits behind the point of sines: those of a long number, as many that cancel, and more."""
_KEPT = 4096
"""Values remembered: programs go round in the same angles."""

_Long = tuple[int, int]
"""A whole number of at most 64 digits, and the power of two that it is multiplied by."""


def sine(angle: float) -> float:
    """Return the sine of an angle in degrees."""
    return _turned(angle, 0) if angle else angle


def cosine(angle: float) -> float:
    """Return the cosine of an angle in degrees.

    Examples
    --------
    >>> cosine(90.0)  # of the long number nearest to a quarter turn, which is a little more
    -2.508278806334166e-20
    """
    return _turned(angle, 1) if angle else 1.0


def tangent(angle: float) -> float:
    """Return the tangent of an angle in degrees."""
    return _slope(angle) if angle else angle


def degrees(angle: float) -> float:
    """Return an angle in radians in degrees."""
    if not angle:
        return angle
    over, under = angle.as_integer_ratio()
    whole, power = _long(180 * over, under, 0)
    return _number(_long(whole, _PI, power + 62))


@lru_cache(_KEPT)
def _turned(angle: float, quarters: int) -> float:
    """Return the sine of an angle in degrees, other than 0, and some quarter turns."""
    whole, power = _radians(angle)
    found = _series(whole, power, quarters)
    return _number(_long(found, 1, -_places(whole, power)))


@lru_cache(_KEPT)
def _slope(angle: float) -> float:
    """Return the tangent of an angle in degrees, other than 0."""
    radians = _radians(angle)
    across, along = _series(*radians, 0), _series(*radians, 1)
    return _number(_long(across, along, 0) if along > 0 else _long(-across, -along, 0))


def _radians(angle: float) -> _Long:
    over, under = angle.as_integer_ratio()
    whole, power = _long(over * _PI, under, -62)
    return _long(whole, 180, power)


def _long(over: int, under: int, power: int) -> _Long:
    """Return the long number nearest to a quotient times a power of two; of two, the even one."""
    shift = over.bit_length() - under.bit_length() - _DIGITS
    size, under = abs(over) << max(-shift, 0), under << max(shift, 0)
    if size >= under << _DIGITS:
        under, shift = under << 1, shift + 1
    whole, rest = divmod(size, under)
    whole += 2 * rest > under or (2 * rest == under and whole & 1)
    return (whole if over > 0 else -whole), power + shift


def _number(value: _Long) -> float:
    return math.ldexp(value[0], value[1])


def _places(whole: int, power: int) -> int:
    """Return how many digits behind the point the sine of a long number is computed with."""
    return _SPARE + abs(whole.bit_length() + power)


def _series(whole: int, power: int, quarters: int) -> int:
    """Return the sine of a long number and some quarter turns, times 2^`_places`."""
    places = _places(whole, power)
    shift = places + power
    rest = whole << shift if shift >= 0 else whole >> -shift
    quarter = _pi(places) >> 1
    turns = (2 * rest + quarter) // (2 * quarter)
    rest -= turns * quarter
    square = rest * rest >> places
    turns += quarters
    term, last = (1 << places, 0) if turns & 1 else (rest, 1)
    found = term
    while abs(term) > 1:
        term = -(term * square >> places) // ((last + 1) * (last + 2))
        found, last = found + term, last + 2
    return -found if turns & 2 else found


@lru_cache(8)
def _pi(places: int) -> int:
    """Return pi times 2^places, after Machin: 16 arctan 1/5 - 4 arctan 1/239."""
    found = 0
    for factor, part in ((16, 5), (-4, 239)):
        term, last = (factor << places + 16) // part, 1
        while term not in (0, -1):
            found += term // last
            term, last = -term // part**2, last + 2
    return found >> 16

# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Values of records as JSON can hold them: what is unknown is None."""

from collections.abc import Collection
from enum import IntEnum
from math import isfinite
from typing import Any


def value_of(names: Collection[str], values: Any, name: str) -> float | None:
    """Return the value of a name, None if it has none."""
    for known, value in zip(names, values, strict=False):
        if known == name:
            return finite(value)
    return None


def finite(value: Any) -> float | None:
    """Return a number, None if it is not finite."""
    return float(value) if isfinite(value) else None


def number(text: str) -> float:
    """Return the number that a text holds, NaN if it is none."""
    try:
        return float(text)
    except ValueError:
        return float('nan')


def word(kind: type[IntEnum], code: int, what: str = 'state') -> str:
    """Return a code in words; a newer sender may know more of them, so `what` names the code."""
    known: dict[int, str] = {item.value: item.name.lower() for item in kind}
    return known.get(int(code), f'{what} {int(code)}')

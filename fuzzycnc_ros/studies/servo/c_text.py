# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""C from templates: constants with their units, and what every exported file says of itself."""

from __future__ import annotations

import re
from math import isinf
from typing import Any, NamedTuple

from fuzzycnc_ros.core import portable
from fuzzycnc_ros.studies.requirement import require


class ExportOrigin(NamedTuple):
    """Name, header and hash of an exported file.

    Attributes
    ----------
    name : str
        Beginning of all names of the file that a program sees; the component's name.
    title, source : str
        Contents of the file, and the machine file that they come from.
    machine_hash : str
        Hash of the axis as the machine file has it, hexadecimal.
    """

    name: str
    title: str
    source: str
    machine_hash: str


def rendered(template: str, values: dict[str, Any], origin: ExportOrigin, **more: Any) -> str:
    """Return a template filled in.

    Raises
    ------
    ValueError
        If the name is none of C.
    """
    if not re.fullmatch('[a-z][a-z0-9_]*', origin.name):
        raise ValueError(f'name: expected letters, digits and _ but found {origin.name!r}')
    jinja2 = require('jinja2')
    environment = jinja2.Environment(
        undefined=jinja2.StrictUndefined,
        keep_trailing_newline=True,
        loader=jinja2.PackageLoader(__package__),
    )
    environment.filters['number'] = number
    return str(environment.get_template(template).render(**values, **origin._asdict(), **more))


def number(value: float) -> str:
    """Return a number as C reads it back to the last bit."""
    value = float(value)
    if isinf(value):
        return 'HUGE_VAL' if value > 0.0 else '-HUGE_VAL'
    return 'NAN' if value != value else repr(value)


def portable_numbers() -> dict[str, Any]:
    """Return the numbers of the elementary functions that have the same digits everywhere."""
    return {
        'log': [number(one) for one in portable._LOG],
        'exp': [number(one) for one in portable._EXP],
        'sin': [number(one) for one in portable._SIN],
        'cos': [number(one) for one in portable._COS],
        'quarter': [number(one) for one in portable._QUARTER],
        'per_quarter': number(portable._PER_QUARTER),
        'root_half': number(portable._ROOT_HALF),
        'ln2_high': number(portable._LN2_HIGH),
        'ln2_low': number(portable._LN2_LOW),
        'per_ln2': number(portable._PER_LN2),
    }

# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Limits of a machine as its LinuxCNC configuration (INI file) has them."""

from __future__ import annotations

import re
import stat
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from math import inf, isfinite
from pathlib import Path
from types import MappingProxyType

from fuzzycnc_ros.core.encodings import decoded
from fuzzycnc_ros.files.os_errors import os_sentence

SIZE_MAX = 1_000_000
"""Largest file that is read [bytes]."""

_SECTION = re.compile(r'\[\s*([A-Za-z0-9_]+)\s*\]')
_INCLUDE = re.compile(r'#INCLUDE\s+(\S.*)')
_LENGTH: Mapping[str, float] = MappingProxyType(
    {'mm': 1e-3, 'metric': 1e-3, 'cm': 1e-2, 'inch': 25.4e-3, 'in': 25.4e-3, 'imperial': 25.4e-3}
)
_NUMBER = re.compile(r'[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?', re.ASCII)
_FAR = 100.0
"""Travel beyond which a limit is none: LinuxCNC's own default is 1e99 [m]."""


@dataclass(frozen=True)
class LinuxcncLimits:
    """Limits in a LinuxCNC configuration; None where it has none.

    Attributes
    ----------
    name : str
        Name of the machine; empty if it has none.
    axes : dict of str to dict of str to float
        By axis, limits by the names of `AxisLimits`, in SI.
    path : dict of str to float
        Limits along the path by the names of `PathLimits`, in SI.
    """

    name: str
    axes: dict[str, dict[str, float]]
    path: dict[str, float]


def read_linuxcnc_ini(path: Path) -> LinuxcncLimits:
    """Read the limits of a LinuxCNC configuration.

    What `OFFSET_AV_RATIO` keeps for external offsets is taken off velocity and acceleration of an
    axis, as LinuxCNC does.

    Raises
    ------
    ValueError
        If the file is missing or no LinuxCNC configuration; the message names file and line.
    """
    entries = read_sections(path)
    traj = entries.get('TRAJ', {})
    if 'LINEAR_UNITS' not in traj:
        raise ValueError(
            f'{path}: expected a LinuxCNC configuration with LINEAR_UNITS in [TRAJ] but found none'
        )
    word, line = traj['LINEAR_UNITS']
    unit = _LENGTH.get(word.lower())
    if unit is None:
        raise ValueError(
            f'{path}: line {line}: LINEAR_UNITS: expected one of {", ".join(_LENGTH)} but found '
            f'{word!r}'
        )
    letters = re.findall('[XYZ]', traj.get('COORDINATES', ('X Y Z', 0))[0].upper())
    axes: dict[str, dict[str, float]] = {}
    for letter in dict.fromkeys(letters):
        section = entries.get(f'AXIS_{letter}', {})
        ratio = _number(path, section, 'OFFSET_AV_RATIO', 1.0).get('OFFSET_AV_RATIO', 0.0)
        if not 0.0 <= ratio < 1.0:
            text, line = section['OFFSET_AV_RATIO']
            raise ValueError(
                f'{path}: line {line}: OFFSET_AV_RATIO: expected a share from 0 to below 1 but '
                f'found {text!r}'
            )
        share = 1.0 - ratio
        found = {
            'velocity': _number(path, section, 'MAX_VELOCITY', unit * share),
            'acceleration': _number(path, section, 'MAX_ACCELERATION', unit * share),
            'jerk': _number(path, section, 'MAX_JERK', unit),
            'travel_low': _number(path, section, 'MIN_LIMIT', unit),
            'travel_high': _number(path, section, 'MAX_LIMIT', unit),
        }
        axes[letter] = {
            name: value for name, one in found.items() for value in one.values() if _near(value)
        }
    limits = {
        'velocity': _number(path, traj, 'MAX_LINEAR_VELOCITY', unit)
        or _number(path, traj, 'MAX_VELOCITY', unit),
        'acceleration': _number(path, traj, 'MAX_LINEAR_ACCELERATION', unit)
        or _number(path, traj, 'MAX_ACCELERATION', unit),
        'jerk': _number(path, traj, 'MAX_LINEAR_JERK', unit),
    }
    name = entries.get('EMC', {}).get('MACHINE', ('', 0))[0]
    return LinuxcncLimits(
        name, axes, {key: value for key, one in limits.items() for value in one.values()}
    )


def _near(value: float) -> bool:
    return abs(value) < _FAR


def _text(path: Path) -> str:
    """Return the text of a configuration, or of a file that one includes."""
    try:
        status = path.stat()
        # A pipe would be waited for; an endless device has no size.
        if not (stat.S_ISREG(status.st_mode) or stat.S_ISDIR(status.st_mode)) or (
            status.st_size > SIZE_MAX
        ):
            raise ValueError(f'{path}: expected a LinuxCNC configuration, a file of at most 1 MB')
        data = path.read_bytes()
    except OSError as error:
        raise ValueError(os_sentence(error, path)) from error
    try:
        return decoded(data, errors='replace')
    except ValueError as error:
        raise ValueError(f'{path}: {error}') from error


def _lines(path: Path) -> Iterator[tuple[int, str]]:
    """Yield the lines of a configuration with their numbers.

    Those of a file that it includes have the number of the line that says so.  What is included
    includes nothing: LinuxCNC expands one level.
    """
    size = 0
    for number, line in enumerate(_text(path).split('\n'), 1):  # no other mark ends a line
        included = _INCLUDE.match(line)
        if included is None:
            yield number, line
            continue
        name = Path(included[1].strip())
        with suppress(RuntimeError):  # a home folder that nobody has
            name = name.expanduser()
        try:
            text = _text(path.parent / name)
        except ValueError as error:
            raise ValueError(f'{path}: line {number}: #INCLUDE: {error}') from error
        size += len(text)
        if size > SIZE_MAX:
            raise ValueError(
                f'{path}: line {number}: #INCLUDE: expected a LinuxCNC configuration of at most '
                '1 MB in all'
            )
        for inner in text.split('\n'):
            yield number, inner


def read_sections(path: Path) -> dict[str, dict[str, tuple[str, int]]]:
    """Return entries and their lines by section; the first of several with one name counts.

    Raises
    ------
    ValueError
        If the file is missing or too large to be a configuration.
    """
    found: dict[str, dict[str, tuple[str, int]]] = {}
    section: dict[str, tuple[str, int]] = {}
    for number, raw in _lines(path):
        line = raw.strip()
        if not line or line[0] in '#;':
            continue
        match = _SECTION.match(line)
        if match:
            section = found.setdefault(match[1].upper(), {})
        elif '=' in line:
            key, _, value = line.partition('=')
            section.setdefault(key.strip().upper(), (value.split('#')[0].strip(), number))
    return found


def _number(
    path: Path, section: dict[str, tuple[str, int]], name: str, unit: float
) -> dict[str, float]:
    """Return a number under its name in SI; empty where the file does not say it."""
    if name not in section:
        return {}
    text, line = section[name]
    # Python alone takes 5_0, and digits of other scripts.
    value = float(text) * unit if _NUMBER.fullmatch(text) else inf
    if not isfinite(value):
        raise ValueError(f'{path}: line {line}: {name}: expected a number but found {text!r}')
    return {name: value}

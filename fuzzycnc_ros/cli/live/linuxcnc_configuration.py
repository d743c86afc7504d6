# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Configurations of LinuxCNC: what they lack for offsets along their axes."""

import re
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple

from fuzzycnc_ros.adapters.linuxcnc.component import (
    FEED,
    current_component,
    hal_text,
    linuxcnc_version,
)
from fuzzycnc_ros.adapters.linuxcnc.control import LinuxcncError
from fuzzycnc_ros.adapters.linuxcnc.hal_process import HAL_FILES
from fuzzycnc_ros.adapters.linuxcnc.simulation import shipped
from fuzzycnc_ros.machine_file.linuxcnc_ini import read_sections

AXES = 'XYZUVW'
"""Axes whose offsets are lengths."""


class Finding(NamedTuple):
    """One thing that offsets need: whether it is there, and what was found or is to be done."""

    what: str
    fine: bool
    text: str


def coordinates_of(ini: Path) -> str:
    """Return COORDINATES of a configuration in capitals; empty where it has none."""
    return read_sections(ini).get('TRAJ', {}).get('COORDINATES', ('', 0))[0].upper()


def axes_of(ini: Path) -> tuple[str, ...]:
    """Return the axes of a configuration whose offsets are lengths.

    Raises
    ------
    ValueError
        If the file is no configuration of LinuxCNC, or has no such axis.
    """
    axes = tuple(dict.fromkeys(letter for letter in coordinates_of(ini) if letter in AXES))
    if not axes:
        raise ValueError(f'{ini}: expected one of {AXES} as COORDINATES in [TRAJ] but found none')
    return axes


def joint_of(ini: Path, axis: str) -> int:
    """Return the joint of an axis.

    Raises
    ------
    ValueError
        If the file is no configuration of LinuxCNC, or has no such axis, or two joints of it.
    """
    word = coordinates_of(ini)
    letters = word.replace(' ', '')
    if letters.count(axis) != 1:
        raise ValueError(
            f'{ini}: expected {axis} once as COORDINATES in [TRAJ] but found {word or "none"}'
        )
    return letters.index(axis)


def lacking_lines(ini: Path) -> list[str]:
    """Return the lines that a configuration lacks, each after its section.

    Raises
    ------
    ValueError
        If the file is no configuration of LinuxCNC.
    """
    have, lines = read_sections(ini), []
    section = ''
    for line in shipped('fuzzycnc.ini').read_text().splitlines():
        name, _, value = (part.strip() for part in line.partition('='))
        if line.startswith('['):
            section = line.strip('[]')
        elif value and not line.startswith('#') and name != 'HALFILE':
            axis = section.removeprefix('AXIS_')
            if section.startswith('AXIS_') and axis != 'X':
                continue
            names = [f'AXIS_{axis}' for axis in axes_of(ini)] if axis == 'X' else [section]
            lines += [
                f'[{n}]{name} = {value}'
                for n in names
                # With a share of 0, the default of LinuxCNC, no offset ever moves.
                if (found := have.get(n, {}).get(name)) is None
                or (axis == 'X' and re.fullmatch(r'[0.]+', found[0].strip()))
            ]
    if HAL_FILES[True] not in hal_files(ini):
        lines.insert(0, f'[HAL]HALFILE = {HAL_FILES[True]}')
    return lines


def has_offsets(ini: Path) -> bool:
    """Return whether a configuration loads a HAL file for offsets or feed shares."""
    return not {*HAL_FILES, f'{FEED}.hal'}.isdisjoint(hal_files(ini))


def lacking_feed_lines(ini: Path) -> list[str]:
    """Return the lines that a configuration lacks for feed shares, each after its section."""
    have = read_sections(ini)
    lines = []
    if f'{FEED}.hal' not in hal_files(ini):
        lines.append(f'[HAL]HALFILE = {FEED}.hal')
    if 'HALUI' not in have.get('HAL', {}):
        lines.append('[HAL]HALUI = halui')
    if 'FEED_TABLE' not in have.get('FUZZYCNC', {}):
        lines.append('[FUZZYCNC]FEED_TABLE = part.feed')
    return lines


def check(ini: Path) -> Iterator[Finding]:
    """Look at everything that offsets along the axes of a configuration need.

    Raises
    ------
    ValueError
        If the file is no configuration of LinuxCNC.
    """
    sections = read_sections(ini)
    looks: tuple[tuple[str, Callable[[], object]], ...] = (
        ('LinuxCNC', linuxcnc_version),
        ('component', current_component),
    )
    feeds = f'{FEED}.hal' in hal_files(ini)
    if feeds:
        looks = (*looks, ('component of feed shares', lambda: current_component(FEED)))
    for what, look in looks:
        try:
            yield Finding(what, True, str(look()))
        except LinuxcncError as error:
            yield Finding(what, False, str(error))
    written = ini.parent / HAL_FILES[True]
    if not written.exists():
        yield Finding('HAL file', False, f'{written} is missing: fuzzycnc linuxcnc install {ini}')
    elif written.read_text(errors='replace') != hal_text(axes_of(ini)):
        yield Finding('HAL file', False, f'{written} is not that for {", ".join(axes_of(ini))}')
    else:
        yield Finding('HAL file', True, str(written))
    files = hal_files(ini)
    if HAL_FILES[True] in files and HAL_FILES[False] in files:
        yield Finding('INI file', False, f'loads {" and ".join(HAL_FILES)}: remove the first')
    lacking = lacking_lines(ini) + (lacking_feed_lines(ini) if feeds else [])
    yield Finding('INI file', not lacking, f'lacks {"; ".join(lacking)}' if lacking else str(ini))
    for axis in axes_of(ini):
        section = sections.get(f'AXIS_{axis}', {})
        missing = [name for name in ('MIN_LIMIT', 'MAX_LIMIT') if name not in section]
        text = f'no {" and ".join(missing)} in [AXIS_{axis}]: offsets cannot slope along it'
        ends = ' to '.join(section[name][0] for name in ('MIN_LIMIT', 'MAX_LIMIT') if not missing)
        yield Finding(f'travel {axis}', not missing, text if missing else ends)


def hal_files(ini: Path) -> list[str]:
    """Return the names of all HAL files that a configuration loads."""
    found = re.findall(
        r'^\s*HALFILE\s*=\s*(\S+)', ini.read_text(errors='replace'), re.MULTILINE | re.IGNORECASE
    )
    return [Path(name).name for name in found]

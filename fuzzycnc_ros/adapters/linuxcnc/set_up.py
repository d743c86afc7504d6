# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The realtime component `fuzzycnc_offset`, and what a configuration of LinuxCNC needs for it."""

import re
import shutil
import subprocess
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

from fuzzycnc_ros.adapters.linuxcnc.control import LinuxcncError
from fuzzycnc_ros.adapters.linuxcnc.hal_process import HAL_FILES
from fuzzycnc_ros.adapters.linuxcnc.simulation import shipped
from fuzzycnc_ros.machine_file.linuxcnc_ini import read_sections

COMPONENT = 'fuzzycnc_offset'
COMPILER = 'halcompile'
OLDEST = (2, 9)
"""First version of LinuxCNC that has been tried."""
TIMEOUT = 120.0
AXES = 'XYZUVW'
"""Axes whose offsets are lengths."""


class Finding(NamedTuple):
    """One thing that offsets need: whether it is there, and what was found or is to be done."""

    what: str
    fine: bool
    text: str


def linuxcnc_version() -> str:
    """Return the version of the installed LinuxCNC.

    Raises
    ------
    LinuxcncError
        If there is none, or one too old for external offsets along an axis.
    """
    try:
        version = _run('linuxcnc_var', 'LINUXCNCVERSION').strip()
    except LinuxcncError:
        raise LinuxcncError(
            'expected an installed LinuxCNC but found none (Debian: apt-get install '
            'linuxcnc-uspace)'
        ) from None
    numbers = tuple(int(number) for number in re.findall(r'\d+', version)[:2])
    if numbers < OLDEST:
        raise LinuxcncError(
            f'expected LinuxCNC {".".join(map(str, OLDEST))} or newer but found {version}'
        )
    return version


def installed_component() -> Path | None:
    """Return where the component is installed; None if it is not.

    Raises
    ------
    LinuxcncError
        If there is no compiler that tells where LinuxCNC looks for it.
    """
    text = Path(_compile('--print-modinc').strip()).read_text(encoding='utf-8')
    for folder in re.findall(r'^RTLIBDIR\s*:=\s*(\S+)', text, re.MULTILINE):
        path = Path(folder, f'{COMPONENT}.so')
        if path.exists():
            return path
    return None


def install_component() -> None:
    """Build the component from its source, and install it where LinuxCNC looks for it.

    Raises
    ------
    LinuxcncError
        If that is not possible.
    """
    _compile('--install', str(shipped(f'{COMPONENT}.comp')))


def hal_text(axes: Sequence[str]) -> str:
    """Return the HAL file with the component for axes, from the shipped one."""
    head, *blocks = re.split(r'^(?=# axis )', shipped(HAL_FILES[True]).read_text(), flags=re.M)
    head = head.replace('# axes X, Y, Z.', f'# axes {", ".join(axes)}.')
    head = head.replace('personality=3', f'personality={len(axes)}')
    block = blocks[0].strip()
    written = [
        re.sub(r'-0\b', f'-{number}', block)
        .replace('axis X', f'axis {axis}')
        .replace('AXIS_X', f'AXIS_{axis}')
        .replace('axis.x.', f'axis.{axis.lower()}.')
        .replace('-x', f'-{axis.lower()}')
        for number, axis in enumerate(axes)
    ]
    return '\n\n'.join([head.strip(), *written]) + '\n'


def axes_of(ini: Path) -> tuple[str, ...]:
    """Return the axes of a configuration whose offsets are lengths.

    Raises
    ------
    ValueError
        If the file is no configuration of LinuxCNC, or has no such axis.
    """
    word = read_sections(ini).get('TRAJ', {}).get('COORDINATES', ('', 0))[0].upper()
    axes = tuple(dict.fromkeys(letter for letter in word if letter in AXES))
    if not axes:
        raise ValueError(f'{ini}: expected one of {AXES} as COORDINATES in [TRAJ] but found none')
    return axes


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
            lines += [f'[{n}]{name} = {value}' for n in names if name not in have.get(n, {})]
    if HAL_FILES[True] not in _hal_files(ini):
        lines.insert(0, f'[HAL]HALFILE = {HAL_FILES[True]}')
    return lines


def check(ini: Path) -> Iterator[Finding]:
    """Look at everything that offsets along the axes of a configuration need.

    Raises
    ------
    ValueError
        If the file is no configuration of LinuxCNC.
    """
    sections = read_sections(ini)
    for what, look in (('LinuxCNC', linuxcnc_version), ('component', _component_text)):
        try:
            yield Finding(what, True, look())
        except LinuxcncError as error:
            yield Finding(what, False, str(error))
    written = ini.parent / HAL_FILES[True]
    if not written.exists():
        yield Finding('HAL file', False, f'{written} is missing: fuzzycnc linuxcnc install {ini}')
    elif written.read_text(errors='replace') != hal_text(axes_of(ini)):
        yield Finding('HAL file', False, f'{written} is not that for {", ".join(axes_of(ini))}')
    else:
        yield Finding('HAL file', True, str(written))
    files = _hal_files(ini)
    if HAL_FILES[True] in files and HAL_FILES[False] in files:
        yield Finding('INI file', False, f'loads {" and ".join(HAL_FILES)}: remove the first')
    lacking = lacking_lines(ini)
    yield Finding('INI file', not lacking, f'lacks {"; ".join(lacking)}' if lacking else str(ini))
    for axis in axes_of(ini):
        section = sections.get(f'AXIS_{axis}', {})
        missing = [name for name in ('MIN_LIMIT', 'MAX_LIMIT') if name not in section]
        text = f'no {" and ".join(missing)} in [AXIS_{axis}]: offsets cannot slope along it'
        ends = ' to '.join(section[name][0] for name in ('MIN_LIMIT', 'MAX_LIMIT') if not missing)
        yield Finding(f'travel {axis}', not missing, text if missing else ends)


def _component_text() -> str:
    found = installed_component()
    if found is None:
        raise LinuxcncError(f'{COMPONENT} is not installed: fuzzycnc linuxcnc install')
    source = shipped(f'{COMPONENT}.comp')
    if found.stat().st_mtime < max(
        path.stat().st_mtime for path in (source, source.with_suffix('.h'))
    ):
        raise LinuxcncError(f'{found} is older than its source: fuzzycnc linuxcnc install')
    return str(found)


def _hal_files(ini: Path) -> list[str]:
    """Return the names of all HAL files that a configuration loads."""
    found = re.findall(
        r'^\s*HALFILE\s*=\s*(\S+)', ini.read_text(errors='replace'), re.MULTILINE | re.IGNORECASE
    )
    return [Path(name).name for name in found]


def _compile(*words: str) -> str:
    """Run LinuxCNC's compiler of components; return what it says."""
    if shutil.which(COMPILER) is None:
        raise LinuxcncError(
            f'expected {COMPILER} but found none (Debian: apt-get install linuxcnc-uspace-dev); '
            f'without it {HAL_FILES[False]} serves, with which no offset slopes along an axis'
        )
    return _run(COMPILER, *words)


def _run(*words: str) -> str:
    try:
        done = subprocess.run(words, capture_output=True, text=True, check=False, timeout=TIMEOUT)
    except (OSError, subprocess.TimeoutExpired) as error:
        raise LinuxcncError(f'{" ".join(words)}: {error}') from error
    if done.returncode:
        last = (done.stdout + done.stderr).strip().splitlines()[-3:]
        raise LinuxcncError(f'{" ".join(words)}: {"; ".join(last)}')
    return done.stdout

# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The realtime components `fuzzycnc_offset` and `fuzzycnc_feed`: built, installed, HAL files."""

import contextlib
import re
import shutil
import subprocess
import time
from collections.abc import Callable, Sequence
from pathlib import Path

from fuzzycnc_ros.adapters.linuxcnc.control import LinuxcncError
from fuzzycnc_ros.adapters.linuxcnc.hal_process import HAL_FILES
from fuzzycnc_ros.adapters.linuxcnc.simulation import shipped

COMPONENT = 'fuzzycnc_offset'
FEED = 'fuzzycnc_feed'
FEED_TABLE = '[FUZZYCNC]FEED_TABLE'
"""Table of the component of feed shares in its HAL file."""
COMPILER = 'halcompile'
OLDEST = (2, 9)
"""First version of LinuxCNC that has been tried."""
TIMEOUT = 120.0
PASSED = 0.1
"""Time in which the servo thread has left a function that was taken from it [s]."""


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


def installed_component(name: str = COMPONENT) -> Path | None:
    """Return where a component is installed; None if it is not.

    Raises
    ------
    LinuxcncError
        If there is no compiler that tells where LinuxCNC looks for it.
    """
    text = Path(_compile('--print-modinc').strip()).read_text(encoding='utf-8')
    for folder in re.findall(r'^RTLIBDIR\s*:=\s*(\S+)', text, re.MULTILINE):
        path = Path(folder, f'{name}.so')
        if path.exists():
            return path
    return None


def install_component(source: Path) -> None:
    """Build a component from its source, and install it where LinuxCNC looks for it.

    Parameters
    ----------
    source : Path
        File that halcompile takes.

    Raises
    ------
    LinuxcncError
        If that is not possible.
    """
    _compile('--install', str(source))


def remove_component(name: str) -> None:
    """Remove a component from where LinuxCNC looks for it, if it is there."""
    found = installed_component(name)
    if found is not None:
        found.unlink()


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


def current_component(name: str = COMPONENT) -> Path:
    """Return where a component is installed, as new as its source.

    Raises
    ------
    LinuxcncError
        If it is not.
    """
    found = installed_component(name)
    if found is None:
        raise LinuxcncError(f'{name} is not installed: fuzzycnc linuxcnc install')
    source = shipped(f'{name}.comp')
    if found.stat().st_mtime < max(
        path.stat().st_mtime for path in source.parent.glob(f'{name}*.[ch]*')
    ):
        raise LinuxcncError(f'{found} is older than its source: fuzzycnc linuxcnc install')
    return found


def load_feed(halcmd: Callable[..., object], table: Path) -> None:
    """Load the component of feed shares with a table into a LinuxCNC that runs, if need be anew.

    Parameters
    ----------
    halcmd : callable
        Runs `halcmd` with some words; no program may run.
    table : Path
        File of the table.

    Raises
    ------
    LinuxcncError
        If `halcmd` does not do it.
    """
    with contextlib.suppress(LinuxcncError):  # it is not loaded
        halcmd('delf', 'fuzzycnc-feed', 'servo-thread')
        time.sleep(PASSED)
        halcmd('unloadrt', FEED)
        halcmd('sets', 'fuzzycnc-feed-share', '1')
    for line in shipped(f'{FEED}.hal').read_text().splitlines():
        words = line.partition('#')[0].replace(FEED_TABLE, str(table)).split()
        if words:
            halcmd(*words)


def run_halcmd(*words: str) -> str:
    """Do something to the HAL of the LinuxCNC that runs here; return what it says.

    Raises
    ------
    LinuxcncError
        If it does not work.
    """
    return _run('halcmd', *words)


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

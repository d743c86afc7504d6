# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""`fuzzycnc linuxcnc`: what a LinuxCNC needs for offsets, installed and checked."""

from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

import typer

from fuzzycnc_ros.cli.console import check_new, say, write_text

HELP = """Install and check what a LinuxCNC needs for offsets along its axes.

    fuzzycnc linuxcnc install mill.ini
    fuzzycnc linuxcnc check mill.ini

Installing writes among the modules of LinuxCNC: use sudo. docs/how-to/linuxcnc.md has the rest.
"""

Ini = Annotated[
    Path, typer.Argument(metavar='FILE.ini', help='Configuration (INI file) of LinuxCNC.')
]


def install(ini: Ini) -> None:
    """Build the realtime component, write the HAL file, show which lines the INI file lacks.

    The component is built by LinuxCNC's halcompile and installed among its modules, which takes
    the rights to write there (sudo). The HAL file goes beside the INI file, which stays as it is.

        fuzzycnc linuxcnc install ~/linuxcnc/configs/mill/mill.ini
    """
    from fuzzycnc_ros.adapters.linuxcnc.component import (
        hal_text,
        install_component,
        installed_component,
        linuxcnc_version,
    )
    from fuzzycnc_ros.adapters.linuxcnc.control import LinuxcncError
    from fuzzycnc_ros.adapters.linuxcnc.hal_process import HAL_FILES
    from fuzzycnc_ros.cli.live.linuxcnc_configuration import axes_of, lacking_lines

    axes, lacking = axes_of(ini), lacking_lines(ini)
    text, out = hal_text(axes), ini.parent / HAL_FILES[True]
    if not (out.exists() and out.read_text(errors='replace') == text):
        check_new(out, 'remove it: it is not that of these axes')
    try:
        version = linuxcnc_version()
        install_component()
        say(f'LinuxCNC {version}: {installed_component()}')
    except LinuxcncError as error:
        raise ValueError(str(error)) from error
    write_text(out, text)
    say(f'{out}: axes {", ".join(axes)}')
    if lacking:
        say(f'{ini}: add, each to its section')
    for line in lacking:
        say(f'  {line}')


def check(ini: Ini) -> None:
    """Check versions, the component, the HAL file and the INI file; ends with 1 if one lacks.

    Nothing is changed; LinuxCNC may run meanwhile.

        fuzzycnc linuxcnc check ~/linuxcnc/configs/mill/mill.ini
    """
    from fuzzycnc_ros.cli.live import linuxcnc_configuration

    fine = True
    for finding in linuxcnc_configuration.check(ini):
        fine = fine and finding.fine
        say(f'{"" if finding.fine else "! "}{finding.what}: {finding.text}')
    if not fine:
        raise typer.Exit(1)


COMMANDS: dict[str, Callable[..., Any]] = {'install': install, 'check': check}

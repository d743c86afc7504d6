# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""`fuzzycnc linuxcnc`: what a LinuxCNC needs for offsets and feed shares."""

from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

import typer

from fuzzycnc_ros.cli.console import check_new, say, write_text

HELP = """Install and check what a LinuxCNC needs for offsets along its axes and for feed shares.

    fuzzycnc linuxcnc install mill.ini
    fuzzycnc linuxcnc check mill.ini
    fuzzycnc linuxcnc feed part.ngc part.feed

Installing writes among the modules of LinuxCNC: use sudo. docs/how-to/linuxcnc.md has the rest.
"""

Ini = Annotated[
    Path, typer.Argument(metavar='FILE.ini', help='Configuration (INI file) of LinuxCNC.')
]


def install(
    ini: Ini,
    feed: Annotated[
        bool, typer.Option('--feed', help='What feed shares along the path need, too.')
    ] = False,
) -> None:
    """Build the realtime component, write the HAL file, show which lines the INI file lacks.

    The component is built by LinuxCNC's halcompile and installed among its modules, which takes
    the rights to write there (sudo). The HAL file goes beside the INI file, which stays as it is.

        fuzzycnc linuxcnc install ~/linuxcnc/configs/mill/mill.ini
        sudo fuzzycnc linuxcnc install mill.ini --feed
    """
    from fuzzycnc_ros.adapters.linuxcnc.component import (
        COMPONENT,
        FEED,
        hal_text,
        install_component,
        installed_component,
        linuxcnc_version,
    )
    from fuzzycnc_ros.adapters.linuxcnc.control import LinuxcncError
    from fuzzycnc_ros.adapters.linuxcnc.hal_process import HAL_FILES
    from fuzzycnc_ros.adapters.linuxcnc.simulation import shipped
    from fuzzycnc_ros.cli.live.linuxcnc_configuration import (
        axes_of,
        lacking_feed_lines,
        lacking_lines,
    )

    axes, lacking = axes_of(ini), lacking_lines(ini)
    if feed:
        lacking += lacking_feed_lines(ini)
    text, out = hal_text(axes), ini.parent / HAL_FILES[True]
    if not (out.exists() and out.read_text(errors='replace') == text):
        check_new(out, 'remove it: it is not that of these axes')
    try:
        version = linuxcnc_version()
        for name in (COMPONENT, FEED) if feed else (COMPONENT,):
            install_component(name)
            say(f'LinuxCNC {version}: {installed_component(name)}')
    except LinuxcncError as error:
        raise ValueError(str(error)) from error
    write_text(out, text)
    say(f'{out}: axes {", ".join(axes)}')
    if feed:
        out = ini.parent / f'{FEED}.hal'
        write_text(out, shipped(out.name).read_text())
        say(f'{out}: axes X, Y, Z')
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


def follow(
    program: Annotated[
        Path, typer.Argument(metavar='PROGRAM', help='Part program that LinuxCNC has loaded.')
    ],
    table: Annotated[Path, typer.Argument(metavar='TABLE', help='Its feed shares.')],
    load: Annotated[
        bool,
        typer.Option(
            '--load', help='Load the table into the component first, while no program runs.'
        ),
    ] = False,
    interpreter: Annotated[
        str,
        typer.Option(metavar='FILE', help="Python that LinuxCNC's modules are built for."),
    ] = '/usr/bin/python3',
) -> None:
    """Let a running LinuxCNC follow the feed shares of a program; ends with LinuxCNC or Ctrl-C.

    While the program that LinuxCNC has loaded is that of the table, and work offset, tool length,
    rotation and cutter compensation are those that it was made for, the component fuzzycnc_feed is
    armed; otherwise one line says why not. A program that runs while this command ends goes on
    with the least share of the table.

        fuzzycnc linuxcnc feed part.ngc part.feed
        fuzzycnc linuxcnc feed part.ngc part.feed --load
    """
    import subprocess

    from fuzzycnc_ros.adapters.linuxcnc import feed_process
    from fuzzycnc_ros.adapters.linuxcnc.component import load_feed, run_halcmd
    from fuzzycnc_ros.adapters.linuxcnc.control import LinuxcncError
    from fuzzycnc_ros.studies.programs.adaptive_feed import program_hash, table_header

    try:
        known, offset, length = table_header(table.read_text(errors='replace'))
    except ValueError as error:
        raise ValueError(f'{table}: {error}') from error
    found = program_hash(program.read_text(encoding='utf-8', errors='surrogateescape'))
    if found != known:
        raise ValueError(
            f'{table}: expected the table of {program} ({found[:8]}) but found that of another '
            f'program ({known[:8]}); schedule it again'
        )
    try:
        if load:
            if run_halcmd('getp', 'halui.program.is-idle').strip() != 'TRUE':
                raise ValueError('--load: expected that no program runs but one does; wait for it')
            load_feed(run_halcmd, table.absolute())
    except LinuxcncError as error:
        raise ValueError(str(error)) from error
    words = [interpreter, str(feed_process.__file__), known, str(offset), str(length)]
    try:
        done = subprocess.run(words, check=False, stderr=subprocess.PIPE, text=True)
    except OSError as error:
        raise ValueError(f'--interpreter {interpreter}: {error}') from error
    if done.returncode:
        raise ValueError(done.stderr.strip().splitlines()[-1] if done.stderr else 'it ended')


COMMANDS: dict[str, Callable[..., Any]] = {'install': install, 'check': check, 'feed': follow}

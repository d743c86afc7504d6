# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""`fuzzycnc linuxcnc`: what a LinuxCNC needs for offsets, axis controllers and feed shares."""

from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

import typer

from fuzzycnc_ros.cli.axes.servo_axis import FOR_ANY_AXIS
from fuzzycnc_ros.cli.console import check_new, say, write_text
from fuzzycnc_ros.cli.options import OptionalPath, OptionalText, choice, given
from fuzzycnc_ros.core.encodings import decoded

HELP = """Install and check what a LinuxCNC needs for offsets, axis controllers and feed shares.

    fuzzycnc linuxcnc install mill.ini
    fuzzycnc linuxcnc install mill.ini --machine-file tuned.yaml --axis X
    fuzzycnc linuxcnc check mill.ini
    fuzzycnc linuxcnc drive --machine-file ballscrew --out run
    fuzzycnc linuxcnc feed part.ngc part.feed

Installing writes among the modules of LinuxCNC: use sudo. docs/how-to/linuxcnc.md has the rest.
"""

Ini = Annotated[
    Path, typer.Argument(metavar='FILE.ini', help='Configuration (INI file) of LinuxCNC.')
]
Params = Annotated[OptionalPath, given('Rules as `servo learn` writes them.', metavar='FILE')]


def install(
    ini: Ini,
    machine_file: Annotated[
        OptionalText,
        given('Machine file of an axis whose controller is installed.', metavar='FILE'),
    ] = None,
    axis: Annotated[str, typer.Option(metavar='NAME', show_default=False, help='The axis.')] = '',
    params: Params = None,
    feed: Annotated[
        bool, typer.Option('--feed', help='What feed shares along the path need, too.')
    ] = False,
) -> None:
    """Build the realtime component, write the HAL file, show which lines the INI file lacks.

    The component is built by LinuxCNC's halcompile and installed among its modules, which takes
    the rights to write there (sudo). The HAL file goes beside the INI file, which stays as it is.

        fuzzycnc linuxcnc install ~/linuxcnc/configs/mill/mill.ini
        sudo fuzzycnc linuxcnc install mill.ini --feed

    With a machine file the controller of an axis is exported and installed instead, and the lines
    for the INI and HAL files are shown. It gives nothing out where the machine file in use is not
    that from which it was exported.

        fuzzycnc linuxcnc install mill.ini --machine-file tuned.yaml --axis X
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

    if machine_file is not None:
        from fuzzycnc_ros.cli.live.linuxcnc_axis import install_axis

        done = install_axis(ini, machine_file, axis, params)
        say(f'{done.component}: installed')
        for what, lines in (
            ('add, each to its section', done.ini),
            ('in its HAL files', done.hal),
        ):
            say(f'{ini}: {what}')
            for line in lines:
                say(f'  {line}')
        return
    if axis or params is not None:
        raise ValueError('--machine-file: expected one with --axis and --params but found none')
    axes, lacking = axes_of(ini), lacking_lines(ini)
    if feed:
        lacking += lacking_feed_lines(ini)
    text, out = hal_text(axes), ini.parent / HAL_FILES[True]
    if not (out.exists() and out.read_text(errors='replace') == text):
        check_new(out, 'remove it: it is not that of these axes')
    try:
        version = linuxcnc_version()
        for name in (COMPONENT, FEED) if feed else (COMPONENT,):
            install_component(shipped(f'{name}.comp'))
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
    """Check versions, components, HAL files and the INI file; ends with 1 if one lacks.

    Nothing is changed; LinuxCNC may run meanwhile. Of an axis with a controller of its own the
    installed component is compared with the machine file that the INI file names.

        fuzzycnc linuxcnc check ~/linuxcnc/configs/mill/mill.ini
    """
    from fuzzycnc_ros.cli.live import linuxcnc_configuration
    from fuzzycnc_ros.cli.live.linuxcnc_axis import check_axes

    found = list(check_axes(ini))
    if not found or linuxcnc_configuration.has_offsets(ini):
        found = [*linuxcnc_configuration.check(ini), *found]
    fine = True
    for finding in found:
        fine = fine and finding.fine
        say(f'{"" if finding.fine else "! "}{finding.what}: {finding.text}')
    if not fine:
        raise typer.Exit(1)


def drive(
    machine_file: Annotated[str, typer.Option(metavar='FILE', help='Machine file of the axis.')],
    out: Annotated[Path, typer.Option(metavar='BAG', help='Bag to write.')],
    axis: Annotated[str, typer.Option(metavar='NAME', show_default=False, help='The axis.')] = '',
    controller: Annotated[
        str,
        choice(
            'Controller, untuned if it is not that of the machine file.',
            FOR_ANY_AXIS,
            default=False,
        ),
    ] = '',
    params: Params = None,
    program: Annotated[
        OptionalPath, given('Part program of X in mm; by default ways of its own.', metavar='FILE')
    ] = None,
) -> None:
    """Drive an axis in the servo thread of a LinuxCNC without hardware, and record it.

    The exported controller and the simulated axis of the machine file are built and loaded as
    components; LinuxCNC runs a part program, and every period is written into a bag. A replay
    repeats it with the controller in Python: the duties are the same to the last bit. The axis is
    LinuxCNC's X whatever its name. It takes a quarter of a minute and the rights to install
    components (sudo), and no LinuxCNC may run meanwhile.

        fuzzycnc linuxcnc drive --machine-file ballscrew --out run
        fuzzycnc replay run
    """
    from fuzzycnc_ros.cli.live.linuxcnc_axis import drive_axis

    check_new(out)
    try:
        text = (
            None if program is None else decoded(program.read_bytes(), errors='backslashreplace')
        )
    except ValueError as error:
        raise ValueError(f'--program {program}: {error}') from error
    done = drive_axis(machine_file, axis, controller, params, text, out)
    say(
        f'{out}: {done.controller} in LinuxCNC; following error '
        f'{1e6 * done.largest:.2f} µm at most, {1e6 * done.rms:.2f} µm rms'
    )


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


COMMANDS: dict[str, Callable[..., Any]] = {
    'install': install,
    'check': check,
    'drive': drive,
    'feed': follow,
}

# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""`fuzzycnc service`: a machine's graph as a service of systemd."""

import os
import shlex
import subprocess
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Optional

import typer

from fuzzycnc_ros.bags.shipping import check_no_secret
from fuzzycnc_ros.cli.console import say, write_text
from fuzzycnc_ros.cli.live.page_process import Page
from fuzzycnc_ros.cli.live.service_units import (
    MARK,
    PAGE,
    ServiceLocation,
    Unit,
    graph_unit,
    installing_user,
    page_unit,
    passed_on,
    record_unit,
    unit_name,
)
from fuzzycnc_ros.graph.bring_up import machine_name
from fuzzycnc_ros.ros.presence import GraphError

HELP = """Run a machine as a service of systemd: from boot on, watched, started anew.

    fuzzycnc service install --machine mill -- --model mill.json --autostart
    fuzzycnc service show --machine mill
    fuzzycnc service remove --machine mill

See docs/how-to/service.md.
"""

OWN = ('--machine', '--record', '--page', '--state-directory', '--json')
"""Options of `up` that a service sets by itself, or by an option of its own."""

MachineName = Annotated[str, typer.Option('--machine', help='Name of the machine.')]
System = Annotated[
    bool,
    typer.Option(
        '--system/--user',
        help='A service of the computer, which needs root, or one of this user.',
    ),
]
Now = Annotated[
    bool,
    typer.Option('--now', help='Run the systemctl commands instead of printing them.'),
]


def install(
    options: Annotated[
        Optional[list[str]],  # noqa: UP045 - typer 0.9 does not read the newer form
        typer.Argument(
            metavar='[-- UP OPTIONS]',
            show_default=False,
            help='Options of `fuzzycnc up`, behind two dashes.',
        ),
    ] = None,
    machine: MachineName = 'mill',
    system: System = False,
    run_as: Annotated[
        str,
        typer.Option(
            metavar='USER',
            show_default=False,
            help='With --system: the user it runs as, by default the one who installs it. Shared '
            'memory of DDS is for processes of one user: commands such as `operate` run as that '
            'one.',
        ),
    ] = '',
    record: Annotated[
        Optional[Path],  # noqa: UP045
        typer.Option(
            metavar='DIR',
            help='A second service that records the machine into this folder, a bag for each '
            'start.',
        ),
    ] = None,
    record_options: Annotated[
        str,
        typer.Option(
            metavar='WORDS',
            show_default=False,
            help="Options of `fuzzycnc record` for it, such as '--split-duration 1h'.",
        ),
    ] = '',
    page: Page = None,
    now: Now = False,
    dry_run: Annotated[
        bool, typer.Option('--dry-run', help='Print the units, and write nothing.')
    ] = False,
) -> None:
    """Write the units of a machine; start nothing without --now.

    A service starts in this folder, with this Python and the ROS variables of this shell. It is
    up when all its nodes have reported, and started anew when it fails or one of its nodes hangs.

        fuzzycnc service install --machine mill -- --model mill.json --autostart

    For the computer, with recording and page, at once:

        sudo .venv/bin/fuzzycnc service install --system --record /data/bags --page --now
    """
    machine = machine_name(machine)
    words = list(options or [])
    own = [word for word in words if word.partition('=')[0] in OWN]
    if own:
        raise GraphError(
            f'UP OPTIONS: expected none of {", ".join(OWN)}, which a service sets itself, but '
            f'found {own[0]}; --machine, --record and --page go before the two dashes'
        )
    _parse('up', words)
    recorded = shlex.split(record_options)
    if recorded and record is None:
        raise GraphError('expected --record, too: --record-options says how it records')
    for word in (*words, *recorded):
        # Units are files that everybody reads.
        check_no_secret(word.partition('=')[2] if word.startswith('--') else word)
    if run_as and not system:
        raise GraphError('expected --system, too: a service of this user has its rights')
    place = ServiceLocation(system, run_as or installing_user(), Path.cwd(), passed_on(os.environ))
    units = [graph_unit(place, machine, words)]
    if record is not None:
        record = record.absolute()
        if not record.is_dir():
            raise GraphError(f'--record: expected a folder but found none at {record}; make it')
        _parse('record', ['--out', str(record / 'bag'), *recorded])
        units.append(record_unit(place, machine, record, recorded))
    if page is not None:
        from fuzzycnc_ros.ros.node_config import DashboardConfig

        units.append(page_unit(place, page or DashboardConfig().port, record))
    if dry_run:
        for unit in units:
            say(f'# {_folder(system) / unit.name}')
            _say_lines(unit.text)
        return
    _write(units, _folder(system))
    names = [unit.name for unit in units]
    _systemctl(system, [['daemon-reload'], ['enable', '--now', *names]], now)
    scope = '' if system else '--user '
    say(f'its log: journalctl {scope}-u {names[0]}')
    if not system:
        say('it ends at logout, unless you type once: loginctl enable-linger')


def show(machine: MachineName = 'mill', system: System = False) -> None:
    """Print the units of a machine and of the page as they are installed.

    What `install` would write is printed by its option --dry-run.

        fuzzycnc service show --machine mill
    """
    found = _installed(machine_name(machine), system, page=True)
    if not found:
        raise GraphError(
            f'{_folder(system)}: expected units of {machine} but found none; write them by '
            '`fuzzycnc service install`' + ('' if system else ', or look with --system')
        )
    for file in found:
        say(f'# {file}')
        _say_lines(file.read_text(encoding='utf-8'))


def remove(
    machine: MachineName = 'mill',
    system: System = False,
    page: Annotated[
        bool, typer.Option('--with-page', help='Remove the live page of all machines, too.')
    ] = False,
    now: Now = False,
) -> None:
    """Remove the units of a machine; stop them before, if told by --now.

    Bags and what the nodes have kept stay.

        fuzzycnc service remove --machine mill
    """
    found = _installed(machine_name(machine), system, page=page)
    names = [file.name for file in found]
    if not found:
        say(f'{_folder(system)}: no units of {machine}')
        return
    _systemctl(system, [['disable', '--now', *names]], now)
    for file in found:
        file.unlink()
        say(f'{file}: removed')
    _systemctl(system, [['daemon-reload']], now)


def _parse(command: str, words: Sequence[str]) -> None:
    """Refuse what a command would refuse at its start: a service says so to nobody."""
    # Here: the command line knows this module.
    from fuzzycnc_ros.cli.main import APPLICATION

    APPLICATION.check(command, words)


def _folder(system: bool) -> Path:
    """Return where units are looked for."""
    if system:
        return Path('/etc/systemd/system')
    home = os.environ.get('XDG_CONFIG_HOME') or Path.home() / '.config'
    return Path(home) / 'systemd' / 'user'


def _installed(machine: str, system: bool, *, page: bool) -> list[Path]:
    """Return the units that were written for a machine and are there."""
    names = [unit_name(machine), unit_name(machine, 'record'), *([PAGE] if page else [])]
    files = [_folder(system) / name for name in names]
    return [file for file in files if file.exists() and _ours(file)]


def _ours(file: Path) -> bool:
    return file.read_text(encoding='utf-8', errors='replace').startswith(MARK)


def _write(units: Sequence[Unit], folder: Path) -> None:
    """Write units, all or none if one is somebody else's."""
    for unit in units:
        file = folder / unit.name
        if file.exists() and not _ours(file):
            raise GraphError(
                f'{file}: expected a unit that `fuzzycnc service install` has written, or none, '
                'but found another one; move it away'
            )
    folder.mkdir(parents=True, exist_ok=True)
    for unit in units:
        write_text(folder / unit.name, unit.text)
        say(f'{folder / unit.name}: written')


def _systemctl(system: bool, calls: Sequence[Sequence[str]], now: bool) -> None:
    """Carry calls of systemctl out, or print them.

    Raises
    ------
    GraphError
        If one fails.
    """
    for call in calls:
        command = ['systemctl', *([] if system else ['--user']), *call]
        if not now:
            say(f'type: {"sudo " if system and os.getuid() else ""}{shlex.join(command)}')
            continue
        try:
            done = subprocess.run(command, capture_output=True, text=True, check=False)
        except FileNotFoundError:
            raise GraphError(
                '--now: expected systemctl in PATH but found none; is this a computer with '
                'systemd?'
            ) from None
        if done.returncode:
            raise GraphError(f'{shlex.join(command)}: {done.stderr.strip() or "failed"}')


def _say_lines(text: str) -> None:
    for line in text.splitlines():
        say(line)


COMMANDS = {'install': install, 'show': show, 'remove': remove}

# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Units of systemd for a machine: its graph, its recording, and the live page."""

import json
import os
import re
import shlex
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from fuzzycnc_ros.cli.live.supervision_run import ENDED_FIRST
from fuzzycnc_ros.core.names import file_word
from fuzzycnc_ros.graph.bring_up import ACTIVE_TIMEOUT, NODE_STOP, RECORDER_STOP

MARK = '# Written by `fuzzycnc service install`, which writes it anew.'
"""First line of a unit, by which its writer knows it."""

WATCHDOG = 30
"""Time [s] without a sign of life after which a service is started anew."""
MANAGED = 5
"""Managed nodes of a graph at most: each is waited for before the next is started."""
MARGIN = 20
"""Time [s] that what has to end gets beyond what it takes at most by itself."""

PASSED_ON = (
    'AMENT_PREFIX_PATH', 'CYCLONEDDS_URI', 'FASTRTPS_DEFAULT_PROFILES_FILE', 'LD_LIBRARY_PATH',
    'PYTHONPATH', 'RMW_IMPLEMENTATION', 'ROS_AUTOMATIC_DISCOVERY_RANGE', 'ROS_DISCOVERY_SERVER',
    'ROS_DISTRO', 'ROS_DOMAIN_ID', 'ROS_LOCALHOST_ONLY', 'ROS_PYTHON_VERSION',
    'ROS_SECURITY_ENABLE', 'ROS_SECURITY_KEYSTORE', 'ROS_SECURITY_STRATEGY', 'ROS_STATIC_PEERS',
    'ROS_VERSION',
)  # fmt: skip
"""Variables that a service gets as they are where it is installed."""
_LIBRARIES, _OWN_LIBRARIES = 'LD_LIBRARY_PATH', '_ROS_WHEELS_BOOTSTRAP_COMPLETE'
_PLAIN = re.compile(r'[\w./:=,+@-]+')

_EVERYWHERE = (
    'NoNewPrivileges=yes',
    'LockPersonality=yes',
    'RestrictSUIDSGID=yes',
    'SystemCallArchitectures=native',
    '# DDS asks the kernel for the addresses of this computer, and uses UDP and shared memory.',
    'RestrictAddressFamilies=AF_UNIX AF_INET AF_INET6 AF_NETLINK',
)
_AS_SYSTEM = (
    'ProtectSystem=full',
    'ProtectKernelTunables=yes',
    'ProtectKernelModules=yes',
    'ProtectControlGroups=yes',
    'ProtectClock=yes',
    '# Serial lines and shared memory of DDS lie in /dev, and models and bags may lie in /tmp.',
    '# So neither is private, and nor is the network, whose sockets say which nodes live.',
    'PrivateTmp=no',
    'PrivateDevices=no',
    'PrivateNetwork=no',
)


@dataclass(frozen=True)
class Unit:
    """A unit file.

    Attributes
    ----------
    name, text : str
        Its name and content.
    """

    name: str
    text: str


@dataclass(frozen=True)
class ServiceLocation:
    """Folders and user of services.

    Attributes
    ----------
    system : bool
        Whether they belong to the computer, else to a user.
    user : str
        Whose rights those of the computer have.
    folder : Path
        Working directory.
    environment : mapping
        Environment variables.
    """

    system: bool
    user: str
    folder: Path
    environment: Mapping[str, str]


def passed_on(environment: Mapping[str, str]) -> dict[str, str]:
    """Return the variables of an environment that a service needs as well."""
    found = {name: environment[name] for name in PASSED_ON if environment.get(name)}
    if _OWN_LIBRARIES in environment:  # a Python has set them for itself, and will again
        found.pop(_LIBRARIES, None)
    return found


def unit_name(machine: str, part: str = '') -> str:
    """Return the name of the unit of a machine, or of a part of it."""
    # A machine whose name ends as a unit of another would share it: such a one says what it is.
    part = part or 'graph' * (machine.rpartition('/')[2] in PARTS)
    return f'fuzzycnc-{file_word(machine)}{part and f"-{part}"}.service'


PARTS = ('graph', 'page', 'record')
"""Words that tell the units of one machine apart, and the unit of the page from all of them."""
PAGE = 'fuzzycnc-page.service'
"""The unit of the live page, which shows all machines."""


def graph_unit(place: ServiceLocation, machine: str, options: Sequence[str]) -> Unit:
    """Return the unit of a machine's graph, with more options of `fuzzycnc up`."""
    state = f'fuzzycnc/{machine}'
    command = [*_python('cli.main'), 'up', '--machine', machine]
    line = f'{_words(command)} --state-directory "%S/{state}" {_words(options)}'.rstrip()
    return _unit(
        place,
        unit_name(machine),
        f'fuzzycnc: machine {machine}',
        line,
        # Nodes end one after the other where readings come from, then the rest, then recorders.
        stop=(len(ENDED_FIRST) + 1) * NODE_STOP + RECORDER_STOP,
        start=MANAGED * ACTIVE_TIMEOUT,
        lines=(f'StateDirectory={state}',),
    )


def record_unit(
    place: ServiceLocation, machine: str, folder: Path, options: Sequence[str]
) -> Unit:
    """Return the unit of a machine's recording: a bag in a folder, named by when it begins."""
    command = [*_python('cli.main'), 'record', '--machine', machine, *options]
    stem = shlex.quote(str(folder / f'{file_word(machine)}-'))
    script = f'exec {shlex.join(command)} --out {stem}"$(date -u +%Y-%m-%dT%H-%M-%SZ)"'
    return _unit(
        place,
        unit_name(machine, 'record'),
        f'fuzzycnc: recording of machine {machine}',
        _words(['/bin/sh', '-c', script]),
        stop=RECORDER_STOP,
        # The recorder is a process of its own, which says itself how it is.
        lines=('NotifyAccess=all',),
    )


def page_unit(place: ServiceLocation, port: int, bags: Path | None) -> Unit:
    """Return the unit of the live page."""
    command = [*_python('nodes.dashboard'), '--ros-args', '-p', f'port:={port}']
    if bags is not None:
        # JSON is YAML: a folder named 2024 stays a text.
        command += ['-p', f'bags:={json.dumps(str(bags))}']
    return _unit(place, PAGE, 'fuzzycnc: live page', _words(command), stop=RECORDER_STOP)


def _python(module: str) -> list[str]:
    return [sys.executable, '-m', f'fuzzycnc_ros.{module}']


def _unit(
    place: ServiceLocation,
    name: str,
    description: str,
    command: str,
    *,
    stop: float,
    start: float = 0.0,
    lines: Sequence[str] = (),
) -> Unit:
    network = ['After=network-online.target', 'Wants=network-online.target']
    parts = [
        MARK,
        '[Unit]',
        f'Description={description}',
        *(network if place.system else []),
        '# What fails five times within five minutes is left for a person.',
        'StartLimitIntervalSec=300',
        'StartLimitBurst=5',
        '',
        '[Service]',
        '# It says itself when it is up, and that it lives.',
        'Type=notify',
        f'ExecStart={command}',
        f'WorkingDirectory={_literal(str(place.folder))}',
        *([f'User={place.user}'] if place.system else []),
        *(
            f'Environment={_word(f"{key}={value}", "")}'
            for key, value in place.environment.items()
        ),
        *lines,
        'Restart=on-failure',
        'RestartSec=5',
        'SuccessExitStatus=130 143',
        f'TimeoutStartSec={start + 3 * MARGIN:g}',
        f'WatchdogSec={WATCHDOG}',
        '# Also then nodes end in their order, and offsets ramp to zero.',
        'WatchdogSignal=SIGTERM',
        'KillSignal=SIGTERM',
        'KillMode=mixed',
        f'TimeoutStopSec={stop + MARGIN:g}',
        *_EVERYWHERE,
        *(_AS_SYSTEM if place.system else ()),
        '',
        '[Install]',
        f'WantedBy={"multi-user" if place.system else "default"}.target',
        '',
    ]
    return Unit(name, '\n'.join(parts))


def _literal(text: str) -> str:
    """Return text whose specifiers mean nothing."""
    return text.replace('%', '%%')


def _word(text: str, dollar: str = '$') -> str:
    """Return a word of a line, in quotes if it must; a dollar sign counts where variables do."""
    if _PLAIN.fullmatch(text):
        return text
    quoted = _literal(text).replace('\\', '\\\\').replace('"', '\\"')
    return f'"{quoted.replace("$", f"{dollar}$")}"'


def _words(words: Sequence[str]) -> str:
    return ' '.join(_word(word) for word in words)


def installing_user() -> str:
    """Return who installs, also behind sudo."""
    import pwd

    return os.environ.get('SUDO_USER') or pwd.getpwuid(os.getuid()).pw_name

# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""A real LinuxCNC without a screen and without hardware, operated from here."""

import contextlib
import fcntl
import json
import os
import shutil
import signal
import socket
import subprocess
import tempfile
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from fuzzycnc_ros.adapters.linuxcnc.control import LinuxcncError, linuxcnc_runs
from fuzzycnc_ros.adapters.linuxcnc.hal_process import HAL_FILES
from fuzzycnc_ros.ros.processes import child_set_up

PYTHON = '/usr/bin/python3'
START_TIMEOUT = 40.0
END_TIMEOUT = 20.0
_LOOK = 0.02  # between two looks at a program that runs [s]
_IDLE = 0.3  # of a program that is over: on a busy computer it seems so for a moment [s]
SHARED_USER = 65534
"""Whom LinuxCNC becomes when root starts it: nobody."""

INI = """
[EMC]
MACHINE = test
VERSION = 1.1
[DISPLAY]
DISPLAY = ./driver
[TASK]
TASK = milltask
CYCLE_TIME = 0.001
[RS274NGC]
PARAMETER_FILE = test.var
[EMCMOT]
EMCMOT = motmod
COMM_TIMEOUT = 1.0
SERVO_PERIOD = 1000000
[EMCIO]
EMCIO = io
CYCLE_TIME = 0.100
TOOL_TABLE = tool.tbl
[HAL]
HALUI = halui
HALFILE = machine.hal
{hal}
[TRAJ]
COORDINATES = {letters}
LINEAR_UNITS = mm
ANGULAR_UNITS = degree
MAX_LINEAR_VELOCITY = 500
DEFAULT_LINEAR_VELOCITY = 100
DEFAULT_LINEAR_ACCELERATION = 2500
MAX_LINEAR_ACCELERATION = 2500
[KINS]
KINEMATICS = trivkins coordinates={letters} kinstype=BOTH
JOINTS = {joints}
"""
AXIS = """
[AXIS_{axis}]
OFFSET_AV_RATIO = {offsets}
MAX_VELOCITY = {velocity}
MAX_ACCELERATION = {acceleration}
MIN_LIMIT = {low}
MAX_LIMIT = {high}
"""
JOINT = """
[JOINT_{joint}]
TYPE = LINEAR
HOME_SEQUENCE = 0
MAX_VELOCITY = {velocity}
MAX_ACCELERATION = {acceleration}
MIN_LIMIT = {low}
MAX_LIMIT = {high}
"""
LOADED = """
loadrt [KINS]KINEMATICS
loadrt [EMCMOT]EMCMOT servo_period_nsec=[EMCMOT]SERVO_PERIOD num_joints=[KINS]JOINTS
"""
THREAD = """
addf motion-command-handler servo-thread
addf motion-controller servo-thread
"""
LOOPBACKS = """
net estop-loop iocontrol.0.user-enable-out iocontrol.0.emc-enable-in
net tool-prep-loop iocontrol.0.tool-prepare iocontrol.0.tool-prepared
net tool-change-loop iocontrol.0.tool-change iocontrol.0.tool-changed
"""
JOINT_HAL = 'net J{joint} joint.{joint}.motor-pos-cmd => joint.{joint}.motor-pos-fb'


class Limits(NamedTuple):
    """Velocity, acceleration and travel of all axes, and what offsets take of the first two.

    Joints may go a millimetre further.
    """

    velocity: float
    """[mm/s]"""
    acceleration: float
    """[mm/s^2]"""
    low: float
    """[mm]"""
    high: float
    """[mm]"""
    offsets: float = 0.0
    """Share [-], see `OFFSET_AV_RATIO`."""


def ini_text(letters: str, hal: Sequence[str], limits: Limits) -> str:
    """Return a configuration of axes that are alike.

    Parameters
    ----------
    letters : str
        Axis of each joint.
    hal : sequence of str
        HAL files behind `machine.hal`.
    limits : Limits
        What axes and joints are allowed.
    """
    files = '\n'.join(f'HALFILE = {name}' for name in hal)
    axis, joint = limits._asdict(), limits._replace(low=limits.low - 1, high=limits.high + 1)
    return '\n'.join(
        [
            INI.format(hal=files, letters=letters, joints=len(letters)),
            *(AXIS.format(axis=letter, **axis) for letter in dict.fromkeys(letters)),
            *(JOINT.format(joint=place, **joint._asdict()) for place in range(len(letters))),
        ]
    )


class LinuxcncSimulation:
    """LinuxCNC with the shipped HAL file; what its operator does is called by name.

    Parameters
    ----------
    folder : Path
        Where its files go.
    slopes : bool
        Whether offsets may slope along an axis: needs the component `fuzzycnc_offset`.
    letters : str
        Axis of each joint; one with two joints is a gantry.
    **section : float
        Lines of the section `[FUZZYCNC]` that differ.
    """

    def __init__(
        self, folder: Path, *, slopes: bool = False, letters: str = 'XYZ', **section: float
    ) -> None:
        self._folder, self.letters = folder, letters
        self._hal = HAL_FILES[slopes]
        self._section = {
            'SCALE': 0.00001,
            'COUNTS_MAX': 10000,
            'COUNTS_MIN': -10000,
            'COUNTS_PER_SECOND': 100000,
            'SLOPE_MAX': 50,
            'SPEED_MAX': 1000,
            'HOLD_TIME': 6.0,
            **section,
        }
        self._process: subprocess.Popen[bytes] | None = None
        self._lines: Any = None
        self._socket: socket.socket | None = None
        self._starts = 0

    def start(self) -> None:
        """Start it, off and not homed.

        Raises
        ------
        LinuxcncError
            If it does not come up.
        """
        self._starts += 1
        path = self._folder / f'operator{self._starts}'
        self._write_files()
        environment = {
            **{name: value for name, value in os.environ.items() if name != 'DISPLAY'},
            'RUNTESTS': '1',
            'HOME': str(self._folder),
            'FUZZYCNC_OPERATOR': str(path),
        }
        if os.geteuid() == 0:
            environment |= {
                'RTAPI_UID': str(SHARED_USER),
                'RTAPI_FIFO_PATH': str(self._folder / 'fifo'),
            }
        with (self._folder / f'linuxcnc{self._starts}.log').open('wb') as log:
            self._process = subprocess.Popen(
                ['linuxcnc', '-r', 'test.ini'],
                cwd=self._folder,
                env=environment,
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=subprocess.STDOUT,
                start_new_session=True,
                preexec_fn=child_set_up(),
            )
        end = time.monotonic() + START_TIMEOUT
        self._socket = socket.socket(socket.AF_UNIX)
        while True:
            try:
                self._socket.connect(str(path))
                break
            except OSError:
                if time.monotonic() > end or self._process.poll() is not None:
                    self.end()
                    raise LinuxcncError(f'LinuxCNC does not come up: {self.log}') from None
                time.sleep(0.05)
        self._lines = self._socket.makefile('rw')

    @property
    def log(self) -> str:
        """Log of LinuxCNC."""
        path = self._folder / f'linuxcnc{self._starts}.log'
        return path.read_text(errors='replace')

    def __getattr__(self, name: str) -> Any:
        """Return what the operator can do."""
        if name.startswith('_'):
            raise AttributeError(name)

        def call(*arguments: Any) -> Any:
            self._lines.write(json.dumps([name, *arguments]) + '\n')
            self._lines.flush()
            answer = json.loads(self._lines.readline())
            if 'error' in answer:
                raise LinuxcncError(f'{name}{arguments}: {answer["error"]}')
            return answer['ok']

        return call

    def write_program(self, name: str, text: str) -> str:
        """Write a part program where LinuxCNC may read it; return its path."""
        path = self._folder / f'{name}.ngc'
        path.write_text(text)
        return str(path)

    def ready(self) -> None:
        """Switch on and home."""
        self.on()
        self.home()

    def wait_for_end(self, timeout: float) -> None:
        """Wait until the program that runs is over.

        Raises
        ------
        LinuxcncError
            If that takes longer [s].
        """
        begun = idle = time.monotonic()
        while time.monotonic() < idle + _IDLE:
            if self.state()['running']:
                idle = time.monotonic()
            if idle > begun + timeout:
                raise LinuxcncError(f'the program still runs after {timeout:g} s')
            time.sleep(_LOOK)

    def end(self) -> None:
        """End it as its operator does."""
        if self._process is None:
            return
        self._hang_up()
        try:
            self._process.wait(END_TIMEOUT)
        except subprocess.TimeoutExpired:
            self.kill()
        self._process = None
        self._sweep()

    def kill(self) -> None:
        """Kill all of it as a power cut would."""
        for process in self._processes():
            with contextlib.suppress(ProcessLookupError):
                os.kill(process, signal.SIGKILL)
        if self._process is not None:
            self._process.wait(END_TIMEOUT)
        self._hang_up()
        self._process = None

    def _hang_up(self) -> None:
        if self._socket is not None:
            with contextlib.suppress(OSError):
                self._socket.shutdown(socket.SHUT_RDWR)
            if self._lines is not None:
                self._lines.close()
            self._socket.close()
            self._socket = self._lines = None

    def _processes(self) -> list[int]:
        """Return the processes of this LinuxCNC: those of its session or with its environment."""
        mark = f'FUZZYCNC_OPERATOR={self._folder}'.encode()
        found = []
        for folder in Path('/proc').iterdir():
            if folder.name.isdigit():
                with contextlib.suppress(OSError):
                    if mark in (folder / 'environ').read_bytes():
                        found.append(int(folder.name))
        return found

    def _sweep(self) -> None:
        """Remove what a killed LinuxCNC leaves, with its own means."""
        for process in self._processes():
            with contextlib.suppress(ProcessLookupError):
                os.kill(process, signal.SIGKILL)
        if linuxcnc_runs():
            subprocess.run(['halrun', '-U'], capture_output=True, check=False, timeout=END_TIMEOUT)
        Path('/', 'tmp', 'linuxcnc.lock').unlink(missing_ok=True)

    def _files(self) -> dict[str, str]:
        """Return the texts of its configuration by file."""
        lines = ['[FUZZYCNC]', *(f'{name} = {value}' for name, value in self._section.items())]
        limits = Limits(500, 2500, -200, 200, offsets=0.2)
        nets = [JOINT_HAL.format(joint=joint) for joint in range(len(self.letters))]
        return {
            'test.ini': '\n'.join([ini_text(self.letters, [self._hal], limits), *lines, '']),
            'machine.hal': '\n'.join([LOADED, THREAD, LOOPBACKS, *nets, '']),
            self._hal: shipped(self._hal).read_text(),
        }

    def _write_files(self) -> None:
        folder = self._folder
        for name, text in {**self._files(), 'tool.tbl': ''}.items():
            (folder / name).write_text(text)
        driver = folder / 'driver'
        source = Path(__file__).with_name('operator_process.py')
        driver.write_text(f'#!/bin/sh\nexec {PYTHON} -I {source} "$@"\n')
        driver.chmod(0o755)
        if os.geteuid() == 0:
            os.chown(folder, SHARED_USER, -1)
            folder.chmod(0o755)


def shipped(name: str) -> Path:
    """Return a shipped file for LinuxCNC: of the sources, or where they were installed."""
    sources = Path(__file__).parents[3] / 'linuxcnc' / name
    if sources.exists():
        return sources
    from ament_index_python.packages import get_package_share_directory

    return Path(get_package_share_directory('fuzzycnc_ros')) / 'linuxcnc' / name


def own_folder() -> tempfile.TemporaryDirectory[str]:
    """Return a folder for a LinuxCNC, removed with the context."""
    return tempfile.TemporaryDirectory(prefix='fuzzycnc-linuxcnc-', ignore_cleanup_errors=True)


@contextlib.contextmanager
def exclusive() -> Iterator[None]:
    """Keep others on this computer from starting a LinuxCNC: there can be only one.

    Raises
    ------
    LinuxcncError
        If it is not installed, or somebody else's runs.
    """
    if shutil.which('linuxcnc') is None:
        raise LinuxcncError('LinuxCNC is not installed (Debian: apt-get install linuxcnc-uspace)')
    with (Path(tempfile.gettempdir()) / 'fuzzycnc-linuxcnc.lock').open('w') as handle:
        fcntl.flock(handle, fcntl.LOCK_EX)
        if linuxcnc_runs():
            raise LinuxcncError(
                'a LinuxCNC runs on this computer already, and there can be only one'
            )
        yield

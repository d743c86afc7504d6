# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Joint commands of a real LinuxCNC in every servo period, recorded by HAL's sampler."""

from __future__ import annotations

import contextlib
import signal
import subprocess
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import numpy as np

from fuzzycnc_ros.adapters.linuxcnc.component import load_feed
from fuzzycnc_ros.adapters.linuxcnc.control import LinuxcncError
from fuzzycnc_ros.adapters.linuxcnc.simulation import LinuxcncSimulation, exclusive, own_folder
from fuzzycnc_ros.core.arrays import Array
from fuzzycnc_ros.ros.processes import child_set_up

PERIOD = 1e-3
"""Servo period [s]."""
MILLIMETRE = 1e-3
TRAVEL = 2000.0
"""Travel of the axes either way while programs are recorded [mm]."""
_SHARE = 0.8
"""Of velocity and acceleration that external offsets leave, see `OFFSET_AV_RATIO`."""
_DEPTH = 16000  # samples that HAL keeps while nobody reads them
_DRAIN = 60.0  # their reader will not take the last ones any more [s]
_QUIT = 20.0
_PASSED = 0.3  # the servo thread and halui have seen what was set [s]


class Recorder:
    """Records the commanded positions of X, Y and Z.

    Parameters
    ----------
    machine : LinuxcncSimulation
        Switched on and homed.
    folder : Path
        Where part programs and records go.
    """

    def __init__(self, machine: LinuxcncSimulation, folder: Path) -> None:
        self._machine, self._folder = machine, folder
        self._runs = 0
        self.halcmd('loadrt', 'sampler', f'depth={_DEPTH}', 'cfg=fff')
        self.halcmd('setp', 'sampler.0.enable', '0')
        self.halcmd('addf', 'sampler.0', 'servo-thread')
        for joint in range(3):
            self.halcmd('net', f'J{joint}', f'sampler.0.pin.{joint}')

    def limit(self, velocity: Sequence[float], acceleration: Sequence[float]) -> None:
        """Set the limits that X, Y and Z have while programs run [m/s, m/s^2]."""
        for joint, axis in enumerate('xyz'):
            for name in (axis, str(joint)):
                for quantity, value in (
                    ('max_velocity', velocity[joint] / MILLIMETRE / _SHARE),
                    ('max_acceleration', acceleration[joint] / MILLIMETRE / _SHARE),
                    ('min_limit', -TRAVEL),
                    ('max_limit', TRAVEL),
                ):
                    self.halcmd('setp', f'ini.{name}.{quantity}', f'{value:.9f}')

    def origin(self, path_mode: str = 'G64') -> None:
        """Move the axes to where they stood when homed, and set the path mode.

        LinuxCNC keeps the path mode of one program for the next.

        Parameters
        ----------
        path_mode : str
            What is in effect before a program says so, in millimetres; the default is that of a
            LinuxCNC just started.

        Raises
        ------
        LinuxcncError
            If that takes more than a minute.
        """
        path = self._folder / 'origin.ngc'
        path.write_text(f'G92.1\nG54 G90 G21\n{path_mode}\nG53 G0 X0 Y0 Z0\nG4 P0.5\nM2\n')
        self._machine.run(str(path))
        self._machine.wait_for_end(60.0)

    def follow(self, table: str) -> None:
        """Load the component `fuzzycnc_feed` with a table, armed.

        Raises
        ------
        LinuxcncError
            If it is not installed.
        """
        path = self._folder / 'table.feed'
        path.write_text(table)
        load_feed(self.halcmd, path)
        # a helper is not what is tried here
        self.halcmd('setp', 'fuzzycnc-feed.timeout', '1e9')
        self.halcmd('sets', 'fuzzycnc-feed-arm', '1')
        self.halcmd('sets', 'fuzzycnc-feed-heartbeat', '1')
        time.sleep(_PASSED)

    def run(
        self,
        program: str,
        timeout: float,
        during: Callable[[LinuxcncSimulation], None] = lambda machine: None,
        line: int = 0,
    ) -> Array:
        """Run a part program to its end.

        Parameters
        ----------
        program : str
            The program.
        timeout : float
            Time that it may take [s].
        during : callable
            Operates the machine while the program runs.
        line : int
            Line that it starts at; 0 for its beginning.

        Returns
        -------
        ndarray, shape (n, 3)
            Commanded positions, `PERIOD` apart, from before its start to after its end [m].

        Raises
        ------
        LinuxcncError
            If it takes longer, LinuxCNC refuses it, or samples were lost.
        """
        self._runs += 1
        path = self._folder / f'program{self._runs}.ngc'
        path.write_text(program)
        record = self._folder / f'samples{self._runs}.txt'
        reader = subprocess.Popen(
            ['halsampler', '-t', str(record)], preexec_fn=child_set_up(), stderr=subprocess.DEVNULL
        )
        try:
            self.halcmd('setp', 'sampler.0.enable', '1')
            self._machine.run(str(path), line)
            during(self._machine)
            self._machine.wait_for_end(timeout)
            self.halcmd('setp', 'sampler.0.enable', '0')
            end = time.monotonic() + _DRAIN
            while self._machine.halcmd('getp', 'sampler.0.curr-depth') != '0':
                if time.monotonic() > end:
                    raise LinuxcncError('nobody reads the samples')
                time.sleep(0.01)
        finally:
            reader.send_signal(signal.SIGINT)
            reader.wait(_QUIT)
        lines = record.read_text().splitlines()
        record.unlink()
        # a reader that did not begin with sample 1 reports an overrun before its first one
        rows = [line.split() for line in lines if line.strip() != 'overrun']
        table = np.array(rows, dtype=np.float64)
        if len(table) < 2 or not np.all(np.diff(table[:, 0]) == 1.0):
            raise LinuxcncError('samples are missing: they were read too late')
        return np.asarray(MILLIMETRE * table[:, 1:])

    def halcmd(self, *words: str) -> None:
        """Do something to the HAL.

        Raises
        ------
        LinuxcncError
            If it does not work.
        """
        said = self._machine.halcmd(*words).splitlines()
        # as root it tells whom it becomes
        wrong = [line for line in said if not line.startswith('Running with fallback_uid')]
        if wrong:
            raise LinuxcncError(f'halcmd {" ".join(words)}: {wrong}')


@contextlib.contextmanager
def recording() -> Iterator[Recorder]:
    """Start a LinuxCNC that is ready for programs, and end it.

    Raises
    ------
    LinuxcncError
        If it is not installed, or another one runs.
    """
    with exclusive(), contextlib.ExitStack() as ending:
        folder = Path(ending.enter_context(own_folder()))
        machine = LinuxcncSimulation(folder)
        ending.callback(machine.end)
        machine.start()
        machine.ready()
        yield Recorder(machine, folder)

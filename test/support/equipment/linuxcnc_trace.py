# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""What a real LinuxCNC commands to its joints in every servo period, judged by the true path."""

import signal
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from processes import HANG, start

from fuzzycnc_ros.cli.linuxcnc_simulation import LinuxcncSimulation
from fuzzycnc_ros.core.arrays import Array
from fuzzycnc_ros.core.machine.contour import Contour
from fuzzycnc_ros.core.machine.contouring_axes import ContouringAxes, ContouringConfig
from fuzzycnc_ros.core.machine.path_error import WINDOW_LENGTH, WINDOW_TIME

PERIOD = 1e-3
"""Servo period of the machine [s]."""
MILLIMETRE = 1e-3
REST = 0.2
"""Rest that tells the cut from the way to its start [s]; exact stops are shorter."""
_DEPTH = 16000  # samples that HAL keeps while nobody reads them
_DRAIN = 60.0  # their reader will not take the last ones any more [s]
_STILL = 1e-10  # a sample nearer to the last one has not moved [m]: HAL prints nanometres

LOOP = ContouringConfig(velocity_max=10.0, acceleration_max=1000.0)
"""Position and velocity loops of the simulated machine, whose axes never reach their limits."""


@dataclass(frozen=True)
class Judged:
    """A cut that LinuxCNC commanded.

    Attributes
    ----------
    duration : float
        Time from the first move to the last [s].
    deviation, deviation_rms : float
        Distance of the commanded positions from the true path, largest and rms [m].
    contour, contour_rms : float
        The same of where axes would be that follow the commands with the loops `LOOP` [m].
    acceleration, jerk : float
        Largest of the commanded motion, as vectors [m/s^2, m/s^3].
    """

    duration: float
    deviation: float
    deviation_rms: float
    contour: float
    contour_rms: float
    acceleration: float
    jerk: float


class Recorder:
    """Records the commanded positions of X, Y and Z with HAL's `sampler`.

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

    def run(self, program: str, timeout: float) -> Array:
        """Run a part program from its first line to its end.

        Parameters
        ----------
        program : str
            The program.
        timeout : float
            Time that it may take [s].

        Returns
        -------
        ndarray, shape (n, 3)
            Commanded positions, `PERIOD` apart, from before its start to after its end [m].

        Raises
        ------
        AssertionError
            If it takes longer, or samples were lost.
        """
        self._runs += 1
        path = self._folder / f'program{self._runs}.ngc'
        path.write_text(program)
        record = self._folder / f'samples{self._runs}.txt'
        reader = start(['halsampler', '-t', str(record)])
        try:
            self.halcmd('setp', 'sampler.0.enable', '1')
            self._machine.run(str(path))
            end = time.monotonic() + timeout
            while self._machine.state()['running']:
                assert time.monotonic() < end, f'the program still runs after {timeout} s'
                time.sleep(0.05)
            self.halcmd('setp', 'sampler.0.enable', '0')
            end = time.monotonic() + _DRAIN
            while self._machine.halcmd('getp', 'sampler.0.curr-depth') != '0':
                assert time.monotonic() < end, 'nobody reads the samples'
                time.sleep(0.01)
        finally:
            reader.send_signal(signal.SIGINT)
            reader.wait(HANG)
        lines = record.read_text().splitlines()
        record.unlink()
        # a reader that did not begin with sample 1 reports an overrun before its first one
        rows = [line.split() for line in lines if line.strip() != 'overrun']
        table = np.array(rows, dtype=np.float64)
        assert np.all(np.diff(table[:, 0]) == 1.0), 'samples are missing: they were read too late'
        return np.asarray(MILLIMETRE * table[:, 1:])

    def halcmd(self, *words: str) -> None:
        """Do something to the HAL.

        Raises
        ------
        AssertionError
            If it does not work.
        """
        said = self._machine.halcmd(*words).splitlines()
        # as root it tells whom it becomes
        wrong = [line for line in said if not line.startswith('Running with fallback_uid')]
        assert not wrong, f'halcmd {" ".join(words)}: {wrong}'


def cut_of(samples: Array) -> Array:
    """Return the last motion between two rests of `REST`: the cut, without the way to it.

    Parameters
    ----------
    samples : ndarray, shape (n, d)
        Commanded positions [m].

    Returns
    -------
    ndarray, shape (m, d)
        From the last sample at rest before it to the first one at rest after it [m].
    """
    moved = np.flatnonzero(np.linalg.norm(np.diff(samples, axis=0), axis=1) > _STILL)
    begins = np.flatnonzero(np.diff(moved) > REST / PERIOD)
    first = moved[begins[-1] + 1] if len(begins) else moved[0]
    return samples[first : moved[-1] + 2]


def judge(cut: Array, path: Contour) -> Judged:
    """Judge a cut by the true path.

    Parameters
    ----------
    cut : ndarray, shape (n, d)
        Commanded positions, `PERIOD` apart [m].
    path : Contour
        The true path, in as many dimensions.
    """
    step = np.linalg.norm(np.diff(cut, axis=0), axis=1)
    way = np.append(0.0, np.cumsum(step))
    way *= path.length / way[-1]
    reach = WINDOW_LENGTH + WINDOW_TIME * float(step.max()) / PERIOD
    asked = path.distance(cut, way, reach).distance
    out = round(LOOP.run_out / PERIOD)
    reference = np.concatenate([cut, np.repeat(cut[-1:], out, axis=0)])
    axes = np.concatenate([cut[:1], ContouringAxes(cut[0], LOOP).follow(reference[:-1])])
    place = np.append(way, np.full(out, way[-1]))
    index = np.arange(len(place))
    delayed = np.interp(index - LOOP.delay / PERIOD, index, place)
    left = path.distance(axes, delayed, reach).distance
    rest = np.repeat(cut[:1], 3, axis=0), cut, np.repeat(cut[-1:], 3, axis=0)
    second, third = (
        np.linalg.norm(np.diff(np.concatenate(rest), order, axis=0), axis=1).max() / PERIOD**order
        for order in (2, 3)
    )
    return Judged(
        duration=PERIOD * (len(cut) - 1),
        deviation=float(asked.max()),
        deviation_rms=float(np.sqrt(np.mean(asked**2))),
        contour=float(left.max()),
        contour_rms=float(np.sqrt(np.mean(left**2))),
        acceleration=float(second),
        jerk=float(third),
    )

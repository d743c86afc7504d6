# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The offset that a real LinuxCNC really applies, in every servo period, whoever lives."""

import contextlib
import signal
import subprocess
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from processes import start

from fuzzycnc_ros.adapters.linuxcnc.simulation import LinuxcncSimulation
from fuzzycnc_ros.core.arrays import Array

PERIOD = 1e-3
"""Servo period of the machine [s]."""
MILLIMETRE = 1e-3
TRAVEL = 0.2
"""Travel of the simulation either way [m]."""
COUNT = 1e-5
"""Offset of one count [mm]."""
FLOATS = ('position', 'request', 'applied', 'low', 'high')
_DEPTH = 16000  # samples that HAL keeps while nobody reads them
_DRAIN = 0.3  # time in which the reader, which looks every 10 ms, has taken the last ones [s]
_END = 60.0


class Trace:
    """Samples signals with HAL's `sampler`, from its making to `stop`.

    Parameters
    ----------
    machine : LinuxcncSimulation
        One that was started.
    folder : Path
        Where the samples go.
    kinds : str
        Kind of each signal, `f`loat or `b`it.
    *signals : str
        Names of the signals.
    """

    def __init__(
        self, machine: LinuxcncSimulation, folder: Path, kinds: str, *signals: str
    ) -> None:
        self._file = folder / f'offsets{time.monotonic_ns()}.txt'
        self._machine, self._width = machine, len(signals)
        machine.halcmd('loadrt', 'sampler', f'depth={_DEPTH}', f'cfg={kinds}')
        for number, name in enumerate(signals):
            machine.halcmd('net', name, f'sampler.0.pin.{number}')
        self._reader = start(['halsampler', '-t', str(self._file)])
        machine.halcmd('addf', 'sampler.0', 'servo-thread')

    def table(self) -> Array:
        """End it; return what was sampled, `PERIOD` apart, shape (n, signals).

        Raises
        ------
        AssertionError
            If samples are missing.
        """
        time.sleep(_DRAIN)
        self.close()
        rows = [line.split() for line in self._file.read_text().splitlines()]
        # a reader that did not begin with sample 1 reports an overrun before its first one
        table = np.array([row for row in rows if len(row) == 1 + self._width], dtype=np.float64)
        assert np.all(np.diff(table[:, 0]) == 1.0), 'samples are missing: they were read too late'
        return table[:, 1:]

    def close(self) -> None:
        """Let go of HAL, also of one whose LinuxCNC was killed."""
        if self._reader.poll() is None:
            self._reader.send_signal(signal.SIGINT)
            with contextlib.suppress(subprocess.TimeoutExpired):
                self._reader.wait(_END)
        if self._reader.poll() is None:
            self._reader.kill()
            self._reader.wait()


class OffsetTrace(Trace):
    """Samples what LinuxCNC applies on Z."""

    def __init__(self, machine: LinuxcncSimulation, folder: Path) -> None:
        super().__init__(machine, folder, 'f', 'fuzzycnc-applied-z')

    def stop(self) -> Array:
        """End it; return the offsets, `PERIOD` apart, shape (n,) [m]."""
        return np.asarray(MILLIMETRE * self.table()[:, 0])


@dataclass(frozen=True)
class LineSamples:
    """What was found in each period, all in m."""

    position: Array
    request: Array
    applied: Array
    low: Array
    high: Array
    tracking: NDArray[np.bool_]
    following: NDArray[np.bool_]

    @property
    def line(self) -> Array:
        """The line in force at the commanded position; the travel is that of the simulation."""
        share = (self.position + TRAVEL) / (2.0 * TRAVEL)
        return np.asarray(self.low + (self.high - self.low) * share)


class LineTrace(Trace):
    """Samples how the offset of an axis follows it along its line."""

    def __init__(self, machine: LinuxcncSimulation, folder: Path, axis: str) -> None:
        names = (f'fuzzycnc-{name}-{axis}' for name in FLOATS)
        super().__init__(
            machine, folder, 'fffffbb', *names, 'fuzzycnc-tracking', 'fuzzycnc-following'
        )

    def stop(self) -> LineSamples:
        """End it; return the samples."""
        table = self.table()
        found = dict(zip(FLOATS, MILLIMETRE * table.T[:5], strict=True))
        for name in ('low', 'high'):
            found[name] = found[name] * COUNT
        tracking, following = table.T[5:] > 0.0
        return LineSamples(**found, tracking=tracking, following=following)


def fastest(offsets: Array, window: int = 50) -> float:
    """Return the fastest change of an offset, over `window` periods each [m/s]."""
    return float(np.abs(offsets[window:] - offsets[:-window]).max() / (window * PERIOD))

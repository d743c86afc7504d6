# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The offset that a real LinuxCNC really applies, in every servo period, whoever lives."""

import contextlib
import signal
import subprocess
import time
from pathlib import Path

import numpy as np
from processes import start

from fuzzycnc_ros.adapters.linuxcnc.simulation import LinuxcncSimulation
from fuzzycnc_ros.core.arrays import Array

PERIOD = 1e-3
"""Servo period of the machine [s]."""
MILLIMETRE = 1e-3
_DEPTH = 16000  # samples that HAL keeps while nobody reads them
_DRAIN = 0.3  # time in which the reader, which looks every 10 ms, has taken the last ones [s]
_END = 60.0


class OffsetTrace:
    """Samples the read-back of Z with HAL's `sampler`, from its making to `stop`.

    Parameters
    ----------
    machine : LinuxcncSimulation
        One that was started.
    folder : Path
        Where the samples go.
    """

    def __init__(self, machine: LinuxcncSimulation, folder: Path) -> None:
        self._file = folder / f'offsets{time.monotonic_ns()}.txt'
        self._machine = machine
        machine.halcmd('loadrt', 'sampler', f'depth={_DEPTH}', 'cfg=f')
        machine.halcmd('net', 'fuzzycnc-applied-z', 'sampler.0.pin.0')
        self._reader = start(['halsampler', '-t', str(self._file)])
        machine.halcmd('addf', 'sampler.0', 'servo-thread')

    def stop(self) -> Array:
        """End it; return the offsets, `PERIOD` apart, shape (n,) [m].

        Raises
        ------
        AssertionError
            If samples are missing.
        """
        time.sleep(_DRAIN)
        self.close()
        rows = [line.split() for line in self._file.read_text().splitlines()]
        # a reader that did not begin with sample 1 reports an overrun before its first one
        table = np.array([row for row in rows if len(row) == 2], dtype=np.float64)
        assert np.all(np.diff(table[:, 0]) == 1.0), 'samples are missing: they were read too late'
        return np.asarray(MILLIMETRE * table[:, 1])

    def close(self) -> None:
        """Let go of HAL, also of one whose LinuxCNC was killed."""
        if self._reader.poll() is None:
            self._reader.send_signal(signal.SIGINT)
            with contextlib.suppress(subprocess.TimeoutExpired):
                self._reader.wait(_END)
        if self._reader.poll() is None:
            self._reader.kill()
            self._reader.wait()


def fastest(offsets: Array, window: int = 50) -> float:
    """Return the fastest change of an offset, over `window` periods each [m/s]."""
    return float(np.abs(offsets[window:] - offsets[:-window]).max() / (window * PERIOD))

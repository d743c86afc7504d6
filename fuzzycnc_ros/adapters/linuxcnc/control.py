# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""A running LinuxCNC as an object: status in, counts out, in SI units.

Behind it stands a process with the HAL pins (`hal_process`); every connection is a fresh one.
"""

import contextlib
import json
import math
import os
import select
import subprocess
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from fuzzycnc_ros.adapters.controller import Controller
from fuzzycnc_ros.adapters.link import LinkError
from fuzzycnc_ros.adapters.linuxcnc import hal_process
from fuzzycnc_ros.adapters.linuxcnc.status import (
    ControllerOutput,
    LinuxcncStatus,
    ServoThreadLimits,
)
from fuzzycnc_ros.core.inputs.lines import Travel
from fuzzycnc_ros.runtime.enums import MachineMode
from fuzzycnc_ros.runtime.records import Names

ANSWER_TIMEOUT = 1.0
"""Wall time [s] for an answer; measured on an idle machine: 0.2 ms."""
START_TIMEOUT = 5.0
"""Wall time [s] for the process to start and find the pins."""
STILL = 1.0
"""Wall time [s] after which a servo thread whose own time never changes stands still."""
FAR = 100.0
"""Travel beyond which a limit of LinuxCNC is none [m]."""


class LinuxcncError(LinkError):
    """LinuxCNC is not there, has ended, or refuses; the text says what to do."""


def linuxcnc_runs() -> bool:
    """Return True if a LinuxCNC runs on this machine."""
    return hal_process.hal_memory() is not None


class LineProcess:
    """A process beside LinuxCNC that answers each request, JSON lines both ways.

    Parameters
    ----------
    command : sequence of str
        Interpreter of LinuxCNC's modules, program and arguments.
    ended : str
        Text of the error when it is not there any more.
    **options
        Further options of `subprocess.Popen`.

    Raises
    ------
    LinuxcncError
        If it does not start, or says why it cannot serve.
    """

    def __init__(
        self, command: Sequence[str], *, ended: str = 'LinuxCNC has ended', **options: Any
    ) -> None:
        self._pending, self._ended = b'', ended
        try:
            self.process = subprocess.Popen(
                command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, **options
            )
        except OSError as error:
            raise LinuxcncError(f'interpreter = {command[0]}: {error}') from error
        try:
            self._receive(START_TIMEOUT)
        except LinuxcncError:
            self.close(ANSWER_TIMEOUT)
            raise

    def ask(self, request: dict[str, Any], timeout: float) -> dict[str, Any]:
        """Return the answer to a request.

        Raises
        ------
        LinuxcncError
            If it refuses, does not answer in time [s], or has ended.
        """
        stream = self.process.stdin
        assert stream is not None
        try:
            stream.write(json.dumps(request).encode() + b'\n')
            stream.flush()
        except (OSError, ValueError):
            raise LinuxcncError(self._ended) from None
        return self._receive(timeout)

    def close(self, timeout: float) -> None:
        """End it; it is killed if that takes longer [s]."""
        for stream in (self.process.stdin, self.process.stdout):
            if stream is not None:
                with contextlib.suppress(OSError):  # it has ended
                    stream.close()
        try:
            self.process.wait(timeout)
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.process.wait()

    def _receive(self, timeout: float) -> dict[str, Any]:
        stream = self.process.stdout
        assert stream is not None
        end = time.monotonic() + timeout
        while b'\n' not in self._pending:
            left = end - time.monotonic()
            if left <= 0.0 or not select.select([stream], [], [], left)[0]:
                raise LinuxcncError(f'the process with the HAL pins is silent for {timeout:g} s')
            block = os.read(stream.fileno(), 65536)
            if not block:
                raise LinuxcncError(self._ended)
            self._pending += block
        line, _, self._pending = self._pending.partition(b'\n')
        answer: dict[str, Any] = json.loads(line)
        if set(answer) == {'error'}:
            raise LinuxcncError(str(answer['error']))
        return answer


class Linuxcnc(Controller[LinuxcncStatus, ControllerOutput, ServoThreadLimits]):
    """Pins of one bridge in a running LinuxCNC.

    Parameters
    ----------
    axes : sequence of str
        Axes with offsets.
    interpreter : str
        Python that LinuxCNC's modules are built for.

    Raises
    ------
    LinuxcncError
        If LinuxCNC does not run, lacks the HAL file, or cannot be talked to.
    """

    def __init__(self, axes: Names, interpreter: str) -> None:
        self._axes = [axis.lower() for axis in axes]
        self._tick: Any = None
        self._metre = 1e-3
        self._tick_at = time.monotonic()
        command = [interpreter, '-I', str(Path(hal_process.__file__)), ','.join(axes)]
        self._process = LineProcess(command, stderr=subprocess.DEVNULL)

    def read(self) -> LinuxcncStatus:
        """Return the present status."""
        return self._status(self._ask({'op': 'read', 'due': self.probe_due}))

    def write(self, orders: ControllerOutput) -> LinuxcncStatus:
        """Write counts, and the heartbeat; return the present status."""
        request = {
            'op': 'write',
            'offset': orders.counts.tolist(),
            'slope': (orders.slope * self._metre).tolist(),
            'reference': (orders.reference / self._metre).tolist(),
            'limit': orders.limit,
            'rezero': orders.rezero,
            'due': self.probe_due,
        }
        return self._status(self._ask(request))

    def limits(self) -> ServoThreadLimits:
        """Return the limits of the HAL file."""
        found = self._ask({'op': 'limits'})
        return ServoThreadLimits(**{**found, 'slope': found['slope'] / self._metre})

    def claim(self) -> None:
        """Become the writer of the counts, from where they stand.

        Raises
        ------
        LinuxcncError
            If another process or part of the HAL configuration writes them.
        """
        self._ask({'op': 'claim'})

    def release(self) -> None:
        """Write no more; the servo thread takes what still stands to zero."""
        self._ask({'op': 'release'})

    def close(self) -> None:
        """End the process; offsets that stand are left to the watchdog of the HAL file."""
        self._process.close(ANSWER_TIMEOUT)

    def _ask(self, request: dict[str, Any]) -> dict[str, Any]:
        return self._process.ask(request, ANSWER_TIMEOUT)

    def _status(self, found: dict[str, Any]) -> LinuxcncStatus:
        self._check_time(found['tick'])
        metre = self._metre = 1e-3 / found['units']

        def column(name: str, unit: float) -> Any:
            return unit * np.array([found[f'{name}-{axis}'] for axis in self._axes], np.float64)

        scale = column('scale', metre)
        ends = [column('min', metre), column('max', metre)] if found['slopes'] else [scale, scale]
        travel = Travel(low=ends[0], high=np.where(ends[1] - ends[0] < FAR, ends[1], ends[0]))
        lines = base = None
        if found['slopes']:
            inside = np.concatenate([scale * column(name, 1.0) for name in ('low', 'high')])
            lines = travel.lines(inside, travel.low)
            base = scale * column('base', 1.0)
        return LinuxcncStatus(
            mode=MachineMode[found['mode'].upper()],
            homed=found['homed'],
            ready=found['ready'],
            alive=found['alive'],
            frozen=not found['on'],
            soft_limited=found['soft-limited'],
            writer=found['writer'],
            position=column('position', metre),
            applied=column('applied', metre),
            register=column('request', metre),
            counts=column('register', 1.0),
            scale=scale,
            lines=lines,
            travel=travel,
            base=base,
            tracking=found['tracking'],
            tick=found['tick'],
            spindle_speed=2.0 * math.pi * found['spindle'],
            coolant=found['coolant'],
            probe=(found['probe-code'], found['probe-value']) if found['probed'] else None,
        )

    def _check_time(self, tick: Any) -> None:
        """Notice a servo thread that stands still: what it tells is not true any more."""
        now = time.monotonic()
        if tick != self._tick:
            self._tick, self._tick_at = tick, now
        elif now - self._tick_at > STILL:
            raise LinuxcncError(
                f"LinuxCNC's servo thread has stood still for {now - self._tick_at:.1f} s; "
                'it was killed or it hangs'
            )

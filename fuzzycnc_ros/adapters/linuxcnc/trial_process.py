# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""A process between an operator who tries settings of an axis and LinuxCNC, JSON lines both ways.

It runs under the Python that LinuxCNC's modules are built for.  Arguments are the prefix of an
exported component, the letter of its axis, and the file that gets a row of doubles a period.
Each request, `{"op": ...}`, gets one line of answer.  A trial ends when its input ends, when no
request has come for `SILENCE`, when the spindle turns, and when it is told to.
"""

import json
import os
import select
import signal
import struct
import sys
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[3]))  # started as a file

from fuzzycnc_ros.adapters.linuxcnc.hal_process import (
    PREFIX,
    HalError,
    begin_of,
    hal_memory,
    linuxcnc_modules,
)

TYPES = 'bffffss'
"""Types of a sample of the component."""
TRIED = 1
"""State of a trial that drives the axis."""
ANEW = -1
"""Sign of life at which the controller begins anew."""
LOOK = 0.01
"""Time between two looks at the samples [s]."""
SILENCE = 0.25
"""Time without a request after which a trial is ended [s]."""
NUMBERS = ('gain', 'error_max', 'low', 'high')
"""Parameters of a trial beside its settings."""


class Trials:
    """The axis in LinuxCNC: its parameters and samples, and its jogs."""

    def __init__(self, hal, linuxcnc, prefix, axis, rows):
        self._hal, self._linuxcnc, self._prefix = hal, linuxcnc, prefix
        self._axis = 'XYZABCUVW'.index(axis)
        self._state, self._command = linuxcnc.stat(), linuxcnc.command()
        self._errors = linuxcnc.error_channel()
        self._component = hal.component(f'{PREFIX}-{os.getpid()}-{begin_of(os.getpid())}')
        try:
            key = hal.get_value(f'{prefix}.stream')
            self._stream = hal.stream(self._component, key, TYPES)
        except (RuntimeError, hal.error) as error:
            raise HalError(
                f'expected the component {prefix} as `fuzzycnc linuxcnc install` exports it, but '
                f'found none: {error}'
            ) from None
        self._component.ready()
        self._rows, self._row = rows, struct.Struct(f'{len(TYPES) + 1}d')
        self._last, self._still, self._count = None, 0, 0
        self._sign, self._heard, self._why = 0, time.monotonic(), ''
        while self._stream.read() is not None:  # what was before
            pass
        if self._value('trial-state') == TRIED:
            raise HalError(f'{prefix}: expected no trial but somebody else tries settings')
        self._tell(0)

    def _value(self, name):
        return self._hal.get_value(f'{self._prefix}.{name}')

    def _set(self, name, value):
        self._hal.set_p(f'{self._prefix}.{name}', repr(value))

    def _tell(self, sign):
        self._sign = sign
        self._set('trial', sign)

    def look(self):
        """Read samples; end a trial that must not go on."""
        while (sample := self._stream.read()) is not None:
            self._rows.write(self._row.pack(self._stream.sampleno, *sample))
            moves = sample[2] != 0.0 or (self._last and sample[1] != self._last[1])
            self._still = 0 if moves else self._still + 1
            self._last, self._count = sample, self._count + 1
        self._rows.flush()
        if self._sign > 0:
            why = self.forbidden()
            if time.monotonic() - self._heard > SILENCE:
                why = 'its operator has gone'
            if why:
                self._why = why
                self.end()

    def forbidden(self):
        """Return what of the machine forbids a trial; empty if nothing does."""
        module, state = self._linuxcnc, self._state
        state.poll()
        if any(
            spindle['enabled'] or spindle['speed'] for spindle in state.spindle[: state.spindles]
        ):
            return 'spindle: expected one at rest but found one that turns; stop it'
        if state.task_state != module.STATE_ON:
            return 'LinuxCNC: expected drives that are on but found otherwise; switch it on'
        if state.interp_state != module.INTERP_IDLE:
            return 'LinuxCNC: expected no program but one runs; wait for it'
        if not all(state.homed[: state.joints]):
            return 'LinuxCNC: expected homed joints but found otherwise; home it'
        if state.task_mode != module.MODE_MANUAL or state.motion_mode != module.TRAJ_MODE_TELEOP:
            return 'LinuxCNC: expected manual mode along axes but found another one'
        return ''

    def answer(self, request):
        """Carry out a request; return the state."""
        self._heard = time.monotonic()
        getattr(self, request.pop('op'))(**request)
        self.look()
        error = self._errors.poll()
        last = self._last or (0, 0.0, 0.0, 0.0, 0.0, 0, 0)
        why, self._why = self._why, ''
        return {
            'rows': self._count,
            'still': self._still,
            'enabled': bool(last[0]),
            'command': last[1],
            'state': last[6],
            'fault_code': self._value('fault-code'),
            'exported_from': self._value('exported-from') & 0xFFFFFFFF,
            'in_use': self._value('machine-file') & 0xFFFFFFFF,
            'controller': self._value('controller') & 0xFFFFFFFF,
            'forbidden': why or self.forbidden(),
            'error': error[1] if error else '',
        }

    def state(self):
        """Do nothing."""

    def manual(self):
        """Go to manual mode along axes, from another one in which nothing moves."""
        module, command = self._linuxcnc, self._command
        self._state.poll()
        if self._state.task_state == module.STATE_ON and (
            self._state.interp_state == module.INTERP_IDLE
        ):
            command.mode(module.MODE_MANUAL)
            command.wait_complete()
            command.teleop_enable(1)
            command.wait_complete()

    def anew(self):
        """Have the controller of an axis at rest begin anew."""
        self._tell(ANEW)

    def begin(self, numbers, **values):
        """Begin a trial."""
        for place, value in enumerate(numbers):
            self._set(f'trial-number-{place:02d}', value)
        for name in NUMBERS:
            self._set(f'trial-{name.replace("_", "-")}', values[name])
        self._tell(1)

    def hold(self):
        """Give a sign of life, unless it was ended."""
        if self._sign > 0:
            self._tell(self._sign + 1)

    def end(self):
        """End the trial, and the motion."""
        self._tell(0)
        self._command.jog(self._linuxcnc.JOG_STOP, False, self._axis)

    def jog(self, way, speed):
        """Go a way [m] at a speed [m/s]."""
        units = 1e3 * self._state.linear_units
        self._command.jog(
            self._linuxcnc.JOG_INCREMENT, False, self._axis, speed * units, way * units
        )

    def close(self):
        """End what is under way, and give the component back to HAL."""
        if self._sign:
            self.end()
        del self._stream  # else its memory would outlive LinuxCNC
        self._component.exit()


def main():
    """Serve one operator."""
    prefix, axis, file = sys.argv[1:]
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the operator's Ctrl-C is for the command
    memory = hal_memory()

    def say(content):
        sys.stdout.write(json.dumps(content) + '\n')
        sys.stdout.flush()

    try:
        if memory is None:
            raise HalError('LinuxCNC does not run here')
        hal, linuxcnc = linuxcnc_modules()
        rows = Path(file).open('wb')
        trials = Trials(hal, linuxcnc, prefix, axis, rows)
    except (HalError, RuntimeError) as error:
        say({'error': str(error)})
        return
    say({})
    try:
        while hal_memory() == memory:
            if not select.select([sys.stdin], [], [], LOOK)[0]:
                trials.look()
                continue
            line = sys.stdin.readline()
            if not line:
                break
            say(trials.answer(json.loads(line)))
    finally:
        trials.close()


if __name__ == '__main__':
    main()

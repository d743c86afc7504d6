# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""A process that holds the HAL pins: LinuxCNC in, JSON lines out.

It runs under the Python that LinuxCNC's modules are built for, and needs nothing else; any Python
of the node will do.  LinuxCNC ends the processes of its HAL components when it ends, and keeps
the memory of those that were killed: a process of its own makes both harmless.

Each line that it reads is a request, `{"op": ...}`, and gets one line of answer.  When its input
ends it ends too, and leaves the offsets to the watchdog in the servo thread.
"""

import json
import os
import signal
import sys
import time
from importlib import import_module
from pathlib import Path

MODULES = '/usr/lib/python3/dist-packages'
"""Folder in which Debian installs hal and linuxcnc."""
HAL_KEY = 0x48414C32
"""Key of the shared memory that HAL uses."""
MODE_PERIOD = 0.05
"""Time [s] between two looks at the state, which is slower to read than pins."""
ARMING = 0.05
"""Time [s] for the servo thread to see an edge of the enable of its watchdog."""
PREFIX = 'fuzzycnc'
HAL_FILES = ('fuzzycnc.hal', 'fuzzycnc_offset.hal')
LINE = ('offset', 'slope', 'reference')
"""Inputs of the component fuzzycnc_offset for each axis."""
VALID_FOR = 10.0
"""Validity of a set without a following one [s]."""
TAKEN = 3.0
"""Time [s] after which a set that it has not taken is told; it takes two servo periods, and a
servo thread that stands still is told before."""
NUMBERS = 32767
"""Numbers of sets go from 1 to this and begin anew."""
PROBE_READS = ('probe-code', 'probe-value')
"""Signals of fuzzycnc_probe.hal: the code is read first, since the number is written first."""
PROBE_DUE = 'probe-due'
SERVER = 'linuxcncsvr'
"""Process that every LinuxCNC has."""
TOOLS = '.tool.mmap'
"""File in the home of LinuxCNC's user without which its module tells no state."""


def hal_memory():
    """Return the id of HAL's shared memory; None if LinuxCNC does not run."""
    for line in Path('/proc/sysvipc/shm').read_text().splitlines()[1:]:
        key, number = line.split()[:2]
        if int(key) & 0xFFFFFFFF == HAL_KEY:
            return int(number)
    return None


def home_of_linuxcnc(processes=Path('/proc')):
    """Return the home of who runs LinuxCNC; that of this process if nobody tells another."""
    for process in processes.glob('[0-9]*'):
        try:
            if (process / 'comm').read_text().strip() != SERVER:
                continue
            environment = (process / 'environ').read_bytes().split(b'\0')
        except OSError:
            continue
        for entry in environment:
            name, _, value = entry.partition(b'=')
            if name == b'HOME':
                return os.fsdecode(value)
    return os.path.expanduser('~')


def begin_of(process):
    """Return when a process began, in clock ticks; None if there is none of this number."""
    try:
        text = Path(f'/proc/{process}/stat').read_text()
    except OSError:
        return None
    fields = text.rpartition(')')[2].split()
    return None if fields[0] in ('Z', 'X') else int(fields[19])


def is_dead(component):
    """Return True if a component is a bridge whose process is gone; all others are left alone."""
    parts = component.split('-')
    if len(parts) != 3 or parts[0] != PREFIX or not (parts[1] + parts[2]).isdigit():
        return False
    return begin_of(int(parts[1])) != int(parts[2])


ANSWERS = sys.stdout


class HalError(Exception):
    """A request cannot be carried out; the text says why."""


def linuxcnc_modules():
    """Return LinuxCNC's modules hal and linuxcnc, for the user that runs it."""
    os.environ['HOME'] = home_of_linuxcnc()
    sys.path.append(MODULES)
    try:
        return import_module('hal'), import_module('linuxcnc')
    except ImportError as error:
        raise HalError(
            f"expected LinuxCNC's Python modules hal and linuxcnc but: {error}"
        ) from None


def drivers(hal):
    """Return the pin that writes each signal, by the signal's name; empty if none does."""
    return {item['NAME']: item.get('DRIVER') or '' for item in hal.get_info_signals()}


class Bridge:
    """Pins of one bridge, named after its process: a killed one leaves its pins behind."""

    def __init__(self, hal, linuxcnc, axes):
        self._hal, self._linuxcnc = hal, linuxcnc
        self._axes = axes
        self._state = None
        self._mode_at = 0.0
        self._mode = {}
        self._claimed = False
        self._edge_at = 0.0
        self._name = f'{PREFIX}-{os.getpid()}-{begin_of(os.getpid())}'
        self._component = hal.component(self._name)
        kinds = {'f': hal.HAL_FLOAT, 's': hal.HAL_S32, 'b': hal.HAL_BIT}
        known = drivers(hal)
        self._slopes = f'{PREFIX}-sequence' in known
        reads = [(n, 'b') for n in ('homed', 'ready', 'alive', 'on', 'soft-limited')]
        writes = [('heartbeat', 'b'), ('enable', 'b'), ('rezero', 'b')]
        axis_reads = [('position', 'f'), ('applied', 'f'), ('request', 'f'), ('register', 's')]
        axis_writes = LINE if self._slopes else ('counts',)
        if self._slopes:
            reads += [('acknowledged', 's'), ('following', 'b'), ('tracking', 'b')]
            writes += [('sequence', 's'), ('valid-for', 'f'), ('limit', 'f')]
            axis_reads += [('low', 'f'), ('high', 'f'), ('base', 'f')]
        for axis in axes:
            reads += [(f'{name}-{axis}', kind) for name, kind in axis_reads]
            writes += [(f'{name}-{axis}', 'f') for name in axis_writes]
        new = self._component.newpin
        self._in = {name: new(name, kinds[kind], hal.HAL_IN) for name, kind in reads}
        self._out = {name: new(name, kinds[kind], hal.HAL_OUT) for name, kind in writes}
        self._probe_in = {name: new(name, hal.HAL_FLOAT, hal.HAL_IN) for name in PROBE_READS}
        self._due = new(PROBE_DUE, hal.HAL_BIT, hal.HAL_OUT)
        self._component.ready()
        missing = sorted(f'{PREFIX}-{n}' for n in (*self._in, *self._out))
        missing = [name for name in missing if name not in known]
        if missing:
            self._component.exit()
            raise HalError(
                f'expected the signals of {HAL_FILES[self._slopes]} but {", ".join(missing)} are '
                'missing; load the HAL file, and compare the axes'
            )
        for name in self._in:
            hal.connect(f'{self._name}.{name}', f'{PREFIX}-{name}')
        # the pin that writes a register tells which axis of the component it is
        self._places = {
            axis: self.writer(f'register-{axis}').partition('.counts-') for axis in axes
        }
        self._probed = all(f'{PREFIX}-{name}' in known for name in PROBE_READS)
        if self._probed:
            for name in PROBE_READS:
                hal.connect(f'{self._name}.{name}', f'{PREFIX}-{name}')
        self._shows_due = f'{PREFIX}-{PROBE_DUE}' not in known
        self.show(False)

    def writer(self, name):
        """Return the pin that writes a signal; empty if there is none."""
        return drivers(self._hal).get(f'{PREFIX}-{name}', '')

    def show(self, due):
        """Show whether a probing cycle is due, once no other bridge that is alive does."""
        if due == self._due.value and self._shows_due:
            return
        self._due.value = due
        pin = '' if self._shows_due else self.writer(PROBE_DUE)
        if self._shows_due or (pin and not is_dead(pin.partition('.')[0])):
            return
        if pin:
            self._hal.disconnect(pin)
        self._hal.connect(f'{self._name}.{PROBE_DUE}', f'{PREFIX}-{PROBE_DUE}')
        self._shows_due = True

    def limits(self):
        """Return the limits of the servo thread."""
        value = self._hal.get_value
        if self._slopes:
            name = self.writer('acknowledged').rpartition('.')[0]
            return {
                'counts_max': value(f'{name}.size-max'),
                'counts_rate': value(f'{name}.rate-max'),
                'slope': value(f'{name}.slope-max'),
                'hold_time': value(f'{name}.hold-time'),
            }
        rows = [f'{PREFIX}-limit-{axis}' for axis in self._axes]
        return {
            'slope': 0.0,
            'counts_max': min(min(value(f'{n}.max'), -value(f'{n}.min')) for n in rows),
            'counts_rate': min(value(f'{n}.maxv') for n in rows),
            'hold_time': value('watchdog.timeout-0'),
        }

    def claim(self):
        """Become the writer; start with the values that stand."""
        for name in self._out:
            pin = self.writer(name)
            owner = pin.partition('.')[0]
            if pin and not is_dead(owner):
                raise HalError(f'{PREFIX}-{name} is written by {pin}; end {owner} first')
            if pin:
                self._hal.disconnect(pin)
        self._out['enable'].value = bool(self._hal.get_value(f'{PREFIX}-enable'))
        if self._slopes:
            self._out['sequence'].value = self._in['acknowledged'].value
            self._set, self._set_at = None, time.monotonic()
        else:
            for axis in self._axes:
                self._out[f'counts-{axis}'].value = self._in[f'register-{axis}'].value
        for name in self._out:
            self._hal.connect(f'{self._name}.{name}', f'{PREFIX}-{name}')
        self._claimed = True

    def write(self, lines, rezero):
        """Write offsets, slopes and references; show the watchdog that somebody is there."""
        if not self._claimed:
            raise HalError('the pins have not been claimed')
        if self._slopes:
            self._write_set(lines)
        else:
            for axis, counts in zip(self._axes, lines['offset'], strict=True):
                self._out[f'counts-{axis}'].value = counts
        self._out['rezero'].value = rezero
        beat, enable = self._out['heartbeat'], self._out['enable']
        beat.value = not beat.value
        # A watchdog that has let go starts again at an edge of its enable.
        now = time.monotonic()
        if not self._in['alive'].value and now - self._edge_at > ARMING:
            enable.value = not enable.value
            self._edge_at = now

    def _write_set(self, lines):
        """Write a set that is news, once the one before was taken: half of one is never taken."""
        now, number = time.monotonic(), self._out['sequence'].value
        if self._in['acknowledged'].value != number:
            if now - self._set_at > TAKEN:
                raise HalError(
                    f'fuzzycnc_offset has not taken set {number} for {TAKEN:g} s; is its function '
                    'in servo-thread'
                )
            return
        stands = self._in['following'].value and now - self._set_at < VALID_FOR / 3.0
        if lines == self._set and stands:
            return
        for name in LINE:
            for axis, value in zip(self._axes, lines[name], strict=True):
                self._out[f'{name}-{axis}'].value = value
        self._out['limit'].value = lines['limit']
        self._out['valid-for'].value = VALID_FOR
        self._out['sequence'].value = number % NUMBERS + 1
        self._set, self._set_at = lines, now

    def release(self):
        """Write no more; what still stands goes to zero in the servo thread, at once."""
        if self._claimed:
            self._out['rezero'].value = self._out['enable'].value = False
            for name in self._out:
                self._hal.disconnect(f'{self._name}.{name}')
            self._claimed = False

    def status(self):
        """Return what LinuxCNC tells now, in its own units."""
        now = time.monotonic()
        if now - self._mode_at > MODE_PERIOD:
            self._mode, self._mode_at = self._read_mode(), now
        found = {name: pin.value for name, pin in (*self._probe_in.items(), *self._in.items())}
        found['probed'], found['slopes'] = self._probed, self._slopes
        found.setdefault('tracking', True)
        for axis in self._axes:
            found[f'scale-{axis}'] = self._hal.get_value(f'axis.{axis}.eoffset-scale')
            if self._slopes:
                name, _, number = self._places[axis]
                for end in ('min', 'max'):
                    found[f'{end}-{axis}'] = self._hal.get_value(f'{name}.{end}-{number}')
        found['tick'] = self._hal.get_value('servo-thread.time')
        return {**found, **self._mode}

    def _read_mode(self):
        module = self._linuxcnc
        try:
            if self._state is None:
                self._state = module.stat()
            self._state.poll()
        except module.error as error:
            self._state = None
            raise HalError(f'LinuxCNC does not report its state: {error}') from None
        except SystemError:  # so its second call ends where there is no such file
            file = Path(os.environ['HOME'], TOOLS)
            raise HalError(
                f'LinuxCNC does not report its state: cannot read {file}; run this node as the '
                'user that runs LinuxCNC'
            ) from None
        state = self._state
        mode = 'off'
        if state.task_state == module.STATE_ESTOP:
            mode = 'estop'
        elif any(joint['fault'] for joint in state.joint[: state.joints]):
            mode = 'fault'
        elif state.task_state == module.STATE_ON:
            mode = 'on' if state.interp_state == module.INTERP_IDLE else 'running'
        pin = self.writer(f'counts-{self._axes[0]}')
        owner = pin.partition('.')[0]
        return {
            'mode': mode,
            'units': state.linear_units or 1.0,
            'coolant': bool(state.flood or state.mist),
            'spindle': self._hal.get_value('spindle.0.speed-out-rps'),
            'writer': '' if is_dead(owner) else owner,
        }

    def close(self):
        """Give the component back to HAL."""
        self._component.exit()


def serve(bridge, memory):
    """Answer requests until the input ends."""
    for line in sys.stdin:
        request = json.loads(line)
        try:
            if hal_memory() != memory:
                raise HalError('LinuxCNC has ended')
            operation = request['op']
            if 'due' in request:
                bridge.show(request['due'])
            if operation == 'claim':
                bridge.claim()
            elif operation == 'release':
                bridge.release()
            elif operation == 'write':
                bridge.write({name: request[name] for name in (*LINE, 'limit')}, request['rezero'])
            elif operation == 'limits':
                answer(bridge.limits())
                continue
            answer(bridge.status())
        except (HalError, RuntimeError, ValueError) as error:
            answer({'error': str(error)})


def answer(content):
    """Write one line."""
    ANSWERS.write(json.dumps(content) + '\n')
    ANSWERS.flush()


def main():
    """Serve one bridge."""
    global ANSWERS
    ANSWERS = os.fdopen(os.dup(1), 'w')
    os.dup2(2, 1)  # LinuxCNC's libraries print where they like
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the node says when
    memory = hal_memory()
    if memory is None:
        answer({'error': 'LinuxCNC does not run here'})
        return
    try:
        hal, linuxcnc = linuxcnc_modules()
    except HalError as error:
        answer({'error': str(error)})
        return
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(0))
    try:
        bridge = Bridge(hal, linuxcnc, sys.argv[1].lower().split(','))
    except (HalError, RuntimeError, hal.error) as error:
        answer({'error': str(error)})
        return
    try:
        answer({'name': 'ready'})
        serve(bridge, memory)
    finally:
        bridge.close()


if __name__ == '__main__':
    main()

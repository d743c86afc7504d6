# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""A process that arms `fuzzycnc_feed` while LinuxCNC has the program of its table loaded.

It runs under the Python that LinuxCNC's modules are built for, and ends with LinuxCNC, or when it
is ended: then the component is disarmed.  Each change of what it finds is one line.
"""

import hashlib
import os
import signal
import sys
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[3]))  # started as a file

from fuzzycnc_ros.adapters.linuxcnc.hal_process import (
    PREFIX,
    HalError,
    begin_of,
    drivers,
    hal_memory,
    is_dead,
    linuxcnc_modules,
)

PERIOD = 0.05
"""Time between two looks at LinuxCNC, and half of that between two heartbeats [s]."""
FEED = f'{PREFIX}-feed'
NO_LENGTH, LENGTH_OF_TOOL = -1, -2
"""Tool length of a table that names none, and that of the loaded tool."""
NEAR = 1e-6
"""Lengths that count as the same [units], angles too [deg]."""


class Judge:
    """Compares what LinuxCNC has loaded and in force with a table.

    Parameters
    ----------
    program : str
        SHA-256 of the program, as hex digits.
    offset, length : int
        Work offset in tenths of its G word, 0 for any; number of the tool length, 0 for none.
    """

    def __init__(self, program, offset, length):
        self._program, self._offset, self._length = program, offset, length
        self._seen, self._known = None, ''  # file with its times, and its hash

    def doubt(self, state, table_id):
        """Return why the table cannot be followed; empty if it can."""
        if table_id != int(self._program[:8], 16):
            return (
                'the component has another table or none: expected that of this program; --load '
                'loads it, or FEED_TABLE when LinuxCNC starts'
            )
        found = self._hash(state.file)
        if found != self._program:
            return (
                f'{state.file or "no program"} is loaded: expected the program of the table '
                f'({self._program[:8]}) but found {found[:8] or "none"}; load that program'
            )
        if abs(state.rotation_xy) > NEAR:
            return (
                f'rotation: expected none but found {state.rotation_xy:g} degrees; G10 L2 P0 R0 '
                'takes it away'
            )
        if any(code in (410, 411, 420, 421) for code in state.gcodes):
            return 'cutter compensation: expected none but found it in force; G40 ends it'
        names = [540, 550, 560, 570, 580, 590, 591, 592, 593]
        if self._offset and names.index(self._offset) + 1 != state.g5x_index:
            return (
                f'work offset: expected G{self._offset / 10:g} but found '
                f'G{names[state.g5x_index - 1] / 10:g}; choose it before the program starts'
            )
        return self._length_doubt(state)

    def _length_doubt(self, state):
        if self._length == NO_LENGTH:
            return ''
        number = state.tool_in_spindle if self._length == LENGTH_OF_TOOL else self._length
        wanted = [(0.0, 0.0, 0.0)] if number == 0 else []
        for tool in state.tool_table:
            if number and tool.id == number:
                wanted.append((tool.xoffset, tool.yoffset, tool.zoffset))
        if not wanted:
            return f'tool length: expected that of tool {number} but the tool table has none'
        if any(abs(a - b) > NEAR for a, b in zip(state.tool_offset, wanted[0])):  # noqa: B905
            return (
                f'tool length: expected that of tool {number} in force but found another one; '
                f'{"G49" if number == 0 else f"G43 H{number}"} before the program starts'
            )
        return ''

    def _hash(self, file):
        try:
            status = os.stat(file)
            seen = (file, status.st_mtime_ns, status.st_size, status.st_ino)
            if self._seen != seen:
                self._known = hashlib.sha256(Path(file).read_bytes()).hexdigest()
                self._seen = seen
        except OSError:
            return ''
        return self._known


def origin(state):
    """Return where zero of the program is, by X, Y and Z [units]."""
    return [
        state.g5x_offset[axis] + state.g92_offset[axis] + state.tool_offset[axis]
        for axis in range(3)
    ]


class Helper:
    """Pins that arm the component, and its heartbeat."""

    def __init__(self, hal, linuxcnc, judge):
        self._hal, self._linuxcnc, self._judge = hal, linuxcnc, judge
        self._state, self._said = linuxcnc.stat(), None
        self._name = f'{PREFIX}-{os.getpid()}-{begin_of(os.getpid())}'
        component = self._component = hal.component(self._name)
        names = ['arm', 'heartbeat', *(f'offset-{axis}' for axis in 'xyz')]
        self._pins = {
            name: component.newpin(
                name, hal.HAL_FLOAT if 'offset' in name else hal.HAL_BIT, hal.HAL_OUT
            )
            for name in names
        }
        component.ready()
        signals = drivers(hal)
        for name in names:
            driver = signals.get(f'{FEED}-{name}')
            if driver is None:
                raise HalError(
                    f'expected the signal {FEED}-{name} but found none; load fuzzycnc_feed.hal'
                )
            if driver and not is_dead(driver.partition('.')[0]):
                raise HalError(f'{FEED}-{name}: expected no writer but found {driver}; end it')
            if driver:
                hal.disconnect(driver)
        for name in names:
            hal.connect(f'{self._name}.{name}', f'{FEED}-{name}')

    def look(self):
        """Compare, arm or disarm; return what is new of it, empty if nothing."""
        self._state.poll()
        state, pins = self._state, self._pins
        doubt = self._judge.doubt(state, self._hal.get_value(f'{FEED}.table-id') & 0xFFFFFFFF)
        here = origin(state)
        if state.interp_state == self._linuxcnc.INTERP_IDLE:
            for axis, value in zip('xyz', here):  # noqa: B905
                pins[f'offset-{axis}'].value = value
        elif any(
            abs(pins[f'offset-{axis}'].value - value) > NEAR
            for axis, value in zip('xyz', here)  # noqa: B905
        ):
            doubt = doubt or 'the coordinates have changed while the program runs'
        pins['arm'].value = not doubt
        pins['heartbeat'].value = not pins['heartbeat'].value
        if doubt:
            said = f'refused: {doubt}'
        elif self._hal.get_value(f'{FEED}.lost'):
            said = 'lost: the least share of the table until the path is found or the program ends'
        elif self._hal.get_value(f'{FEED}.active'):
            said = 'armed'
        else:
            said = 'to be armed when no program runs'
        new, self._said = said if said != self._said else '', said
        return new

    def close(self):
        """Disarm, and give the component back to HAL."""
        self._pins['arm'].value = False
        self._component.exit()


def main():
    """Serve one table until LinuxCNC ends."""
    program, offset, length = sys.argv[1], int(sys.argv[2]), int(sys.argv[3])
    memory = hal_memory()
    if memory is None:
        sys.exit('refused: LinuxCNC does not run here')
    try:
        hal, linuxcnc = linuxcnc_modules()
    except HalError as error:
        sys.exit(f'refused: {error}')
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda *_: sys.exit(0))
    try:
        helper = Helper(hal, linuxcnc, Judge(program, offset, length))
    except (HalError, RuntimeError, hal.error, linuxcnc.error) as error:
        sys.exit(f'refused: {error}')
    try:
        while hal_memory() == memory:
            said = helper.look()
            if said:
                print(said, flush=True)
            time.sleep(PERIOD)
    except (RuntimeError, SystemError, linuxcnc.error) as error:
        sys.exit(f'refused: LinuxCNC does not report its state: {error}')
    finally:
        helper.close()


if __name__ == '__main__':
    main()

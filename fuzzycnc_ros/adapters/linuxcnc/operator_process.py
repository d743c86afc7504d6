# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Operates a LinuxCNC from within: it is started as its display and obeys a socket.

Runs under the Python that LinuxCNC's modules are built for; LinuxCNC ends with it.
"""

import json
import os
import socket
import subprocess
import sys
import time
from importlib import import_module

sys.path.append('/usr/lib/python3/dist-packages')
linuxcnc = import_module('linuxcnc')

TIMEOUT = 10.0
ACCEPT_TIMEOUT = 60.0


class Operator:
    """Person at the machine: switches it on, homes it and runs programs."""

    def __init__(self):
        self._command, self._state = linuxcnc.command(), linuxcnc.stat()

    def _until(self, condition, what):
        end = time.monotonic() + TIMEOUT
        while True:
            self._state.poll()
            if condition(self._state):
                return
            if time.monotonic() > end:
                raise RuntimeError(f'not within {TIMEOUT} s: {what}')
            time.sleep(0.005)

    def on(self):
        """Switch the machine on."""
        self._command.state(linuxcnc.STATE_ESTOP_RESET)
        self._command.wait_complete()
        self._command.state(linuxcnc.STATE_ON)
        self._until(lambda s: s.task_state == linuxcnc.STATE_ON, 'on')

    def off(self):
        """Switch it off."""
        self._command.state(linuxcnc.STATE_OFF)
        self._until(lambda s: s.task_state != linuxcnc.STATE_ON, 'off')

    def estop(self):
        """Press the emergency stop."""
        self._command.state(linuxcnc.STATE_ESTOP)
        self._until(lambda s: s.task_state == linuxcnc.STATE_ESTOP, 'emergency stop')

    def home(self):
        """Home all joints."""
        self._mode(linuxcnc.MODE_MANUAL)
        self._command.teleop_enable(0)
        self._command.wait_complete()
        self._command.home(-1)
        self._until(lambda s: all(s.homed[: s.joints]), 'homed')
        self.teleop()

    def teleop(self):
        """Leave joint mode."""
        self._command.teleop_enable(1)
        self._until(lambda s: s.motion_mode == linuxcnc.TRAJ_MODE_TELEOP, 'teleop')

    def joints(self):
        """Go to joint mode."""
        self._mode(linuxcnc.MODE_MANUAL)
        self._command.teleop_enable(0)
        self._until(lambda s: s.motion_mode == linuxcnc.TRAJ_MODE_FREE, 'joint mode')

    def jog(self, joint, distance, speed):
        """Move a joint in joint mode by a distance [units] at a speed [units/s]."""
        self._command.jog(linuxcnc.JOG_INCREMENT, True, joint, speed, distance)
        self._command.wait_complete()
        self._until(lambda s: s.inpos and abs(s.joint[joint]['velocity']) == 0.0, 'jogged')

    def unhome(self):
        """Forget the home of Z."""
        self.joints()
        self._command.unhome(2)
        self._until(lambda s: not s.homed[2], 'unhomed')

    def line(self, code):
        """Execute one line and wait for its end."""
        self._mode(linuxcnc.MODE_MDI)
        self._command.mdi(code)
        self._until(lambda s: s.interp_state == linuxcnc.INTERP_IDLE and s.inpos, code)

    def run(self, path, line=0):
        """Start a part program, at its beginning or at a line."""
        self._mode(linuxcnc.MODE_AUTO)
        self._command.program_open(path)
        self._command.wait_complete()
        self._command.auto(linuxcnc.AUTO_RUN, line)
        self._until(lambda s: s.interp_state != linuxcnc.INTERP_IDLE, 'program runs')

    def pause(self):
        """Pause the program that runs."""
        self._command.auto(linuxcnc.AUTO_PAUSE)

    def resume(self):
        """Go on with it."""
        self._command.auto(linuxcnc.AUTO_RESUME)

    def abort(self):
        """End the program that runs."""
        self._command.abort()
        self._until(lambda s: s.interp_state == linuxcnc.INTERP_IDLE, 'aborted')

    def override(self, share):
        """Set the feed override [-]."""
        self._command.feedrate(share)

    def version(self):
        """Tell which LinuxCNC it is."""
        return linuxcnc.version

    def state(self):
        """Tell where the machine is."""
        self._state.poll()
        return {
            'running': self._state.interp_state != linuxcnc.INTERP_IDLE,
            'position': self._state.position[:3],
            'line': self._state.motion_line,
        }

    def halcmd(self, *words):
        """Do something to the HAL."""
        done = subprocess.run(
            ['halcmd', *words], capture_output=True, text=True, check=False, timeout=TIMEOUT
        )
        return done.stdout.strip() + done.stderr.strip()

    def _mode(self, mode):
        self._command.mode(mode)
        self._until(lambda s: s.task_mode == mode, f'mode {mode}')


def main():
    """Obey one connection, line by line."""
    operator = Operator()
    listening = socket.socket(socket.AF_UNIX)
    path = os.environ['FUZZYCNC_OPERATOR']
    before = os.umask(0o177)  # whoever may write to it moves the machine
    listening.bind(path)
    os.umask(before)
    listening.listen()
    listening.settimeout(ACCEPT_TIMEOUT)  # whoever started LinuxCNC may have been killed
    connection, _ = listening.accept()
    lines = connection.makefile('rw')
    for line in lines:
        name, *arguments = json.loads(line)
        try:
            answer = {'ok': getattr(operator, name)(*arguments)}
        except Exception as error:
            answer = {'error': f'{type(error).__name__}: {error}'}
        lines.write(json.dumps(answer) + '\n')
        lines.flush()


if __name__ == '__main__':
    main()

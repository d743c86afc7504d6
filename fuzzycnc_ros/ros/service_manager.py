# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Service notifications to systemd, or to another parent that asks for them: sd_notify(3).

Nothing is told where nobody asked by `NOTIFY_SOCKET`.  No ROS is imported.
"""

import math
import os
import socket
import time
from collections.abc import MutableMapping

SOCKET, WATCHDOG = 'NOTIFY_SOCKET', 'WATCHDOG_USEC'
"""Environment variables: where to tell, and within which wall time [us] to say that one lives."""
_PULSES = 3.0
"""Signs of life in the time that the manager waits for one."""


class ServiceManager:
    """Service manager that has started this process.

    Parameters
    ----------
    environment : mutable mapping, optional
        Environment of this process.  What the manager wrote is taken out of it: processes that
        this one starts are not asked.
    """

    def __init__(self, environment: MutableMapping[str, str] = os.environ) -> None:
        place = environment.pop(SOCKET, '')
        period = environment.pop(WATCHDOG, '')
        environment.pop('WATCHDOG_PID', None)
        self._place = f'\0{place[1:]}' if place.startswith('@') else place
        self.present = place.startswith(('/', '@'))
        """True if there is one."""
        waited_for = period.isdecimal()
        self._period = 1e-6 * int(period) / _PULSES if waited_for else math.inf
        self._due_at = 0.0 if waited_for else math.inf
        self._ready = False
        self._status = ''

    def ready(self) -> None:
        """Say that the service is up, until that has been taken."""
        if self.present and not self._ready:
            self._ready = self._tell('READY=1')

    def pulse(self) -> None:
        """Say that the service lives, as often as that is waited for."""
        if not self.present:
            return
        now = time.monotonic()
        if now >= self._due_at and self._tell('WATCHDOG=1'):
            self._due_at = now + self._period

    def status(self, text: str) -> None:
        """Say in a line how the service is, where that is something new."""
        line = ' '.join(text.split())
        if self.present and line != self._status and self._tell(f'STATUS={line}'):
            self._status = line

    def stopping(self) -> None:
        """Say that the service ends."""
        if self.present:
            self._tell('STOPPING=1')

    def _tell(self, text: str) -> bool:
        """Return whether the manager has taken a message; it is never waited for."""
        with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as channel:
            channel.setblocking(False)
            try:
                channel.sendto(text.encode(), self._place)
            except OSError:  # it is busy, or gone
                return False
        return True

# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""A service manager that tests stand for: the socket that services tell how they are."""

import socket
import uuid
from pathlib import Path


class Manager:
    """Hears what a service tells.

    Parameters
    ----------
    folder : Path, optional
        Where its socket lies; without it the socket has a name only (Linux).
    """

    def __init__(self, folder: Path | None) -> None:
        name = f'fuzzycnc-{uuid.uuid4().hex[:12]}'
        self._place = f'@{name}' if folder is None else str(folder / name)
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self._socket.bind(f'\0{name}' if folder is None else self._place)
        self._socket.setblocking(False)
        self.all: list[str] = []
        """Everything heard so far."""

    def __enter__(self) -> 'Manager':
        """Return the manager."""
        return self

    def __exit__(self, *_: object) -> None:
        """Be gone."""
        self._socket.close()

    def environment(self, watchdog: float | None = None) -> dict[str, str]:
        """Return what a service is told, with the time [s] that signs of life are waited for."""
        found = {'NOTIFY_SOCKET': self._place}
        if watchdog is not None:
            found |= {'WATCHDOG_USEC': f'{1e6 * watchdog:.0f}', 'WATCHDOG_PID': '1'}
        return found

    def heard(self) -> list[str]:
        """Return what has been told since this was asked last."""
        new = []
        while True:
            try:
                new.append(self._socket.recv(4096).decode())
            except BlockingIOError:
                self.all += new
                return new

    def since(self, text: str) -> list[str]:
        """Return what has been told after something was told first."""
        self.heard()
        return self.all[self.all.index(text) :]

    def has_heard(self, text: str) -> bool:
        """Whether something has ever been told."""
        self.heard()
        return text in self.all

# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Debian's mosquitto as a broker that comes and goes, and somebody who listens to it."""

import shutil
import socket
import subprocess
import time
from pathlib import Path
from typing import Any

from equipment.certificates import LOCAL, certificate
from paho.mqtt.client import Client
from paho.mqtt.enums import CallbackAPIVersion
from processes import free_port

MOSQUITTO = shutil.which('mosquitto', path='/usr/sbin:/usr/bin:/usr/local/sbin:/usr/local/bin')
USER, PASSWORD = 'mill-publisher', 'Kq7-very-secret-9vW'
TIMEOUT = 60.0


class MqttBroker:
    """A broker at a port of its own.

    Parameters
    ----------
    folder : Path
        Where its files go.
    tls : bool
        Whether it speaks TLS, with the certificate `broker.pem` in the folder.
    password : str
        Password of the one user; empty lets everybody in.
    """

    def __init__(self, folder: Path, *, tls: bool = False, password: str = '') -> None:
        self._folder, self._tls = folder, tls
        self.port = free_port()
        lines = [f'listener {self.port} {LOCAL}', 'user root', 'max_queued_messages 0']
        if tls:
            certificate(folder)
            lines += [f'certfile {folder}/broker.pem', f'keyfile {folder}/broker-key.pem']
        lines.append(f'allow_anonymous {str(not password).lower()}')
        if password:
            lines.append(f'password_file {folder}/passwords')
            self.admit(password)
        (folder / 'mosquitto.conf').write_text('\n'.join(lines) + '\n')
        self._process: subprocess.Popen[bytes] | None = None

    def admit(self, password: str) -> None:
        """Set the password of the one user."""
        command = ['mosquitto_passwd', '-b', '-c', str(self._folder / 'passwords')]
        subprocess.run([*command, USER, password], check=True, capture_output=True)

    def start(self) -> None:
        """Start it; return when it answers."""
        assert MOSQUITTO is not None
        with (self._folder / 'mosquitto.log').open('ab') as log:
            self._process = subprocess.Popen(
                [MOSQUITTO, '-c', str(self._folder / 'mosquitto.conf')], stdout=log, stderr=log
            )
        wait(self._answers, 'the broker to answer')

    def stop(self) -> None:
        """End it as a power cut does."""
        if self._process is not None:
            self._process.kill()
            self._process.wait(TIMEOUT)
            self._process = None

    def send(self, number: int) -> None:
        """Send it a signal."""
        assert self._process is not None
        self._process.send_signal(number)

    def listen(self, topic: str = '#') -> list[tuple[str, str]]:
        """Return what is published from now on, as it comes."""
        heard: list[tuple[str, str]] = []
        subscribed: list[Any] = []
        client = Client(CallbackAPIVersion.VERSION2)
        if self._tls:
            client.tls_set(str(self._folder / 'broker.pem'))
        client.username_pw_set(USER, PASSWORD)
        client.reconnect_delay_set(1, 1)
        client.on_message = lambda c, d, message: heard.append(
            (message.topic, message.payload.decode())
        )
        client.on_connect = lambda c, *rest: c.subscribe(topic, 1)
        client.on_subscribe = lambda *rest: subscribed.append(rest)
        client.connect(LOCAL, self.port)
        client.loop_start()
        self._listeners = [*getattr(self, '_listeners', []), client]
        wait(lambda: subscribed, 'the subscription')
        return heard

    def close(self) -> None:
        """End it and all who listen."""
        for client in getattr(self, '_listeners', []):
            client.disconnect()
            client.loop_stop()
        self.stop()

    def _answers(self) -> bool:
        try:
            socket.create_connection((LOCAL, self.port), 1.0).close()
        except OSError:
            return False
        return True


def wait(wanted: Any, what: str) -> Any:
    """Wait for a condition; return what it gave."""
    deadline = time.monotonic() + TIMEOUT
    while time.monotonic() < deadline:
        found = wanted()
        if found:
            return found
        time.sleep(0.02)
    raise AssertionError(f'waited in vain for {what}')


def credentials(folder: Path, password: str = PASSWORD) -> Path:
    """Write the credentials of the one user; return the file."""
    path = folder / 'broker-user.yaml'
    path.write_text(f'username: {USER}\npassword: {password}\n')
    path.chmod(0o600)
    return path

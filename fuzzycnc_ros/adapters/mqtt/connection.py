# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""A connection to a broker that is kept up, with what waits for it."""

import sys
from collections import deque
from contextlib import suppress
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import Any

from fuzzycnc_ros.adapters.mqtt.broker_file import Broker, ReportBroker
from fuzzycnc_ros.adapters.opcua.file_fields import read_credentials
from fuzzycnc_ros.bags.secret_file import check_secret
from fuzzycnc_ros.ros.parameters import ParameterError
from fuzzycnc_ros.runtime.component import Health, Level

BACK_OFF_MAX = 2
"""Longest pause between two attempts to connect [s]; the first one is half of it."""
CONNECT_TIMEOUT = 2.0
"""Longest wait for the broker's port to answer [s]."""
UNCONFIRMED_MAX = 20
"""Reports that are on their way without the broker's word; the next ones wait here."""
AT_LEAST_ONCE = 1
ONLINE, OFFLINE = '{"online": true}', '{"online": false}'
TEXT_MAX = 300
"""Longest text that is passed on: a part of it may come from the broker."""


class BrokerConnection:
    """Publish reports of a machine; keep them while the broker is away.

    Callbacks of the library run in a thread of its own and only leave word; `turn`, which is to
    be called often, does the rest.

    Parameters
    ----------
    broker : ReportBroker
        Where it is.
    machine : str
        Name of the machine; its topics are TOPIC/MACHINE/state and TOPIC/MACHINE/status.

    Raises
    ------
    ParameterError
        If the library is missing, or a certificate is of no use.
    """

    def __init__(self, broker: ReportBroker, machine: str) -> None:
        self._broker = broker
        base = f'{broker.topic}/{machine}'
        self._state, self._status = f'{base}/state', f'{base}/status'
        self._waiting: deque[str] = deque(maxlen=broker.buffered)
        self._confirmed: SimpleQueue[int] = SimpleQueue()
        self._unconfirmed: set[int] = set()
        self._connected = self._told = False
        self._trouble = 'not connected yet'
        self._refused = False
        self.sent = self.dropped = 0
        self._client = client = new_client(broker)
        client.reconnect_delay_set(BACK_OFF_MAX // 2, BACK_OFF_MAX)
        client.will_set(self._status, OFFLINE, AT_LEAST_ONCE, retain=True)
        client.on_connect, client.on_connect_fail = self._on_connect, self._on_connect_fail
        client.on_disconnect, client.on_publish = self._on_disconnect, self._on_publish
        self._enter()
        client.connect_async(broker.host, broker.port, broker.keep_alive)
        client.loop_start()

    def publish(self, report: str) -> None:
        """Take a report; while the broker is away the oldest ones make room."""
        self.dropped += len(self._waiting) == self._broker.buffered
        self._waiting.append(report)
        self.turn()

    def turn(self) -> None:
        """Send what waits, as far as the broker has confirmed what went before."""
        while True:
            try:
                number = self._confirmed.get_nowait()
            except Empty:
                break
            if number in self._unconfirmed:  # a status is none of the reports
                self._unconfirmed.discard(number)
                self.sent += 1
        if self._refused:
            self._refused = False
            self._enter()  # a corrected file is taken without a restart
        if not self._connected:
            return
        if not self._told:
            self._told = True
            self._client.publish(self._status, ONLINE, AT_LEAST_ONCE, retain=True)
        while self._waiting and len(self._unconfirmed) < UNCONFIRMED_MAX:
            # The library keeps it and sends it anew after a reconnection.
            made = self._client.publish(self._state, self._waiting.popleft(), AT_LEAST_ONCE)
            self._unconfirmed.add(made.mid)

    def health(self) -> Health:
        """Say whether the broker is there, and what waits for it."""
        values = {
            'sent': str(self.sent),
            'waiting': str(len(self._waiting) + len(self._unconfirmed)),
            'dropped': str(self.dropped),
        }
        where = self._broker.address
        if not self._connected:
            text = f'{where}: {self._trouble}; {values["waiting"]} reports wait'
            text += f', {self.dropped} are lost' if self.dropped else ''
            return Health('broker', Level.ERROR, text[:TEXT_MAX], values)
        return Health('broker', Level.OK, f'{where}: connected', values)

    def close(self) -> None:
        """Say that the machine is no longer watched, and end the connection."""
        if self._connected:
            self.turn()
            last = self._client.publish(self._status, OFFLINE, AT_LEAST_ONCE, retain=True)
            # The broker may go at this moment.
            with suppress(RuntimeError):
                last.wait_for_publish(CONNECT_TIMEOUT)
        self._client.disconnect()
        self._client.loop_stop()

    def _enter(self) -> None:
        """Take name and password out of their file."""
        if self._broker.credentials is None:
            return
        try:
            self._client.username_pw_set(*read_credentials(self._broker.credentials))
        except ParameterError as error:
            self._trouble = str(error)

    def _on_connect(self, client: Any, data: Any, flags: Any, reason: Any, more: Any) -> None:
        if reason.is_failure:
            self._trouble = f'the broker refuses the connection ({reason}); compare credentials'
            self._refused = True
            return
        # Before the next turn, which may come only after a loss and a return.
        self._told, self._connected = False, True

    def _on_connect_fail(self, client: Any, data: Any) -> None:
        # Called where the failure is handled; the library does not say it otherwise.
        error = sys.exc_info()[1]
        self._trouble = f'cannot connect ({error}); is it on, are host, port and tls right?'

    def _on_disconnect(self, client: Any, data: Any, flags: Any, reason: Any, more: Any) -> None:
        if self._connected:
            self._trouble = f'connection lost ({reason})'
        self._connected = False

    def _on_publish(self, client: Any, data: Any, mid: int, reason: Any, more: Any) -> None:
        self._confirmed.put(mid)


def new_client(broker: Broker) -> Any:
    """Return a client of the library, its way secured, that has not entered yet.

    Raises
    ------
    ParameterError
        If the library is missing, or a certificate is of no use.
    """
    try:
        from paho.mqtt.client import Client
        from paho.mqtt.enums import CallbackAPIVersion
    except ImportError as error:
        raise ParameterError(
            f"MQTT needs paho-mqtt ({error}); run pip install 'fuzzycnc_ros[mqtt]'"
        ) from error
    client = Client(CallbackAPIVersion.VERSION2)
    client.connect_timeout = CONNECT_TIMEOUT
    if broker.tls is not None:
        try:
            if broker.tls.private_key is not None:
                check_secret(broker.tls.private_key, 'private_key')
            client.tls_set(
                ca_certs=str(broker.tls.ca),
                certfile=_text(broker.tls.certificate),
                keyfile=_text(broker.tls.private_key),
            )
        except (OSError, ValueError) as error:  # those of ssl are among them
            raise ParameterError(f'tls: a certificate is of no use ({error})') from error
    return client


def _text(path: Path | None) -> str | None:
    return None if path is None else str(path)

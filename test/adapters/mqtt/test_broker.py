# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Reports to a real broker: its file, security, and what happens while it is away."""

import gc
import re
import signal
from types import SimpleNamespace

import pytest

pytest.importorskip('rclpy')
pytest.importorskip('paho')

from equipment.certificates import LOCAL, certificate
from equipment.mqtt_broker import (
    MOSQUITTO,
    PASSWORD,
    credentials,
    wait,
)

from fuzzycnc_ros.adapters.mqtt import connection
from fuzzycnc_ros.adapters.mqtt.broker_file import read_broker
from fuzzycnc_ros.adapters.mqtt.connection import OFFLINE, ONLINE, BrokerConnection
from fuzzycnc_ros.ros.parameters import ParameterError
from fuzzycnc_ros.runtime.component import Level

pytestmark = pytest.mark.ros
needs_broker = pytest.mark.skipif(
    MOSQUITTO is None, reason='no mosquitto here: apt-get install mosquitto'
)
BACK_MAX = 5.0
"""Longest pause and wait between the return of a broker and the connection to it [s]."""
STATE, STATUS = 'fuzzycnc/mill/state', 'fuzzycnc/mill/status'


@pytest.fixture
def connect(tmp_path):
    """Connect to a broker by its file."""
    made = []

    def to(broker, more=''):
        path = tmp_path / 'broker.yaml'
        path.write_text(f'host: {LOCAL}\nport: {broker.port}\n{more}')
        made.append(BrokerConnection(read_broker(path), 'mill'))
        return made[-1]

    yield to
    for link in made:
        link.close()


def until(link, level, text=''):
    """Wait until a connection is well or not; return its health."""

    def told():
        link.turn()
        health = link.health()
        return health if health.level is level and text in health.message else None

    return wait(told, f'{level.name}: {text}')


def states(heard):
    return [text for topic, text in heard if topic == STATE]


@needs_broker
def test_reports_wait_for_a_broker_that_is_away_and_the_newest_are_kept(serve, connect):
    broker = serve()
    heard = broker.listen()
    link = connect(broker, 'buffered: 30\n')
    until(link, Level.OK)
    link.publish('0')
    wait(lambda: states(heard) == ['0'], 'the first report')
    assert (STATUS, ONLINE) in heard
    wait(lambda: link.turn() or link.health().values['waiting'] == '0', 'its confirmation')
    broker.stop()
    until(link, Level.ERROR)
    for number in range(1, 51):
        link.publish(str(number))
    health = link.health()
    assert health.values['waiting'] == '30'
    assert health.values['dropped'] == '20'
    assert '30 reports wait, 20 are lost' in health.message
    broker.start()
    heard = broker.listen()
    until(link, Level.OK)
    wanted = [str(number) for number in range(21, 51)]
    # Those who listen may come back after the reports that went first: what they hear is the end.
    wait(lambda: link.turn() or link.health().values['waiting'] == '0', 'all confirmations')
    assert link.sent == 31
    link.publish('last')
    wait(lambda: states(heard)[-1:] == ['last'], 'the last report')
    got = states(heard)[:-1]
    assert got == wanted[len(wanted) - len(got) :]


def test_a_broker_is_back_in_time():
    """Figures, not the clock: what stands between the return of a broker and the connection."""
    assert connection.BACK_OFF_MAX + connection.CONNECT_TIMEOUT < BACK_MAX


@needs_broker
def test_a_broker_that_hangs_is_noticed_and_goes_on(serve, connect):
    broker = serve()
    link = connect(broker, 'keep_alive: 1\n')
    until(link, Level.OK)
    for _ in range(2):
        broker.send(signal.SIGSTOP)
        link.publish('meanwhile')
        link.turn()  # it is sent, and nobody has confirmed it
        assert link.health().values['waiting'] == '1'
        until(link, Level.ERROR, 'connection lost')
        broker.send(signal.SIGCONT)
        until(link, Level.OK)
        wait(lambda: link.turn() or link.health().values['waiting'] == '0', 'the confirmation')
    assert link.sent == 2


@needs_broker
def test_the_broker_tells_when_a_machine_is_no_longer_watched(serve, connect):
    broker = serve()
    link = connect(broker)
    until(link, Level.OK)
    heard = broker.listen(STATUS)
    wait(lambda: (STATUS, ONLINE) in heard, 'the retained status')
    # Without a goodbye, as when the computer fails
    link._client._sock.close()
    wait(lambda: (STATUS, OFFLINE) in heard, 'the last will')
    # A node that was busy takes its turn only when all is well again.
    wait(lambda: link._connected and not link._told, 'the new connection')
    link.turn()
    wait(lambda: heard[-1] == (STATUS, ONLINE), 'the status of the new connection')
    link.close()
    wait(lambda: heard[-1] == (STATUS, OFFLINE), 'the status at the end')


def test_a_broker_that_goes_at_the_end_is_no_failure(connect):
    def gone(timeout):
        raise RuntimeError('Message publish failed: The client is not currently connected.')

    link = connect(SimpleNamespace(port=1))
    link._connected = True
    link._client.publish = lambda *_, **__: SimpleNamespace(mid=1, wait_for_publish=gone)
    link.close()
    assert link._client._thread is None


@needs_broker
def test_tls_and_credentials(serve, connect, tmp_path):
    broker = serve(tls=True, password=PASSWORD)
    credentials(tmp_path, 'wrong')
    link = connect(broker, 'tls: {ca: broker.pem}\ncredentials: broker-user.yaml\n')
    health = until(link, Level.ERROR, 'the broker refuses the connection (Not authorized)')
    assert 'wrong' not in health.message
    # The right password is taken without a restart.
    credentials(tmp_path)
    until(link, Level.OK)
    heard = broker.listen()
    link.publish('hello')
    wait(lambda: states(heard) == ['hello'], 'the report')


# The library leaves the socket of a failed handshake to the garbage collector.
@pytest.mark.filterwarnings('ignore::pytest.PytestUnraisableExceptionWarning')
@needs_broker
def test_nothing_is_sent_to_a_broker_that_nobody_vouches_for(serve, connect, tmp_path):
    broker = serve(tls=True, password=PASSWORD)
    certificate(tmp_path, 'other')
    credentials(tmp_path)
    link = connect(broker, 'tls: {ca: other.pem}\ncredentials: broker-user.yaml\n')
    until(link, Level.ERROR, 'CERTIFICATE_VERIFY_FAILED')
    link.close()
    gc.collect()


FILE = 'host: broker\nport: 1884\nbuffered: 10\n'


@pytest.mark.parametrize(
    ('old', 'new', 'line', 'text'),
    [
        ('host: broker\n', '', 1, "expected the field 'host'"),
        ('1884', '70000', 2, 'port: expected a whole number from 0 to 65535'),
        ('buffered: 10', 'buffered: 0', 3, 'buffered: expected a whole number from 1'),
        ('buffered', 'bufered', 3, "unknown field 'bufered'; did you mean buffered?"),
        ('buffered: 10', 'topic: a/#', 3, "topic: expected words between slashes but found 'a/#'"),
        ('buffered: 10', 'tls: {ca: none.pem}', 3, 'expected a file but nothing is at'),
        ('buffered: 10', 'tls: {ca: ca.pem, certificate: ca.pem}', 3, 'private_key together'),
        ('buffered: 10', 'credentials: user.yaml', 3, 'or say allow_plain_password: true'),
        ('buffered: 10', 'password: secret', 3, "unknown field 'password'"),
    ],
)
def test_wrong_files_are_refused(tmp_path, old, new, line, text):
    (tmp_path / 'ca.pem').write_text('')
    (tmp_path / 'user.yaml').write_text('')
    path = tmp_path / 'broker.yaml'
    path.write_text(FILE.replace(old, new, 1))
    with pytest.raises(ParameterError, match=re.escape(text)) as caught:
        read_broker(path)
    assert f'broker.yaml: line {line}: ' in str(caught.value)


def test_credentials_that_others_can_read_are_refused(tmp_path):
    credentials(tmp_path).chmod(0o644)
    path = tmp_path / 'broker.yaml'
    path.write_text(f'{FILE}credentials: broker-user.yaml\nallow_plain_password: true\n')
    with pytest.raises(ParameterError, match='found mode 644; run chmod 600'):
        read_broker(path)


def test_a_certificate_that_is_none_is_refused(tmp_path):
    (tmp_path / 'ca.pem').write_text('')
    path = tmp_path / 'broker.yaml'
    path.write_text(f'{FILE}tls: {{ca: ca.pem}}\n')
    with pytest.raises(ParameterError, match='tls: a certificate is of no use'):
        BrokerConnection(read_broker(path), 'mill')

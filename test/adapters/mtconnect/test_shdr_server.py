# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The adapter for agents: several clients, slow and rude ones, an agent of others."""

import socket
import time

import pytest

pytest.importorskip('rclpy')

from equipment.field_servers import LOCAL
from equipment.mtconnect_agent import InstituteAgent
from processes import free_port

from fuzzycnc_ros.adapters.mtconnect import shdr_server
from fuzzycnc_ros.adapters.mtconnect.shdr_server import BEHIND_MAX, CLIENTS_MAX, ShdrServer
from fuzzycnc_ros.adapters.readings.device_file import read_devices
from fuzzycnc_ros.adapters.readings.polling import Poller
from fuzzycnc_ros.components.report.shdr import Shdr
from fuzzycnc_ros.ros.parameters import ParameterError

pytestmark = pytest.mark.ros

TIMEOUT = 60.0


@pytest.fixture
def server():
    made = ShdrServer(LOCAL, 0)
    yield made
    made.close()
    assert not made._loop.alive


@pytest.fixture
def client(server):
    made = []

    def begin():
        made.append(socket.create_connection((LOCAL, server.port), TIMEOUT))
        return made[-1]

    yield begin
    for item in made:
        item.close()


def until(condition, what):
    deadline = time.monotonic() + TIMEOUT
    while not condition():
        assert time.monotonic() < deadline, what
        time.sleep(0.005)


def clients(server, count):
    until(lambda: server.health().values['clients'] == str(count), f'{count} clients')


def test_all_clients_are_told_and_a_new_one_everything(server, client):
    server.publish(['a|x|1'], ['a|x|1|y|2'])
    one = client().makefile('rb')
    assert one.readline() == b'a|x|1|y|2\n'
    server.publish(['b|x|2'], ['b|x|2|y|2'])
    assert one.readline() == b'b|x|2\n'
    two = client().makefile('rb')
    assert two.readline() == b'b|x|2|y|2\n'
    server.publish(['c|x|3', 'c|y|4'], [])
    for stream in (one, two):
        assert [stream.readline(), stream.readline()] == [b'c|x|3\n', b'c|y|4\n']
    assert server.health().message == f'SHDR {LOCAL}:{server.port}: 2 agents'


def test_a_ping_is_answered_and_nothing_else_is(server, client):
    connection = client()
    connection.sendall(b'* device: other\n|x|9\nhello\n* PING\r\n')
    connection.shutdown(socket.SHUT_WR)
    assert connection.makefile('rb').read() == b'* PONG 10000\n'


def test_a_client_that_pings_no_more_is_dropped(server, client, monkeypatch):
    monkeypatch.setattr(shdr_server, 'HEARTBEAT', 0.05)
    silent, connection = client(), client()
    connection.sendall(b'* PING\n')
    assert connection.makefile('rb').readline() == b'* PONG 50\n'
    assert connection.recv(1) == b''
    clients(server, 1)
    silent.sendall(b'* PING\n')
    assert silent.makefile('rb').readline() == b'* PONG 50\n'


def test_slow_rude_and_too_many_clients_cost_the_others_nothing(server, client):
    well = client()
    slow = client()
    clients(server, 2)
    line = 'x' * 65536
    well.setblocking(True)

    def push():
        server.publish([line], [])
        rest = len(line) + 1
        while rest:
            rest -= len(well.recv(rest))
        return server.dropped

    until(push, 'the slow one to be dropped')
    clients(server, 1)
    assert server.dropped == 1
    slow.close()
    rude = client()
    rude.sendall(b'y' * 5000)
    assert rude.recv(1) == b''
    clients(server, 1)
    for _ in range(CLIENTS_MAX - 1):
        client()
    clients(server, CLIENTS_MAX)
    assert client().recv(1) == b''
    assert BEHIND_MAX > len(line)


def test_a_port_that_is_taken_is_refused(server):
    with pytest.raises(ParameterError, match='expected a free port on 127') as refusal:
        ShdrServer(LOCAL, server.port)
    assert 'is another adapter running?' in str(refusal.value)


@pytest.mark.qualify
def test_the_agent_of_the_institute_reads_the_adapter_and_is_read(server, tmp_path):
    """From a report through SHDR and the C++ agent back to readings; the agent is killed once."""
    shdr = Shdr('mill', 150.0)

    def tell(front, alarms=()):
        temperatures = {
            'age_s': 0.0,
            'temperature_degC': {'front bearing': front, 'rear': None},
            'status': {'front bearing': 'ok', 'rear': 'missing'},
        }
        document = {
            'time': time.strftime('%Y-%m-%dT%H:%M:%S.000+00:00', time.gmtime()),
            'offsets': {'age_s': 0.0, 'offset_um': {'Z': -12.5}, 'status': 'following'},
            'errors': None,
            'temperatures': temperatures,
            'spindle': {'age_s': 0.0, 'speed_rpm': 600.0, 'status': 'ok'},
            'alarms': list(alarms),
        }
        server.publish(shdr.take(document), shdr.everything())

    tell(31.25)
    devices = tmp_path / 'Devices.xml'
    devices.write_text(shdr.devices())
    agent = InstituteAgent(tmp_path, devices, server.port, free_port())
    path = tmp_path / 'devices.yaml'
    path.write_text(
        'devices: [{name: m, protocol: mtconnect, period: 0.1, timeout: 1, '
        f'url: "http://{LOCAL}:{agent.port}/mill", spindle_speed: {{item: spindle_speed}}, '
        'sensors: {T1: temperature_front_bearing, T2: temperature_rear, T3: offset_Z}}]'
    )
    agent.start()
    poller = Poller(read_devices(path), time.monotonic_ns)

    def wait(wanted):
        deadline = time.monotonic() + TIMEOUT
        while time.monotonic() < deadline:
            polled = poller.results.get(timeout=TIMEOUT)
            if wanted(polled):
                return polled
        raise AssertionError(f'the last result was {polled}')

    def reads(front):
        return lambda polled: polled.readings is not None and polled.readings[0] == front

    try:
        readings = wait(reads(31.25)).readings
        assert readings[1] == 'data item temperature_rear: the agent reports UNAVAILABLE'
        assert 'expected one of CELSIUS' in readings[2]
        assert 'found MILLIMETER' in readings[2]
        assert readings[3] == pytest.approx(62.8318530718)
        tell(32.5)
        wait(reads(32.5))
        alarm = {'level': 'error', 'node': 'compensator', 'name': 'limit', 'text': 'at 50 um'}
        tell(32.5, [alarm])
        until(lambda: '>at 50 um</Fault>' in current(agent), 'the alarm')
        assert 'nativeCode="compensator.limit"' in current(agent)
        assert '>-0.0125</Displacement>' in current(agent)
        tell(32.5)
        until(lambda: '</Fault>' not in current(agent), 'the end of the alarm')
        # More than its buffer holds at once: observations are lost, the newest value is not.
        for step in range(200):
            tell(33.0 + step / 100.0)
        wait(reads(34.99))
        agent.stop()
        assert wait(lambda polled: polled.readings is None).trouble
        tell(20.5)
        agent.start()
        wait(reads(20.5))
    finally:
        poller.close()
        agent.stop()


def current(agent):
    """Return what an agent tells now."""
    from urllib.request import urlopen

    with urlopen(f'http://{LOCAL}:{agent.port}/current', timeout=TIMEOUT) as answer:
        return answer.read().decode()

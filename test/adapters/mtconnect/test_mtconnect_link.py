# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""MTConnect agents as devices: what is read, what is lost and comes back, hostile answers."""

import math
import random
import ssl
import time
from urllib.parse import parse_qs, unquote, urlsplit

import pytest

pytest.importorskip('rclpy')

from equipment.certificates import certificate
from equipment.field_servers import LOCAL, Field, HostileServer, Route
from equipment.mtconnect_agent import BOUNDARY, Agent, http
from equipment.polled import TIMEOUT, close, good, lost, wait

from fuzzycnc_ros.adapters.link import LinkError
from fuzzycnc_ros.adapters.mtconnect import link as mtconnect
from fuzzycnc_ros.adapters.mtconnect.documents import DataItem, Document, parse
from fuzzycnc_ros.adapters.mtconnect.link import FILTER_MAX, path_of
from fuzzycnc_ros.adapters.readings import polling
from fuzzycnc_ros.adapters.readings.device_file import read_devices
from fuzzycnc_ros.adapters.readings.device_source import DeviceHealth
from fuzzycnc_ros.adapters.readings.polling import TEXT_MAX, Poller
from fuzzycnc_ros.ros.parameters import ParameterError
from fuzzycnc_ros.runtime.component import Level

pytestmark = pytest.mark.ros

FILE = """
devices:
  - name: mill
    protocol: mtconnect
    url: {scheme}://{host}:{port}/mill
    period: 0.02
    timeout: {timeout:g}
    sensors: {sensors}
    positions: {axes}
    spindle_speed: {{item: Srpm, max: 6000}}
"""
SENSORS = '{T1: t1, T2: {item: rear, scale: 1, offset: 0.5}}'
START = {
    't1': '21.5',
    't2': '77',
    's1': '3000',
    'x1': '12',
    'm1': 'AUTOMATIC',
    'b1': '90',
    'l1': '3',
}


@pytest.fixture
def field():
    made = Field()
    yield made
    made.close()


@pytest.fixture
def agent(field):
    made = Agent()
    made.observations = list(START.items())
    return field.add(made)


@pytest.fixture
def poll(tmp_path, monkeypatch):
    """Poll an agent; a lost one is asked again at once, and may soon be one that `hurries`."""
    monkeypatch.setattr(polling, 'BACK_OFF_FIRST', 0.05)
    pollers = []

    def begin(
        server, sensors=SENSORS, *, axes='{}', more='', scheme='http', host=LOCAL, hurries=False
    ):
        if hurries:
            monkeypatch.setattr(mtconnect, 'HEARTBEAT', 0.2)
        path = tmp_path / 'devices.yaml'
        places = {'scheme': scheme, 'host': host, 'port': server.port}
        places['timeout'] = 0.3 if hurries else 30.0
        path.write_text(FILE.format(sensors=sensors, axes=axes, **places) + more)
        (device,) = read_devices(path)
        pollers.append(Poller([device], time.monotonic_ns))
        pollers[-1].device = device
        return pollers[-1]

    yield begin
    for poller in pollers:
        close(poller)


def reads(first):
    return lambda polled: good(polled) and polled.readings[0] == first


@pytest.mark.parametrize(
    ('kind', 'chunked'),
    [
        ('multipart/x-mixed-replace', False),
        ('multipart/x-mixed-replace', True),
        ('multipart/mixed', True),
    ],
)
def test_the_present_state_is_read_once_and_then_what_changes(field, agent, poll, kind, chunked):
    agent.kind, agent.chunked = kind, chunked
    poller = poll(agent)
    readings = wait(poller, good).readings
    assert list(readings) == pytest.approx([21.5, 25.5, 100.0 * math.pi])
    field.call(agent.observe(t1=22.0))
    field.call(agent.observe(t1=22.5, s1=0))
    readings = wait(poller, reads(22.5)).readings
    assert list(readings) == pytest.approx([22.5, 25.5, 0.0])
    kinds = [path.partition('?')[0] for path in agent.requests]
    assert kinds == ['/mill/probe', '/mill/current', '/mill/sample']
    assert '?from=8&count=1000&interval=20&heartbeat=1000&path=' in agent.requests[-1]


def paths(agent):
    """Return the XPath of each request."""
    return [parse_qs(urlsplit(request).query).get('path') for request in agent.requests]


def test_no_more_is_kept_than_is_read(tmp_path):
    """An agent that tells of ever new data items would fill the memory."""
    path = tmp_path / 'devices.yaml'
    places = {'scheme': 'http', 'host': LOCAL, 'port': 1, 'timeout': 1.0}
    path.write_text(FILE.format(sensors=SENSORS, axes='{}', **places))
    (device,) = read_devices(path)
    link = mtconnect.MtconnectLink(device)
    link._found = [DataItem(channel.item, '', 'CELSIUS') for channel in device.channels]
    known = device.channels[0].item
    for number in range(100):
        told = {f'other{number}': '1', known: str(number)}
        link._take(Document('MTConnectStreams', '1', '', 1, 1, 2, (), told, {}))
    assert link._values == {known: '99'}


def test_no_more_is_sent_than_is_read(agent, poll):
    wait(poll(agent, axes='{X: Xact}'), lambda _: '/sample' in agent.requests[-1])
    chosen = ['//DataItem[@id="s1" or @id="t1" or @id="t2" or @id="x1"]']
    assert paths(agent) == [None, chosen, chosen]


@pytest.mark.parametrize('answer', ['refuses', 'empties'])
def test_an_agent_that_makes_nothing_of_a_path_is_asked_for_everything(field, agent, poll, answer):
    agent.paths = answer
    poller = poll(agent)
    wait(poller, reads(21.5))
    field.call(agent.observe(t1=22.0))
    wait(poller, reads(22.0))
    assert [path is None for path in paths(agent)] == [True, False, True, True]


def test_a_path_that_an_agent_might_not_take_is_not_sent():
    few, many = ({f'Mill-1.T{k:03d}' for k in range(count)} for count in (80, 200))
    assert unquote(path_of(few)).startswith('//DataItem[@id="Mill-1.T000" or @id="Mill-1.T001" or')
    assert len(path_of(few)) < FILTER_MAX
    assert path_of(many) == path_of(set()) == ''
    for name in ('a/b', 'a|b', 'a"b', "a'b", 'a&b', 'T\u00e4'):
        assert path_of({name, 't1'}) == ''


def test_positions_are_in_metres_and_radians(field, agent, poll):
    poller = poll(agent, '{T1: t1}', axes='{X: Xact, B: b1, C: l1, D: m1, E: x9}')
    readings = wait(poller, good).readings
    assert list(readings[1:3]) == pytest.approx([0.012, math.pi / 2.0])
    units = 'MILLIMETER, INCH, METER, DEGREE, RADIAN'
    assert readings[3] == f'data item l1: expected one of {units} but found PERCENT'
    assert readings[4] == "data item m1: expected a number but found 'AUTOMATIC'"
    assert readings[5].endswith('none of this id or name; of this kind it has x1, b1')
    field.call(agent.observe(m1=3, x1='UNAVAILABLE', b1=-45))
    readings = wait(poller, lambda polled: isinstance(polled.readings[1], str)).readings
    assert readings[1] == 'data item Xact: the agent reports UNAVAILABLE'
    assert readings[2] == pytest.approx(-math.pi / 4.0)
    assert readings[4] == f'data item m1: expected one of {units} but found no unit'
    field.call(agent.lose(5, x1=20.0))
    polled = wait(poller, lambda polled: polled.readings[1] == pytest.approx(0.02))
    assert polled.facts['sequence_gaps'] == '1'
    health = DeviceHealth(poller.device, interval=60.0)
    health.note(polled)
    assert health.health().values['axis E'] == polled.readings[5]


@pytest.fixture
def secured(field, tmp_path):
    """An agent that speaks TLS; its certificate is `agent.pem`."""
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.load_cert_chain(certificate(tmp_path, 'agent'), tmp_path / 'agent-key.pem')
    made = Agent(context)
    made.observations = list(START.items())
    return field.add(made)


TRUSTED = '    ca_file: agent.pem\n'


def test_an_agent_is_read_over_https(field, secured, poll):
    poller = poll(secured, more=TRUSTED, scheme='https')
    assert list(wait(poller, good).readings) == pytest.approx([21.5, 25.5, 100.0 * math.pi])
    field.call(secured.observe(t1=22.0))
    wait(poller, reads(22.0))
    assert poller.device.address == f'MTConnect https://{LOCAL}:{secured.port}/mill'


def test_what_the_system_trusts_is_trusted(secured, poll, tmp_path, monkeypatch):
    poller = poll(secured, scheme='https')
    said = wait(poller, lost).trouble
    assert said.startswith('the certificate of the agent is not trusted (self-signed certificate)')
    assert said.endswith('as ca_file')
    assert not secured.requests
    monkeypatch.setenv('SSL_CERT_FILE', str(tmp_path / 'agent.pem'))
    wait(poller, reads(21.5))


def test_a_certificate_of_another_host_is_not_trusted(secured, poll):
    poller = poll(secured, more=TRUSTED, scheme='https', host='localhost')
    wait(poller, lambda polled: 'not trusted (Hostname mismatch, cert' in polled.trouble)
    assert not secured.requests


def test_an_agent_that_speaks_no_tls_is_told(field, poll):
    answer = http(b'', '400 Bad Request', 'text/plain')
    poller = poll(field.add(HostileServer(lambda request: answer)), scheme='https')
    wait(poller, lambda polled: 'expected TLS but the agent speaks none' in polled.trouble)


def test_an_agent_without_streams_is_asked_again(field, agent, poll):
    agent.streams = False
    poller = poll(agent)
    wait(poller, reads(21.5))
    field.call(agent.observe(t1=23.0))
    wait(poller, reads(23.0))
    wait(poller, lambda _: agent.requests[-1].startswith('/mill/sample?from=9&'))
    assert sum('/current' in path for path in agent.requests) == 1


def test_what_is_no_value_is_missing_and_said_so(field, agent, poll):
    poller = poll(agent, '{A: t1, B: x1, C: t9, D: m1, E: {item: t2, open_circuit: 77}}')
    readings = wait(poller, good).readings
    assert readings[1] == (
        'data item x1: expected one of CELSIUS, FAHRENHEIT, KELVIN but found MILLIMETER'
    )
    assert readings[2] == (
        'data item t9: the agent has none of this id or name; of this kind it has t1, t2'
    )
    assert readings[3] == "data item m1: expected a number but found 'AUTOMATIC'"
    assert readings[4] == 'open circuit (raw value 77)'
    for text, said in (
        ('UNAVAILABLE', 'the agent reports UNAVAILABLE'),
        ('nan', "expected a number but found 'nan'"),
        ('1_0', "expected a number but found '1_0'"),
        ('1e999', 'reads inf'),
        ('x' * 100_000, 'expected a number but found'),
    ):
        field.call(agent.observe(t1=text))
        polled = wait(poller, lambda polled, said=said: said in str(polled.readings[0]))
        assert len(polled.readings[0]) < 200
    health = DeviceHealth(poller.device, interval=60.0)
    health.note(polled)
    assert health.health().level is Level.WARN
    field.call(agent.observe(t1='+2.15e1'))
    wait(poller, reads(21.5))


@pytest.mark.parametrize('streams', [True, False])
def test_a_gap_in_the_sequence_is_counted_and_the_present_state_read_anew(
    field, agent, poll, streams
):
    agent.streams = streams
    poller = poll(agent)
    assert wait(poller, reads(21.5)).facts['sequence_gaps'] == '0'
    field.call(agent.lose(5, t1=30.0))
    polled = wait(poller, lambda polled: polled.facts.get('sequence_gaps') == '1')
    polled = wait(poller, reads(30.0))
    assert polled.facts['restarts'] == '0'
    health = DeviceHealth(poller.device, interval=60.0)
    health.note(polled)
    assert health.health().values['sequence_gaps'] == '1'


def test_an_agent_that_was_started_anew_is_read_anew(field, agent, poll):
    poller = poll(agent)
    wait(poller, lambda polled: good(polled) and '/sample' in agent.requests[-1])
    field.call(agent.restart(t1=40.0, t2=50))
    polled = wait(poller, reads(40.0))
    assert polled.facts['restarts'] == '1'
    # What the new run has not told is not made up from the old one.
    assert polled.readings[2] == 'data item Srpm: the agent has no value for it'
    # Its clock is years off; ours stamps.
    assert polled.facts['clock_ahead'].endswith(' s')
    assert abs(polled.stamp - time.monotonic_ns()) < TIMEOUT * 1e9


@pytest.mark.parametrize('fault', ['refuse', 'cut', 'hang', 'garble'])
def test_a_lost_agent_comes_back(field, agent, poll, fault):
    route = field.add(Route(agent))
    poller = poll(route, hurries=True)
    wait(poller, lambda polled: good(polled) and '/sample' in agent.requests[-1])
    field.call(route.set(fault))
    field.call(agent.observe(t1=1.0))
    assert 0 < len(wait(poller, lost).trouble) <= TEXT_MAX
    field.call(route.set(''))
    wait(poller, reads(1.0))


def error(code):
    return (
        f'<MTConnectError><Errors><Error errorCode="{code}"/></Errors></MTConnectError>'.encode()
    )


BOMB = b'<!DOCTYPE a [<!ENTITY a "aaaaaaaaaa"><!ENTITY b "&a;&a;">]><MTConnectDevices>&b;'
HOSTILE = {
    'noise': (random.Random(0).randbytes(5000), 'HTTP'),
    'no end': (b'HTTP/1.1 200 OK\r\n' + b'A: b\r\n' * 200 + b'\r\n', 'HTTP'),
    'a page': (http(b'<html><body/></html>'), "found 'html'"),
    'no xml': (http(b'{"a": 1}'), 'found no XML'),
    'half a document': (http(b'<MTConnectDevices><Header'), 'found no XML'),
    'entities': (http(BOMB), 'declares a document type'),
    'other files': (
        http(b'<!DOCTYPE a SYSTEM "other.dtd"><MTConnectDevices/>'),
        'declares a document type',
    ),
    'deep': (http(b'<MTConnectDevices>' + b'<a>' * 5000), 'at most 100 levels'),
    'numbers': (
        http(b'<MTConnectDevices><Header nextSequence="9e9"/></MTConnectDevices>'),
        "nextSequence: expected a number below 2^64 but found '9e9'",
    ),
    'not found': (http(b'gone', '404 Not Found', 'text/plain'), 'HTTP status 404'),
    'moved': (http(b'', '302 Found', 'text/plain'), 'HTTP status 302'),
    'an error': (http(error('INTERNAL_ERROR')), 'sent MTConnectError: INTERNAL_ERROR'),
    'a huge document': (
        b'HTTP/1.1 200 OK\r\nContent-Length: 99999999\r\n\r\n' + b' ' * (9 << 20),
        'expected a document up to 8 MiB',
    ),
}


@pytest.mark.parametrize(('answer', 'said'), HOSTILE.values(), ids=HOSTILE)
def test_hostile_answers_are_lost_devices(field, poll, answer, said):
    server = field.add(HostileServer(lambda request: answer))
    poller = poll(server, hurries=True)
    asked = 0
    while asked < 2:
        asked = server.asked
        polled = poller.results.get(timeout=TIMEOUT)
        assert lost(polled)
        assert len(polled.trouble) <= TEXT_MAX
    wait(poller, lambda polled: said in polled.trouble)


PLAIN = 'HTTP/1.1 200 OK\r\nContent-Type: multipart/x-mixed-replace'
STREAM = f'{PLAIN};boundary={BOUNDARY}\r\n\r\n'
PARTS = {
    'no boundary': (
        'HTTP/1.1 200 OK\r\nContent-Type: multipart/x-mixed-replace\r\n\r\n',
        'missing',
    ),
    'another boundary': (f'{STREAM}--other\r\n', "boundary of the stream but found b'--other'"),
    'no length': (f'{STREAM}--{BOUNDARY}\r\nContent-type: text/xml\r\n\r\n<a/>', 'Content-length'),
    'negative': (f'{STREAM}--{BOUNDARY}\r\nContent-length: -1\r\n\r\n', "but found '-1'"),
    'huge': (f'{STREAM}--{BOUNDARY}\r\nContent-length: 99999999\r\n\r\n', 'up to 8 MiB'),
    'many lines': (f'{STREAM}--{BOUNDARY}\r\n' + 'A: b\r\n' * 50, 'at most 32 lines'),
    'no xml': (f'{STREAM}--{BOUNDARY}\r\nContent-length: 4\r\n\r\nnone', 'found no XML'),
    'stays open': (f'{STREAM}--{BOUNDARY}\r\nContent-length: 40\r\n\r\n<MTC', 'silent for'),
}


@pytest.mark.parametrize(('answer', 'said'), PARTS.values(), ids=PARTS)
def test_hostile_streams_are_lost_devices(field, agent, poll, answer, said):
    def reply(request):
        path = request.decode().split(' ')[1]
        return answer.encode() if '/sample' in path else http(agent.reply(path))

    poller = poll(field.add(HostileServer(reply)), hurries=True)
    for _ in range(2):
        wait(poller, good)
        # A busy computer may be too slow for an answer first.
        wait(poller, lambda polled: lost(polled) and said in polled.trouble)


def test_an_address_that_is_none_is_refused(tmp_path):
    path = tmp_path / 'devices.yaml'
    good_url = FILE.format(
        scheme='http', host=LOCAL, port=5000, timeout=1.0, sensors='{T1: t1}', axes='{X: x1}'
    )
    for url, said in (
        ('http://mill', 'expected http://HOST:PORT/MACHINE or https://HOST:PORT/MACHINE, usual'),
        ('https://mill', 'expected http://HOST:PORT/MACHINE or https://HOST:PORT/MACHINE, usual'),
        ('ftp://mill:5000', 'expected http://HOST:PORT/MACHINE'),
        ('http://me:secret@mill:5000', 'expected no user and password in the address'),
        ('http://mill:5000/a?b=c', 'expected the name of a machine behind the port'),
    ):
        path.write_text(good_url.replace(f'http://{LOCAL}:5000/mill', url))
        with pytest.raises(ParameterError, match='line 5') as refusal:
            read_devices(path)
        assert said in str(refusal.value)
    (tmp_path / 'none.pem').write_text('none')
    for more, said in (
        ('    ca_file: none.pem\n', 'ca_file: expected https:// in url beside it'),
        ('    ca_file: gone.pem\n', 'ca_file: expected a file but nothing is at'),
    ):
        path.write_text(good_url + more)
        with pytest.raises(ParameterError, match='line 11') as refusal:
            read_devices(path)
        assert said in str(refusal.value)
    path.write_text(good_url.replace('http:', 'https:') + '    ca_file: none.pem\n')
    with pytest.raises(ParameterError, match='line 11: device mill: ca_file: expected certific'):
        read_devices(path)
    path.write_text(good_url.replace('{X: x1}', '{X: [x1]}'))
    with pytest.raises(ParameterError, match='line 9: device mill, axis X: expected a text but'):
        read_devices(path)
    second = (
        good_url.partition('\n')[2].partition('\n')[2].replace('mill\n    pro', 'other\n    pro')
    )
    path.write_text(good_url + second.replace('{T1: t1}', '{T2: t1}'))
    with pytest.raises(ParameterError, match='axis X is already read from device mill; every'):
        read_devices(path)


def test_a_newer_observation_is_not_overwritten_by_an_older_one():
    body = ''.join(f'<A dataItemId="t1" sequence="{number}">{number}</A>' for number in (7, 9, 8))
    document = parse(f'<MTConnectStreams><Header/>{body}</MTConnectStreams>'.encode())
    assert document.observations == {'t1': '9'}
    # One that agents must number but do not: what is numbered is newer.
    body = '<A dataItemId="t1" sequence="0">0</A><A dataItemId="t1">?</A><A dataItemId="t2">2</A>'
    document = parse(f'<MTConnectStreams><Header/>{body}</MTConnectStreams>'.encode())
    assert document.observations == {'t1': '0', 't2': '2'}
    with pytest.raises(LinkError, match=r"sequence: expected a number .* but found '-1'"):
        parse(b'<MTConnectStreams><A dataItemId="t" sequence="-1"/></MTConnectStreams>')

# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""A printer by Moonraker, over HTTP and WebSocket: readings, states, faults, and back again."""

import pytest

pytest.importorskip('rclpy')
pytest.importorskip('websockets')

from equipment.field_servers import LOCAL, Field, HostileServer
from equipment.moonraker_server import MOONRAKER, Klipper, RealMoonraker, StandIn
from equipment.polled import good, is_text, lost, wait

pytestmark = pytest.mark.ros

FILE = """
devices:
  - name: printer
    protocol: moonraker
    url: {scheme}://{host}:{port}
    period: 0.02
    timeout: 2.0
    {more}
    sensors:
      bed: {{object: heater_bed, rate_max: 0.7, range_high: 130}}
      chamber: temperature_sensor chamber
      gone: temperature_sensor nothing
"""
KEY = 'Kq7-very-secret-9vW'
needs_moonraker = pytest.mark.skipif(
    not MOONRAKER, reason='no MOONRAKER=.../moonraker here: pip install moonraker, elsewhere'
)


@pytest.fixture
def field():
    made = Field()
    yield made
    made.close()


@pytest.fixture
def klipper():
    return Klipper()


@pytest.fixture
def server(request, field, klipper, tmp_path):
    if request.param == 'real':
        return field.add(RealMoonraker(klipper, tmp_path / 'printer_data'))
    return field.add(StandIn(klipper))


@pytest.fixture
def begin(poll_file):
    def of(server, scheme, more=''):
        return poll_file(FILE.format(scheme=scheme, host=LOCAL, port=server.port, more=more))

    return of


KINDS = ['stand-in', pytest.param('real', marks=[needs_moonraker, pytest.mark.slow])]


@pytest.mark.parametrize('scheme', ['http', 'ws'])
@pytest.mark.parametrize('server', KINDS, indirect=True)
def test_temperatures_of_a_printer_are_read_and_come_back(field, klipper, server, begin, scheme):
    poller = begin(server, scheme)
    bed, chamber, gone = wait(poller, good).readings
    assert (bed, chamber) == (60.25, 31.5)
    assert is_text(gone, 'temperature_sensor nothing temperature: Klipper has no such object')

    klipper.objects['heater_bed']['temperature'] = 'hot'
    wait(poller, lambda i: good(i) and is_text(i.readings[0], "expected a number but found 'hot'"))
    klipper.objects['heater_bed']['temperature'] = 10_000.0
    wait(poller, lambda item: good(item) and is_text(item.readings[0], 'reads 10000 degC'))
    klipper.objects['heater_bed']['temperature'] = 60.25

    ready = klipper.objects['webhooks']
    klipper.objects['webhooks'] = {'state': 'shutdown', 'state_message': 'MCU\n shutdown'}
    wait(
        poller, lambda item: good(item) and is_text(item.readings[1], 'shutdown', 'do not change')
    )
    klipper.objects['webhooks'] = ready
    wait(poller, lambda item: good(item) and list(item.readings[:2]) == [60.25, 31.5])

    field.call(server.stop())
    wait(poller, lost)
    field.call(server.start())
    wait(poller, lambda item: good(item) and list(item.readings[:2]) == [60.25, 31.5])


@pytest.mark.parametrize('scheme', ['http', 'ws'])
@pytest.mark.parametrize('server', ['stand-in'], indirect=True)
def test_a_moonraker_without_klipper_is_a_lost_device(klipper, server, begin, scheme):
    objects = dict(klipper.objects)
    klipper.objects.clear()
    poller = begin(server, scheme)
    trouble = wait(poller, lost).trouble
    assert trouble == 'Moonraker answers Klippy Host not connected; does Klipper run?'
    klipper.objects.update(objects)
    wait(poller, good)


@pytest.mark.parametrize('scheme', ['http', 'ws'])
def test_a_key_lets_us_in_and_is_told_nowhere(field, klipper, begin, tmp_path, scheme):
    server = field.add(StandIn(klipper, KEY))
    assert 'name the key as api_key' in wait(begin(server, scheme), lost).trouble
    path = tmp_path / 'key'
    path.write_text(f'{KEY}\n')
    path.chmod(0o600)
    poller = begin(server, scheme, f'allow_plain_password: true\n    api_key: {path}')
    wait(poller, good)
    path.write_text('another')
    field.call(server.stop())
    field.call(server.start())
    trouble = wait(poller, lambda i: lost(i) and 'lets us not in' in i.trouble).trouble
    assert 'another' not in trouble


HOSTILE = {
    'noise': b'\x00\xff' * 50,
    'no JSON': b'HTTP/1.1 200 OK\r\nContent-Length: 1\r\n\r\n{',
    'another document': b'HTTP/1.1 200 OK\r\nContent-Length: 15\r\n\r\n{"result": [1]}',
    'endless': b'HTTP/1.1 200 OK\r\nContent-Length: 9999999\r\n\r\n' + b' ' * 2_000_000,
}


@pytest.mark.parametrize('scheme', ['http', 'ws'])
@pytest.mark.parametrize('answer', HOSTILE.values(), ids=HOSTILE)
def test_what_is_no_moonraker_is_a_lost_device(field, begin, answer, scheme):
    server = field.add(HostileServer(lambda request: answer))
    assert wait(begin(server, scheme), lost).trouble


def test_wrong_files_are_refused(refused_file, tmp_path):
    def line(old, new):
        text = FILE.format(scheme='http', host=LOCAL, port=7125, more='')
        assert old in text
        return refused_file(text.replace(old, new))

    assert 'url: expected http://HOST:PORT or ws://HOST:PORT' in line(':7125', '')
    assert 'put the key into the file api_key' in line('127.0', 'joe:secret@127.0')
    path = tmp_path / 'key'
    path.write_text(KEY)
    assert 'api_key: expected https:// or wss://' in line('period: 0.02', f'api_key: {path}')
    text = line('period: 0.02', f'allow_plain_password: true\n    api_key: {path}')
    assert 'run chmod 600' in text
    assert KEY not in text

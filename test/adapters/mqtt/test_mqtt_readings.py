# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Sensors behind a real broker: what messages mean, faults, security, and back again."""

import pytest

pytest.importorskip('rclpy')
pytest.importorskip('paho')

from equipment.certificates import LOCAL
from equipment.mqtt_broker import MOSQUITTO, PASSWORD, USER, credentials
from equipment.polled import TIMEOUT, good, is_text, lost, wait
from paho.mqtt.client import Client
from paho.mqtt.enums import CallbackAPIVersion

from fuzzycnc_ros.adapters.mqtt.readings import value_at

needs_broker = pytest.mark.skipif(
    MOSQUITTO is None, reason='no mosquitto here: apt-get install mosquitto'
)
pytestmark = [pytest.mark.ros, needs_broker]

FILE = """
devices:
  - name: house
    protocol: mqtt
    host: {host}
    port: {port}
    period: 0.05
    timeout: 0.3
    max_age: {max_age}
    {more}
    sensors:
      tasmota: {{topic: tele/+/SENSOR, json: DS18B20.Temperature}}
      esphome: mill/sensor/front/state
      zigbee: {{topic: zigbee2mqtt/column, json: temperature}}
      list: {{topic: plc, json: values.1}}
"""
SENT = {
    'tele/mill/SENSOR': '{"Time": "x", "DS18B20": {"Temperature": 71.6}, "TempUnit": "F"}',
    'tele/mill/STATE': '{"Heap": 25}',
    'mill/sensor/front/state': '21.5',
    'zigbee2mqtt/column': '{"temperature": 22.5, "battery": 90}',
    'plc': '{"values": [1, 23.5]}',
}
VALUES = [pytest.approx(22.0), 21.5, 22.5, 23.5]


@pytest.fixture
def begin(poll_file):
    def of(broker, more='', max_age=60, sensors=None):
        text = FILE.format(host=LOCAL, port=broker.port, more=more, max_age=max_age)
        if sensors is not None:
            text = f'{text.partition("    sensors:")[0]}    sensors: {sensors}\n'
        return poll_file(text)

    return of


class Sensors:
    """Devices that publish to a broker."""

    def __init__(self, broker, tls=None):
        self._client = Client(CallbackAPIVersion.VERSION2)
        if tls is not None:
            self._client.tls_set(str(tls))
        self._client.username_pw_set(USER, PASSWORD)
        self._client.connect(LOCAL, broker.port)
        self._client.loop_start()

    def send(self, messages, retain=False):
        for topic, text in messages.items():
            self._client.publish(topic, text, 1, retain).wait_for_publish(TIMEOUT)

    def close(self):
        self._client.disconnect()
        self._client.loop_stop()


@pytest.fixture
def sensors():
    made = []

    def of(broker, **security):
        made.append(Sensors(broker, **security))
        return made[-1]

    yield of
    for one in made:
        one.close()


def sent_until(poller, sensors, messages, wanted):
    """Publish again and again until a reading is as wanted; return it."""

    def found(item):
        sensors.send(messages)
        return good(item) and wanted(item.readings)

    return wait(poller, found).readings


def test_values_come_from_plain_and_json_messages_and_come_back(serve, begin, sensors):
    broker = serve()
    poller, some = begin(broker), sensors(broker)
    sent_until(poller, some, SENT, lambda found: list(found) == VALUES)
    broker.stop()
    assert 'connection lost' in wait(poller, lost).trouble
    broker.start()
    sent_until(poller, sensors(broker), SENT, lambda found: list(found) == VALUES)


def test_a_sensor_that_falls_silent_is_missing_alone(serve, begin, sensors):
    broker = serve()
    poller, some = begin(broker, max_age=0.5), sensors(broker)
    sent_until(poller, some, SENT, lambda found: list(found) == VALUES)
    rest = {topic: text for topic, text in SENT.items() if topic != 'zigbee2mqtt/column'}
    found = sent_until(
        poller, some, rest, lambda f: is_text(f[2], 'nothing came for', 'have it send more often')
    )
    assert found[1] == 21.5


@pytest.mark.parametrize(
    ('topic', 'text', 'place', 'parts'),
    [
        ('mill/sensor/front/state', 'nan', 1, ("expected a number but found 'nan'",)),
        ('mill/sensor/front/state', '10230', 1, ('reads 10230 degC, which no', 'or ohms say')),
        ('mill/sensor/front/state', '', 1, ("expected a number but found ''",)),
        ('zigbee2mqtt/column', '{"temperature": null}', 2, ('expected this path but found',)),
        ('zigbee2mqtt/column', '{"temperature": true}', 2, ('expected a number but found True',)),
        ('zigbee2mqtt/column', '[' * 50_000, 2, ('expected this path but found',)),
        ('plc', '{"values": [1]}', 3, ('plc values.1: expected',)),
        (
            'tele/oven/SENSOR',
            SENT['tele/mill/SENSOR'],
            0,
            ('tele/mill/SENSOR, tele/oven/SENSOR', ''),
        ),
    ],
)
def test_what_is_no_temperature_is_told(serve, begin, sensors, topic, text, place, parts):
    broker = serve()
    poller, some = begin(broker), sensors(broker)
    sent_until(poller, some, SENT, lambda found: list(found) == VALUES)
    sent_until(poller, some, {topic: text}, lambda found: is_text(found[place], *parts))


def test_a_message_that_the_broker_kept_is_no_reading(serve, begin, sensors):
    broker = serve()
    some = sensors(broker)
    some.send({'mill/sensor/front/state': '19.0'}, retain=True)
    poller = begin(broker)
    wait(poller, lambda i: good(i) and is_text(i.readings[1], 'the broker had kept, of unknown'))
    sent_until(poller, some, SENT, lambda found: list(found) == VALUES)


def test_a_broker_with_tls_and_password_is_entered_and_no_secret_is_told(
    serve, begin, sensors, tmp_path
):
    broker = serve(tls=True, password=PASSWORD)
    more = f'tls: {{ca: broker.pem}}\n    credentials: {credentials(tmp_path)}'
    poller, some = begin(broker, more), sensors(broker, tls=tmp_path / 'broker.pem')
    sent_until(poller, some, SENT, lambda found: list(found) == VALUES)
    credentials(tmp_path, 'another')
    broker.stop()
    broker.start()
    trouble = wait(poller, lambda item: lost(item) and 'refuses' in item.trouble).trouble
    assert 'compare credentials' in trouble
    assert 'another' not in trouble


def test_wrong_files_are_refused(refused_file, tmp_path):
    def line(old, new):
        text = FILE.format(host=LOCAL, port=1, more='', max_age=60)
        assert old in text
        return refused_file(text.replace(old, new))

    assert 'topic: expected a topic, with + for one level' in line('topic: plc', 'topic: a/#/b')
    text = line('period: 0.05', f'credentials: {credentials(tmp_path)}')
    assert 'credentials: expected tls beside it' in text
    text = line('period: 0.05', 'allow_plain_password: true\n    credentials: none.yaml')
    assert 'nothing is at' in text
    (tmp_path / 'broker-user.yaml').chmod(0o644)
    place = f'allow_plain_password: true\n    credentials: {tmp_path}/broker-user.yaml'
    text = line('period: 0.05', place)
    assert 'device house: ' in text
    assert 'run chmod 600' in text
    assert PASSWORD not in text


def test_paths():
    assert value_at(b'{"a.b": 1}', 'a.b') == (None, '')
    assert value_at(b'\xff', 'a') == (None, '')
    assert value_at(b'[[1, 2]]', '0.1') == (2, '')
    assert value_at(b'[1]', '5') == (None, '')

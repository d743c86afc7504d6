# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The node `mqtt_publisher` with a real broker: what it tells, its last will, its secrets."""

import json
import signal

import pytest

pytest.importorskip('paho')

from bag_contents import contents
from equipment.mqtt_broker import LOCAL, MOSQUITTO, PASSWORD, USER, MqttBroker, credentials, wait
from processes import command_line

pytestmark = [
    pytest.mark.ros,
    pytest.mark.skipif(MOSQUITTO is None, reason='no mosquitto here: apt-get install mosquitto'),
]
STATE, STATUS = 'fuzzycnc/mill/state', 'fuzzycnc/mill/status'


@pytest.fixture
def broker(tmp_path):
    made = MqttBroker(tmp_path, tls=True, password=PASSWORD)
    made.start()
    yield made
    made.close()


def test_a_machine_is_told_of_and_its_secrets_are_not(graph, observer, broker, tmp_path):
    credentials(tmp_path)
    path = tmp_path / 'broker.yaml'
    path.write_text(
        f'host: {LOCAL}\nport: {broker.port}\ntls: {{ca: broker.pem}}\n'
        'credentials: broker-user.yaml\n'
    )
    csv = tmp_path / 'readings.csv'
    csv.write_text('time,T1,T2\n' + ''.join(f'{k},21.5,22.0\n' for k in range(600)))
    heard = broker.listen()
    observer.watch_diagnostics()
    bag = tmp_path / 'bag'
    recorder = graph.start('recorder', {'output': str(bag), 'topics': '.*', 'exclude': '^$'})
    node = graph.start('mqtt_publisher', {'broker_file': str(path)})
    source = {'source': 'csv', 'csv_file': str(csv), 'csv_time': 'time', 'interval': 1.0}
    graph.start('temperature_acquisition', {**source, 'stuck_time': 0.0})

    def told():
        found = [json.loads(text) for topic, text in list(heard) if topic == STATE]
        return [item for item in found if item['temperatures'] and item['alarms']]

    observer.until(told, 'a report with temperatures and alarms')
    report = told()[-1]
    assert report['machine'] == 'mill'
    assert report['temperatures']['temperature_degC'] == {'T1': 21.5, 'T2': 22.0}
    assert report['temperatures']['status'] == {'T1': 'ok', 'T2': 'ok'}
    assert report['offsets'] is None

    def newest():
        return observer.statuses.get('mill/mqtt_publisher: broker', [(None, '')])[-1][1]

    observer.until(lambda: newest().endswith(': connected'), 'its health')
    broker.stop()
    observer.until(lambda: newest().endswith('reports wait'), 'the loss')
    broker.start()
    observer.until(lambda: newest().endswith(': connected'), 'the return')

    again = broker.listen(STATUS)
    wait(lambda: (STATUS, '{"online": true}') in again, 'the status')
    started = [command_line(item.process.pid) for item in (node, recorder)]
    node.send(signal.SIGKILL)
    wait(lambda: (STATUS, '{"online": false}') in again, 'the last will')
    assert recorder.interrupt() == 0

    secrets = (USER.encode(), PASSWORD.encode())
    written = [item for part in bag.rglob('*') if part.is_file() for item in contents(part)]
    logs = [text.encode() for text in (node.output, recorder.output, *started)]
    published = [text.encode() for _, text in [*heard, *again]]
    assert len(written) > 10
    assert not [text for text in (*written, *logs, *published) for s in secrets if s in text]

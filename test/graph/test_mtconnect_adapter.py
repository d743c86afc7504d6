# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The node `mtconnect_adapter`: what a client hears of a machine, and the file for its agent."""

import socket
from xml.etree import ElementTree

import pytest
from equipment.field_servers import LOCAL

pytestmark = [pytest.mark.ros, pytest.mark.slow]


def test_a_machine_is_told_of(graph, observer, tmp_path):
    csv, devices = tmp_path / 'readings.csv', tmp_path / 'mill.xml'
    csv.write_text('time,T1,T2\n' + ''.join(f'{k},21.5,999\n' for k in range(600)))
    observer.watch_diagnostics()
    given = {'port': 0, 'devices_file': str(devices), 'age_max': 3.0}
    node = graph.start('mtconnect_adapter', given)
    source = {'source': 'csv', 'csv_file': str(csv), 'csv_time': 'time', 'interval': 1.0}
    driver = graph.start('temperature_acquisition', {**source, 'stuck_time': 0.0})
    name = 'mill/mtconnect_adapter: adapter'
    observer.until(lambda: observer.told(name, f'SHDR {LOCAL}:'), 'its health')
    port = int(observer.statuses[name][-1][1].split(':')[1])
    heard = bytearray()
    with socket.create_connection((LOCAL, port)) as client:
        client.setblocking(False)

        def told(wanted):
            try:
                heard.extend(client.recv(1 << 16))
            except BlockingIOError:
                pass
            return wanted in heard

        observer.until(lambda: told(b'|temperature_T1|21.5'), 'a temperature')
        observer.until(lambda: told(b'|temperature_T2|UNAVAILABLE'), 'one out of range')
        observer.until(lambda: told(b'|alarms|WARNING|temperature_acquisition.'), 'an alarm')
        observer.until(lambda: observer.told(name, ': 1 agents'), 'a client')
        observer.until(devices.exists, 'the file of devices')
        assert b'temperature_T1' in devices.read_bytes()
        ElementTree.parse(devices)
        assert driver.interrupt() == 0
        observer.until(lambda: told(b'|temperature_T1|UNAVAILABLE'), 'what is too old')
        assert node.interrupt() == 0
    assert 'Traceback' not in node.output

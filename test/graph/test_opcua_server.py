# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The node `opcua_server`: what a client with the password reads; its secrets."""

import asyncio

import pytest

pytest.importorskip('asyncua')

from asyncua import Client, ua
from asyncua.crypto.security_policies import SecurityPolicyBasic256Sha256
from bag_contents import contents
from cryptography.x509.oid import ExtendedKeyUsageOID
from equipment.field_servers import LOCAL
from equipment.secured_server import PASSWORD, certificate, user_file
from processes import command_line

pytestmark = [pytest.mark.ros, pytest.mark.slow]


async def read(port, own, place):
    client = Client(f'opc.tcp://{LOCAL}:{port}/', timeout=30.0)
    client.application_uri = 'urn:client'
    client.set_user('joe')
    client.set_password(PASSWORD)
    await client.set_security(SecurityPolicyBasic256Sha256, *map(str, own))
    async with client:
        node = client.get_node(ua.NodeId(place, 2))
        return (await node.read_data_value(False)).Value.Value


def test_a_machine_is_read_with_the_password(graph, observer, tmp_path):
    usage = ExtendedKeyUsageOID.SERVER_AUTH
    theirs = certificate(tmp_path, 'server', 'urn:fuzzycnc:report:server', usage)
    own = certificate(tmp_path, 'own', 'urn:client', ExtendedKeyUsageOID.CLIENT_AUTH)
    files = {
        'certificate': theirs[0],
        'private_key': theirs[1],
        'credentials': user_file(tmp_path),
    }
    csv, bag = tmp_path / 'readings.csv', tmp_path / 'bag'
    csv.write_text('time,T1\n' + ''.join(f'{k},21.5\n' for k in range(600)))
    observer.watch_diagnostics()
    recorder = graph.start('recorder', {'output': str(bag), 'topics': '.*', 'exclude': '^$'})
    given = {name: str(path) for name, path in files.items()}
    node = graph.start('opcua_server', {'port': 0, **given})
    source = {'source': 'csv', 'csv_file': str(csv), 'csv_time': 'time', 'interval': 1.0}
    graph.start('temperature_acquisition', {**source, 'stuck_time': 0.0})
    name = 'mill/opcua_server: server'
    observer.until(lambda: observer.told(name, 'encrypted, with a user'), 'its health')
    port = int(observer.statuses[name][-1][1].split(':')[1])

    def temperature():
        try:
            return asyncio.run(read(port, own, 'mill/temperature/T1'))
        except ua.UaStatusCodeError:
            return None  # not told yet

    observer.until(lambda: temperature() == 21.5, 'a temperature')
    started = command_line(node.process.pid)
    assert node.interrupt() == 0
    assert recorder.interrupt() == 0
    written = [item for part in bag.rglob('*') if part.is_file() for item in contents(part)]
    assert len(written) > 10
    texts = [
        *written,
        node.output.encode(),
        started.encode(),
        *(text.encode() for _, text in observer.statuses[name]),
    ]
    assert not [text for text in texts if PASSWORD.encode() in text]


def test_an_open_file_of_credentials_is_refused(refusal, tmp_path):
    path = user_file(tmp_path)
    path.chmod(0o644)
    given = {'certificate': '/none', 'private_key': '/none', 'credentials': str(path), 'port': 0}
    line = refusal('opcua_server', given)
    assert 'expected a file that only its owner can read' in line
    assert PASSWORD not in line

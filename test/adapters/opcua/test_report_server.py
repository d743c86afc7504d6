# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The report over OPC UA: values, bad statuses, nobody writes or enters without a password."""

import asyncio

import pytest

pytest.importorskip('rclpy')
pytest.importorskip('asyncua')

from asyncua import Client, ua
from asyncua.crypto.security_policies import SecurityPolicyBasic256Sha256
from cryptography.x509.oid import ExtendedKeyUsageOID
from equipment.field_servers import LOCAL
from equipment.secured_server import certificate

from fuzzycnc_ros.adapters.opcua.report_server import NAMESPACE, ReportServer, ServerAccess
from fuzzycnc_ros.ros.parameters import ParameterError

pytestmark = [pytest.mark.ros, pytest.mark.slow]

TIME = '2026-01-02T03:04:05.000+00:00'
REPORT = {
    'time': TIME,
    'offsets': {'age_s': 0.1, 'offset_um': {'Z': -12.5}, 'status': 'following'},
    'errors': {'age_s': 0.1, 'error_um': {'Z': 12.5}, 'valid': False},
    'temperatures': {
        'age_s': 0.1,
        'temperature_degC': {'front bearing': 31.25, 'T2': None},
        'status': {'front bearing': 'ok', 'T2': 'missing'},
    },
    'spindle': {'age_s': 200.0, 'speed_rpm': 6000.0, 'status': 'ok'},
    'alarms': [{'level': 'error', 'node': 'compensator', 'name': 'limit', 'text': 'at 50 um'}],
}


async def data(client, place):
    """Return the data value of a node."""
    index = await client.get_namespace_index(NAMESPACE)
    return await client.get_node(ua.NodeId(place, index)).read_data_value(False)


def test_a_client_reads_and_changes_nothing():
    server = ReportServer('mill', LOCAL, 0, 150.0)
    try:
        server.publish(REPORT)
        asyncio.run(read_and_try(server))
        with pytest.raises(ParameterError, match='expected a free port on 127'):
            ReportServer('mill', LOCAL, server.port, 150.0)
    finally:
        server.close()
    assert not server._loop.alive


async def read_and_try(server):
    async with Client(f'opc.tcp://{LOCAL}:{server.port}/', timeout=30.0) as client:
        index = await client.get_namespace_index(NAMESPACE)
        assert index == 2
        found = await data(client, 'mill/temperature/front bearing')
        assert found.Value.Value == 31.25
        assert found.StatusCode.is_good()
        assert found.SourceTimestamp.isoformat().startswith('2026-01-02T03:04:05')
        assert (await data(client, 'mill/offset/Z')).Value.Value == -12.5
        alarms = await data(client, 'mill/alarms')
        assert alarms.Value.Value == ['error: compensator: limit: at 50 um']
        for place, name in (
            ('mill/temperature/T2', 'BadSensorFailure'),
            ('mill/error/Z', 'BadSensorFailure'),
            ('mill/spindle_speed', 'BadNoCommunication'),
        ):
            found = await data(client, place)
            assert (found.StatusCode.name, found.Value.Value) == (name, None)
        server.publish({**REPORT, 'temperatures': None, 'alarms': []})
        found = await data(client, 'mill/temperature/front bearing')
        assert (found.StatusCode.name, found.Value.Value) == ('BadNoData', None)
        assert (await data(client, 'mill/alarms')).Value.Value == []
        path = [f'{index}:mill', f'{index}:offset', f'{index}:Z']
        node = await client.nodes.objects.get_child(path)
        assert '[um]' in (await node.read_description()).Text
        for act in (
            lambda: node.write_value(99.0, ua.VariantType.Double),
            lambda: node.set_writable(),
            lambda: client.delete_nodes([node]),
            lambda: node.add_variable(index, 'mine', 1.0),
            lambda: client.nodes.objects.add_object(index, 'mine'),
        ):
            with pytest.raises(ua.UaStatusCodeError):
                await act()
        assert (await data(client, 'mill/offset/Z')).Value.Value == -12.5


def test_others_enter_encrypted_and_with_the_password(tmp_path):
    theirs = certificate(
        tmp_path, 'server', 'urn:fuzzycnc:report:server', ExtendedKeyUsageOID.SERVER_AUTH
    )
    own = certificate(tmp_path, 'own', 'urn:client', ExtendedKeyUsageOID.CLIENT_AUTH)
    server = ReportServer('mill', LOCAL, 0, 150.0, ServerAccess(*theirs, 'joe', 'secret'))
    try:
        server.publish(REPORT)
        assert asyncio.run(entered(server, own, 'joe', 'secret')) == -12.5
        for user, password in (('joe', 'wrong'), ('eve', 'secret'), (None, None)):
            with pytest.raises(ua.UaError):
                asyncio.run(entered(server, own, user, password))
        with pytest.raises(ua.UaError):
            asyncio.run(entered(server, None, 'joe', 'secret'))
        assert 'secret' not in repr(server.health())
    finally:
        server.close()


async def entered(server, own, user, password):
    client = Client(f'opc.tcp://{LOCAL}:{server.port}/', timeout=30.0)
    client.application_uri = 'urn:client'
    if user is not None:
        client.set_user(user)
        client.set_password(password)
    if own is not None:
        await client.set_security(SecurityPolicyBasic256Sha256, *map(str, own))
    async with client:
        return (await data(client, 'mill/offset/Z')).Value.Value


def test_a_certificate_that_is_none_is_refused(tmp_path):
    none = tmp_path / 'none.der'
    with pytest.raises(ParameterError, match=r'none\.der'):
        ReportServer('mill', LOCAL, 0, 150.0, ServerAccess(none, none, 'joe', 'secret'))

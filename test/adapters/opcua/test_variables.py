# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Types of OPC UA variables: the declared one, or that of the value where that is a subtype."""

import asyncio
from types import SimpleNamespace

import pytest

pytest.importorskip('rclpy')
ua = pytest.importorskip('asyncua').ua

from fuzzycnc_ros.adapters.link import LinkError  # noqa: E402
from fuzzycnc_ros.adapters.opcua.variables import ControlVariable, Variables, VariableType  # noqa: E402

pytestmark = pytest.mark.ros

OWN_TYPE = ua.NodeId(3002, 4)
"""A data type that a control declares itself, below one that is built in."""
DURATION = ua.NodeId(ua.ObjectIds.Duration)
"""A subtype that OPC UA declares: below Double."""


class Server:
    """Answers of a server that has one variable."""

    def __init__(self, data_type, value):
        self._answers = {
            ua.AttributeIds.DataType: ua.DataValue(ua.Variant(data_type)),
            ua.AttributeIds.UserAccessLevel: ua.DataValue(ua.Variant(3, ua.VariantType.Byte)),
            ua.AttributeIds.Value: ua.DataValue(value),
        }
        self.written = []
        self.client = SimpleNamespace(
            get_node=lambda node: node, read_attributes=self._read, uaclient=self
        )

    async def find(self, variables):
        return [ua.NodeId(7, 2) for _ in variables]

    async def _read(self, nodes, attribute):
        return [self._answers[attribute]]

    async def write_attributes(self, nodes, values, attribute):
        self.written += [value.Value for value in values]
        return [ua.StatusCode()]


def found_at(server, kind, **more):
    variable = ControlVariable(node='ns=2;i=7', kind=kind, **more)
    return asyncio.run(Variables.find(server, {'offset': variable}))


@pytest.mark.parametrize('data_type', [OWN_TYPE, DURATION, ua.NodeId(ua.ObjectIds.Double)])
@pytest.mark.parametrize('kind', [ua.VariantType.Double, ua.VariantType.Float])
def test_real_value_of_a_subtype_is_written_as_the_server_holds_it(data_type, kind):
    declared = data_type == ua.NodeId(ua.ObjectIds.Double)
    server = Server(data_type, ua.Variant(0.0, kind))
    variables = found_at(server, VariableType.QUANTITY, scale=1e-6, scaled=True, written=True)
    asyncio.run(variables.write({'offset': 12e-6}))
    (sent,) = server.written
    assert sent.VariantType is (ua.VariantType.Double if declared else kind)
    assert sent.Value == pytest.approx(12.0)
    assert variables.steps == {'offset': 0.0}


def test_whole_value_of_a_subtype_is_written_in_counts():
    server = Server(OWN_TYPE, ua.Variant(0, ua.VariantType.Int16))
    variables = found_at(server, VariableType.QUANTITY, scale=1e-7, scaled=True, written=True)
    asyncio.run(variables.write({'offset': 12e-6}))
    (sent,) = server.written
    assert (sent.VariantType, sent.Value) == (ua.VariantType.Int16, 120)
    assert variables.steps == {'offset': 1e-7}


@pytest.mark.parametrize(
    ('value', 'says'),
    [(ua.Variant('12', ua.VariantType.String), 'it is String'), (None, 'it is Null')],
)
def test_subtype_whose_value_does_not_fit_is_refused_by_its_type(value, says):
    server = Server(OWN_TYPE, value)
    with pytest.raises(LinkError, match=says):
        found_at(server, VariableType.QUANTITY, scale=1e-6, scaled=True)

# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Calls of an operator whose answers are lost on a busy computer."""

from types import SimpleNamespace

import pytest

pytest.importorskip('rclpy', reason='rclpy is not installed here: run `make test`')

from lifecycle_msgs.srv import ChangeState, GetState
from rcl_interfaces.msg import SetParametersResult
from rcl_interfaces.srv import SetParameters
from rclpy.task import Future

from fuzzycnc_ros.cli.live import operator_client
from fuzzycnc_ros.cli.live.operator_client import OperatorClient
from fuzzycnc_ros.ros.presence import GraphError

pytestmark = pytest.mark.ros


class Server:
    """Stands for a managed node: carries out all it hears, and loses some answers."""

    def __init__(self, lost):
        self.state, self.lost, self.heard = 'active', lost, []

    def create_client(self, kind, name):
        return SimpleNamespace(
            service_is_ready=lambda: True, call_async=lambda request: self._call(kind, request)
        )

    def _call(self, kind, request):
        self.heard.append(kind)
        answer = kind.Response()
        if kind is ChangeState:
            answer.success = self.state not in ('inactive', 'finalized')
            if self.state != 'finalized':
                self.state = 'inactive' if request.transition.label == 'deactivate' else 'active'
        elif kind is GetState:
            answer.current_state.label = self.state
        else:
            answer.results = [SetParametersResult(successful=True)]
        future = Future()
        if self.heard.count(kind) > self.lost.get(kind, 0):
            future.set_result(answer)
        return future


@pytest.fixture
def serve(domain, monkeypatch):
    """Let an operator call a server that loses the first answers of some services."""
    monkeypatch.setenv('ROS_DOMAIN_ID', str(domain))
    monkeypatch.setattr(operator_client, 'AGAIN', 0.1)
    with OperatorClient('mill') as operator:

        def begin(lost):
            server = Server(lost)
            monkeypatch.setattr(operator.node, 'create_client', server.create_client)
            monkeypatch.setattr(operator.node, 'destroy_client', lambda client: None)
            return operator, server

        yield begin
        monkeypatch.undo()


def test_what_may_be_asked_twice_is_asked_again(serve):
    operator, server = serve({GetState: 2, SetParameters: 1})
    assert operator.lifecycle('compensator') == 'active'
    assert operator.set_parameters('compensator', {'offset_max': 1e-5}) == []
    assert server.heard == 3 * [GetState] + 2 * [SetParameters]


def test_a_transition_is_asked_for_once_and_known_by_its_state(serve):
    operator, server = serve({ChangeState: 1, GetState: 1})
    assert operator.transition('compensator', 'deactivate')
    assert server.heard.count(ChangeState) == 1
    # Somebody else has carried it out meanwhile.
    assert operator.transition('compensator', 'deactivate')
    server.state = 'finalized'
    assert not operator.transition('compensator', 'deactivate')


def test_what_changes_nothing_that_can_be_looked_at_is_waited_for(serve, monkeypatch):
    monkeypatch.setattr(operator_client, 'CALL_TIMEOUT', 0.5)
    operator, server = serve({ChangeState: 1})
    server.state = 'finalized'
    monkeypatch.setattr(operator_client, 'REACHED', {'activate': 'never'})
    with pytest.raises(GraphError, match=r'service compensator/change_state: nothing within'):
        operator.transition('compensator', 'activate')

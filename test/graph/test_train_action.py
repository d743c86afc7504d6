# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Action `train_thermal_model` and the live parameter `model` of the predictor."""

import json
import re
from pathlib import Path
from typing import Any

import pytest
from action_msgs.msg import GoalStatus
from live_graph import AGAIN
from rcl_interfaces.msg import Parameter, ParameterType, ParameterValue
from rcl_interfaces.srv import SetParameters
from rclpy.action import ActionClient
from rclpy.qos import QoSProfile

from fuzzycnc_msgs.action import TrainThermalModel
from fuzzycnc_ros.core.names import text_hash
from fuzzycnc_ros.core.thermal.candidate import UNCOMPENSATED
from fuzzycnc_ros.runtime.component import LATCHED
from fuzzycnc_ros.runtime.host import NodeConfiguration
from fuzzycnc_ros.studies.shift.thermal_shift import record_calibration

pytestmark = pytest.mark.ros

DUTIES = ('D0', 'T1')


@pytest.fixture(scope='session')
def bags(tmp_path_factory: pytest.TempPathFactory) -> list[str]:
    """Bags of calibration runs."""
    return list(record_calibration(DUTIES, folder=tmp_path_factory.mktemp('runs')).bags)


class Client:
    """A client of the action that notes the feedback."""

    def __init__(self, observer: Any) -> None:
        self._observer = observer
        self._client = ActionClient(
            observer.node,
            TrainThermalModel,
            'train_thermal_model',
            feedback_sub_qos_profile=QoSProfile(depth=1000),
        )
        self.feedback: list[Any] = []
        observer.until(self._client.server_is_ready, 'action train_thermal_model')
        observer.settle('thermal_predictor')  # it knows whom to answer

    def send(self, bags: list[str], **request: Any) -> Any:
        """Ask for a training; return the handle of the goal."""
        self.feedback.clear()
        future = self._client.send_goal_async(
            TrainThermalModel.Goal(bag=bags, **request),
            feedback_callback=lambda message: self.feedback.append(message.feedback),
        )
        self._observer.until(future.done, 'answer to the goal')
        return future.result()

    def result(self, handle: Any) -> Any:
        """Wait for the end of a training; return status and result."""
        future = handle.get_result_async()
        self._observer.until(future.done, 'end of the training')
        return future.result()

    def cancel(self, handle: Any) -> Any:
        """Cancel a training; return status and result."""
        future = handle.cancel_goal_async()
        self._observer.until(future.done, 'answer to the cancellation')
        assert future.result().goals_canceling
        return self.result(handle)

    def close(self) -> None:
        """Leave the graph."""
        self._client.destroy()


@pytest.fixture
def client(graph, observer):
    """A client of a predictor without a model."""
    graph.start('thermal_predictor')
    found = Client(observer)
    yield found
    found.close()


def test_training_tells_every_step_and_its_model_is_used(client, observer, bags, tmp_path):
    configurations = observer.records('node_configuration', NodeConfiguration, LATCHED)
    file = tmp_path / 'trained.json'
    handle, told = client.send(bags, file=str(file)), client.feedback
    observer.until(lambda: told and told[-1].done == told[-1].total > 0, 'the first stage')
    # Whoever has the result hears no feedback that comes after it.
    observer.until(
        lambda: told[-1].stage == 'fit' and told[-1].done == told[-1].total, 'the last fit'
    )
    answer = client.result(handle)
    assert answer.status == GoalStatus.STATUS_SUCCEEDED
    assert answer.result.success
    assert list(answer.result.channel) == ['Y', 'Z']
    assert all(0.0 < value < 5e-6 for value in answer.result.held_out_rms)
    text = file.read_text(encoding='utf-8')
    assert text_hash(text) == answer.result.model_hash
    assert [item.candidate for item in told if item.stage == 'read'] == bags
    fitted = {item.candidate for item in told if item.stage == 'fit'}
    assert fitted >= set(json.loads(text)['candidates']) - {UNCOMPENSATED}
    assert any(item.stage == 'select_sensors' for item in told)
    assert told[-1].done == told[-1].total > 0
    observer.until(
        lambda: any(item.model_hash == answer.result.model_hash for item in configurations),
        'configuration with the new model',
    )


@pytest.mark.slow
def test_training_can_be_cancelled_and_asked_for_again(client, observer, bags):
    observer.watch_diagnostics()
    handle = client.send(bags)
    observer.until(lambda: client.feedback, 'feedback')
    second = client.send(bags)
    assert not second.accepted
    answer = client.cancel(handle)
    assert answer.status == GoalStatus.STATUS_CANCELED
    assert not answer.result.success
    assert answer.result.message == 'cancelled'
    observer.until(
        lambda: observer.told('mill/thermal_predictor: prediction', 'no model; set the'),
        'no model',
    )
    answer = client.result(client.send(bags))
    assert answer.status == GoalStatus.STATUS_SUCCEEDED
    assert answer.result.message.startswith('using ')


def test_training_on_what_is_no_run_is_aborted_with_the_reason(client, tmp_path):
    answer = client.result(client.send([str(tmp_path)]))
    assert answer.status == GoalStatus.STATUS_ABORTED
    assert not answer.result.success
    assert str(tmp_path) in answer.result.message


def test_training_takes_limits_of_single_sensors(client, bags):
    answer = client.result(client.send(bags, sensor_limits=['*:range_high:1']))
    assert answer.status == GoalStatus.STATUS_ABORTED
    assert 'and 1 degC' in answer.result.message
    assert re.search(
        r"limits of its own: sensor_limits: \['\w+:range_high:\d+'\]", answer.result.message
    )
    answer = client.result(client.send(bags, sensor_limits=['bed']))
    assert 'sensor_limits: expected SENSOR:LIMIT:VALUE' in answer.result.message


def set_model(observer: Any, path: Path | str) -> Any:
    """Set the parameter model; return the result."""
    value = ParameterValue(type=ParameterType.PARAMETER_STRING, string_value=str(path))
    request = SetParameters.Request(parameters=[Parameter(name='model', value=value)])
    service = '/mill/thermal_predictor/set_parameters'
    return observer.call(SetParameters, service, request, again=AGAIN).results[0]


def test_model_is_a_live_parameter(graph, observer, model_file, model_text, tmp_path):
    configurations = observer.records('node_configuration', NodeConfiguration, LATCHED)
    graph.start('thermal_predictor')
    observer.watch_diagnostics()
    refused = set_model(observer, tmp_path / 'none.json')
    assert not refused.successful
    assert 'none.json: No such file' in refused.reason
    (tmp_path / 'damaged.json').write_text('{}', encoding='utf-8')
    refused = set_model(observer, tmp_path / 'damaged.json')
    assert not refused.successful
    assert 'damaged.json: ' in refused.reason
    assert set_model(observer, model_file).successful
    observer.until(
        lambda: any(
            item.model_hash == text_hash(model_text)
            and json.loads(item.parameters)['model'] == str(model_file)
            for item in configurations
        ),
        'configuration with the model',
    )
    refused = set_model(observer, '')
    assert not refused.successful
    assert 'a model in use stays in use' in refused.reason

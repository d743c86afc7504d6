# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Each node alone: parameters with descriptors, diagnostics, clean ends, refusals."""

import signal
from collections.abc import Callable
from dataclasses import fields
from pathlib import Path
from typing import Any

import pytest
from live_graph import AGAIN
from rcl_interfaces.msg import Parameter, ParameterType, ParameterValue
from rcl_interfaces.srv import DescribeParameters, ListParameters, SetParameters
from tiers import rest_slow

from fuzzycnc_ros.bags.writer import BagWriter
from fuzzycnc_ros.core.config import Config
from fuzzycnc_ros.registry import COMPONENTS
from fuzzycnc_ros.ros.node_config import (
    HostConfig,
    MqttPublisherConfig,
    MtconnectAdapterConfig,
    OpcuaServerConfig,
    PlayerConfig,
    RecorderConfig,
)
from fuzzycnc_ros.ros.presence import TAKEOVER

pytestmark = pytest.mark.ros

NODES = [*COMPONENTS, 'recorder', 'player', 'mqtt_publisher', 'mtconnect_adapter', 'opcua_server']
ALONE = [
    'linuxcnc_bridge',
    'simulated_body',
    'joint_trajectory_bridge',
    'mqtt_publisher',
    'mtconnect_adapter',
]
"""Nodes that no other quick test starts as a process, wherever it runs."""
SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


def schema(node: str) -> list[Any]:
    """Return the declared parameters of a node."""
    records: dict[str, list[type[Config]]] = {
        'recorder': [RecorderConfig],
        'player': [PlayerConfig],
        'mqtt_publisher': [MqttPublisherConfig],
        'mtconnect_adapter': [MtconnectAdapterConfig],
        'opcua_server': [OpcuaServerConfig],
    }
    kinds = records.get(node) or [HostConfig, COMPONENTS[node].CONFIG]
    return [item for kind in kinds for item in fields(kind)]


@pytest.fixture
def needed(tmp_path: Path) -> Callable[[str], dict[str, Any]]:
    """Parameters without which a node has nothing to do."""

    def find(node: str) -> dict[str, Any]:
        if node == 'recorder':
            return {'output': str(tmp_path / 'recorded')}
        if node == 'mqtt_publisher':
            (tmp_path / 'broker.yaml').write_text('host: 127.0.0.1\nport: 9\n')
            return {'broker_file': str(tmp_path / 'broker.yaml')}
        if node in {'mtconnect_adapter', 'opcua_server'}:
            return {'port': 0}
        if node != 'player':
            return {}
        bag = tmp_path / 'played'
        if not bag.exists():
            with BagWriter(bag) as writer:
                writer.add_topic('/mill/note', 'std_msgs/msg/String')
                text = b'\x00\x01\x00\x00\x03\x00\x00\x00hi\x00'
                for second in (1, 600):
                    writer.write('/mill/note', second * 10**9, second * 10**9, text)
        return {'bag': str(bag)}

    return find


@pytest.mark.parametrize(
    ('alone', 'first', 'interrupts'), rest_slow([(ALONE, 0, 'ignored'), (NODES, 1, 'default')], 0)
)
def test_describe_report_and_end(
    graph, observer, root, needed, monkeypatch, alone, first, interrupts
):
    """Each node, `alone` as a process; they are asked to end by one signal or the other."""
    monkeypatch.setenv(TAKEOVER, '1')  # all of those that a machine has one of, side by side
    observer.watch_diagnostics()
    files = {node: root / 'params' / f'{node}.yaml' for node in NODES}
    started = [
        graph.start(node, needed(node), files=(files[node],), interrupts=interrupts)
        for node in alone
    ]
    if together := [node for node in NODES if node not in alone]:
        wanted = {node: needed(node) for node in together}
        given = tuple(files[node] for node in together)
        started.append(
            graph.compose(*together, parameters=wanted, files=given, interrupts=interrupts)
        )
    for node in NODES:
        check_description(observer, node)
    observer.until(
        lambda: (
            {name.partition(':')[0] for name in observer.statuses}
            >= {f'mill/{node}' for node in NODES}
        ),
        f'diagnostics of every node, found {sorted(observer.statuses)}',
    )
    for place, running in enumerate(started, first):
        assert running.interrupt(SIGNALS[place % len(SIGNALS)]) == 0, running.output


def check_description(observer: Any, node: str) -> None:
    """Compare what a node says of its parameters with the schema."""
    items = schema(node)
    names = [item.name for item in items]
    service = f'/mill/{node}'
    listed = observer.call(
        ListParameters, f'{service}/list_parameters', ListParameters.Request(), again=AGAIN
    ).result.names
    assert set(names) <= set(listed), node
    request = DescribeParameters.Request(names=names)
    described = observer.call(
        DescribeParameters, f'{service}/describe_parameters', request, again=AGAIN
    ).descriptors
    for item, descriptor in zip(items, described, strict=True):
        assert item.metadata['doc'] in descriptor.description
        assert f'[{item.metadata["unit"]}]' in descriptor.description
        assert descriptor.read_only is not item.metadata['live']
        ranges = [*descriptor.floating_point_range, *descriptor.integer_range]
        several = isinstance(item.default, tuple) and item.default
        sample = item.default[0] if several else item.default
        bounded = isinstance(sample, (int, float)) and not isinstance(sample, bool)
        assert len(ranges) == bounded, f'{node}: {item.name}'
        for found in ranges:
            bounds = (item.metadata['low'], item.metadata['high'])
            assert (found.from_value, found.to_value) == bounds


@pytest.mark.parametrize('node', NODES)
def test_misspelt_parameter_is_refused(refusal, needed, node):
    line = refusal(node, {**needed(node), 'executer': 'lean'})
    assert 'unknown parameter executer' in line
    assert 'executor' in line


REFUSED = [
    ('simulated_machine', {'seed': -1}, 'seed'),
    ('simulated_machine', {'duties': ['T9']}, 'T9'),
    ('simulated_machine', {'duties': [1, 2]}, 'duties'),
    ('simulated_machine', {'sensor_faults': ['T99:dead:0']}, 'T99'),
    ('temperature_acquisition', {'interval': 0.0}, 'interval'),
    ('temperature_acquisition', {'range_low': 130.0}, 'range_low'),
    ('temperature_acquisition', {'source': 'modem'}, 'source'),
    ('temperature_acquisition', {'source': 'csv'}, 'csv_file'),
    ('temperature_acquisition', {'source': 'csv', 'csv_file': '/none.csv'}, '/none.csv'),
    ('temperature_acquisition', {'source': 'temperature_topics'}, 'temperature_topics'),
    (
        'temperature_acquisition',
        {'source': 'temperature_topics', 'temperature_topics': ['a=/x', 'a=/y']},
        'a more than once',
    ),
    (
        'temperature_acquisition',
        {'source': 'csv', 'csv_file': 'a.csv', 'lockstep': True},
        'sensor_readings',
    ),
    ('sensor_selector', {'clusters': 0}, 'clusters'),
    ('thermal_predictor', {'model': '/none.json'}, '/none.json'),
    ('thermal_predictor', {'gap_max': 'long'}, 'gap_max'),
    ('compensator', {'offset_max': 1.0}, 'offset_max'),
    ('compensator', {'ramp_rate': 1e-6}, 'ramp_rate'),
    ('compensator', {'axes': ['Q']}, 'axes'),
    ('recorder', {}, 'output'),
    ('recorder', {'output': '/proc/none/bag'}, '/proc/none/bag'),
    ('recorder', {'output': 'bag', 'topics': '('}, 'topics'),
    ('mqtt_publisher', {}, 'broker_file'),
    ('mqtt_publisher', {'broker_file': '/none.yaml'}, '/none.yaml'),
    ('mtconnect_adapter', {'port': 70000}, 'port'),
    ('mtconnect_adapter', {'listen': '192.0.2.1'}, 'parameter port: expected a free port on 192'),
    ('opcua_server', {'listen': '0.0.0.0'}, 'parameter certificate: expected a file'),
    ('player', {}, 'bag'),
    ('player', {'bag': '/none'}, '/none'),
]


@pytest.mark.parametrize(('node', 'parameters', 'named'), REFUSED)
def test_impossible_parameter_is_refused(refusal, node, parameters, named):
    assert named in refusal(node, parameters)


@pytest.fixture(scope='module')
def nodes(shared_graph):
    """Nodes whose parameters are set; no test needs the values of another."""
    shared_graph.compose('compensator', 'temperature_acquisition')


@pytest.mark.usefixtures('nodes')
@pytest.mark.parametrize(
    ('node', 'name', 'good', 'bad', 'reason'),
    [
        ('compensator', 'offset_max', 20e-6, 2e-3, 'range'),
        ('compensator', 'slew_max', 0.2e-6, 1e-8, 'ramp_rate'),
        ('temperature_acquisition', 'range_high', 90.0, 2000.0, 'range'),
    ],
)
def test_parameter_set_at_run_time(shared_observer, node, name, good, bad, reason):
    def change(value: float) -> Any:
        wanted = ParameterValue(type=ParameterType.PARAMETER_DOUBLE, double_value=value)
        request = SetParameters.Request(parameters=[Parameter(name=name, value=wanted)])
        service = f'/mill/{node}/set_parameters'
        return shared_observer.call(SetParameters, service, request, again=AGAIN).results[0]

    assert change(good).successful
    refused = change(bad)
    assert not refused.successful
    assert reason in refused.reason
    assert change(good).successful


@pytest.mark.usefixtures('nodes')
def test_fixed_parameter_is_refused_at_run_time(shared_observer):
    value = ParameterValue(type=ParameterType.PARAMETER_DOUBLE, double_value=30.0)
    request = SetParameters.Request(parameters=[Parameter(name='interval', value=value)])
    result = shared_observer.call(
        SetParameters, '/mill/temperature_acquisition/set_parameters', request, again=AGAIN
    ).results[0]
    assert not result.successful
    assert 'interval' in result.reason

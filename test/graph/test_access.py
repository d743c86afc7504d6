# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""What policies allow is what nodes create: nothing is missing, and little is too much."""

import time
from fnmatch import fnmatchcase
from importlib import import_module
from importlib.util import find_spec
from itertools import count

import pytest

pytest.importorskip('rclpy', reason='rclpy is not installed here: run `make test`')

import rclpy

from fuzzycnc_ros.bags.writer import BagWriter
from fuzzycnc_ros.cli.live.operator_client import OperatorClient
from fuzzycnc_ros.cli.live.supervision_monitor import Monitor
from fuzzycnc_ros.graph.access import (
    ACTIONS,
    DASHBOARD,
    MQTT,
    MTCONNECT,
    OPCUA,
    OPERATOR,
    PLAYER,
    PRETENDERS,
    RECORDER,
    access_of,
)
from fuzzycnc_ros.registry import COMPONENTS
from fuzzycnc_ros.runtime.records import CompensationApplied

pytestmark = pytest.mark.ros

DEVICES = """\
devices:
  - name: rtd
    protocol: modbus_tcp
    host: 127.0.0.1
    port: 1
    sensors: {T1: 0}
    spindle_speed: {register: 1}
"""
ENDS = {'_action/send_goal', '_action/cancel_goal', '_action/get_result'}
TOPICS = {'_action/feedback', '_action/status'}


def entities(node, name, space):
    """Return what a node has, as the graph tells it: topics, services, clients."""
    return [
        {topic for topic, _ in ask(name, space)}
        for ask in (
            node.get_publisher_names_and_types_by_node,
            node.get_subscriber_names_and_types_by_node,
            node.get_service_names_and_types_by_node,
            node.get_client_names_and_types_by_node,
        )
    ]


def served(action):
    """Whether an action is there; one of ROS's own needs its messages."""
    return action != 'follow_joint_trajectory' or find_spec('control_msgs') is not None


def settled(node, name, space):
    """Return the same once the graph, which learns a little later, shows all that there is."""
    actions = [f'{space}/{action}/' for action in ACTIONS.get(name, ()) if served(action)]
    there = [
        {item.topic_name for item in node.publishers}
        | {'/rosout'}
        | {action + topic for action in actions for topic in TOPICS},
        {item.topic_name for item in node.subscriptions},
        {item.srv_name for item in node.services}
        | {action + end for action in actions for end in ENDS},
        {item.srv_name for item in node.clients},
    ]
    # What is relative, or the node's own, is told without its namespace.
    there = [{node.resolve_topic_name(item) for item in kind} for kind in there]
    deadline = time.monotonic() + 60.0
    while True:
        has = entities(node, name, space)
        if all(some <= every for some, every in zip(there, has, strict=True)):
            return has
        assert time.monotonic() < deadline, (there, has)
        time.sleep(0.01)


def allowed(name, space='/mill'):
    """Return the patterns of what it may have, in the same order."""
    access = access_of(name)

    def absolute(names):
        for item in names:
            if item.startswith('~'):
                yield f'{space}/{name}{item[1:]}'.replace('//', '/')
            else:
                yield item if item.startswith('/') else f'{space}/{item}'.replace('//', '/')

    return [
        {*absolute(access.publish), *absolute(f'{a}/{t}' for a in access.execute for t in TOPICS)},
        {*absolute(access.subscribe), *absolute(f'{a}/{t}' for a in access.call for t in TOPICS)},
        {*absolute(access.reply), *absolute(f'{a}/{e}' for a in access.execute for e in ENDS)},
        {*absolute(access.request), *absolute(f'{a}/{e}' for a in access.call for e in ENDS)},
    ]


def denied(has, patterns):
    """Return what a node has that no pattern allows."""
    return {
        name
        for names, some in zip(has, patterns, strict=True)
        for name in names
        if not any(fnmatchcase(name, pattern) for pattern in some)
    }


@pytest.fixture
def created(domain, monkeypatch, tmp_path):
    """Create a node with parameters; return what it has."""
    monkeypatch.setenv('ROS_DOMAIN_ID', str(domain))
    monkeypatch.setenv('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')

    # A node that is gone stays in the graph for a while, in place of another of its name.
    number = count()

    def create(name, **parameters):
        space = f'/mill_{next(number)}'
        switches = [w for key, value in parameters.items() for w in ('-p', f'{key}:={value}')]
        rclpy.init(args=['--ros-args', '-r', f'__ns:={space}', *switches])
        try:
            host = import_module(f'fuzzycnc_ros.nodes.{name}').make()
            try:
                return [
                    {item.replace(f'{space}/', '/mill/') for item in kind}
                    for kind in settled(host.node, name, space)
                ]
            finally:
                host.stop()
                host.node.destroy_node()
        finally:
            rclpy.shutdown()

    return create


@pytest.mark.parametrize('name', list(COMPONENTS))
def test_a_policy_is_what_the_node_creates(created, tmp_path, name):
    variants = [
        {'lockstep': lockstep, 'use_sim_time': sim}
        for lockstep, sim in (('false', 'true'), ('true', 'false'))
    ]
    if name == 'temperature_acquisition':
        pytest.importorskip('pymodbus')
        path = tmp_path / 'devices.yaml'
        path.write_text(DEVICES)
        variants += [{'source': 'devices', 'device_file': path}]
    if name == 'probe_cycle':
        variants += [{'result_file': tmp_path / 'results.txt'}]
    if name == 'simulated_machine':
        nodes = ','.join(other for other in COMPONENTS if other not in PRETENDERS)
        variants[1] |= {'lockstep_nodes': f'[{nodes}]', 'lockstep_recorder': 'true'}
    found = [created(name, **variant) for variant in variants]
    every = [set().union(*kind) for kind in zip(*found, strict=True)]
    assert denied(every, allowed(name)) == set()
    unused = [may - does for may, does in zip(allowed(name), every, strict=True)]
    # Topics of sensors come with the first sample, frames and goals with messages of ROS.
    later = {'/mill/temperature/*'}
    later |= set() if find_spec('tf2_msgs') else {'/tf', '/tf_static'}
    actions = [action for action in ACTIONS.get(name, ()) if not served(action)]
    later |= {f'/mill/{action}/{end}' for action in actions for end in ENDS | TOPICS}
    assert [names - later for names in unused] == [set()] * 4


def test_recorder_and_player_have_what_they_need(created, tmp_path):
    bag = tmp_path / 'played'
    with BagWriter(bag) as writer:
        writer.add_topic('/mill/note', 'std_msgs/msg/String')
        text = b'\x00\x01\x00\x00\x03\x00\x00\x00hi\x00'
        writer.write('/mill/note', 10**9, 10**9, text)
    for lockstep in ('false', 'true'):
        for name, own in (
            (RECORDER, {'output': tmp_path / f'recorded-{lockstep}'}),
            (PLAYER, {'bag': bag, 'use_sim_time': 'true'}),
        ):
            has = created(name, lockstep=lockstep, **own)
            assert denied(has, allowed(name)) == set(), (name, lockstep)


@pytest.mark.parametrize('name', [MQTT, MTCONNECT, OPCUA])
def test_who_hands_reports_on_has_what_it_needs(created, tmp_path, name):
    given = {'port': 0}
    if name == MQTT:
        pytest.importorskip('paho')
        path = tmp_path / 'broker.yaml'
        path.write_text('host: 127.0.0.1\nport: 9\n')
        given = {'broker_file': path}
    has = created(name, **given)
    assert denied(has, allowed(name)) == set()
    assert [may - does for may, does in zip(allowed(name), has, strict=True)] == [
        set(),
        {'/clock'},
        set(),
        set(),
    ]


def test_the_page_has_what_it_needs(created):
    pytest.importorskip('starlette')
    has = created(DASHBOARD, port=0)
    assert denied(has, allowed(DASHBOARD)) == set()
    assert allowed(DASHBOARD)[1] - has[1] == {'/clock'}


def test_the_operator_may_create_what_it_creates_and_ask_every_node(created):
    with OperatorClient('mill') as operator:
        has = settled(operator.node, OPERATOR, '/mill')
    assert denied(has, allowed(OPERATOR)) == set()
    monitor = Monitor(['mill'])
    try:
        monitor.listen('mill', CompensationApplied, 'compensation_applied')
        has = settled(monitor.operator.node, OPERATOR, '/')
    finally:
        monitor.close()
    # Its node stands outside of the machine, under the same enclave.
    here, outside = allowed(OPERATOR), allowed(OPERATOR, '/')
    assert denied(has, [a | b for a, b in zip(here, outside, strict=True)]) == set()
    asked = allowed(OPERATOR)[3]
    for name in COMPONENTS:
        assert allowed(name)[2] <= asked, name

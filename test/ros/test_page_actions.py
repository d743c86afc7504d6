# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Recordings that are begun on the page: their names, and their end with the page."""

import asyncio
import contextlib
import sys
from concurrent.futures import Future
from types import SimpleNamespace

import pytest

pytest.importorskip('rclpy', reason='rclpy is not installed here: run `make test`')

from lifecycle_msgs.srv import GetState
from processes import HANG, wait_for

from fuzzycnc_ros.ros import page_actions
from fuzzycnc_ros.ros.page_actions import Actions
from fuzzycnc_ros.ros.presence import GraphError

pytestmark = pytest.mark.ros

RECORDER = """
import os, signal, sys, time
bag, code = sys.argv[1:]
def close(number, frame):
    while not os.path.exists(f'{bag}/room'):
        time.sleep(0.01)
    sys.exit(int(code))
signal.signal(signal.SIGTERM, close)
os.makedirs(bag)
while True:
    signal.pause()
"""
"""Stands for a recorder that has closed its bag when there is room for it."""


class Node:
    """Stands for the node of the page: its thread is that of the test, and recorders listen."""

    def create_guard_condition(self, work):
        return SimpleNamespace(trigger=work)

    def create_publisher(self, *_, **__):
        return SimpleNamespace(publish=lambda message: None)

    def get_subscriptions_info_by_topic(self, topic):
        namespace = topic.rpartition('/')[0]
        return [SimpleNamespace(node_namespace=namespace, node_name='recorder')]

    def get_name(self):
        return 'dashboard'


@pytest.fixture
def record(tmp_path, monkeypatch):
    """Begin a recording of a machine on a page whose recorders end with a code."""
    begun = []

    def begin(*machines, code=0):
        command = [sys.executable, '-c', RECORDER]
        monkeypatch.setattr(
            page_actions, 'recorder_command', lambda bag, machine: [*command, str(bag), str(code)]
        )
        actions = Actions(Node(), tmp_path)
        for machine in machines:
            actions.join(machine)
            view = SimpleNamespace(machine=machine, living_nodes=(), stamp=0)
            asyncio.run(actions.act(view, 'record', {'start': True}))
            begun.append(actions._recorders[machine])
            wait_for(begun[-1][1].exists, 'the recorder has begun')
        return actions

    yield begin
    for process, _ in begun:
        with contextlib.suppress(ProcessLookupError):
            process.kill()
        process.wait()


def test_machines_whose_names_look_alike_have_bags_of_their_own(record):
    actions = record('shop/mill', 'shop_mill', 'mill')
    names = [actions.recording(name) for name in ('shop/mill', 'shop_mill', 'mill')]
    assert [name.rsplit('_', 2)[0] for name in names] == ['shop-mill', 'shop_mill', 'mill']


def test_a_recorder_that_takes_longer_than_its_page_ends_whole(record, monkeypatch):
    monkeypatch.setattr(page_actions, 'RECORDER_STOP', 0.0)
    actions = record('mill')
    ((process, bag),) = actions._recorders.values()
    (told,) = actions.close()
    assert f'{bag.name} is not closed after 0 s' in told
    assert f'process {process.pid}, goes on' in told
    (bag / 'room').touch()
    assert process.wait(HANG) == 0


def test_a_recorder_that_fails_as_its_page_ends_is_named(record):
    actions = record('mill', 'lathe', code=1)
    bags = [bag for _, bag in actions._recorders.values()]
    for bag in bags:
        (bag / 'room').touch()
    assert actions.close() == [
        f'the recorder of {bag.name} ended with code 1; make the bag whole with fuzzycnc info '
        '--repair'
        for bag in bags
    ]


def test_a_recording_that_cannot_be_read_is_no_success(record):
    actions = record('mill')
    ((_, bag),) = actions._recorders.values()
    (bag / 'room').touch()
    (told,) = actions.close()
    assert bag.name in told
    assert 'metadata.yaml' in told


def test_a_transition_whose_answer_is_lost_is_seen_in_the_state(record, monkeypatch):
    actions = record()
    state = ['inactive']

    async def call(kind, name, request, **_):
        if kind is GetState:
            answer = GetState.Response()
            answer.current_state.label = state[-1]
            return answer
        state.append({'activate': 'active', 'deactivate': 'unheard'}[request.transition.label])
        raise GraphError(f'{name} did not answer')

    monkeypatch.setattr(actions, '_call', call)
    view = SimpleNamespace(machine='mill', nodes=('compensator',))
    assert asyncio.run(actions._activate(view, {}, 'anna')) == 'compensator is active'
    with pytest.raises(GraphError, match='change_state did not answer'):
        asyncio.run(actions._deactivate(view, {}, 'anna'))


class Busy:
    """Stands for the client of a node that drops the first answers."""

    def __init__(self, dropped):
        self.dropped, self.asked = dropped, 0

    def service_is_ready(self):
        return True

    def call_async(self, request):
        self.asked += 1
        future = Future()
        if self.asked > self.dropped:
            answer = GetState.Response()
            answer.current_state.label = 'active'
            future.set_result(answer)
        return future


def test_a_node_that_drops_an_answer_is_asked_for_its_state_again(record, monkeypatch):
    monkeypatch.setattr(page_actions, 'ANSWERED', 0.1)
    actions = record()
    view = SimpleNamespace(machine='mill')
    for busy in (Busy(2), Busy(3)):
        monkeypatch.setattr(Node, 'create_client', lambda *_, busy=busy: busy, raising=False)
        monkeypatch.setattr(Node, 'destroy_client', lambda *_: None, raising=False)
        asked = actions._lifecycle(view, 'compensator')
        if busy.dropped == 2:
            assert asyncio.run(asked) == 'active'
        else:
            with pytest.raises(GraphError, match='get_state did not answer'):
                asyncio.run(asked)
        assert busy.asked == 3

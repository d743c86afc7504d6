# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Recordings that are begun on the page: their names, and their end with the page."""

import asyncio
import contextlib
import sys
import threading
from concurrent.futures import Future
from types import SimpleNamespace

import pytest

pytest.importorskip('rclpy', reason='rclpy is not installed here: run `make test`')

from lifecycle_msgs.srv import ChangeState, GetState
from processes import HANG, wait_for

from fuzzycnc_ros.graph import page_actions
from fuzzycnc_ros.graph.page_actions import Actions
from fuzzycnc_ros.ros.presence import GraphError
from fuzzycnc_ros.runtime.host import FINALIZED

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
    assert [name.rsplit('_', 3)[0] for name in names] == ['shop-mill', 'shop_mill', 'mill']


def test_bags_that_are_begun_within_a_second_have_names_of_their_own(tmp_path):
    names = []
    for now in (5.25, 5.5, 5.5, 5.5, 6.0):
        bag = page_actions._new_bag(tmp_path, 'mill', now)
        bag.mkdir()
        names.append(bag.name.removeprefix('mill_19700101_0000'))
    assert names == ['05_250', '05_500', '05_500_2', '05_500_3', '06_000']


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


def test_what_somebody_else_has_just_done_is_no_refusal(record, monkeypatch):
    """Of two that deactivate at once the second is refused by the node."""
    actions, states = record(), ['active', 'inactive', 'active', 'active']

    async def call(kind, name, request, **_):
        if kind is not GetState:
            return ChangeState.Response(success=False)
        answer = GetState.Response()
        answer.current_state.label = states.pop(0)
        return answer

    monkeypatch.setattr(actions, '_call', call)
    view = SimpleNamespace(machine='mill', nodes=('compensator',))
    assert 'is inactive' in asyncio.run(actions._deactivate(view, {}, 'anna'))
    with pytest.raises(GraphError, match='refuses to deactivate'):
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


class Hung:
    """Stands for a node whose thread does nothing any more, from a number of jobs on."""

    def __init__(self, jobs=0):
        self.jobs, self.asked = jobs, []

    def ask(self, job):
        future = Future()
        self.asked.append(future)
        if len(self.asked) <= self.jobs:
            future.set_result(job())
        return future


MILL = SimpleNamespace(machine='mill', nodes=('compensator',), living_nodes=(), stamp=0)


@pytest.mark.parametrize('jobs', [0, 1])
@pytest.mark.parametrize(
    ('action', 'body'),
    [
        ('reference', {}),
        ('activate', {}),
        ('deactivate', {}),
        ('probe', {'values': {'Y': 1e-6}}),
        ('forget', {'mode': 'undo', 'why': 'chip'}),
        ('record', {'start': True}),
    ],
)
def test_an_action_ends_though_its_node_hangs(record, monkeypatch, action, body, jobs):
    """A machine that stays busy would refuse everything after that."""
    monkeypatch.setattr(page_actions, 'TAKEN_UP', 0.05)
    actions = record()
    monkeypatch.setattr(Node, 'create_client', lambda *_: Busy(9), raising=False)
    monkeypatch.setattr(Node, 'count_publishers', lambda *_: 0, raising=False)
    monkeypatch.setattr(actions, '_start_recorder', lambda *_: SimpleNamespace(poll=lambda: None))
    hung = Hung(jobs)
    monkeypatch.setattr(actions.thread, 'ask', hung.ask)
    view = SimpleNamespace(**vars(MILL), newest=lambda _: None)
    for _ in range(2):  # it can be tried again
        with pytest.raises(GraphError, match='dashboard itself did not get to it'):
            asyncio.run(actions.act(view, action, body))
    assert all(job.done() for job in hung.asked), 'what was given up would still be done'


@pytest.mark.parametrize(
    ('body', 'naming'),
    [
        ({'mode': 'undo'}, 'why: expected a reason'),
        ({'mode': 'undo', 'why': ' '}, 'why: expected a reason'),
        ({'mode': 'undo', 'why': 'x' * 201}, 'why: expected a reason'),
        ({'mode': 'undo', 'why': 5}, 'why: expected a reason'),
        ({'why': 'chip'}, 'mode: expected one of widen, undo, all but found None'),
        ({'mode': ['undo'], 'why': 'chip'}, 'mode: expected one of'),
    ],
)
def test_forgetting_needs_a_mode_and_a_reason(record, body, naming):
    with pytest.raises(GraphError, match=naming):
        asyncio.run(record()._forget(MILL, body, 'anna'))


def test_what_is_forgotten_is_asked_of_the_predictor_once(record, monkeypatch):
    actions, asked = record(), []

    async def call(_, name, request, *, times=1):
        asked.append((name, request.mode, request.why, request.by, times))
        return SimpleNamespace(success=len(asked) < 2, message='said')

    monkeypatch.setattr(actions, '_call', call)
    body = {'mode': 'all', 'why': 'sign\x1b[2J'}
    assert asyncio.run(actions._forget(MILL, body, 'anna')) == 'said'
    assert asked == [('/mill/forget_thermal_posterior', 2, 'sign\\x1b[2J', 'anna', 1)]
    with pytest.raises(GraphError, match='said'):
        asyncio.run(actions._forget(MILL, body, 'anna'))


def test_a_recorder_that_is_not_started_in_time_is_named(record, monkeypatch):
    monkeypatch.setattr(page_actions, 'TAKEN_UP', 0.05)
    actions, go_on = record(), threading.Event()
    monkeypatch.setattr(actions, '_start_recorder', lambda *_: go_on.wait(HANG))
    with pytest.raises(GraphError, match='no recorder was started within'):
        asyncio.run(actions.act(MILL, 'record', {'start': True}))
    go_on.set()


def test_an_action_as_a_whole_ends(record, monkeypatch):
    monkeypatch.setattr(page_actions, 'CARRIED_OUT', 0.05)
    actions = record()

    async def endless(*_):
        await asyncio.Event().wait()

    monkeypatch.setitem(actions._carry, 'probe', endless)
    for _ in range(2):
        with pytest.raises(GraphError, match='mill: probe did not end within'):
            asyncio.run(actions.act(MILL, 'probe', {}))


class Compensator:
    """Stands for a managed node that takes its time over a transition, until it is let go on."""

    def __init__(self):
        self.state, self.heard, self.go_on = 'inactive', [], asyncio.Event()

    async def lifecycle(self, view, node):
        return self.state

    async def transition(self, view, node, label):
        self.heard.append(label)
        if label == 'activate':
            await self.go_on.wait()
        self.state = {'configure': 'inactive', 'activate': 'active'}.get(label, 'inactive')


@pytest.mark.parametrize('other', ['record', 'activate'])
def test_deactivate_is_never_refused_for_what_is_under_way(record, monkeypatch, other):
    actions = record()
    begun = []

    async def scenario():
        node = Compensator()
        monkeypatch.setattr(actions, '_lifecycle', node.lifecycle)
        monkeypatch.setattr(actions, '_transition', node.transition)

        async def recording(*_):
            begun.append('record')
            await node.go_on.wait()
            return 'recording'

        monkeypatch.setitem(actions._carry, 'record', recording)
        if other == 'record':
            node.state = 'active'
        under_way = asyncio.create_task(actions.act(MILL, other, {}))
        while not (node.heard or begun):
            await asyncio.sleep(0)
        with pytest.raises(GraphError, match='another action is under way'):
            await actions.act(MILL, 'probe', {})
        off = asyncio.create_task(actions.act(MILL, 'deactivate', {}))
        if other == 'record':
            await off  # it waits for nothing
        node.go_on.set()
        await under_way
        assert await off == 'compensator is inactive and goes on until it is at rest'
        assert node.state == 'inactive'
        assert node.heard[-1] == 'deactivate'

    actions.join('mill')
    asyncio.run(scenario())


def test_an_activation_does_not_come_behind_a_deactivation(record, monkeypatch):
    actions = record()

    async def scenario():
        node = Compensator()
        node.state = 'unconfigured'
        monkeypatch.setattr(actions, '_lifecycle', node.lifecycle)

        async def transition(view, name, label):
            node.heard.append(label)
            await node.go_on.wait()

        monkeypatch.setattr(actions, '_transition', transition)
        on = asyncio.create_task(actions.act(MILL, 'activate', {}))
        while not node.heard:
            await asyncio.sleep(0)
        off = asyncio.create_task(actions.act(MILL, 'deactivate', {}))
        while not actions._off:
            await asyncio.sleep(0)
        node.go_on.set()
        assert await off == 'compensator is not active'
        with pytest.raises(GraphError, match='being deactivated'):
            await on
        assert node.heard == ['configure']

    actions.join('mill')
    asyncio.run(scenario())


def test_a_node_that_was_shut_down_cannot_be_activated(record, monkeypatch):
    actions = record()
    node = Compensator()
    node.state = FINALIZED
    monkeypatch.setattr(actions, '_lifecycle', node.lifecycle)
    monkeypatch.setattr(actions, '_transition', node.transition)
    with pytest.raises(GraphError, match='compensator was shut down for good; end its process'):
        asyncio.run(actions.act(MILL, 'activate', {}))
    assert node.heard == []


def test_a_recording_begins_though_the_last_recorder_is_still_told_of(record):
    """It has ended; the graph says so a moment later."""

    class View(SimpleNamespace):
        told = iter([('recorder',), ('recorder',), ()])

        @property
        def living_nodes(self):
            return next(self.told)

    actions = record()
    actions.join('mill')
    asyncio.run(actions.act(View(machine='mill', stamp=0), 'record', {'start': True}))
    process, _ = actions._recorders['mill']
    process.kill()
    assert process.wait(HANG)


def test_a_recorder_of_somebody_else_is_no_second_one(record, monkeypatch):
    monkeypatch.setattr(page_actions, 'PATIENCE', 0.0)
    view = SimpleNamespace(machine='mill', living_nodes=('recorder',), stamp=0)
    actions = record()
    actions.join('mill')
    with pytest.raises(GraphError, match='recorded already'):
        asyncio.run(actions.act(view, 'record', {'start': True}))

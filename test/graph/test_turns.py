# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Turns of a node that is not scheduled for a while, as on a busy host: it misses nothing."""

import signal
import time
from dataclasses import replace
from types import SimpleNamespace

import pytest
from live_graph import ANSWER_TIMEOUT

from fuzzycnc_ros.components.machine.simulated_machine import (
    SimulatedMachine,
    SimulatedMachineConfig,
)
from fuzzycnc_ros.graph.sequencer import BACKLOG, Participant, Sequencer
from fuzzycnc_ros.ros.topics import RCLPY, create_publisher, routes_matched
from fuzzycnc_ros.runtime.component import STREAM
from fuzzycnc_ros.runtime.convert import encode

pytestmark = pytest.mark.ros

READER = 'feedrate_scheduler'
QUEUE = 512
"""Messages that Fast DDS queues for a process in shared memory."""
PAUSE = 0.1
"""Wall time [s] in which a reader that goes on takes what is queued; what comes then is heard."""


class Ticking:
    """A machine that publishes states of its axes, some in each tick."""

    def __init__(self, graph, observer, *, ticks, states):
        self.reader = graph.start(READER, {'lockstep': True, 'autostart': True})
        self.observer = observer
        self.records = samples()
        self.publishers = {
            name: create_publisher(observer.node, record.TYPE, name, STREAM)
            for name, record in self.records.items()
        }
        self.counts = {item.topic_name: 0 for item in self.publishers.values()}
        self.ticks, self.states = ticks, states
        self.tick = self.stamp = 0
        self.over = False
        self.sequencer = Sequencer(
            observer.node,
            (READER,),
            advance=self.advance,
            published=lambda: dict(self.counts),
            matched=lambda readers: routes_matched(
                observer.node, (), self.publishers.values(), readers
            ),
            finished=self.finish,
            recorder=False,
            answer_timeout=ANSWER_TIMEOUT,
        )

    def finish(self):
        self.over = True

    def advance(self):
        if self.tick == self.ticks:
            return None
        self.tick += 1
        self.publish_states()
        return self.stamp

    def publish_states(self):
        for _ in range(self.states):
            self.stamp += 1_000_000
            self.publish('axis_state')

    def publish(self, name):
        record = replace(self.records[name], stamp=self.stamp)
        self.publishers[name].publish(encode(record, RCLPY))
        self.counts[self.publishers[name].topic_name] += 1

    def run(self):
        """Go on to the end; the reader misses nothing."""
        self.observer.until(lambda: self.over, f'{self.ticks} ticks')
        assert (self.sequencer.missed, self.sequencer.lost) == (0, [])


class Flooding(Ticking):
    """It stops its reader in each tick, until more has come than can be queued."""

    def publish_states(self):
        self.reader.send(signal.SIGSTOP)
        super().publish_states()
        self.reader.send(signal.SIGCONT)
        time.sleep(PAUSE)  # else its turn would be dropped too, and come with the states
        self.publish('machine_state')


class Waiting(Ticking):
    """It notes how many states its reader has had no turn for, at each tick."""

    def __init__(self, *arguments, **settings):
        super().__init__(*arguments, **settings)
        self.waiting = []

    def publish_states(self):
        super().publish_states()
        topic = self.publishers['axis_state'].topic_name
        (reader,) = self.sequencer._participants
        self.waiting.append(self.counts[topic] - reader.seen.get(topic, 0))


def samples():
    """Return an idle machine's first states."""
    machine = SimulatedMachine(SimulatedMachineConfig(duties=(), paths=('infinity',)))
    found = {emission.output: emission.record for _ in range(20) for emission in machine.tick()}
    return {name: found[name] for name in ('axis_state', 'machine_state')}


def test_what_was_dropped_on_the_way_is_waited_for(graph, observer):
    Flooding(graph, observer, ticks=6, states=QUEUE + 200).run()


def test_a_machine_does_not_run_away_from_its_reader(graph, observer):
    """States of the axes alone give it no turn, but not more may wait than can be queued."""
    machine = Waiting(graph, observer, ticks=4 * QUEUE, states=1)
    machine.run()
    assert max(machine.waiting) == BACKLOG < QUEUE / 2


def test_who_stood_still_itself_does_not_take_it_for_the_silence_of_others(graph, observer):
    """An answer that waits to be taken is in time, however late the timer before it is."""
    machine = Ticking(graph, observer, ticks=10**6, states=1)
    observer.until(lambda: machine.tick > 10, 'ticks')
    (reader,) = machine.sequencer._participants
    reader.timeout = 1.0
    for _ in range(3):
        observer.until(lambda: machine.sequencer._waiting, 'a turn is given')
        time.sleep(1.5 * reader.timeout)
        tick = machine.tick
        observer.until(lambda tick=tick: machine.tick > tick, 'the next tick')
    machine.ticks = machine.tick
    machine.run()


def test_a_turn_is_given_for_what_is_new_and_matters():
    course = SimpleNamespace(tick=2, _programme_over=False, _stamp=100)
    item = Participant('compensator', None, 1.0, reads=('a', 'b'), quiet=frozenset({'b'}))
    item.seen = {'a': 500, 'b': 700}

    def due(a, b):
        return Sequencer._due(course, item, {'a': a, 'b': b, 'c': 9})

    assert due(501, 700)
    assert not due(500, 700)
    assert not due(500, 701)
    assert due(500, 700 + BACKLOG)
    item.next_deadline = 101
    assert not due(500, 700)
    item.next_deadline = 100
    assert due(500, 700)
    item.every = 3
    assert not due(501, 700)
    course._programme_over = True
    assert due(501, 700)

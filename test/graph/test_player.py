# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The player at a rate: order, time, QoS, choice of topics and stretches, repetition."""

from itertools import pairwise
from types import SimpleNamespace

import numpy as np
import pytest
from rosgraph_msgs.msg import Clock

from fuzzycnc_ros.bags.metadata import LATCHED, STREAM
from fuzzycnc_ros.bags.playback import PlayedMessage, by_stamp
from fuzzycnc_ros.bags.typestore import ROSBAGS, serialize
from fuzzycnc_ros.bags.writer import BagWriter
from fuzzycnc_ros.nodes.player import CLOCK_PERIOD, PlayerNode
from fuzzycnc_ros.runtime.component import Durability
from fuzzycnc_ros.runtime.convert import encode, stamp_of
from fuzzycnc_ros.runtime.records import (
    SECOND,
    Displacement,
    Temperatures,
    ThermalReference,
)

pytestmark = pytest.mark.ros

SAMPLES = 60
"""Seconds in the bag, one sample each."""
FOUND = 3.0
"""Wall time [s] in which readers are found: the player begins without those it does not know."""


def temperatures(second):
    return Temperatures(
        stamp=second * SECOND,
        frame_id='mill/machine',
        sensor=('T1', 'T2'),
        temperature=np.array([20.0 + second, 30.0]),
        status=np.zeros(2, np.uint8),
        readings=5,
    )


def displacement(second):
    return Displacement(
        stamp=second * SECOND,
        frame_id='mill/workpiece',
        axis=('Y',),
        channel=('Y',),
        displacement=np.array([1e-6 * second]),
        standard_deviation=np.array([np.nan]),
        includes_compensation=False,
    )


def reference(second):
    return ThermalReference(
        stamp=second * SECOND,
        frame_id='mill/machine',
        cold_since=SECOND,
        set_by='test',
        sensor=('T1', 'T2'),
        temperature=np.array([20.0, 30.0]),
        samples=3,
    )


@pytest.fixture
def bag(tmp_path):
    """A minute of two topics, a latched one near the beginning, and plumbing."""
    path = tmp_path / 'bag'
    with BagWriter(path) as writer:
        writer.add_topic('/mill/temperatures', Temperatures.TYPE, STREAM)
        writer.add_topic('/mill/displacement', Displacement.TYPE, STREAM)
        writer.add_topic('/mill/thermal_reference', ThermalReference.TYPE, LATCHED)
        writer.add_topic('/mill/tick_answer', 'std_msgs/msg/String', STREAM)
        for second in range(1, SAMPLES + 1):
            records = [('temperatures', temperatures(second))]
            records.append(('displacement', displacement(second)))
            if second == 3:
                records.append(('thermal_reference', reference(second)))
            for name, record in records:
                payload = serialize(encode(record, ROSBAGS))
                writer.write(f'/mill/{name}', second * SECOND, second * SECOND, payload)
            text = b'\x00\x01\x00\x00\x01\x00\x00\x00\x00'
            writer.write('/mill/tick_answer', second * SECOND, second * SECOND, text)
    return path


def play(graph, bag, **parameters):
    """Start the player fast."""
    return graph.start(
        'player', {'bag': str(bag), 'rate': 100.0, 'start_delay': FOUND, **parameters}
    )


def test_everything_but_plumbing_with_clock(graph, observer, bag):
    clock = []
    observer.node.create_subscription(Clock, '/clock', lambda m: clock.append(m.clock), 1000)
    sampled = observer.records('temperatures', Temperatures)
    moved = observer.records('displacement', Displacement)
    player = play(graph, bag)
    assert observer.until_ended(player) == 0
    assert player.outcome == {'messages': 2 * SAMPLES + 1}
    assert [item.stamp // SECOND for item in sampled] == list(range(1, SAMPLES + 1))
    assert [item.temperature[0] for item in sampled] == [20.0 + k for k in range(1, SAMPLES + 1)]
    assert [item.stamp for item in moved] == [item.stamp for item in sampled]
    times = [stamp_of(time) for time in clock]
    assert times[0] == SECOND
    assert times[-1] == SAMPLES * SECOND
    assert all(before <= after for before, after in pairwise(times))
    assert set(range(1, SAMPLES + 1)) <= {time // SECOND for time in times}
    assert '/mill/tick_answer' not in dict(observer.node.get_topic_names_and_types())


def test_latched_topics_stay_latched(graph, observer, bag):
    """Also from a later start: a reader that comes late gets the reference in force."""
    sampled = observer.records('temperatures', Temperatures)
    play(graph, bag, start=20.0, end=59.0, rate=20.0)
    observer.until(lambda: sampled, 'temperatures')
    told = observer.records('thermal_reference', ThermalReference, Durability.LATCHED)
    observer.until(lambda: told, 'the reference')
    assert told[0].stamp == 3 * SECOND
    assert sampled[0].stamp == 21 * SECOND


def test_stretch_topics_and_namespace(graph, observer, bag):
    sampled = observer.records('/lathe/temperatures', Temperatures)
    moved = observer.records('/lathe/displacement', Displacement)
    player = graph.start(
        'player',
        {
            'bag': str(bag),
            'rate': 100.0,
            'start_delay': FOUND,
            'start': 10.0,
            'end': 20.0,
            'topics': 'temperatures',
            'keep_namespace': False,
        },
        namespace='/lathe',
    )
    assert observer.until_ended(player) == 0
    assert player.outcome == {'messages': 10}
    assert [item.stamp // SECOND for item in sampled] == list(range(11, 21))
    assert moved == []


def test_repetition_moves_stamps_on(graph, observer, bag):
    sampled = observer.records('temperatures', Temperatures)
    player = play(graph, bag, loop=True, restamp=True, rate=200.0, topics='temperatures|disp')
    observer.until(lambda: len(sampled) > 3 * SAMPLES, 'three repetitions')
    assert player.interrupt() == 0
    assert [item.stamp // SECOND for item in sampled[: 3 * SAMPLES]] == list(
        range(1, 3 * SAMPLES + 1)
    )
    values = [item.temperature[0] for item in sampled]
    assert values[SAMPLES : 2 * SAMPLES] == values[:SAMPLES]


@pytest.mark.parametrize(
    ('parameters', 'named'),
    [
        ({'topics': 'humidity'}, '/mill/temperatures (60)'),
        ({'start': 100.0}, '59.000 s long'),
        ({'start': 10.0, 'end': 5.0}, 'must lie behind start'),
        ({'lockstep': True, 'loop': True}, 'restamp'),
        ({'topics': '('}, 'regular expression'),
    ],
)
def test_impossible_wishes_are_refused(refusal, bag, parameters, named):
    assert named in refusal('player', {'bag': str(bag), **parameters})


def test_empty_and_truncated_bags_are_refused(refusal, bag, tmp_path):
    empty = tmp_path / 'empty'
    with BagWriter(empty) as writer:
        writer.add_topic('/mill/temperatures', Temperatures.TYPE, STREAM)
    assert 'no messages at all' in refusal('player', {'bag': str(empty)})
    file = bag / 'bag_0.mcap'
    file.write_bytes(file.read_bytes()[:-200])
    line = refusal('player', {'bag': str(bag)})
    assert 'truncated' in line
    assert 'fuzzycnc info --repair' in line


def test_by_stamp_puts_late_messages_in_their_place():
    def message(stamp, log_time):
        return PlayedMessage('/a', log_time, stamp, b'')

    source = [message(1, 1), message(2, 2), message(4, 3), message(3, 4), message(5, 5)]
    assert [m.stamp for m in by_stamp(iter(source))] == [1, 2, 3, 4, 5]
    # What comes later than is held back goes with the stamp being played.
    assert [m.stamp for m in by_stamp(iter([message(9, 1), message(1, 2)]), held=0)] == [9, 9]


def test_time_passes_between_messages_but_not_past_the_next():
    sent = []
    following = PlayedMessage('/a', 0, 12 * SECOND, b'')
    player = SimpleNamespace(
        _machine_time=10 * SECOND,
        _machine_time_at=3 * SECOND,
        _clock_sent=0.0,
        _playback=SimpleNamespace(next=following, timing={'/a'}),
        _send_clock=sent.append,
    )
    for now, due in ((CLOCK_PERIOD, 3.5), (1.5 * CLOCK_PERIOD, 3.6), (1.0, 4.0), (2.0, 9.0)):
        PlayerNode._keep_time(player, now, round(due * SECOND))
    # The second one came before a period had passed.
    assert sent == [round(at * SECOND) for at in (10.5, 11.0, 12.0)]
    player._playback.timing = set()
    PlayerNode._keep_time(player, 3.0, 9 * SECOND)
    PlayerNode._keep_time(player, 4.0, 1 * SECOND)  # back never
    assert sent[3:] == [16 * SECOND, 10 * SECOND]

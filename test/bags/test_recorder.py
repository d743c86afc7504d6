# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The recording thread: order, counts of every loss, errors of the thread."""

import errno
import json
import re
import threading

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fuzzycnc_ros.bags.errors import BagTopicError, BagWriteError
from fuzzycnc_ros.bags.reader import BagReader
from fuzzycnc_ros.bags.recorder import (
    MODULUS,
    NO_TIME,
    REPORT_NAME,
    UNSUPPORTED,
    RecordingThread,
    SequenceCounter,
)
from fuzzycnc_ros.bags.repair import repair
from fuzzycnc_ros.bags.writer import BagWriter

NUMBER = 'std_msgs/msg/UInt64'


def payload(number):
    return b'\x00\x01\x00\x00' + number.to_bytes(8, 'little')


def missing(numbers, publisher=None):
    counter = SequenceCounter()
    for number in numbers:
        counter.update(number, publisher)
    return counter.missing


# Gaps


@pytest.mark.parametrize(
    ('numbers', 'expected'),
    [
        ([], 0),
        ([500, 501, 502], 0),
        ([1, 2, 5, 6, 10], 5),
        ([UNSUPPORTED, UNSUPPORTED, None, 1, 2], 0),
        ([7, 8, 9, 1, 2, 3], 0),
        ([7, 8, 9, 1, 3], 1),
    ],
)
def test_gaps_of_one_publisher(numbers, expected):
    assert missing(numbers) == expected
    assert missing(numbers, 'gid') == expected


def test_number_at_the_end_of_the_range_wraps():
    # 2^64 - 1 itself means that there are no numbers, so it is skipped.
    assert missing([MODULUS - 2, 0, 1], 'gid') == 1
    assert missing([MODULUS - 2, 2], 'gid') == 3
    assert missing([MODULUS - 2, 2]) == 3


@given(st.lists(st.tuples(st.sampled_from('ab'), st.integers(1, 4)), min_size=1, max_size=60))
def test_named_publishers_are_counted_apart(steps):
    counter, last, expected = SequenceCounter(), {}, 0
    for publisher, step in steps:
        if publisher in last:
            expected += step - 1
        last[publisher] = last.get(publisher, 1000) + step
        counter.update(last[publisher], publisher)
    assert counter.missing == expected
    assert counter.streams == len(last)


def test_a_publisher_that_is_gone_is_forgotten_only_after_long_silence():
    """While it may come back its next number is no gap of the one that goes on."""
    there = 2
    counter = SequenceCounter(lambda: there)
    for number in (100, 5000, 101, 5001):
        counter.update(number)
    there = 1
    counter.update(5003)  # one lost, and the graph shows one publisher only
    counter.update(103)  # the other, one lost too, has been silent for two messages
    assert (counter.streams, counter.missing) == (2, 2)


@given(st.lists(st.booleans(), max_size=80), st.integers(0, 1))
def test_two_anonymous_publishers_without_loss_show_no_gap(turns, first):
    """Whatever their interleaving, two publishers that start at one are told apart."""
    numbers, counter = {True: first, False: first}, SequenceCounter()
    for turn in turns:
        counter.update(numbers[turn])
        numbers[turn] += 1
    assert counter.missing == 0


def missing_of(numbers, publishers):
    counter = SequenceCounter(lambda: publishers)
    for number in numbers:
        counter.update(number)
    return counter.missing


@pytest.mark.parametrize(
    ('numbers', 'publishers', 'expected'),
    [
        ([41, 57, 42, 58, 43, 59], 2, 0),  # a reader that comes late
        ([41, 57, 42, 60], 2, 2),
        ([57, 41, 70, 58, 71, 42], 3, 0),
        ([41, 44], 1, 2),
        ([41, 44], 0, 2),  # not known
    ],
)
def test_publishers_that_a_late_reader_hears_first_are_no_gap(numbers, publishers, expected):
    assert missing_of(numbers, publishers) == expected


def test_nothing_continues_a_publisher_that_is_gone():
    """A node restarts and its earlier life leaves the graph: a gap of the new one is seen."""
    alive = 1
    counter = SequenceCounter(lambda: alive)
    for number in range(1, 51):
        counter.update(number)
    alive = 2  # the dead one is still believed in
    for number in range(1, 40):
        counter.update(number)
    alive = 1
    counter.update(40)
    counter.update(51)  # the number that the dead one would have had next
    assert counter.missing == 10
    assert counter.streams == 2


def test_publishers_that_leave_one_after_the_other_are_no_gap():
    """At the end of a run: nobody says which of them has left."""
    alive = 3
    counter, last = SequenceCounter(lambda: alive), [20, 10, 0]
    for turn in range(60):
        if turn in (20, 40):
            alive -= 1
        for publisher in range(3 - alive, 3) if turn % 2 else reversed(range(3 - alive, 3)):
            last[publisher] += 1
            counter.update(last[publisher])
    assert counter.missing == 0


@given(
    st.lists(st.integers(0, 2), max_size=120),
    st.tuples(*[st.integers(1, 10_000)] * 3).filter(lambda first: len(set(first)) == 3),
)
def test_three_publishers_without_loss_show_no_gap_whatever_they_begin_with(turns, first):
    counter, following = SequenceCounter(lambda: 3), list(first)
    for turn in turns:
        counter.update(following[turn])
        following[turn] += 1
    assert counter.missing == 0


@given(st.sets(st.integers(1, 80)))
def test_gaps_are_what_lies_between_the_numbers(numbers):
    ordered = sorted(numbers)
    expected = ordered[-1] - ordered[0] + 1 - len(ordered) if ordered else 0
    assert missing(ordered, 'gid') == expected


# Recording


def test_everything_is_written_in_order(tmp_path):
    thread = RecordingThread(BagWriter(tmp_path / 'bag'))
    for topic in ('/a', '/b'):
        thread.add_topic(topic, NUMBER)
    for k in range(5000):
        assert thread.put('/a' if k % 3 else '/b', payload(k), k, k, k // 3 + 1, 'gid')
    thread.attach('note', 'warm')
    progress = thread.close()
    assert (progress.received, progress.written, progress.lost) == (5000, 5000, 0)
    assert (progress.pending, progress.pending_bytes, progress.error) == (0, 0, '')
    assert thread.close() == progress
    with BagReader(tmp_path / 'bag') as reader:
        assert [m.message.data for m in reader.messages()] == list(range(5000))
        assert reader.attachments()['note'].text == 'warm'


def test_gaps_are_written_into_the_bag(tmp_path):
    thread = RecordingThread(BagWriter(tmp_path / 'bag'))
    thread.add_topic('/a', NUMBER)
    for number in (1, 2, 5):
        thread.put('/a', payload(number), number, sequence=number)
    thread.close()
    with BagReader(tmp_path / 'bag') as reader:
        report = json.loads(reader.attachments()[REPORT_NAME].text)
    assert report['topics'] == {
        '/a': {'received': 3, 'written': 3, 'missing': 2, 'dropped': 0, 'publishers': 1}
    }


def test_topic_that_was_not_announced_is_refused(tmp_path):
    thread = RecordingThread(BagWriter(tmp_path / 'bag'))
    with pytest.raises(BagTopicError, match=r'call add_topic'):
        thread.put('/a', b'', 0)
    thread.add_topic('/a', NUMBER)
    with pytest.raises(BagTopicError, match=r'expected type'):
        thread.add_topic('/a', 'std_msgs/msg/Bool')
    assert thread.close().received == 0


def test_unknown_type_is_recorded_without_definition(tmp_path):
    thread = RecordingThread(BagWriter(tmp_path / 'bag'))
    thread.add_topic('/a', 'shop_floor_msgs/msg/Secret')
    thread.put('/a', b'\x00\x01\x00\x00abcd', 1)
    thread.close()
    with BagReader(tmp_path / 'bag') as reader:
        report = json.loads(reader.attachments()[REPORT_NAME].data)
        assert 'source the workspace' in report['unknown_types']['shop_floor_msgs/msg/Secret']
        assert [m.message for m in reader.messages(raw=True)] == [b'\x00\x01\x00\x00abcd']


class SlowWriter(BagWriter):
    """Writes nothing until it is told to go on."""

    def __init__(self, path):
        super().__init__(path)
        self.go_on = threading.Event()
        self.busy = threading.Event()

    def write(self, *arguments, **options):
        self.busy.set()
        assert self.go_on.wait(60.0)
        super().write(*arguments, **options)


def test_memory_is_bounded_and_what_does_not_fit_is_counted(tmp_path):
    writer = SlowWriter(tmp_path / 'bag')
    thread = RecordingThread(writer, pending_max=10 * len(payload(0)))
    thread.add_topic('/a', NUMBER)
    taken = [thread.put('/a', payload(k), k, sequence=k + 1) for k in range(25)]
    assert sum(taken) == 10
    assert taken == [True] * 10 + [False] * 15
    assert thread.progress().pending_bytes == 10 * len(payload(0))
    assert writer.busy.wait(60.0)
    writer.go_on.set()
    progress = thread.close()
    assert vars(progress.topics['/a']) == {
        'received': 25,
        'written': 10,
        'missing': 0,
        'dropped': 15,
        'publishers': 1,
    }
    assert progress.lost == 15
    with BagReader(tmp_path / 'bag') as reader:
        assert [m.message.data for m in reader.messages()] == list(range(10))


def test_what_comes_before_any_time_waits_and_is_bounded_as_well(tmp_path):
    thread = RecordingThread(BagWriter(tmp_path / 'bag'), pending_max=10 * len(payload(0)))
    thread.add_topic('/a', NUMBER)
    taken = [thread.put('/a', payload(k), None, sequence=k + 1) for k in range(12)]
    assert taken == [True] * 10 + [False] * 2
    progress = thread.progress()
    assert (progress.pending, progress.untimed) == (0, 10)
    assert progress.pending_bytes == 10 * len(payload(0))
    assert progress.behind > 0.0
    assert not thread.put('/a', payload(12), 700, sequence=13)  # no room: it tells the time
    progress = thread.close()
    assert (progress.written, progress.lost, progress.untimed) == (10, 3, 0)
    with BagReader(tmp_path / 'bag') as reader:
        found = [(m.message.data, m.log_time) for m in reader.messages()]
        gaps = json.loads(reader.attachments()['recording.json'].text)['gaps']
    assert found == [(k, 700) for k in range(10)]
    assert gaps == [{'cause': NO_TIME, 'from_s': 0.0, 'messages': 3, 'to_s': 7e-7}]


def test_a_bag_that_never_had_a_time_is_whole(tmp_path):
    thread = RecordingThread(BagWriter(tmp_path / 'bag'))
    thread.add_topic('/a', NUMBER)
    for k in range(3):
        thread.put('/a', payload(k), None)
    assert thread.close().written == 3
    with BagReader(tmp_path / 'bag') as reader:
        assert [(m.message.data, m.log_time) for m in reader.messages()] == [
            (0, 0),
            (1, 0),
            (2, 0),
        ]


def test_who_announces_topics_and_models_does_not_wait_for_the_disk(tmp_path):
    """It is the thread that takes messages: while it waits they are lost elsewhere."""
    writer = SlowWriter(tmp_path / 'bag')
    thread = RecordingThread(writer)
    thread.add_topic('/a', NUMBER)
    thread.put('/a', payload(0), 0)
    assert writer.busy.wait(60.0)
    done = threading.Event()

    def announce():
        thread.add_topic('/b', NUMBER)
        thread.attach('model.json', '{}')
        thread.put('/b', payload(1), 1)
        done.set()

    threading.Thread(target=announce, daemon=True).start()
    announced = done.wait(10.0)
    behind = thread.progress().behind
    writer.go_on.set()
    assert announced
    assert behind > 0.0
    assert thread.close().written == 2
    assert thread.progress().behind == 0.0
    with BagReader(tmp_path / 'bag') as reader:
        assert [m.topic for m in reader.messages()] == ['/a', '/b']
        assert reader.attachments()['model.json'].data == b'{}'
    with pytest.raises(BagWriteError, match='expected an open bag'):
        thread.attach('model.json', '{}')


def test_error_of_the_thread_surfaces(tmp_path, monkeypatch):
    errors = []
    failed = threading.Event()
    thread = RecordingThread(
        BagWriter(tmp_path / 'bag'), on_error=lambda error: (errors.append(error), failed.set())
    )
    thread.add_topic('/a', NUMBER)
    thread.check()
    full = OSError(errno.ENOSPC, 'No space left on device')

    def refuse(sink, data):
        raise full

    monkeypatch.setattr('fuzzycnc_ros.bags.writer.Sink.write', refuse)
    count = 0
    while thread.put('/a', bytes(1000), count):
        count += 1
    assert failed.wait(60.0)
    with pytest.raises(BagWriteError, match=r'the disk is full; free some space'):
        thread.check()
    assert [str(error) for error in errors] == [thread.progress().error]
    with pytest.raises(BagWriteError, match=r'the disk is full'):
        thread.close()
    progress = thread.progress()
    assert progress.received == progress.written + progress.topics['/a'].dropped
    assert progress.pending == progress.pending_bytes == 0
    monkeypatch.undo()
    assert repair(tmp_path / 'bag', tmp_path / 'repaired').damage


@pytest.mark.parametrize(
    ('fault', 'says'),
    [(MemoryError(), 'there is not enough memory'), (LookupError('x'), "found LookupError('x')")],
)
def test_whatever_ends_the_thread_surfaces(tmp_path, monkeypatch, fault, says):
    """Else the recorder would go on, all is well by its reports, and nobody writes."""
    thread = RecordingThread(BagWriter(tmp_path / 'bag'))
    thread.add_topic('/a', NUMBER)
    failed = threading.Event()
    monkeypatch.setattr(thread, '_on_error', lambda error: failed.set())

    def refuse(sink, data):
        raise fault

    monkeypatch.setattr('fuzzycnc_ros.bags.writer.Sink.write', refuse)
    for k in range(3):
        thread.put('/a', bytes(100_000), k)
    assert failed.wait(60.0)
    assert thread.failed
    with pytest.raises(BagWriteError, match=re.escape(says)):
        thread.close()
    progress = thread.progress()
    assert progress.received == progress.written + progress.topics['/a'].dropped == 3
    assert progress.pending == progress.pending_bytes == 0
    monkeypatch.undo()
    assert repair(tmp_path / 'bag', tmp_path / 'repaired').damage


def test_many_threads_lose_nothing(tmp_path):
    thread = RecordingThread(BagWriter(tmp_path / 'bag'))
    thread.add_topic('/a', NUMBER)

    def send(part):
        for k in range(500):
            thread.put('/a', payload(part * 500 + k), k, sequence=k + 1, publisher=part)

    senders = [threading.Thread(target=send, args=(part,)) for part in range(4)]
    for sender in senders:
        sender.start()
    for sender in senders:
        sender.join()
    progress = thread.close()
    assert (progress.written, progress.lost) == (2000, 0)
    assert progress.topics['/a'].publishers == 4
    with BagReader(tmp_path / 'bag') as reader:
        assert sorted(m.message.data for m in reader.messages()) == list(range(2000))


def test_idle_messages_reach_the_disk(tmp_path):
    """Nothing more arrives, yet the open chunk is closed: a kill would lose no more than 1 s."""
    flushed = threading.Event()

    class Watched(BagWriter):
        def flush(self):
            super().flush()
            flushed.set()

    thread = RecordingThread(Watched(tmp_path / 'bag'))
    thread.add_topic('/a', NUMBER)
    thread.put('/a', payload(1), 1)
    assert flushed.wait(60.0)
    report = repair(tmp_path / 'bag')
    assert report.topics['/a'].kept == 1
    thread.close()

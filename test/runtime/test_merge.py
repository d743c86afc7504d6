# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Merge by stamp: the order of arrival changes nothing."""

from collections.abc import Iterator
from dataclasses import dataclass

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fuzzycnc_ros.core.config import Config
from fuzzycnc_ros.runtime.component import LATCHED, Component, Emission, Input, Output
from fuzzycnc_ros.runtime.merge import STAMP_MAX, Merger
from fuzzycnc_ros.runtime.records import SECOND, Record


@dataclass(frozen=True, kw_only=True, eq=False)
class Note(Record):
    """A record that only says who it is."""

    TYPE = 'test/msg/Note'

    text: str = ''


class Journal(Component):
    """Writes down what it is given, in order, and wakes up at every third second."""

    NAME = 'journal'
    SUMMARY = 'Writes down what it gets.'
    CONFIG = Config
    INPUTS = (
        Input('first', Note),
        Input('drive', Note, driving=True),
        Input('second', Note, max_age=2.0),
        Input('latched', Note, LATCHED),
    )
    OUTPUTS = (Output('entry', Note),)

    def __init__(self, period: int | None = 3 * SECOND) -> None:
        super().__init__()
        self._period = period
        self._deadline = period
        self.seen: list[tuple[int, str]] = []

    @property
    def next_deadline(self) -> int | None:
        return self._deadline

    def on_first(self, note: Note) -> None:
        self.seen.append((note.stamp, f'first {note.text}'))

    def on_second(self, note: Note) -> None:
        self.seen.append((note.stamp, f'second {note.text}'))

    def on_latched(self, note: Note) -> None:
        self.seen.append((note.stamp, f'latched {note.text}'))

    def on_drive(self, note: Note) -> Iterator[Emission]:
        self.seen.append((note.stamp, f'drive {note.text}'))
        sides = [self.newest(self.input(name), note.stamp) for name in ('first', 'second')]
        text = ' '.join(item.text if isinstance(item, Note) else '-' for item in sides)
        yield Emission('entry', Note(stamp=note.stamp, text=text))

    def on_deadline(self, stamp: int) -> Iterator[Emission]:
        self.seen.append((stamp, 'deadline'))
        self._deadline = stamp + self._period if self._period else None
        yield Emission('entry', Note(stamp=stamp, text='deadline'))


def texts(emissions: list[Emission]) -> list[tuple[int, str]]:
    """Return what was emitted as stamps and texts."""
    return [(item.record.stamp, item.record.text) for item in emissions]


STREAMS = ('first', 'drive', 'second')
STAMPS = st.lists(st.integers(min_value=1, max_value=12), unique=True, max_size=8)
ARRIVALS = st.tuples(STAMPS, STAMPS, STAMPS)


@given(ARRIVALS, st.data())
def test_order_of_arrival_changes_nothing(arrivals, data):
    """Routes may overtake each other; within a route the order stays."""
    queues = {
        name: [(name, Note(stamp=k * SECOND, text=f'{name}{k}')) for k in sorted(stamps)]
        for name, stamps in zip(STREAMS, arrivals, strict=True)
    }
    in_order = sorted(
        (item for queue in queues.values() for item in queue), key=lambda i: i[1].stamp
    )
    shuffled = []
    while any(queues.values()):
        name = data.draw(st.sampled_from([name for name, queue in queues.items() if queue]))
        shuffled.append(queues[name].pop(0))

    outcome = []
    for order in (in_order, shuffled):
        merger = Merger(Journal())
        for name, note in order:
            assert merger.push(name, note)
        emitted = merger.advance(13 * SECOND)
        outcome.append((texts(emitted), merger.component.seen, merger.counts))
    assert outcome[0] == outcome[1]


@given(ARRIVALS, st.lists(st.integers(min_value=0, max_value=13), max_size=5))
def test_how_often_it_works_changes_nothing(arrivals, pauses):
    """Many small turns or one large one."""
    notes = [
        (name, Note(stamp=k * SECOND, text=f'{name}{k}'))
        for name, stamps in zip(STREAMS, arrivals, strict=True)
        for k in sorted(stamps)
    ]
    whole, stepwise = Merger(Journal()), Merger(Journal())
    for name, note in notes:
        whole.push(name, note)
        stepwise.push(name, note)
    at_once = whole.advance(13 * SECOND)
    pieces = []
    for pause in [*sorted(pauses), 13]:
        pieces += stepwise.advance(pause * SECOND)
    assert texts(pieces) == texts(at_once)
    assert stepwise.component.seen == whole.component.seen


@given(ARRIVALS)
def test_a_component_never_goes_back_in_time(arrivals):
    merger = Merger(Journal())
    for name, stamps in zip(STREAMS, arrivals, strict=True):
        for k in sorted(stamps):
            merger.push(name, Note(stamp=k * SECOND))
    merger.advance(13 * SECOND)
    stamps = [stamp for stamp, _ in merger.component.seen]
    assert stamps == sorted(stamps)


def test_at_equal_stamps_sides_come_first_then_deadline_then_driver():
    merger = Merger(Journal())
    for name in ('drive', 'latched', 'second', 'first'):
        merger.push(name, Note(stamp=3 * SECOND))
    merger.advance(3 * SECOND)
    assert [text.split()[0] for _, text in merger.component.seen] == [
        'first',
        'second',
        'latched',
        'deadline',
        'drive',
    ]


def test_nothing_newer_than_asked_for_is_touched():
    merger = Merger(Journal())
    merger.push('drive', Note(stamp=2 * SECOND))
    assert merger.advance(2 * SECOND - 1) == []
    assert merger.component.seen == []
    assert texts(merger.advance(2 * SECOND)) == [(2 * SECOND, '- -')]


def test_deadlines_fire_in_between_with_their_own_stamp():
    merger = Merger(Journal())
    merger.push('drive', Note(stamp=1 * SECOND))
    merger.push('drive', Note(stamp=7 * SECOND))
    emitted = texts(merger.advance(10 * SECOND))
    assert emitted == [
        (1 * SECOND, '- -'),
        (3 * SECOND, 'deadline'),
        (6 * SECOND, 'deadline'),
        (7 * SECOND, '- -'),
        (9 * SECOND, 'deadline'),
    ]
    assert merger.time == 10 * SECOND


def test_deadline_that_does_not_move_is_an_error():
    """It would never end."""

    class Stubborn(Journal):
        def on_deadline(self, stamp: int) -> Iterator[Emission]:
            yield from ()

    merger = Merger(Stubborn())
    with pytest.raises(RuntimeError, match=r'journal asked for a deadline at 3\.0 s after'):
        merger.advance(4 * SECOND)


def test_side_input_that_is_too_old_counts_as_absent():
    merger = Merger(Journal(None))
    merger.push('second', Note(stamp=1 * SECOND, text='old'))
    merger.push('first', Note(stamp=1 * SECOND, text='timeless'))
    merger.push('drive', Note(stamp=3 * SECOND))
    merger.push('drive', Note(stamp=3 * SECOND + 1))
    emitted = texts(merger.advance(4 * SECOND))
    assert emitted == [(3 * SECOND, 'timeless old'), (3 * SECOND + 1, 'timeless -')]


def test_newest_side_record_up_to_the_stamp_is_used():
    merger = Merger(Journal(None))
    for k in (1, 2, 4):
        merger.push('first', Note(stamp=k * SECOND, text=str(k)))
    merger.push('drive', Note(stamp=3 * SECOND))
    assert texts(merger.advance(5 * SECOND)) == [(3 * SECOND, '2 -')]


@pytest.mark.parametrize('stamp', [1, 2])
def test_record_that_is_not_newer_is_dropped_and_counted(stamp):
    merger = Merger(Journal(None))
    assert merger.push('drive', Note(stamp=2 * SECOND))
    assert not merger.push('drive', Note(stamp=stamp * SECOND))
    count = merger.counts['drive']
    assert (count.received, count.dropped, count.late) == (2, 1, 0)
    assert len(merger.advance(3 * SECOND)) == 1


def test_late_driving_record_is_lost_and_counted():
    """What it would cause lies before what has been published already."""
    merger = Merger(Journal(None))
    merger.advance(5 * SECOND)
    assert not merger.push('drive', Note(stamp=4 * SECOND))
    assert merger.counts['drive'].late == 1
    assert merger.advance(6 * SECOND) == []
    assert merger.push('drive', Note(stamp=7 * SECOND))


def test_late_side_record_still_counts():
    merger = Merger(Journal(None))
    merger.advance(5 * SECOND)
    assert merger.push('first', Note(stamp=4 * SECOND, text='late'))
    assert merger.counts['first'].late == 1
    merger.push('drive', Note(stamp=6 * SECOND))
    assert texts(merger.advance(6 * SECOND)) == [(6 * SECOND, 'late -')]
    assert merger.time == 6 * SECOND


def test_latched_record_of_the_same_age_replaces_the_one_before():
    """A reader that comes back gets it again; it may be set anew before time moves."""
    merger = Merger(Journal(None))
    merger.advance(9 * SECOND)
    assert merger.push('latched', Note(stamp=2 * SECOND, text='a'))
    assert merger.push('latched', Note(stamp=2 * SECOND, text='b'))
    assert not merger.push('latched', Note(stamp=1 * SECOND, text='c'))
    merger.advance(9 * SECOND)
    assert [text for _, text in merger.component.seen] == ['latched a', 'latched b']
    count = merger.counts['latched']
    assert (count.received, count.dropped, count.late) == (3, 1, 0)


def test_interval_of_an_input_is_known_for_lateness():
    merger = Merger(Journal(None))
    merger.push('drive', Note(stamp=1 * SECOND))
    assert merger.counts['drive'].interval == 0
    merger.push('drive', Note(stamp=4 * SECOND))
    assert merger.counts['drive'].interval == 3 * SECOND
    assert merger.counts['drive'].newest == 4 * SECOND


def test_unknown_input_is_an_error():
    with pytest.raises(KeyError):
        Merger(Journal()).push('nonsense', Note(stamp=1))


class Telltale(Component):
    """Emits because of an input that it declares as quiet."""

    NAME = 'telltale'
    SUMMARY = 'Breaks its word.'
    CONFIG = Config
    INPUTS = (Input('whisper', Note, quiet=True), Input('drive', Note, driving=True))
    OUTPUTS = (Output('entry', Note),)

    def on_whisper(self, note: Note) -> Iterator[Emission]:
        """Emit what was to be kept."""
        yield Emission('entry', note)


def test_a_quiet_input_causes_nothing_by_itself():
    merger = Merger(Telltale())
    merger.push('whisper', Note(stamp=1))
    with pytest.raises(RuntimeError, match='input whisper as quiet but emitted entry'):
        merger.advance(1)


@pytest.mark.parametrize('stamp', [-1, STAMP_MAX + 1, (2**31 - 1) * SECOND])
@pytest.mark.parametrize('name', ['first', 'drive', 'latched'])
def test_impossible_stamps_are_refused(name, stamp):
    """What follows from them could not be published: a message counts whole seconds to 2038."""
    merger = Merger(Journal())
    assert not merger.push(name, Note(stamp=stamp))
    assert merger.counts[name].refused == 1
    assert merger.counts[name].refusal.startswith('stamp: expected 0 to 2147397248 s of machine')
    assert merger.push(name, Note(stamp=SECOND))
    assert merger.counts[name].refusal == ''
    assert merger.counts[name].refused == 1

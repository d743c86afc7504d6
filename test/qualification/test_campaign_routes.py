# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""What disturbs routes and values, and what strangers order."""

from types import SimpleNamespace
from typing import ClassVar

import numpy as np
import pytest

pytest.importorskip('rclpy')

from campaign.actions import falsify
from campaign.corrupted_values import (
    DRIVE_FIELDS,
    FIELDS,
    KINDS,
    PATH_FIELDS,
    PATTERN_FIELDS,
    falsified,
    shifted,
)
from campaign.relay import (
    Delay,
    Drop,
    Duplicate,
    Falsify,
    durability,
    readers,
    record_types,
    remappings,
)
from campaign.rogue_nodes import FORGED, STRANGE_EPOCH, STRANGER, strange_word
from campaign.scenario import MACHINE
from fault_records import MICRO, TICK, applied, command

from fuzzycnc_ros.runtime.component import LATCHED, STREAM
from fuzzycnc_ros.runtime.convert import encode
from fuzzycnc_ros.runtime.records import SECOND, Compensation, TrajectoryState

ALL = [
    *FIELDS.values(),
    *PATH_FIELDS.values(),
    *DRIVE_FIELDS.values(),
    *PATTERN_FIELDS.values(),
]


@pytest.mark.parametrize('wrong', ALL, ids=lambda wrong: f'{wrong.topic}-{wrong.field}')
def test_every_falsified_field_is_an_array_or_number_of_an_input(wrong):
    known = record_types()[wrong.topic].__dataclass_fields__
    assert {wrong.name(kind) for kind in KINDS} <= set(known)


@pytest.mark.parametrize('kind', KINDS)
def test_values_are_falsified(kind):
    change = falsified(FIELDS['compensation'], kind)
    first = change(command(0, 5.0))
    hour = change(command(3600 * SECOND, 6.0))
    wanted = {
        'nan': (np.nan, np.nan),
        'stuck': (5.0, 5.0),
        'jump': (1005.0, 1006.0),
        'drift': (5.0, 406.0),
    }[kind]
    found = [record.offset[0] / MICRO for record in (first, hour)]
    np.testing.assert_allclose(found, wanted)
    assert hour.stamp == 3600 * SECOND


def state(stamp, epoch):
    """Return a state of a trajectory."""
    return TrajectoryState(
        stamp=stamp, path_id='p', epoch=epoch, part=1, status=1, reason='', arc_length=0.5
    )


@pytest.mark.parametrize(
    ('kind', 'epoch', 'arc_length'),
    [('nan', 7, np.nan), ('stuck', 3, 0.5), ('jump', 1007, 0.5), ('drift', 1007, 0.5)],
)
def test_whole_numbers_stay_whole(kind, epoch, arc_length):
    """What is no number is another field: whole numbers cannot say it."""
    from fuzzycnc_ros.ros.topics import RCLPY

    change = falsified(PATH_FIELDS['trajectory_state'], kind)
    change(state(0, 3))
    later = change(state(SECOND, 7))
    assert later.epoch == epoch
    np.testing.assert_equal(later.arc_length, arc_length)
    encode(later, RCLPY)  # the message takes it


def test_unknown_kind_is_refused():
    with pytest.raises(ValueError, match='expected one of nan, stuck'):
        falsified(FIELDS['compensation'], 'late')


def test_stamps_do_not_fall_below_zero():
    assert shifted(-600.0)(command(60 * SECOND)).stamp == 0
    assert shifted(600.0)(command(60 * SECOND)).stamp == 660 * SECOND


def test_routes_are_disturbed_by_seed():
    dropped = Drop(0.5, 7)
    kept = sum(len(dropped.passed('t', b'x')) for _ in range(1000))
    assert 450 < kept < 550
    assert dropped.count == 1000 - kept
    assert Duplicate(0.1).passed('t', b'x') == [(0.0, b'x'), (0.1, b'x')]
    waits = [Delay(0.0, 1.0, 7).passed('t', b'x')[0][0] for _ in range(2)]
    assert waits[0] == waits[1]
    assert 0.0 < waits[0] < 1.0


def payload_of(record):
    """Return a record as it goes over the wire."""
    from rclpy.serialization import serialize_message

    from fuzzycnc_ros.ros.topics import RCLPY

    return bytes(serialize_message(encode(record, RCLPY)))


def test_only_the_messages_of_one_topic_are_falsified():
    from rclpy.serialization import deserialize_message

    from fuzzycnc_ros.ros.topics import message_class

    payload = payload_of(command(TICK))
    fault = Falsify('compensation', falsified(FIELDS['compensation'], 'jump'))
    assert fault.passed('other', payload) == [(0.0, payload)]
    ((_, content),) = fault.passed('compensation', payload)
    message = deserialize_message(content, message_class(Compensation.TYPE))
    np.testing.assert_allclose(message.offset, 1.005e-3)


def test_a_scenario_lasts_until_something_was_falsified():
    """A pattern comes every few seconds: on a busy computer none came in the time it was."""

    class Live:
        relay = SimpleNamespace(fault=None)
        destroyed = 0
        done: ClassVar[list[str]] = []

        def until(self, condition, what):
            assert not condition()
            self.relay.fault.passed('compensation', payload_of(command(TICK)))
            assert condition()
            self.done.append('falsified')

        def run(self, minutes):
            self.done.append(f'{minutes:g} min')

    live = Live()
    falsify(FIELDS['compensation'], 'jump', minutes=2.0)(live)
    assert live.done == ['falsified', '2 min']
    assert live.relay.fault is None


def test_the_relay_stands_between_publisher_and_readers():
    assert remappings({'/clock': 'a', 'temperatures': 'b'}) == [
        'a:/clock:=direct/clock',
        'b:temperatures:=direct/temperatures',
    ]


def test_strangers_order_by_the_highest_rank():
    told = command(TICK, epoch=4)
    order = strange_word('compensation', 2 * TICK, told)
    assert order.epoch > told.epoch
    assert order.source == STRANGER
    assert order.axis == told.axis
    assert (order.offset > MACHINE.offset_max).all()
    assert strange_word('axis_command', TICK, None).epoch == STRANGE_EPOCH
    forged = strange_word('compensation_applied', TICK, applied(0, 1.0))
    assert (forged.epoch, forged.offset.max()) == (FORGED, pytest.approx(1e-6))
    with pytest.raises(ValueError, match='to imitate but found none'):
        strange_word('compensation', TICK, None)


def test_the_relay_keeps_topics_as_their_readers_do():
    assert durability('tool_path') is durability('material') is LATCHED
    assert durability('trajectory') is STREAM
    assert readers('tool_path', ('feedrate_scheduler', 'servo_controller')) == 1
    assert readers('trajectory', ('feedrate_scheduler', 'servo_controller')) == 1
    assert readers('/clock', ('feedrate_scheduler', 'servo_controller')) == 2

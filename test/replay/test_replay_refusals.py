# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Bags whose provenance means nothing: a replay says so."""

import json

import pytest

from fuzzycnc_ros.bags.typestore import message_type
from fuzzycnc_ros.bags.writer import BagWriter
from fuzzycnc_ros.registry import COMPONENTS
from fuzzycnc_ros.replay.replay import ReplayError, _SeriesEnd, replay
from fuzzycnc_ros.runtime.convert import Target, encode
from fuzzycnc_ros.runtime.host import NodeEvent
from fuzzycnc_ros.runtime.provenance import configuration_record
from fuzzycnc_ros.runtime.records import SECOND

ROSBAGS = Target(message_type, numpy_arrays=True)


@pytest.fixture
def replaying(tmp_path):
    """Replay a bag of one node with these parameters, later parameters and requests."""

    def run(node, *parameters, events=()):
        component = COMPONENTS[node]()
        bag = tmp_path / f'bag{len(parameters)}'
        with BagWriter(bag, flush_interval=None) as writer:
            writer.add_topic('/mill/node_configuration', 'fuzzycnc_msgs/msg/NodeConfiguration')
            writer.add_topic('/mill/node_event', NodeEvent.TYPE)
            for number, text in enumerate(parameters):
                record = configuration_record(component, number * SECOND, 'active')
                message = encode(record, ROSBAGS)
                message.parameters = record.parameters if text is None else text
                writer.write_message('/mill/node_configuration', message, number)
            for name, request in events:
                record = NodeEvent(stamp=9 * SECOND, node=node, name=name, request=request)
                writer.write_message('/mill/node_event', encode(record, ROSBAGS), 9)
        return replay(bag)

    return run


def test_parameters_that_are_gone_are_taken_at_what_is_done_now(replaying):
    assert not replaying('feedrate_scheduler', json.dumps({'log_fuzzy_braking': 0})).differing
    with pytest.raises(ReplayError, match='log_fuzzy_braking'):
        replaying('feedrate_scheduler', None, json.dumps({'log_fuzzy_braking': 3}))


@pytest.mark.parametrize(
    ('text', 'complaint'),
    [
        ('', 'expected JSON'),
        ('[' * 100_000, 'expected JSON'),
        ('[1]', r"expected a JSON object but found '\[1\]'"),
        ('{"no_such": 1}', 'no_such'),
        (json.dumps({'period': 10**400}), 'period: expected a number but found one beyond'),
        ('{"period": NaN}', 'period'),
        ('{"axes": "Y"}', 'axes'),
    ],
)
def test_parameters_that_are_none(replaying, text, complaint):
    for parameters in ((text,), (None, text)):
        with pytest.raises(ReplayError, match=f'compensator: parameters: .*{complaint}'):
            replaying('compensator', *parameters)


@pytest.mark.parametrize(
    ('node', 'name', 'request_text'),
    [
        ('thermal_predictor', 'use_model', '{}'),
        ('thermal_predictor', 'use_model', '[]'),
        ('sensor_selector', 'select_sensors', '{"bag": 5}'),
        ('sensor_selector', 'select_sensors', '{"clusters": "many"}'),
        ('sensor_selector', 'select_sensors', '{"clusters": null}'),
        ('feedrate_scheduler', 'schedule_program', '{}'),
        ('feedrate_scheduler', 'schedule_program', '{"program'),
    ],
)
def test_requests_that_are_none(replaying, node, name, request_text):
    with pytest.raises(ReplayError, match=f'{node}: request {name}: expected'):
        replaying(node, None, events=[(name, request_text)])


@pytest.mark.parametrize(
    'request_text', ['', '{}', '[1]', '{"step": null}', '{"step": 1e400}', '[' * 100_000]
)
def test_a_step_of_the_clock_that_says_no_number_ends_a_replay_all_the_same(
    replaying, request_text
):
    report = replaying('compensator', None, events=[('clock_step', request_text)])
    assert not report.differing
    assert 'the clock of compensator was set at 9.000 s' in report.notes[0]


HOUR = 3600


@pytest.mark.parametrize(
    ('step', 'before', 'after', 'kept'),
    [
        (-HOUR, [98, 99], [99.9, 100.5, -3500], [1, 1, 1, 0, 0]),  # logged after the event
        (-HOUR, [98, 99, -3501], [-3500], [1, 1, 0, 0]),  # logged before it
        (-HOUR, [-9000], [-3498], [1, 0]),  # of a topic that is silent for hours
        (-2, [99, 99.5], [100, 98.2, 98.4], [1, 1, 1, 0, 0]),
        (HOUR, [98, 3701], [99.9, 3702], [1, 0, 1, 0]),
        (0, [98], [99, 101], [1, 1, 0]),
    ],
)
def test_a_series_ends_where_the_clock_was_set_in_whatever_order_it_was_logged(
    step, before, after, kept
):
    end = _SeriesEnd(100 * SECOND, step * SECOND, 0, {'/mill/temperatures': len(before)})
    stamps = [('', int(at * SECOND)) for at in (*before, *after)]
    assert end.kept('/mill/temperatures', stamps) == [bool(item) for item in kept]


def test_each_node_has_a_series_of_its_own():
    end = _SeriesEnd(100 * SECOND, -HOUR * SECOND, 0, {'/mill/node_event': 4})
    told = [('x', 98), ('y', -9000), ('x', 99), ('y', -8999), ('y', 100), ('x', -3500)]
    stamps = [(node, at * SECOND) for node, at in told]
    assert end.kept('/mill/node_event', stamps) == [True, True, True, True, True, False]

# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The components still do what the golden runs in `bags/` say."""

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fuzzycnc_ros.bags.reader import BagReader
from fuzzycnc_ros.bags.typestore import ROSBAGS
from fuzzycnc_ros.bags.writer import BagWriter
from fuzzycnc_ros.replay.replay import ReplayError, relative_difference, replay
from fuzzycnc_ros.runtime.convert import decode, encode
from fuzzycnc_ros.runtime.enums import Status
from fuzzycnc_ros.runtime.records import (
    Compensation,
    Temperatures,
    ThermalError,
)

BAGS = Path(__file__).parents[2] / 'bags'
GOLDEN = sorted(path.name for path in BAGS.iterdir() if path.is_dir())
SIZE_MAX = 512 * 1024


def records(name, topic, kind):
    with BagReader(BAGS / name) as reader:
        return [decode(kind, m.message) for m in reader.messages([f'/mill/{topic}'])]


def rewritten(source, target, change):
    """Copy a bag; `change` may alter or drop messages."""
    with BagReader(source) as reader, BagWriter(target) as writer:
        for connection in reader.connections.values():
            writer.add_topic(connection.name, connection.type, connection.profiles)
        for item in reader.messages():
            message = change(item.topic, item.message)
            if message is not None:
                writer.write_message(item.topic, message, item.log_time)


@pytest.mark.replay
@pytest.mark.parametrize('name', GOLDEN)
def test_every_output_is_recomputed(name):
    report = replay(BAGS / name)
    assert report.equivalent, [t for t in report.topics if not t.equivalent]
    compared = {topic.topic.rsplit('/', 1)[-1]: topic.recomputed for topic in report.topics}
    assert compared['temperatures'] == 60
    assert compared['thermal_error'] == 60
    assert compared['compensation'] >= 55
    assert not report.notes


@pytest.mark.parametrize('name', GOLDEN)
def test_golden_runs_stay_small(name):
    assert sum(file.stat().st_size for file in (BAGS / name).iterdir()) < SIZE_MAX


def test_readme_names_every_golden_run():
    text = (BAGS / 'README.md').read_text(encoding='utf-8')
    assert all(f'`{name}`' in text for name in GOLDEN)


@pytest.mark.replay
def test_lost_sensors_are_seen_and_substituted():
    samples = records('mill_lost_sensors', 'temperatures', Temperatures)
    verdicts = {Status(v) for sample in samples for v in sample.status}
    assert {Status.MISSING, Status.RATE, Status.STUCK} <= verdicts
    last = records('mill_lost_sensors', 'thermal_error', ThermalError)[-1]
    assert len(last.substituted) == 3
    assert last.valid


def test_the_examples_hold_the_same_bag_and_no_link():
    example = BAGS.parent / 'examples' / 'mill_warm_up'
    files = sorted(path.name for path in (BAGS / 'mill_warm_up').iterdir())
    assert sorted(path.name for path in example.iterdir()) == files
    for name in files:
        assert (example / name).read_bytes() == (BAGS / 'mill_warm_up' / name).read_bytes()
    assert not [path for path in example.parent.rglob('*') if path.is_symlink()]


@pytest.mark.replay
def test_lost_sensors_cost_little():
    """Substitution keeps the offsets within a few micrometres of the healthy run's."""
    healthy, faulty = (
        {c.stamp: c.offset for c in records(name, 'compensation', Compensation)}
        for name in ('mill_warm_up', 'mill_lost_sensors')
    )
    shared = sorted(set(healthy) & set(faulty))
    apart = np.abs(np.array([healthy[s] - faulty[s] for s in shared]))
    assert len(shared) > 50
    assert apart.max() < 4e-6


@pytest.mark.replay
def test_altered_output_is_found(tmp_path):
    def change(topic, message):
        if topic == '/mill/compensation':
            record = decode(Compensation, message)
            return encode(replace(record, offset=record.offset + 1e-9), ROSBAGS)
        return message

    rewritten(BAGS / 'mill_warm_up', tmp_path / 'altered', change)
    report = replay(tmp_path / 'altered')
    differing = [topic.topic for topic in report.topics if not topic.equivalent]
    assert differing == ['/mill/compensation']
    assert not report.equivalent


@pytest.mark.replay
def test_missing_input_is_found(tmp_path):
    seen = []

    def change(topic, message):
        if topic == '/mill/sensor_readings':
            seen.append(message)
            if len(seen) == 100:
                return None
        return message

    rewritten(BAGS / 'mill_warm_up', tmp_path / 'gap', change)
    report = replay(tmp_path / 'gap')
    assert not report.equivalent
    first = {topic.topic: topic.first_difference for topic in report.topics}
    # The hundredth reading is the last of the twentieth sample.
    assert first['/mill/temperatures'].endswith('at machine time 22800.000 s')


@pytest.mark.replay
def test_bag_without_configuration_is_refused(tmp_path):
    rewritten(
        BAGS / 'mill_warm_up',
        tmp_path / 'bare',
        lambda topic, message: None if topic.endswith('node_configuration') else message,
    )
    with pytest.raises(ReplayError, match='node_configuration'):
        replay(tmp_path / 'bare')


@pytest.mark.replay
def test_replay_of_one_node():
    report = replay(BAGS / 'mill_warm_up', nodes=['compensator'])
    assert [topic.topic for topic in report.topics] == ['/mill/compensation']


@pytest.mark.replay
def test_model_travels_with_the_bag(tmp_path):
    """A replay needs nothing but the bag."""
    shutil.copytree(BAGS / 'mill_warm_up', tmp_path / 'mill_warm_up')
    assert replay(tmp_path / 'mill_warm_up').equivalent
    with BagReader(tmp_path / 'mill_warm_up') as reader:
        events = [m.message for m in reader.messages(['/mill/node_event'])]
    requests = {event.name: json.loads(event.request) for event in events}
    assert 'inputs' in json.loads(requests['use_model']['model'])


def test_relative_difference_sees_what_matters():
    message = encode(records('mill_warm_up', 'thermal_error', ThermalError)[-1], ROSBAGS)
    other = replace(message, error=message.error * (1 + 1e-12))
    assert 0.0 < relative_difference(message, other) < 1e-11
    assert relative_difference(message, replace(message, valid=not message.valid)) == np.inf
    assert relative_difference(message, replace(message, error=message.error[:1])) == np.inf
    whole = np.array([1.0, -1.0])
    for first, second, apart in (
        (np.inf * whole, -np.inf * whole, np.inf),
        (np.inf * whole, whole, np.inf),
        (np.nan * whole, np.inf * whole, np.inf),
        (np.inf * whole, np.inf * whole, 0.0),
        (np.nan * whole, np.nan * whole, 0.0),
        (1.7e308 * whole, -1.7e308 * whole, np.inf),
        (5e-324 * whole, 0.0 * whole, 1.0),
        (0.0 * whole, -0.0 * whole, 0.0),
    ):
        assert relative_difference(first, second) == relative_difference(second, first) == apart
    nan = replace(message, error=message.error * np.nan)
    assert relative_difference(message, nan) == np.inf


def test_numbers_near_zero_are_judged_by_the_largest_of_their_field():
    """A velocity that crosses zero is rounding where the axis moves, a difference where not."""
    message = encode(records('mill_warm_up', 'thermal_error', ThermalError)[-1], ROSBAGS)
    near = [replace(message, error=np.full_like(message.error, e)) for e in (3e-16, -3e-16)]
    assert relative_difference(*near) == 2.0
    assert relative_difference(*near, {'.error': 1e-5}) < 1e-7
    assert relative_difference(*near, {'.error': 0.1}) < 1e-11
    assert relative_difference(*near, {'.standard_deviation': 0.1}) == 2.0
    apart = [replace(message, error=np.full_like(message.error, e)) for e in (3e-9, -3e-9)]
    assert relative_difference(*apart, {'.error': 0.1}) > 1e-5


@pytest.mark.replay
def test_a_zero_that_is_rounded_otherwise_is_no_difference(tmp_path):
    seen = []

    def change(topic, message):
        if topic == '/mill/compensation':
            record = decode(Compensation, message)
            seen.append(record.offset)
            if not record.offset.any():
                return encode(replace(record, offset=record.offset + 3e-21), ROSBAGS)
        return message

    rewritten(BAGS / 'mill_warm_up', tmp_path / 'rounded', change)
    assert any(not offset.any() for offset in seen)
    assert any(offset.any() for offset in seen)
    report = replay(tmp_path / 'rounded')
    assert report.equivalent
    assert not report.identical

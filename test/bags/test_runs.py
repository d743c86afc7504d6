# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Reading thermal runs from bags."""

import numpy as np
import pytest
from benches.component_bench import machine_state

from fuzzycnc_ros.bags.errors import BagDataError, BagTopicError, RunError
from fuzzycnc_ros.bags.runs import read_run
from fuzzycnc_ros.bags.typestore import message_type
from fuzzycnc_ros.runtime.convert import Target, encode
from fuzzycnc_ros.runtime.enums import SpeedStatus
from fuzzycnc_ros.runtime.records import SpindleSpeed

SECOND = 10**9


def run_messages(new, count=40, space='/mill', start=1, names=None, channels=None):
    """Return temperatures each second and displacements each half second before it."""
    messages = []
    for k in range(count):
        stamp = (start + k) * SECOND
        before = stamp - SECOND // 2
        messages.append(
            (
                f'{space}/displacement',
                new.displacement(before, (k * 1e-6, -k * 1e-6), channels=channels),
                before,
            )
        )
        messages.append(
            (f'{space}/temperatures', new.temperatures(stamp, (20 + k * 0.1, 21.0), names), stamp)
        )
    return messages


def test_run_holds_what_the_bag_holds(make_bag, new):
    run = read_run(make_bag(run_messages(new)))
    assert (run.name, run.sensor, run.channel, run.axis) == (
        'bag',
        ('n0', 'n1'),
        ('Y', 'Z'),
        ('Y', 'Z'),
    )
    np.testing.assert_allclose(run.time, np.arange(40.0))
    np.testing.assert_allclose(run.temperature[:, 0], 20 + np.arange(40) * 0.1)
    np.testing.assert_allclose(run.displacement[:, 1], -np.arange(40) * 1e-6)


def test_window_name_and_channels(make_bag, new):
    bag = make_bag(run_messages(new, channels=('probe_a', 'probe_b')))
    run = read_run(bag, start=10.0, stop=29.0, name='T1')
    assert (run.name, run.channel) == ('T1', ('probe_a', 'probe_b'))
    # What lies before the window stays the reference and warms up lags, but is not measured.
    np.testing.assert_allclose(run.time, np.arange(30.0))
    np.testing.assert_allclose(run.temperature[:, 0], 20 + np.arange(30) * 0.1)
    assert np.isnan(run.displacement[:10]).all()
    np.testing.assert_allclose(run.displacement[10:, 1], -np.arange(10, 30) * 1e-6)
    with pytest.raises(RunError, match=r'between 100.0 and None s but the run lasts from 0 to 39'):
        read_run(bag, start=100.0)
    with pytest.raises(RunError, match=r'at least 8 samples'):
        read_run(bag, stop=3.0)


def test_readings_that_are_not_ok_become_nan(make_bag, new):
    messages = run_messages(new)
    stamp = 11 * SECOND
    messages[21] = (
        '/mill/temperatures',
        new.temperatures(stamp, (99.0, 21.0), None, (4, 0)),
        stamp,
    )
    run = read_run(make_bag(messages))
    assert np.argwhere(np.isnan(run.temperature)).tolist() == [[10, 0]]


def test_newest_displacement_since_the_last_sample_is_taken(make_bag, new):
    """Three displacements before each sample, then a gap, then one exactly on the stamp."""
    messages = []
    for k in range(20):
        stamp = (k + 1) * 10 * SECOND
        for part, value in ((-3, 1e-6), (-2, 2e-6), (-1, 6e-6)):
            if k not in (5, 6):
                at = stamp + part * SECOND
                messages.append(('/m/displacement', new.displacement(at, (value, np.nan)), at))
        if k == 6:
            messages.append(('/m/displacement', new.displacement(stamp, (9e-6, 0.0)), stamp))
        messages.append(('/m/temperatures', new.temperatures(stamp), stamp))
    bag = make_bag(messages)
    newest = read_run(bag).displacement
    mean = read_run(bag, average=True).displacement
    np.testing.assert_allclose(newest[:8, 0], [6e-6] * 5 + [np.nan, 9e-6, 6e-6])
    np.testing.assert_allclose(mean[:8, 0], [3e-6] * 5 + [np.nan, 9e-6, 3e-6], rtol=1e-9)
    assert np.isnan(newest[0, 1])
    assert np.isnan(mean[0, 1])


def test_channels_that_are_probed_one_after_the_other_arrive_together(make_bag, new):
    """Y a second before Z, both between two samples; once Y alone, once neither."""
    messages = []
    for k in range(20):
        stamp = (k + 1) * 10 * SECOND
        for part, values in ((-3, (k * 1e-6, np.nan)), (-2, (np.nan, -k * 1e-6))):
            if k != 6 and (k, part) != (5, -2):
                at = stamp + part * SECOND
                messages.append(('/m/displacement', new.displacement(at, values), at))
        messages.append(('/m/temperatures', new.temperatures(stamp), stamp))
    found = read_run(make_bag(messages)).displacement
    expected = 1e-6 * np.column_stack([np.arange(20.0), -np.arange(20.0)])
    expected[5, 1] = expected[6] = np.nan
    np.testing.assert_allclose(found, expected)


def test_later_displacement_is_never_seen(make_bag, new):
    messages = run_messages(new)
    late = 40 * SECOND + 1
    messages.append(('/mill/displacement', new.displacement(late, (400e-6, 0.0)), late))
    assert np.nanmax(read_run(make_bag(messages)).displacement) < 50e-6


def test_namespace_chooses_the_machine(make_bag, new):
    bag = make_bag(run_messages(new, space='/mill') + run_messages(new, 30, '/lathe', start=101))
    with pytest.raises(BagTopicError, match=r'/lathe/temperatures, /mill/.*name the namespace'):
        read_run(bag)
    assert len(read_run(bag, namespace='lathe').time) == 30
    assert len(read_run(bag, namespace='/mill').time) == 40
    run = read_run(bag, temperatures='/mill/temperatures', displacement='/mill/displacement')
    assert len(run.time) == 40
    with pytest.raises(BagTopicError, match=r'expected messages on /saw/temperatures'):
        read_run(bag, namespace='saw')


def test_topics_without_namespace(make_bag, new):
    assert len(read_run(make_bag(run_messages(new, space=''))).time) == 40


def test_relative_topics_and_mixed_names(make_bag, new):
    bag = make_bag(run_messages(new, space='mill') + run_messages(new, 9, 'lathe', start=101))
    assert len(read_run(bag, temperatures='/mill/temperatures').time) == 40
    assert len(read_run(bag, temperatures='lathe/temperatures').time) == 9


def test_missing_topics_are_named(make_bag, new, data):
    only = [m for m in run_messages(new) if m[0].endswith('temperatures')]
    with pytest.raises(BagTopicError, match=r'displacement but the bag has /mill/temperatures'):
        read_run(make_bag(only))
    with pytest.raises(BagTopicError, match=r'temperatures but the bag has /rosout'):
        read_run(data / 'rosbag2/rosbag2_py/test/resources/mcap/talker')
    with pytest.raises(BagTopicError, match=r'no messages at all'):
        read_run(data / 'rosbag2/ros2bag/test/resources/empty_bag')


def test_other_type_under_the_name_is_refused(make_bag, new):
    messages = run_messages(new)
    swapped = [('/mill/temperatures', m, t) for _, m, t in messages if hasattr(m, 'axis')]
    with pytest.raises(BagTopicError, match=r'expected messages on temperatures'):
        read_run(make_bag(swapped))
    with pytest.raises(BagTopicError, match=r'to be fuzzycnc_msgs/msg/Temperatures'):
        read_run(make_bag(swapped, 'two'), namespace='mill')


def test_repeated_sensor_is_refused(make_bag, new):
    with pytest.raises(RunError, match=r'each sensor name once but found a more than once'):
        read_run(make_bag(run_messages(new, names=('a', 'a'))))
    with pytest.raises(RunError, match=r'each channel name once but found Z'):
        read_run(make_bag(run_messages(new, channels='ZZ'), 'two'))


def test_sensors_that_change_are_refused(make_bag, new):
    messages = run_messages(new, 20) + run_messages(new, 20, start=21, names=('n0', 'n2'))
    with pytest.raises(RunError, match=r'at stamp 21 s they change from \[n0, n1\] to \[n0, n2\]'):
        read_run(make_bag(messages))


def test_arrays_of_different_length_are_refused(make_bag, new):
    messages = run_messages(new)
    messages[1][1].temperature = np.zeros(3)
    with pytest.raises(BagDataError, match=r'expected 2 entries'):
        read_run(make_bag(messages))


def test_stamps_that_go_back_are_refused(make_bag, new):
    messages = run_messages(new, 20)
    topic, message, _ = messages[1]
    messages.append((topic, message, 10**12))
    with pytest.raises(RunError, match=r'increasing stamps but found 1 s after 20 s'):
        read_run(make_bag(messages))


def test_topics_that_do_not_overlap_are_refused(make_bag, new):
    messages = [m for m in run_messages(new) if m[0].endswith('temperatures')]
    messages += [m for m in run_messages(new, start=1000) if m[0].endswith('displacement')]
    with pytest.raises(RunError, match=r'stamps from 1 to 40 s, .* from 999.5 to 1038.5 s'):
        read_run(make_bag(messages))


def test_compensated_displacements_are_refused_unless_asked_for(make_bag, new):
    messages = run_messages(new)
    messages[10][1].includes_compensation = True
    with pytest.raises(RunError, match=r'at stamp 5.5 s compensation was active'):
        read_run(make_bag(messages))
    assert len(read_run(make_bag(messages, 'two'), compensated=True).time) == 40


def speed_messages(count: int = 40, **told):
    """Return what topics tell of the spindle speed each second [rad/s], by topic."""
    target = Target(message_type, numpy_arrays=True)
    messages = []
    for topic, speed in told.items():
        for k in range(count):
            stamp = (k + 1) * SECOND
            if topic == 'machine_state':
                record = machine_state(k + 1, spindle_speed=speed(k))
            else:
                status = SpeedStatus.OK if np.isfinite(speed(k)) else SpeedStatus.MISSING
                record = SpindleSpeed(stamp=stamp, speed=abs(speed(k)), status=int(status))
            messages.append((f'/mill/{topic}', encode(record, target), stamp))
    return messages


@pytest.mark.parametrize('topic', ['machine_state', 'spindle_speed'])
def test_spindle_speed_comes_from_either_topic(make_bag, new, topic):
    speeds = speed_messages(**{topic: lambda k: np.nan if 10 <= k < 20 else float(k)})
    run = read_run(make_bag(run_messages(new) + speeds), start=5.0)
    wanted = np.arange(40.0)
    wanted[10:20] = 9.0
    np.testing.assert_array_equal(run.spindle_speed, wanted)
    assert run.name == 'bag'


def test_spindle_speed_of_the_controller_has_precedence(make_bag, new):
    speeds = speed_messages(machine_state=lambda k: 100.0, spindle_speed=lambda k: 5.0)
    run = read_run(make_bag(run_messages(new) + speeds))
    assert set(run.spindle_speed) == {100.0}
    speeds = speed_messages(machine_state=lambda k: np.nan, spindle_speed=lambda k: 5.0)
    run = read_run(make_bag(run_messages(new) + speeds, name='unknown'))
    assert set(run.spindle_speed) == {5.0}


def test_motion_load_and_coolant_are_means_since_the_sample_before(make_bag, new):
    target, told = Target(message_type, numpy_arrays=True), []
    for k in range(40):
        record = machine_state(
            k + 1,
            axis=('X', 'Y'),
            position=np.zeros(2),
            travel=np.array([0.25 * k, np.nan]),
            square_speed=np.array([0.5 * k, np.nan]),
            spindle_load=0.75,
            coolant=2,
        )
        told.append(('/mill/machine_state', encode(record, target), (k + 1) * SECOND))
    run = read_run(make_bag(run_messages(new) + told), start=5.0)
    assert sorted(run.drives) == ['axis_speed/X', 'axis_square_speed/X', 'coolant', 'spindle_load']
    for name, value in zip(sorted(run.drives), (0.25, 0.5, 1.0, 0.75), strict=True):
        np.testing.assert_allclose(run.drives[name][1:], value, rtol=1e-12)
    assert read_run(make_bag(run_messages(new), name='none')).drives == {}


def test_unknown_speed_and_that_of_another_machine_are_none(make_bag, new):
    speeds = speed_messages(machine_state=lambda k: np.nan, spindle_speed=lambda k: np.nan)
    other = [('/lathe/spindle_speed', *item[1:]) for item in speed_messages(spindle_speed=float)]
    run = read_run(make_bag(run_messages(new) + speeds + other))
    assert run.spindle_speed is None

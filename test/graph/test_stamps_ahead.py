# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""A message from the far future is refused in real time, and the replay refuses it too."""

import time

import numpy as np
import pytest
from rosgraph_msgs.msg import Clock

from fuzzycnc_ros.replay.replay import replay
from fuzzycnc_ros.ros.topics import RCLPY, message_class, publisher_qos
from fuzzycnc_ros.runtime.component import STREAM
from fuzzycnc_ros.runtime.convert import encode
from fuzzycnc_ros.runtime.records import SECOND, Temperatures

pytestmark = pytest.mark.ros

BEGIN = 1000


@pytest.fixture
def sensors(observer):
    """Publish readings and machine time as the bridge of a machine would."""

    class Sensors:
        def __init__(self):
            node, kind = observer.node, message_class(Temperatures.TYPE)
            self.clock = node.create_publisher(Clock, '/clock', 10)
            self.readings = node.create_publisher(
                kind, '/mill/sensor_readings', publisher_qos(STREAM)
            )

        def tell(self, second, ahead=0.0):
            self.clock.publish(Clock(clock=RCLPY.time(int(second * SECOND))))
            observer.settle('temperature_acquisition')
            self.read(second + ahead)

        def read(self, second):
            record = Temperatures(
                stamp=int(second * SECOND),
                frame_id='mill/machine',
                sensor=('T1',),
                temperature=np.array([20.0]),
                status=np.zeros(1, np.uint8),
                readings=1,
            )
            self.readings.publish(encode(record, RCLPY))

    return Sensors()


def test_one_message_from_the_future_blocks_nothing(graph, observer, sensors, tmp_path):
    observer.watch_diagnostics()
    samples = observer.records('temperatures', Temperatures)
    node = graph.start('temperature_acquisition', {'use_sim_time': True, 'interval': 1.0})
    recorder = graph.start('recorder', {'use_sim_time': True, 'output': str(tmp_path / 'bag')})
    observer.until(
        lambda: (
            sensors.clock.get_subscription_count() >= 1
            and sensors.readings.get_subscription_count() == 2
            and observer.hears('temperatures')
            and observer.node.count_subscribers('/mill/temperatures') == 2  # recorder, test
        )
    )
    observer.settle('temperature_acquisition', 'recorder')
    for second in range(BEGIN, BEGIN + 3):
        sensors.tell(second)
    newest = (BEGIN + 2) * SECOND
    observer.until(lambda: samples and samples[-1].stamp == newest, 'samples before it')
    before = len(samples)
    sensors.tell(BEGIN + 3, ahead=7200.0)
    item = 'mill/temperature_acquisition: sensor_readings'
    observer.until(
        lambda: observer.told(item, 'ahead of the clock but found 7200 s'),
        'word of the refused message',
    )
    for second in range(BEGIN + 4, BEGIN + 8):
        sensors.tell(second)
    last = (BEGIN + 7) * SECOND
    observer.until(lambda: samples[-1].stamp == last, 'samples after it')
    assert [item.stamp for item in samples[before:]] == [
        second * SECOND for second in range(BEGIN + 4, BEGIN + 8)
    ]
    observer.settle('temperature_acquisition', 'recorder')
    assert node.interrupt() == 0
    assert recorder.interrupt() == 0
    report = replay(tmp_path / 'bag')
    assert report.identical, report.topics
    assert not report.notes


def test_clock_of_a_source_half_an_hour_ahead(graph, observer, sensors):
    """On the wall clock a reading would else be fresh for half an hour after its source died."""
    observer.watch_diagnostics()
    samples = observer.records('temperatures', Temperatures)
    graph.start('temperature_acquisition', {'interval': 0.1})
    observer.until(
        lambda: sensors.readings.get_subscription_count() == 1 and observer.hears('temperatures')
    )
    item = 'mill/temperature_acquisition: sensor_readings'

    def told():
        sensors.read(time.time() + 1800.0)
        return observer.told(item, 'expected at most 60 s ahead of the clock but found 1')

    observer.until(told, 'word of the refused readings')
    assert not samples
    observer.until(lambda: (sensors.read(time.time() + 1.0), samples)[1], 'a good reading')

# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Drivers of temperature_acquisition: Temperature topics and CSV files."""

import numpy as np
import pytest
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import Temperature

from fuzzycnc_ros.ros.topics import RCLPY
from fuzzycnc_ros.runtime.enums import Status
from fuzzycnc_ros.runtime.records import SECOND, Temperatures

pytestmark = pytest.mark.ros

PERIOD = 10.0


@pytest.fixture
def plc(observer):
    """Publish readings and machine time as a PLC gateway would."""

    class Plc:
        def __init__(self):
            self.clock = observer.node.create_publisher(Clock, '/clock', 10)
            self.topics = {
                name: observer.node.create_publisher(Temperature, f'/plc/{name}', 10)
                for name in ('bearing', 'motor')
            }

        def connected(self):
            ends = [self.clock, *self.topics.values()]
            return all(end.get_subscription_count() == 1 for end in ends)

        def read(self, name, second, value, frame=''):
            message = Temperature(header=RCLPY.header(int(second * SECOND), frame or name))
            message.temperature = value
            self.topics[name].publish(message)

        def tell_time(self, second):
            self.clock.publish(Clock(clock=RCLPY.time(int(second * SECOND))))

    return Plc()


def test_topics_become_one_record(graph, observer, plc):
    graph.start(
        'temperature_acquisition',
        {
            'source': 'temperature_topics',
            'temperature_topics': ['T1=/plc/bearing', 'T2=/plc/motor@motor'],
            'reading_period': PERIOD,
            'interval': 4.0,
            'use_sim_time': True,
        },
    )
    raw = observer.records('sensor_readings', Temperatures)
    samples = observer.records('temperatures', Temperatures)
    topics = ('sensor_readings', 'temperatures')
    observer.until(lambda: plc.connected() and all(observer.hears(name) for name in topics))
    # Best effort: what is sent before both ends know of each other is lost.
    second = 10.0

    def sends():
        nonlocal second
        second += 0.1
        # Told here, since a leap of machine time later would end the period of half a set.
        plc.tell_time(100)
        plc.read('motor', second + 0.02, 30.0)
        plc.read('bearing', second, 20.0)
        return len(raw) > 2

    observer.until(sends, 'readings arrive')

    # Of a topic that sensors share, only the messages of one count.
    plc.read('motor', 100.3, 77.0, frame='gearbox')
    # Complete at once, in the order of the parameter, with the newest stamp.
    plc.read('motor', 100.2, 31.0)
    plc.read('bearing', 100.0, 21.0)
    complete = int(100.2 * SECOND)
    observer.until(lambda: raw[-1].stamp == complete, 'a complete set')
    assert raw[-1].sensor == ('T1', 'T2')
    assert raw[-1].temperature.tolist() == [21.0, 31.0]
    assert raw[-1].status.tolist() == [Status.OK, Status.OK]
    assert raw[-1].frame_id == 'mill/machine'
    # What is no number is a sensor that is missing.
    plc.read('bearing', 101.0, float('nan'))
    plc.read('motor', 101.0, 32.0)
    observer.until(lambda: raw[-1].stamp == 101 * SECOND, 'a set without the bearing')
    assert np.isnan(raw[-1].temperature[0])
    assert raw[-1].status.tolist() == [Status.MISSING, Status.OK]
    known = len(raw)

    # A sensor without a newer message is missing once the period is over.
    plc.read('bearing', 104.0, 22.0)
    plc.read('motor', 100.2, 99.0)
    second = 100

    def time_passes():
        nonlocal second
        second += 1
        plc.tell_time(second)
        return len(raw) > known

    observer.until(time_passes, 'a set without the motor')
    assert second > 104
    assert raw[known].stamp == 104 * SECOND
    assert raw[known].temperature[0] == 22.0
    assert np.isnan(raw[known].temperature[1])
    assert raw[known].status.tolist() == [Status.OK, Status.MISSING]
    observer.until(lambda: samples and samples[-1].stamp == 104 * SECOND, 'a checked sample')
    graph.stop()


def test_readings_that_are_not_used_are_counted(graph, observer, plc):
    """A reading without a stamp, or ahead of the clock, takes nothing from those that are good."""
    graph.start(
        'temperature_acquisition',
        {
            'source': 'temperature_topics',
            'temperature_topics': ['T1=/plc/bearing', 'T2=/plc/motor'],
            'reading_period': PERIOD,
            'interval': 4.0,
            'use_sim_time': True,
            'stamp_ahead_max': 1.0,
        },
    )
    observer.watch_diagnostics()
    raw = observer.records('sensor_readings', Temperatures)
    observer.until(lambda: plc.connected() and observer.hears('sensor_readings'))
    item = 'mill/temperature_acquisition: topic /plc/bearing'
    observer.until(lambda: observer.told(item, 'nothing received yet'), 'silence is told')

    second = 100

    def sends(*wrong):
        nonlocal second
        second += 1
        plc.tell_time(second)
        for stamp in wrong:
            plc.read('bearing', stamp, 99.0)
        plc.read('bearing', second, 20.0)
        plc.read('motor', second, 30.0)

    def told(text, *wrong):
        sends(*wrong)
        return observer.told(item, text)

    observer.until(lambda: told('all readings used'), 'good readings')
    observer.until(lambda: told('without a stamp: have its driver', 0.0), 'those without a stamp')
    observer.until(lambda: told('ahead of the clock: compare', second + 1000.0), 'those ahead')
    observer.until(lambda: told('not newer than the last: compare', 50.0), 'those that are old')
    known = len(raw)
    observer.until(lambda: (sends(), len(raw) > known + 2)[1], 'sets go on')
    assert all(99.0 not in item.temperature for item in raw)
    assert raw[-1].stamp <= second * SECOND
    graph.stop()


CSV = """time,T1,T2
{rows}
"""


def write_csv(path, cells=None):
    """Write twenty rows a minute apart, some cells replaced."""
    rows = [[60 * k, 20 + k, 30.5] for k in range(20)]
    for (row, column), text in (cells or {}).items():
        rows[row][column] = text
    path.write_text(CSV.format(rows='\n'.join(','.join(map(str, row)) for row in rows)))
    return path


@pytest.mark.slow
def test_csv_file_is_played(graph, observer, tmp_path):
    """It is played as soon as anybody listens: what reads it first may be a while ahead of us."""
    file = write_csv(tmp_path / 'log.csv', {(row, 2): '' for row in range(1, 19)})
    raw = observer.records('sensor_readings', Temperatures)
    samples = observer.records('temperatures', Temperatures)
    parameters = {'source': 'csv', 'csv_file': str(file), 'csv_rate': 300.0, 'lockstep': False}
    node = graph.start('temperature_acquisition', parameters)
    observer.until(lambda: 'end of file after 20 rows' in node.output, 'the end of the file')
    observer.until(lambda: raw and raw[-1].stamp == (19 * 60 + 1) * SECOND, 'the last row')
    # The first stamp is 1 s, since 0 means unknown.
    stamps = [item.stamp for item in raw]
    assert set(stamps) <= {(60 * k + 1) * SECOND for k in range(20)}
    assert raw[-1].sensor == ('T1', 'T2')
    assert raw[-1].temperature.tolist() == [39.0, 30.5]
    assert raw[-1].status.tolist() == [Status.OK, Status.OK]
    assert raw[-2].status.tolist() == [Status.OK, Status.MISSING]
    observer.until(lambda: samples, 'a checked sample')
    graph.stop()


@pytest.mark.parametrize(
    ('cells', 'named'),
    [
        ({(3, 1): 'hot'}, "line 5, column 'T1': expected a number but found 'hot'"),
        ({(7, 0): 60}, "line 9, column 'time'"),
        ({(2, 0): ''}, "line 4, column 'time'"),
        ({(0, 0): 0, (5, 2): '1,2'}, 'line 7: expected 3 columns'),
    ],
)
def test_bad_csv_file_is_refused(refusal, tmp_path, cells, named):
    file = write_csv(tmp_path / 'log.csv', cells)
    line = refusal('temperature_acquisition', {'source': 'csv', 'csv_file': str(file)})
    assert line.startswith('error: parameter csv_file: ')
    assert named in line


def test_csv_file_without_sensors_is_refused(refusal, tmp_path):
    file = tmp_path / 'log.csv'
    file.write_text('\n'.join(['time', *(str(60 * row) for row in range(20))]))
    line = refusal('temperature_acquisition', {'source': 'csv', 'csv_file': str(file)})
    assert "expected columns but found one, 'time'" in line


def test_csv_file_without_time_column_is_refused(refusal, tmp_path):
    file = write_csv(tmp_path / 'log.csv')
    parameters = {'source': 'csv', 'csv_file': str(file), 'csv_time': 'clock'}
    line = refusal('temperature_acquisition', parameters)
    assert "expected the column 'clock' but the file has time, T1, T2" in line

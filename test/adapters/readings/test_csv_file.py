# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Playing of a CSV file: it begins when the component listens."""

import time
from types import SimpleNamespace

import numpy as np
import pytest

pytest.importorskip('rclpy', reason='rclpy is not installed here: run `make test`')

from fuzzycnc_ros.adapters.readings import csv_file
from fuzzycnc_ros.components.thermal.temperature_acquisition import (
    TemperatureAcquisitionConfig,
)
from fuzzycnc_ros.nodes.temperature_acquisition import TemperatureAcquisitionNode

pytestmark = pytest.mark.ros


def listen(source, monkeypatch, now, readers, publish):
    """Let a source hear of a number of readers, on a clock that is set by hand [ns]."""
    source._readings._publisher = SimpleNamespace(
        get_subscription_count=lambda: readers[0], publish=publish
    )
    monkeypatch.setattr(csv_file.time, 'monotonic_ns', lambda: now[0])


def test_file_is_played_from_its_first_row_once_a_reader_listens(make_node, tmp_path, monkeypatch):
    file = tmp_path / 'day.csv'
    file.write_text('time,front\n' + ''.join(f'{10 * k},{20 + k}\n' for k in range(8)))
    config = TemperatureAcquisitionConfig(csv_file=str(file), csv_rate=10.0)
    source = csv_file.CsvFile(make_node('temperature_acquisition'), config, 'mill/machine')
    now, readers, sent = [50 * 10**9], [0], []
    listen(
        source, monkeypatch, now, readers, lambda message: sent.append(list(message.temperature))
    )
    for _ in range(5):
        source._play()
        now[0] += 10**9
    assert not sent, 'nobody would have read it'
    readers[0] = 1
    source._play()
    assert sent == [[20.0]]
    now[0] += 10**9
    source._play()
    assert sent == [[20.0], [21.0]]


@pytest.mark.parametrize('begin', ['0', '2021-06-13 05:42:16'])
@pytest.mark.parametrize(('rate', 'simulated'), [(1.0, False), (10.0, False), (1.0, True)])
def test_stamps_are_fresh_where_the_wall_clock_counts(
    make_node, tmp_path, monkeypatch, begin, rate, simulated
):
    """Readings of another day would be late for every node of the graph."""
    file = tmp_path / 'day.csv'
    times = [f'2021-06-13 05:42:{16 + k}' if '-' in begin else str(k) for k in range(8)]
    file.write_text('time,front\n' + ''.join(f'{t},{k}\n' for k, t in enumerate(times)))
    named = {'csv_file': str(file), 'csv_rate': rate}
    node = make_node('temperature_acquisition', source='csv', use_sim_time=simulated, **named)
    acquisition = TemperatureAcquisitionNode(node)
    try:
        now, stamps = [10**9], []
        source = acquisition._source
        listen(source, monkeypatch, now, [1], lambda message: stamps.append(message.header.stamp))
        started = time.time()
        source._play()
        now[0] += round(7e9 / rate)
        source._play()
        seconds = [stamp.sec + 1e-9 * stamp.nanosec for stamp in stamps]
        assert np.diff(seconds) == pytest.approx(np.ones(7))
        if rate == 1.0 and not simulated:
            assert started <= seconds[0] <= time.time()
            assert abs(acquisition.now() - 1e9 * time.time()) < 1e10
        else:
            assert seconds[0] == pytest.approx(1623562936.0 if '-' in begin else 1.0)
            acquisition.merger.advance(round(1e9 * seconds[-1]))
            assert acquisition.now() == round(1e9 * seconds[-1])
    finally:
        acquisition.stop()


def test_a_file_is_played_over_the_hour_that_comes_twice(make_node, tmp_path, monkeypatch):
    monkeypatch.setenv('TZ', 'Europe/Berlin')
    file = tmp_path / 'night.csv'
    clock = '02:20 02:40 02:00 02:20 02:40 03:00 03:20 03:40'.split()
    file.write_text('time,front\n' + ''.join(f'2026-10-25 {t}:00,20\n' for t in clock))
    config = TemperatureAcquisitionConfig(csv_file=str(file), csv_rate=100.0)
    source = csv_file.CsvFile(make_node('temperature_acquisition'), config, 'mill/machine')
    now, stamps = [10**9], []
    listen(source, monkeypatch, now, [1], lambda message: stamps.append(message.header.stamp.sec))
    source._play()
    now[0] += 100 * 10**9
    source._play()
    assert np.diff(stamps).tolist() == [1200] * 7

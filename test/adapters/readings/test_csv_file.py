# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Playing of a CSV file: it begins when the component listens."""

from types import SimpleNamespace

import pytest

pytest.importorskip('rclpy', reason='rclpy is not installed here: run `make test`')

from fuzzycnc_ros.adapters.readings import csv_file
from fuzzycnc_ros.components.thermal.temperature_acquisition import (
    TemperatureAcquisitionConfig,
)

pytestmark = pytest.mark.ros


def test_file_is_played_from_its_first_row_once_a_reader_listens(make_node, tmp_path, monkeypatch):
    file = tmp_path / 'day.csv'
    file.write_text('time,front\n' + ''.join(f'{10 * k},{20 + k}\n' for k in range(8)))
    config = TemperatureAcquisitionConfig(csv_file=str(file), csv_rate=10.0)
    source = csv_file.CsvFile(make_node('temperature_acquisition'), config, 'mill/machine')
    now, readers, sent = [50 * 10**9], [0], []
    source._readings._publisher = SimpleNamespace(
        get_subscription_count=lambda: readers[0],
        publish=lambda message: sent.append(list(message.temperature)),
    )
    monkeypatch.setattr(csv_file.time, 'monotonic_ns', lambda: now[0])
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

# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The last 24 hours: what was, in ever coarser rows, in memory that is bounded."""

import json

import numpy as np
import pytest

from fuzzycnc_ros.components.dashboard.history import (
    COLUMNS_MAX,
    POINTS_MAX,
    History,
    QuantityHistory,
    Tier,
    history_document,
    joined,
)
from fuzzycnc_ros.runtime.records import SECOND

SMALL = (Tier(0.0, 10), Tier(10.0, 6), Tier(60.0, 5))


def filled(series, seconds, begin=0):
    for second in range(begin, begin + seconds):
        series.add(second * SECOND, {'a': float(second), 'b': -float(second)})
    return series


def test_new_samples_are_kept_as_they_came():
    rows = filled(QuantityHistory(), 300).rows(100.0, 120.0, 600)
    assert rows.time.tolist() == list(range(100, 121))
    assert rows.mean[:, 0].tolist() == rows.low[:, 0].tolist() == rows.time.tolist()
    assert not rows.flag.any()


def test_older_ones_are_rows_of_least_largest_and_mean():
    rows = filled(QuantityHistory(SMALL), 200).rows(0.0, 1e9, 600)
    assert rows.time[-10:].tolist() == list(range(190, 200))
    coarse = rows.time < 190.0
    assert np.diff(rows.time[coarse]).max() == 60.0
    assert (np.diff(rows.time) > 0).all()
    for low, high, mean in zip(rows.low[:, 0], rows.high[:, 0], rows.mean[:, 0], strict=True):
        assert low <= mean <= high
    minute = rows.time.tolist().index(60.0)
    assert (rows.low[minute, 0], rows.high[minute, 0]) == (60.0, 119.0)
    assert rows.mean[minute, 0] == pytest.approx(89.5)
    assert (rows.low[minute, 1], rows.high[minute, 1]) == (-119.0, -60.0)


def test_the_oldest_is_dropped():
    series = filled(QuantityHistory(SMALL), 1000)
    assert series.begin >= 1000 - 6 * 60
    assert series.rows(0.0, 1e9, 600).time[0] == series.begin


@pytest.mark.slow
def test_a_day_of_76_sensors_at_1_hz_stays_within_150_mib():
    history = History()
    names = [f't{number}' for number in range(76)]
    rng = np.random.default_rng(3)
    day = rng.standard_normal(76)
    for second in range(0, 86400, 5):  # every tier is full all the same
        history['temperatures'].add(second * SECOND, dict(zip(names, day, strict=True)))
    rows = history['temperatures'].rows(0.0, 1e9, POINTS_MAX)
    assert rows.time[-1] - rows.time[0] > 86400 - 120
    assert history.nbytes < 150 * 2**20


def test_few_rows_hold_the_peaks_of_many():
    series = QuantityHistory()
    values = np.random.default_rng(4).standard_normal(600)
    for second, value in enumerate(values):
        series.add(second * SECOND, {'a': value}, frozenset({'a'} if second == 77 else ()))
    rows = series.rows(0.0, 1e9, 20)
    assert len(rows.time) <= 20
    assert rows.high.max() == np.float32(values.max())
    assert rows.low.min() == np.float32(values.min())
    assert rows.flag.sum() == 1


def test_what_two_topics_say_of_one_time_is_one_row():
    series = QuantityHistory()
    series.add(5 * SECOND, {'Y predicted': 1.0})
    series.add(5 * SECOND, {'Y probed': 2.0})
    series.add(4 * SECOND, {'Z probed': 3.0})  # it came late
    rows = series.rows(0.0, 10.0, 10)
    assert rows.time.tolist() == [5.0]
    assert rows.mean.tolist() == [[1.0, 2.0, 3.0]]


def test_columns_come_and_go():
    series = QuantityHistory(SMALL)
    series.add(SECOND, {'a': 1.0})
    series.add(2 * SECOND, {'b': 2.0})
    rows = series.rows(0.0, 10.0, 10)
    assert np.isnan(rows.mean).tolist() == [[False, True], [True, False]]
    assert series.names == ('a', 'b')


def test_what_is_no_number_is_none():
    series = QuantityHistory(SMALL)
    series.add(SECOND, {'a': np.nan, 'b': np.inf, 'c': 1e300, 'd': 1.0})
    series.add(2 * SECOND, {'a': 2.0})
    rows = series.rows(0.0, 10.0, 10)
    document = history_document('mill', 'error', series.names, rows)
    text = json.dumps(document, allow_nan=False)
    assert json.loads(text)['columns']['a']['mean'] == [None, 2.0]
    assert document['columns']['d']['max'] == [1.0, None]
    assert document['flags'] == {}


def test_no_more_columns_than_there_is_room_for():
    series = QuantityHistory(SMALL)
    series.add(SECOND, {f't{number}': 1.0 for number in range(COLUMNS_MAX + 100)})
    series.add(2 * SECOND, {'late': 1.0})
    assert len(series.names) == COLUMNS_MAX


def test_an_empty_series_has_no_rows():
    rows = QuantityHistory().rows(0.0, 1e9, 10)
    assert len(rows.time) == 0
    assert history_document('mill', 'error', (), rows)['time'] == []


def test_two_stretches_are_one():
    first, second = filled(QuantityHistory(), 50), QuantityHistory()
    for at in range(50, 80):
        second.add(at * SECOND, {'b': 1.0, 'c': 2.0})
    columns, rows = joined(
        (first.names, first.rows(0.0, 1e9, 100)), (second.names, second.rows(0.0, 1e9, 100)), 100
    )
    assert columns == ('a', 'b', 'c')
    assert rows.time.tolist() == list(range(80))
    assert np.isnan(rows.mean[50:, 0]).all()
    assert (rows.mean[50:, 2] == 2.0).all()

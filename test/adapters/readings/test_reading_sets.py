# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Sets of readings: complete at the pace of the slowest, held up by nobody who is lost."""

import numpy as np
import pytest

pytest.importorskip('rclpy')

from fuzzycnc_ros.adapters.readings.reading_sets import ReadingSets
from fuzzycnc_ros.runtime.records import SECOND

pytestmark = pytest.mark.ros


def take(sets, device, second, *values):
    sets.take(device, int(second * SECOND), np.array(values, float))


def complete(sets, second):
    found = sets.complete(int(second * SECOND))
    return None if found is None else (found[0] / SECOND, found[1].tolist())


def test_a_set_waits_for_every_device_that_answers():
    sets = ReadingSets([2, 1], pace=1.0)
    assert complete(sets, 0.0) is None
    take(sets, 0, 1.0, 20.0, 21.0)
    assert complete(sets, 5.0) is None
    take(sets, 1, 2.0, 30.0)
    assert complete(sets, 2.0) == (2.0, [20.0, 21.0, 30.0])
    assert complete(sets, 3.0) is None


def test_faster_devices_enter_with_their_median():
    sets = ReadingSets([1, 1], pace=1.0)
    for second, value in enumerate([20.0, 3000.0, 21.0, np.nan, 22.0, 19.0, 23.0], start=1):
        take(sets, 0, second, value)
    take(sets, 1, 8.0, 30.0)
    assert complete(sets, 8.0) == (8.0, [21.5, 30.0])


def test_a_lost_device_holds_up_nobody():
    sets = ReadingSets([1, 1], pace=10.0)
    sets.lose(1)
    take(sets, 0, 1.0, 20.0)
    stamp, values = complete(sets, 1.0)
    assert stamp == 1.0
    np.testing.assert_equal(values, [20.0, np.nan])
    take(sets, 1, 2.0, 30.0)
    assert complete(sets, 2.0) is None
    take(sets, 0, 3.0, 20.5)
    assert complete(sets, 3.0) == (3.0, [20.5, 30.0])


def test_while_all_are_lost_empty_sets_go_at_the_slowest_pace():
    sets = ReadingSets([1, 1], pace=10.0)
    sets.lose(0)
    assert complete(sets, 1.0) is None
    sets.lose(1)
    found = [complete(sets, second) for second in range(1, 32)]
    assert [place for place, item in enumerate(found) if item is not None] == [0, 10, 20, 30]
    np.testing.assert_equal(found[0][1], [np.nan, np.nan])


def test_a_clock_that_stands_still_brings_no_second_set_of_its_time():
    sets = ReadingSets([1], pace=1.0)
    take(sets, 0, 1.0, 20.0)
    assert complete(sets, 1.0) is not None
    take(sets, 0, 1.0, 21.0)
    assert complete(sets, 1.0) is None
    take(sets, 0, 2.0, 22.0)
    assert complete(sets, 2.0) == (2.0, [21.5])

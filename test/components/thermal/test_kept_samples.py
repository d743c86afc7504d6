# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Samples in bounded memory: how many stay, and which."""

from itertools import pairwise

import numpy as np
import pytest
from bag_libraries import need_bag_libraries

from fuzzycnc_ros.bags.typestore import ROSBAGS
from fuzzycnc_ros.components.thermal import kept_samples
from fuzzycnc_ros.components.thermal.kept_samples import KeptSamples
from fuzzycnc_ros.components.thermal.predictor_stream import PredictorStream
from fuzzycnc_ros.components.thermal.thermal_predictor_config import ThermalPredictorConfig
from fuzzycnc_ros.runtime.convert import decode, encode
from fuzzycnc_ros.runtime.records import SECOND, Temperatures

TENTH = SECOND // 10


def sample(stamp, sensors=4):
    """Return a sample of the right size."""
    return Temperatures(
        stamp=stamp,
        frame_id='mill/machine',
        sensor=tuple(f'T{number}' for number in range(sensors)),
        temperature=np.zeros(sensors),
        status=np.zeros(sensors, np.uint8),
        readings=1,
    )


def kept(count, sensors=4, begin=0):
    """Return the stamps that stay of so many samples at 10 Hz."""
    samples = KeptSamples[Temperatures](lambda item: item)
    for number in range(count):
        samples.add(sample(begin + number * TENTH, sensors))
    return [item.stamp for item in samples]


def test_all_stay_that_have_room(monkeypatch):
    monkeypatch.setattr(kept_samples, 'SAMPLES_MAX', 50)
    assert kept(50) == [number * TENTH for number in range(50)]


@pytest.mark.parametrize('count', [51, 52, 99, 1000, 1801])
def test_of_too_many_a_part_of_the_whole_run_stays(monkeypatch, count):
    monkeypatch.setattr(kept_samples, 'SAMPLES_MAX', 50)
    stamps = kept(count)
    assert 24 <= len(stamps) <= 50
    (step,) = {after - before for before, after in pairwise(stamps)}
    assert stamps[0] == 0
    assert stamps[-1] <= (count - 1) * TENTH < stamps[-1] + step


def test_more_sensors_leave_room_for_fewer_samples(monkeypatch):
    monkeypatch.setattr(kept_samples, 'READINGS_MAX', 4000)
    assert len(kept(100, sensors=40)) == 100
    assert 24 <= len(kept(100, sensors=80)) <= 50


def test_a_predictor_that_hears_fast_knows_all_of_the_time_that_matters(monkeypatch):
    """A model that is put into use later begins with all of it, not with the last minutes."""
    monkeypatch.setattr(kept_samples, 'SAMPLES_MAX', 50)
    stream = PredictorStream(ThermalPredictorConfig(settle_time=60.0))
    for number in range(1, 2001):
        heard = stream.hear(sample(number * TENTH))
        assert stream.newest is heard
    stamps = [item.sample.stamp for item in stream.since(0)]
    assert len(stamps) <= 51
    assert stamps[-1] == 2000 * TENTH
    assert stamps[0] <= (2000 - 600) * TENTH < stamps[1]


def test_records_of_equal_names_hold_them_once():
    """A thousand names take six times the room of their temperatures."""
    need_bag_libraries()
    first, second = (
        decode(Temperatures, encode(sample(stamp, sensors=20), ROSBAGS)) for stamp in (1, 2)
    )
    assert first.sensor is second.sensor

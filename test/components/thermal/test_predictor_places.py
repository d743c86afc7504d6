# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Thermal predictor along an axis: learnt from probes at places, published as a line."""

import numpy as np
import pytest

from fuzzycnc_ros.components.thermal.predictor_stream import ProbeSource
from fuzzycnc_ros.components.thermal.thermal_predictor import ThermalPredictor, along_travel
from fuzzycnc_ros.components.thermal.thermal_predictor_config import ThermalPredictorConfig
from fuzzycnc_ros.runtime.records import SECOND, CompensationApplied, Displacement

CHANNELS = ('Y', 'Z', 'Y slope -400..0 mm', 'Y bend -400..0 mm')
AXES = ('Y', 'Z', 'Y', 'Y')


def probe(position, measured, *, includes=False, at=100):
    """Return a probe of Y at positions [m]."""
    count = len(position)
    return Displacement(
        stamp=at * SECOND,
        frame_id='mill/workpiece',
        axis=('Y',) * count,
        channel=tuple(f'p{number}' for number in range(count)),
        displacement=np.array(measured),
        standard_deviation=np.full(count, 1e-6),
        includes_compensation=includes,
        position=np.array(position),
    )


def read_back(at, **more):
    given = {
        'stamp': at * SECOND,
        'frame_id': 'mill/machine',
        'epoch': 1,
        'status': 1,
        'reason': '',
        'axis': ('Y', 'Z'),
        'offset': np.array([5e-6, 0.0]),
        'at_limit': np.zeros(2, bool),
    }
    return CompensationApplied(**(given | more))


def taken(displacement, *applied):
    source = ProbeSource(ThermalPredictorConfig(learn=True))
    for item in applied:
        source.add_read_back(item)
    source.add(displacement)
    return source.take(200 * SECOND, 0)


def test_a_model_publishes_its_axes_with_slope_place_and_what_a_line_leaves():
    error, deviation = np.array([5e-6, 1e-6, -20e-6, 3e-6]), np.array([1e-6, 2e-6, 4e-6, 4e-6])
    offset, found = along_travel(CHANNELS, error, deviation)
    assert offset == [0, 1]
    assert found['slope'] == pytest.approx([-100e-6, np.nan], nan_ok=True)
    assert found['slope_deviation'] == pytest.approx([20e-6, np.nan], nan_ok=True)
    assert found['reference_position'] == pytest.approx([-0.2, np.nan], nan_ok=True)
    assert found['line_deviation'] == pytest.approx([2.5e-6, np.nan], nan_ok=True)


def test_three_places_tell_all_channels_of_an_axis():
    (told,) = taken(probe([-0.4, -0.2, 0.0], [20e-6, 6e-6, -10e-6]))
    error, noise, _ = told.of_channels(CHANNELS, AXES, np.zeros(4), np.full(4, 1e-3))
    assert error == pytest.approx([5.5e-6, np.nan, -15e-6, 1e-6], nan_ok=True, abs=1e-10)
    assert noise[[0, 2, 3]].max() < 2e-6


def test_an_offset_that_slopes_is_taken_off_at_the_place_of_the_probe():
    line = {'slope': np.array([100e-6, 0.0]), 'position': np.array([-0.3, 0.0])}
    (told,) = taken(
        probe([-0.4, 0.0], [0.0, 0.0], includes=True),
        read_back(95, **line),
        read_back(105, **line),
    )
    assert told.offset == pytest.approx([-5e-6, 35e-6])
    assert told.error == pytest.approx([5e-6, -35e-6])


def test_the_axis_may_have_moved_between_two_read_backs():
    before = {'slope': np.array([100e-6, 0.0]), 'position': np.array([-0.3, 0.0])}
    after = {**before, 'position': np.array([-0.1, 0.0]), 'offset': np.array([25e-6, 0.0])}
    (told,) = taken(
        probe([-0.2], [0.0], includes=True), read_back(95, **before), read_back(105, **after)
    )
    assert told.offset == pytest.approx([15e-6])


def test_places_tell_a_model_without_a_slope_their_mean():
    (told,) = taken(probe([-0.4, -0.2, 0.0], [20e-6, np.nan, -10e-6]))
    error, noise, _ = told.of_channels(('Y', 'Z'), ('Y', 'Z'), np.zeros(2), np.full(2, 1e-3))
    assert error == pytest.approx([5e-6, np.nan], nan_ok=True)
    assert noise[0] == pytest.approx(1e-6)


def test_channels_that_are_named_are_taken_as_they_are():
    (told,) = taken(
        Displacement(
            stamp=100 * SECOND,
            frame_id='mill/workpiece',
            axis=AXES,
            channel=CHANNELS,
            displacement=np.array([1e-6, 2e-6, 3e-6, 4e-6]),
            standard_deviation=np.full(4, 1e-6),
            includes_compensation=False,
        )
    )
    error, _, _ = told.of_channels(CHANNELS, AXES, np.zeros(4), np.full(4, 1e-3))
    np.testing.assert_allclose(error, [1e-6, 2e-6, 3e-6, 4e-6])


def test_places_that_are_none_are_refused_at_the_start():
    with pytest.raises(ValueError, match='learn_places: expected each of the axes X, Y, Z'):
        ThermalPredictor(ThermalPredictorConfig(learn=True, learn_places=('Y:0',)))

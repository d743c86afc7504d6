# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fuzzycnc_ros.simulation.soft.foam_tracks import FoamTrack

TRACK = FoamTrack.parallelogram(np.pi / 4)


@pytest.mark.parametrize(
    ('change', 'message'),
    [
        ({'angle': 0.0}, 'angle: expected more than 0 and less than 180 deg but found 0'),
        ({'angle': np.pi}, 'angle: expected more than 0 and less than 180 deg but found 180'),
        ({'angle': np.nan}, 'angle: .* found nan'),
        ({'step': 0.0}, 'step: expected more than 0 mm but found 0'),
        ({'base': 1e-3}, 'base: expected at least the step of 3 mm but found 1'),
        ({'side': np.inf}, 'side: expected at least the step of 3 mm but found inf'),
        ({'centre': (0.0, np.nan)}, 'centre: expected finite coordinates'),
    ],
)
def test_tracks_that_are_none_are_refused(change, message):
    with pytest.raises(ValueError, match=message):
        FoamTrack.parallelogram(**{'angle': 0.5, **change})


def test_bad_runs_are_refused():
    for points in (TRACK.points[:-1], TRACK.points[:, :1], np.full_like(TRACK.points, np.nan)):
        with pytest.raises(ValueError, match='stitched: expected finite points parallel'):
            TRACK.measure(points)
    with pytest.raises(ValueError, match='commanded: expected finite points parallel'):
        TRACK.measure(TRACK.points, TRACK.points[1:])
    with pytest.raises(ValueError, match='feedrate: expected more than 0 m/s but found 0'):
        TRACK.measure(TRACK.points, feedrate=0.0)


@settings(max_examples=40, deadline=None)
@given(
    st.floats(0.2, 2.9),
    st.floats(0.01, 0.09),
    st.floats(0.01, 0.09),
    st.floats(0.001, 0.005),
)
def test_a_track_is_a_closed_centred_parallelogram_stitched_without_error(angle, base, side, step):
    track = FoamTrack.parallelogram(angle, base, side, centre=(0.1, 0.06), step=step)
    corners = track.points[list(track.corners)]
    np.testing.assert_allclose(corners[0], corners[-1], atol=1e-15)
    np.testing.assert_allclose(corners[:4].mean(axis=0), [0.1, 0.06], atol=1e-15)
    lengths = np.hypot(*np.diff(corners, axis=0).T)
    np.testing.assert_allclose(lengths, [base, side, base, side], rtol=1e-12)
    steps = np.hypot(*np.diff(track.points, axis=0).T)
    assert np.all(np.abs(steps - step) <= step)
    quality = track.measure(track.points, feedrate=0.02)
    assert quality[:5] == pytest.approx(np.zeros(5), abs=1e-9)
    assert quality.time == pytest.approx((base + side) / 2 / 0.02)


@settings(max_examples=30, deadline=None)
@given(st.floats(-3.0, 3.0), st.floats(-0.05, 0.05))
def test_turning_and_moving_the_whole_figure_costs_deviation_only(angle, shift):
    c, s = np.cos(angle), np.sin(angle)
    quality = TRACK.measure(TRACK.points @ [[c, s], [-s, c]] + shift)
    assert quality.angle_error == pytest.approx(0.0, abs=1e-9)
    assert quality.straightness == pytest.approx(0.0, abs=1e-12)
    assert quality.closure_gap == pytest.approx(0.0, abs=1e-12)


def test_a_sheared_figure_has_the_angle_error_of_its_shear():
    sheared = TRACK.points.copy()
    sheared[:, 0] += 0.1 * sheared[:, 1]
    found = np.arctan2(1.0, 1.1)
    assert TRACK.measure(sheared).angle_error == pytest.approx(np.pi / 4 - found, abs=1e-12)


def test_spread_gap_deviation_and_time_are_what_they_say():
    bent = TRACK.points.copy()
    bent[10, 1] += 1e-3
    quality = TRACK.measure(bent)
    assert quality.max_deviation == pytest.approx(1e-3)
    assert quality.rms_deviation == pytest.approx(1e-3 / np.sqrt(81))
    assert quality.straightness == pytest.approx(0.25e-3, rel=0.1)  # one side of four
    open_end = TRACK.points.copy()
    open_end[-1] += [3e-3, 4e-3]
    assert TRACK.measure(open_end).closure_gap == pytest.approx(5e-3)
    assert TRACK.measure(TRACK.points).time == pytest.approx(2.86)
    twice = TRACK.measure(TRACK.points, 2.0 * TRACK.points)
    assert twice.time == pytest.approx(5.72)

# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fuzzycnc_ros.core.deformation.compensation import (
    CompensationConfig,
    OffsetPath,
    StepFlag,
    learn_offsets,
)
from fuzzycnc_ros.core.deformation.samples import identify_relaxation
from fuzzycnc_ros.simulation.soft.foam_sheet import FoamSheet
from fuzzycnc_ros.simulation.soft.foam_tracks import FoamTrack

TRACK = FoamTrack.parallelogram(np.pi / 4)
START = OffsetPath.unchanged(TRACK.points)
SHEET = FoamSheet(15e-3, (0.15, 0.1))


@pytest.mark.parametrize('gain', [0.0, -0.1, 1.1, np.nan])
def test_a_gain_out_of_range_is_refused(gain):
    with pytest.raises(ValueError, match='gain: expected more than 0 and at most 1'):
        learn_offsets(START, TRACK.points, gain=gain)


@pytest.mark.parametrize(
    'runs', [TRACK.points[:-1], TRACK.points[:, :1], np.zeros((0, 81, 2)), np.zeros((2, 80, 2))]
)
def test_runs_of_another_track_are_refused(runs):
    with pytest.raises(ValueError, match='learn each track from its own recordings'):
        learn_offsets(START, runs)


def test_lost_stitches_are_refused():
    run = TRACK.points.copy()
    run[7] = np.nan
    with pytest.raises(ValueError, match='leave runs with lost stitches out'):
        learn_offsets(START, run)


def test_a_share_of_the_mean_deviation_is_taken_away():
    runs = TRACK.points + np.array([[[1e-3, 0.0]], [[3e-3, -2e-3]]])
    first = learn_offsets(START, runs)
    np.testing.assert_allclose(first.offset, np.tile([-1.4e-3, 0.7e-3], (81, 1)), atol=1e-15)
    second = learn_offsets(first, TRACK.points - [1e-3, 0.0], gain=0.5)
    added = np.tile([0.5e-3, 0.0], (81, 1))
    np.testing.assert_allclose(second.offset, first.offset + added, atol=1e-15)
    assert not second.flag.any()
    np.testing.assert_array_equal(START.offset, 0.0)


def test_a_perfect_run_changes_nothing():
    path = learn_offsets(START, TRACK.points + 1e-3)
    np.testing.assert_allclose(learn_offsets(path, TRACK.points).offset, path.offset)


def test_learnt_offsets_keep_the_limits():
    config = CompensationConfig(offset_max=2e-3)
    path = learn_offsets(START, TRACK.points - [10e-3, 0.0], config=config)
    np.testing.assert_allclose(path.offset, np.tile([2e-3, 0.0], (81, 1)))
    assert np.all(path.flag == StepFlag.OFFSET_LIMITED)
    size = (TRACK.points[:, 0].max(), 0.1)
    clipped = learn_offsets(START, TRACK.points - [10e-3, 0.0], size=size)
    assert clipped.commanded[:, 0].max() <= size[0]
    assert (clipped.flag & StepFlag.CLIPPED).any()


def test_learning_converges_without_noise():
    path, deviations = START, []
    for _ in range(8):
        stitched = SHEET.stitch(path.commanded, 6e-3)
        deviations.append(np.hypot(*(stitched - TRACK.points).T).max())
        path = learn_offsets(path, stitched)
    assert np.all(np.diff(deviations) < 0.0)
    assert deviations[-1] < 1e-3 * deviations[0]


@settings(max_examples=15, deadline=None)
@given(st.floats(25e-3, 150e-3), st.floats(0.0, 5e-3), st.integers(0, 1000))
def test_a_sheet_of_the_assumed_kind_is_found_again(leak, prompt, seed):
    """D' = D exp(-length / leak) + g length, seen with an offset per side."""
    rng = np.random.default_rng(seed)
    rate = rng.uniform(0.02, 0.15, (4, 2)) * rng.choice([-1.0, 1.0], (4, 2))
    side = np.repeat(np.arange(4), np.diff(TRACK.corners))
    drift, seen = np.zeros(2), [np.zeros(2)]
    for n, way in enumerate(np.hypot(*np.diff(TRACK.points, axis=0).T)):
        drift = drift * np.exp(-way / leak) + rate[side[n]] * way
        seen.append(drift + prompt * rate[side[n]])
    found = identify_relaxation(TRACK.points, TRACK.points - seen, TRACK.corners)
    assert found.leak_length == pytest.approx(leak, abs=1.26e-3)
    finer = leak + np.linspace(-1e-3, 1e-3, 3)
    exact = identify_relaxation(TRACK.points, TRACK.points - seen, TRACK.corners, finer)
    assert exact.leak_length == pytest.approx(leak)
    assert exact.prompt_length == pytest.approx(prompt, abs=1e-9)
    np.testing.assert_allclose(exact.rate, rate, atol=1e-9)
    assert exact.residual < 1e-9


def test_runs_that_tell_nothing_are_refused():
    stitched = SHEET.stitch(TRACK.points, 6e-3)
    with pytest.raises(ValueError, match='points of the same shape'):
        identify_relaxation(TRACK.points, stitched[:-1], TRACK.corners)
    with pytest.raises(ValueError, match='points: expected finite coordinates'):
        identify_relaxation(TRACK.points, np.full_like(stitched, np.nan), TRACK.corners)
    for corners in ((0, 80), (0, 40, 79), (1, 40, 80), (0, 2, 80)):
        with pytest.raises(ValueError, match='corners: expected 0 to 80 in two or more sides'):
            identify_relaxation(TRACK.points, stitched, corners)
    with pytest.raises(ValueError, match='least residual between 80 and 200 mm'):
        identify_relaxation(TRACK.points, stitched, TRACK.corners, [80e-3, 100e-3, 200e-3])
    with pytest.raises(ValueError, match='between 5 and 20 mm but found it at 20 mm'):
        identify_relaxation(TRACK.points, stitched, TRACK.corners, [5e-3, 10e-3, 20e-3])
    with pytest.raises(ValueError, match='record a longer run with corners'):
        identify_relaxation(TRACK.points, TRACK.points, TRACK.corners)

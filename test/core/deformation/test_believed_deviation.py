# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""What of a measured deviation is learnt: no noise, no outliers, and all of a deformation."""

import numpy as np
import pytest

from fuzzycnc_ros.core.deformation.believed_deviation import believed_deviation
from fuzzycnc_ros.simulation.soft.foam_sheet import FoamSheet
from fuzzycnc_ros.simulation.soft.foam_tracks import FoamTrack

TRACK = FoamTrack.parallelogram(np.radians(45.0))
ONE = np.zeros(len(TRACK.points) - 1, np.int64)


def foam():
    return TRACK.points - FoamSheet(15e-3, (0.15, 0.1)).stitch(TRACK.points, 6e-3)


def waves():
    """A field of its own: nothing to do with the way of the foot."""
    x, y = 1e3 * TRACK.points.T
    return 1e-3 * np.column_stack([np.sin(x / 20.0), 0.5 * np.cos(y / 15.0)])


def rms(values):
    return float(np.sqrt((values**2).sum(axis=-1).mean()))


def runs_of(true, noise, seed, runs=1, outliers=0.0):
    rng = np.random.default_rng(seed)
    stitched = TRACK.points - true + rng.normal(0.0, noise, (runs, *true.shape))
    for run in stitched:
        wrong = rng.permutation(len(run))[: round(outliers * len(run))]
        angle = rng.uniform(0.0, 2.0 * np.pi, len(wrong))
        away = rng.uniform(1e-3, 6e-3, len(wrong))
        run[wrong] += (away * np.array([np.cos(angle), np.sin(angle)])).T
    return stitched


@pytest.mark.parametrize('runs', [1, 3])
def test_noise_is_not_learnt(runs):
    nothing = np.zeros_like(TRACK.points)
    for seed in range(10):
        stitched = runs_of(nothing, 1e-4, seed, runs, outliers=0.05 * (seed % 2))
        found = believed_deviation(TRACK.points, stitched, ONE)
        assert not found.corrects
        assert not found.deviation.any()


@pytest.mark.parametrize('true', [foam(), waves()], ids=['foam', 'waves'])
@pytest.mark.parametrize('noise', [0.0, 3e-5, 1e-4])
@pytest.mark.parametrize('runs', [1, 3])
def test_a_deformation_is_learnt_in_spite_of_noise_and_outliers(true, noise, runs):
    clean, dirty, raw = [], [], []
    for seed in range(5):
        stitched = runs_of(true, noise, seed, runs)
        clean.append(rms(believed_deviation(TRACK.points, stitched, ONE).deviation - true))
        raw.append(rms((TRACK.points - stitched).mean(axis=0) - true))
        stitched = runs_of(true, noise, seed, runs, outliers=0.05)
        found = believed_deviation(TRACK.points, stitched, ONE)
        dirty.append(rms(found.deviation - true))
    assert np.mean(clean) <= np.mean(raw) + 1e-9
    assert np.mean(dirty) <= 1.3 * np.mean(clean) + 2e-5


def test_outliers_are_those_that_were_moved():
    stitched = runs_of(foam(), 3e-5, 0)
    stitched[0, [5, 6, 47]] += [2e-3, 1e-3]
    found = believed_deviation(TRACK.points, stitched, ONE)
    assert np.argwhere(found.outlier).tolist() == [[0, 5], [0, 6], [0, 47]]


def test_what_does_not_come_again_in_another_run_is_not_learnt():
    """Each run is smooth, and another one: a sheet that slips."""
    way = np.linspace(0.0, 1.0, len(TRACK.points))
    rng = np.random.default_rng(1)
    slips = [
        1e-3 * np.column_stack([np.sin(6.3 * (way + a)), np.cos(6.3 * (way + b))])
        for a, b in rng.uniform(0.0, 1.0, (4, 2))
    ]
    found = believed_deviation(TRACK.points, TRACK.points - np.array(slips), ONE)
    assert not found.corrects


def test_more_outliers_than_believable_are_noise():
    stitched = runs_of(foam(), 3e-5, 0)
    stitched[0, ::3] += 3e-3
    assert not believed_deviation(TRACK.points, stitched, ONE).outlier.any()


def test_two_stitches_teach_nothing():
    points = TRACK.points[:2]
    found = believed_deviation(points, points[np.newaxis] + 1e-3, ONE[:1])
    assert not found.corrects


def short_track(points):
    """Return an ellipse of few stitches, and a deviation that grows along it [m]."""
    way = np.arange(points) / points
    turn = 2.0 * np.pi * way
    track = np.column_stack([0.075 + 0.038 * np.cos(turn), 0.05 + 0.025 * np.sin(turn)])
    return track, np.column_stack([2e-3 * way * np.sin(turn), 1.5e-3 * way])


@pytest.mark.parametrize('points', [16, 20, 30])
def test_a_short_track_teaches_too_though_one_of_its_stitches_is_astray(points):
    """Its deformation is ten times the noise; blocks as of long tracks would be two or three."""
    track, true = short_track(points)
    one = np.zeros(points - 1, np.int64)
    learnt = invented = 0
    for seed in range(20):
        rng = np.random.default_rng(seed)
        noise = rng.normal(0.0, 1e-4, track.shape)
        noise[rng.integers(points)] += 9e-3
        learnt += believed_deviation(track, (track - true + noise)[np.newaxis], one).corrects
        invented += believed_deviation(track, (track + noise)[np.newaxis], one).corrects
    assert learnt >= 15
    assert invented <= 1

# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Check values of the simulated soft sheet."""

import numpy as np
import pytest

from fuzzycnc_ros.simulation.soft.foam_samples import foam_samples, true_compensation
from fuzzycnc_ros.simulation.soft.foam_sheet import FoamSheet
from fuzzycnc_ros.simulation.soft.foam_tracks import FoamTrack

pytestmark = pytest.mark.paper


def test_force_and_compliance_of_the_foot():
    sheet = FoamSheet(15e-3)
    assert sheet.normal_force(6e-3) == pytest.approx(17.5921, abs=5e-5)
    expected = [[0.372368, -0.153060], [-0.153060, 0.318391]]
    found = 1e3 * sheet.compliance([0.1, 0.06], 6e-3)
    np.testing.assert_allclose(found, expected, rtol=0, atol=5e-7)


@pytest.mark.parametrize(
    ('row', 's'),
    [
        ((0, 6, 2, 3, 15), (6.1114, -2.5121)),
        ((45, 6, 2, 3, 15), (2.4964, 1.8820)),
        ((45, 6, 1, 3, 15), (1.9051, 2.6909)),
        ((30, 2, 2, 2, 5), (8.7249, 0.9451)),
        ((60, 12, 2, 5, 35), (0.2861, 1.0627)),
        ((0, 6, 2, 4, 15), (4.4927, -1.8467)),
    ],
)
def test_samples_without_noise(row, s):
    np.testing.assert_allclose(true_compensation([row])[0], s, rtol=0, atol=5.1e-5)


def test_first_and_last_row_and_spread_of_data_seed_0():
    x, s = foam_samples(0)
    assert x[0].tolist() == [0, 1.5, 2, 3, 5]
    assert x[264].tolist() == [15, 12, 2, 3, 35]
    np.testing.assert_allclose(s[0], [5.84776, -2.32934], rtol=0, atol=5.1e-6)
    np.testing.assert_allclose(s[264], [2.85238, -0.59862], rtol=0, atol=5.1e-6)
    np.testing.assert_allclose(s.std(axis=0), [3.34, 2.61], atol=0.0051)
    np.testing.assert_allclose(np.abs(s).max(axis=0), [18.7, 15.0], atol=0.051)


def test_noise_floor_of_the_data():
    x, s = foam_samples(0)
    assert np.sqrt(np.mean((s - true_compensation(x)) ** 2)) == pytest.approx(0.194, abs=0.02)


def test_track_without_compensation_and_without_noise():
    track, sheet = FoamTrack.parallelogram(np.pi / 4), FoamSheet(15e-3, (0.15, 0.1))
    stitched = sheet.stitch(track.points, 6e-3)
    expected = [(88.586, 36.534), (123.010, 67.115), (60.048, 63.313), (26.367, 32.815)]
    np.testing.assert_allclose(1e3 * stitched[[24, 40, 64, 80]], expected, rtol=0, atol=5.1e-4)
    quality = track.measure(stitched)
    assert np.degrees(quality.angle_error) == pytest.approx(5.1822, abs=5.1e-5)
    assert 1e3 * quality.straightness == pytest.approx(0.4073, abs=5.1e-5)
    assert 1e3 * quality.closure_gap == pytest.approx(4.0742, abs=5.1e-5)


def test_eleven_noisy_runs_without_compensation():
    track, sheet = FoamTrack.parallelogram(np.pi / 4), FoamSheet(15e-3, (0.15, 0.1))
    found = []
    for seed in range(11):
        rng = np.random.default_rng(seed)
        found.append(track.measure(sheet.scattered(rng).stitch(track.points, 6e-3, rng=rng)))
    angles, *lengths, times = np.transpose(found)
    assert np.degrees([angles.mean(), angles.std()]) == pytest.approx([5.11, 0.29], abs=0.0051)
    means = 1e3 * np.mean(lengths, axis=1)
    np.testing.assert_allclose(means, [0.431, 4.25, 6.37, 4.03], atol=0.0051)
    np.testing.assert_allclose(times, 2.86)

# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""One rule for directions: whatever is turned by half a turn, or a whole one, is treated alike."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fuzzycnc_ros.core.deformation.compensation import compensate_path
from fuzzycnc_ros.core.deformation.features import direction_range, folded_samples
from fuzzycnc_ros.core.deformation.model import read_model, write_model
from fuzzycnc_ros.core.deformation.network import TSFuzzyNetwork
from fuzzycnc_ros.core.deformation.stitch_path import SheetMaterial, StitchPath
from fuzzycnc_ros.simulation.soft.foam_samples import true_compensation

SHEET = SheetMaterial(15e-3)


def samples(low, high, count=60, seed=0):
    """Return lines on one sheet whose directions are drawn evenly between two."""
    rng = np.random.default_rng(seed)
    x = np.tile([0.0, 6.0, 2.0, 3.0, 15.0], (count, 1))
    x[:, 0] = rng.uniform(low, high, count)
    x[:, 1] = rng.uniform(5.0, 7.0, count)
    return x, true_compensation(x)


def turned(x, s, turns):
    """Return the same samples, each turned by so many half turns."""
    rows = x.copy()
    rows[:, 0] += 180.0 * np.asarray(turns)
    return rows, s * np.where(np.asarray(turns) % 2, -1.0, 1.0)[:, np.newaxis]


def trained(x, s):
    return TSFuzzyNetwork(n_rules=4, ridge=0.03).fit(x, s).model_


def line(direction):
    """Return 48 mm of stitches in a direction [deg]."""
    along = np.array([np.cos(np.radians(direction)), np.sin(np.radians(direction))])
    points = np.outer(np.arange(17.0) * 3e-3, along)
    return StitchPath(points, depth=6e-3, step=3e-3)


def offsets(model, direction):
    found = compensate_path(
        line(direction), SHEET, model.predict, gate=model, support=model.support
    )
    return found.offset, found.refused


@pytest.fixture(scope='module')
def everywhere():
    return trained(*samples(0.0, 180.0))


@pytest.fixture(scope='module')
def sector():
    """A model of directions on both sides of where paths are folded: 130 to 200 degrees."""
    return trained(*samples(130.0, 200.0))


@pytest.mark.parametrize('direction', range(0, 360, 10))
def test_samples_of_all_directions_are_for_lines_of_all(everywhere, direction):
    offset, refused = offsets(everywhere, direction)
    assert not refused.any()
    needed = true_compensation([[direction, 6.0, 2.0, 3.0, 15.0]])[0]
    # of 48 mm each: the offset at the end of a line grows as the compensation, and along it
    assert offset[-1] @ needed > 0.95 * np.hypot(*offset[-1]) * np.hypot(*needed)


@pytest.mark.parametrize(('direction', 'known'), [(160, True), (195, True), (125, False)])
def test_a_sector_across_the_fold_is_one_sector(sector, direction, known):
    for turn in (0, 180, -180, 360):
        assert offsets(sector, direction + turn)[1].all() == (not known)
    low, high = sector.gate.low[0], sector.gate.high[0]
    assert (low, high) == pytest.approx((130.0, 200.0), abs=5.0)


@settings(max_examples=60, deadline=None)
@given(direction=st.floats(-400.0, 400.0), turns=st.integers(-3, 3))
def test_any_line_is_compensated_like_its_turned_one(everywhere, sector, direction, turns):
    for model in (everywhere, sector):
        low, high = model.gate.low[0], model.gate.high[0]
        edges = (low, high, model.gate.fold_from)
        away = min(abs((direction - edge + 90.0) % 180.0 - 90.0) for edge in edges)
        if away < 1e-3:  # rounding decides on which side of an edge it is
            continue
        x = np.array([[direction, 6.0, 2.0, 3.0, 15.0]])
        other, _ = turned(x, np.zeros((1, 2)), [turns])
        sign = -1.0 if turns % 2 else 1.0
        assert model.accepts(other) == model.accepts(x)
        np.testing.assert_allclose(model.predict(other), sign * model.predict(x), atol=1e-8)
        np.testing.assert_allclose(model.support(other), model.support(x), atol=1e-8)
        np.testing.assert_allclose(model.clip(other) - other, model.clip(x) - x, atol=1e-8)
        one, support = model.predict_one(other[0].tolist())
        np.testing.assert_allclose(one, model.predict(other)[0], atol=1e-9)
        assert support == pytest.approx(model.support(x)[0], abs=1e-8)
        adapted = [
            model.adapted(rows, 1.3 * model.predict(rows)).gain.value for rows in (x, other)
        ]
        np.testing.assert_allclose(*adapted, atol=1e-8)
        (offset, refused), (opposite, also) = (
            offsets(model, direction),
            offsets(model, other[0, 0]),
        )
        assert refused.tolist() == also.tolist()
        np.testing.assert_allclose(opposite, sign * offset, atol=1e-9)


@pytest.mark.parametrize('span', [(0.0, 180.0), (130.0, 200.0), (0.0, 350.0), (20.0, 75.0)])
@pytest.mark.parametrize('seed', [0, 1])
def test_turned_samples_train_the_same_model(span, seed):
    x, s = samples(*span)
    turns = np.random.default_rng(seed).integers(-2, 3, len(x))
    first, second = trained(x, s), trained(*turned(x, s, turns))
    np.testing.assert_allclose(second.gate.low, first.gate.low, atol=1e-6)
    np.testing.assert_allclose(second.gate.high, first.gate.high, atol=1e-6)
    rows, _ = samples(*span, seed=9)
    np.testing.assert_allclose(second.predict(rows), first.predict(rows), atol=1e-4)


def test_both_ends_of_the_half_turn_agree(everywhere):
    ends = [[end, 6.0, 2.0, 3.0, 15.0] for end in (-30.001, -29.999)]
    below, above = everywhere.predict(ends)
    assert np.abs(above - below).max() < 0.1 * np.abs(above).max()


@pytest.mark.parametrize(
    ('directions', 'expected'),
    [
        ([0.0, 15.0, 60.0], (0.0, 60.0)),
        ([140.0, 160.0, 190.0], (140.0, 190.0)),
        ([-20.0, 170.0, 340.0], (-20.0, -10.0)),
        ([0.0, 45.0, 90.0, 135.0], (-30.0, 150.0)),
        (np.arange(1.0, 180.0, 7.0), (-30.0, 150.0)),
        ([30.0], (30.0, 30.0)),
    ],
)
def test_the_range_ends_in_the_widest_gap(directions, expected):
    assert direction_range(np.array(directions)) == pytest.approx(expected, abs=1e-9)


def test_folding_folded_samples_changes_nothing():
    x, s = folded_samples(*samples(100.0, 210.0))
    again, same = folded_samples(x, s)
    np.testing.assert_array_equal(again, x)
    np.testing.assert_array_equal(same, s)


def test_a_file_of_unfolded_samples_is_for_all_directions_too(everywhere):
    """Written before the samples were folded: 1 to 179 degrees."""
    text = write_model(everywhere).replace('[-30.0, ', '[1.0, ').replace('[150.0, ', '[179.0, ')
    model = read_model(text)
    assert (model.gate.low[0], model.gate.high[0]) == (1.0, 179.0)
    rows = np.array([[direction, 6.0, 2.0, 3.0, 15.0] for direction in range(0, 360, 10)])
    assert model.gate.inside(rows).all()

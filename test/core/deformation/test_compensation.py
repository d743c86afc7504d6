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
    compensate_path,
    feature_rows,
    initial_rate_factor,
    limit_offsets,
)
from fuzzycnc_ros.core.deformation.stitch_path import SheetMaterial, StitchPath
from fuzzycnc_ros.simulation.soft.foam_samples import true_compensation
from fuzzycnc_ros.simulation.soft.foam_tracks import FoamTrack

SHEET = SheetMaterial(15e-3, (0.15, 0.1))
TRACK = FoamTrack.parallelogram(np.pi / 4)
PATH = StitchPath(TRACK.points, depth=6e-3, step=3e-3)
RAMP = CompensationConfig(accumulate='ramp')


def line(count=20, step=3e-3, angle=0.0, kind=2, depth=6e-3, start=(0.04, 0.05), turn=1):
    along = np.array([np.cos(angle), np.sin(angle)])
    points = np.asarray(start) + np.outer(np.arange(count + 1) * step, along)
    return StitchPath(points, kind, depth=depth, step=step, turn=turn)


def constant(x=5.0, y=0.0):
    return lambda rows: np.tile([x, y], (len(rows), 1))


class Box:
    """A gate that lets a range of directions pass."""

    def __init__(self, low=0.0, high=60.0):
        self.low, self.high = low, high

    def accepts(self, x):
        return (x[:, 0] >= self.low - 1e-6) & (x[:, 0] <= self.high + 1e-6)

    def clip(self, x):
        return np.column_stack([np.clip(x[:, 0], self.low, self.high), x[:, 1:]])


@pytest.mark.parametrize(
    ('output', 'message'),
    [
        (lambda x: np.zeros((len(x), 3)), r'shape \(20, 2\) but found \(20, 3\)'),
        (lambda x: np.full((len(x), 2), np.nan), 'finite compensations but found some'),
    ],
)
def test_a_model_that_answers_nonsense_is_refused(output, message):
    with pytest.raises(ValueError, match=message):
        compensate_path(line(), SHEET, output)


def test_a_foot_through_the_sheet_and_a_point_off_it_are_refused():
    with pytest.raises(ValueError, match=r'found 12.5 mm in step 0: the foot would go through'):
        compensate_path(line(depth=12.5e-3), SHEET, constant())
    with pytest.raises(ValueError, match=r'clamped area of 150 x 100 mm but found \[151.0, 50.0'):
        compensate_path(line(38, start=(0.04, 0.05)), SHEET, constant())
    compensate_path(line(depth=12e-3), SHEET, constant())


def test_ramp_adds_up_what_is_needed_per_50_mm():
    path = compensate_path(line(), SHEET, constant(5.0, -2.0), config=RAMP)
    way = np.arange(21) * 3e-3
    np.testing.assert_allclose(path.offset, np.outer(way, [0.1, -0.04]), atol=1e-15)
    np.testing.assert_array_equal(path.commanded, path.nominal + path.offset)
    assert not path.flag.any()
    assert np.isnan(path.support).all()


def test_leaky_fades_as_printed():
    config = CompensationConfig(leak_length=80e-3, prompt_length=0.0, initial_rate=False)
    found = compensate_path(line(), SHEET, constant(5.0, 0.0), config=config).offset
    expected = [0.0]
    for _ in range(20):
        expected.append(expected[-1] * np.exp(-3.0 / 80.0) + 5.0 * 3.0 / 50.0)
    np.testing.assert_allclose(found, np.outer(expected, [1e-3, 0.0]), atol=1e-15)


@pytest.mark.parametrize(('leak', 'prompt'), [(60e-3, 0.0), (60e-3, 1e-3), (80e-3, 2e-3)])
def test_the_initial_rate_gives_a_sample_back_its_own_slope(leak, prompt):
    rate, way = 0.1, np.arange(1, 18) * 50e-3 / 17
    drift = rate * (leak * (1.0 - np.exp(-way / leak)) + prompt)
    slope = way @ drift / (way @ way)
    factor = initial_rate_factor(50e-3, 3e-3, leak, prompt)
    assert slope * factor == pytest.approx(rate)


def test_arcs_are_raised_by_the_factor_of_their_shorter_samples():
    config = CompensationConfig(prompt_length=0.0)
    for kind, length in ((1, 30e-3), (2, 50e-3)):
        path = compensate_path(line(kind=kind), SHEET, constant(), config=config)
        expected = initial_rate_factor(length, 3e-3, 60e-3) * 5.0 * 3.0 / 50.0
        assert 1e3 * path.offset[1, 0] == pytest.approx(expected)


@settings(max_examples=60, deadline=None)
@given(st.floats(-179.0, 180.0))
def test_a_direction_and_its_opposite_are_one_with_opposite_signs(angle):
    there, back = (line(3, angle=np.radians(angle + turn)) for turn in (0.0, 180.0))
    (x, sign), (opposite, other) = feature_rows(there, SHEET), feature_rows(back, SHEET)
    assert np.all((x[:, 0] > -30.0 - 1e-6) & (x[:, 0] < 150.0 + 1e-6))
    if abs((angle + 30.0) % 180.0) > 1e-6:  # where rounding decides
        np.testing.assert_allclose(x, opposite, atol=1e-6)
        np.testing.assert_array_equal(sign, -other)


def test_just_below_the_x_axis_nothing_jumps():
    for angle, expected in ((-2.0, -2.0), (178.0, -2.0), (149.0, 149.0), (151.0, -29.0)):
        x, sign = feature_rows(line(1, angle=np.radians(angle)), SHEET)
        assert x[0, 0] == pytest.approx(expected)
        assert sign[0] == (1.0 if expected == angle else -1.0)
    np.testing.assert_allclose(x[0, 1:], [6.0, 2.0, 3.0, 15.0])


def test_going_back_needs_the_opposite():
    there = compensate_path(line(), SHEET, true_compensation)
    back = compensate_path(line(angle=np.pi, start=(0.1, 0.05)), SHEET, true_compensation)
    np.testing.assert_allclose(there.offset, -back.offset, atol=1e-12)


def test_a_path_outside_the_domain_gets_nothing_and_is_flagged():
    asked = []

    def predict(x):
        asked.append(len(x))
        return constant()(x)

    path = compensate_path(
        line(angle=np.radians(90.0), start=(0.05, 0.02)), SHEET, predict, gate=Box()
    )
    assert not path.offset.any()
    assert np.all(path.flag == StepFlag.OUTSIDE_DOMAIN)
    assert path.refused.all()
    assert not asked


def test_offsets_from_before_a_refused_stretch_are_taken_back_gently():
    first, second = line(), line(angle=np.pi / 2, start=(0.1, 0.05), count=16)
    both = StitchPath(np.vstack([first.points, second.points[1:]]), depth=6e-3, step=3e-3)
    config = CompensationConfig(accumulate='ramp', rate_max=0.05)
    path = compensate_path(both, SHEET, constant(2.0), config=config, gate=Box())
    assert path.refused.tolist() == [False] * 20 + [True] * 16
    offset = 1e3 * path.offset[:, 0]
    assert offset[20] == pytest.approx(2.4)
    np.testing.assert_allclose(np.diff(offset[20:36]), -0.15, atol=1e-12)
    assert offset[36] == pytest.approx(0.0, abs=1e-12)
    assert not path.offset[:, 1].any()


def test_right_turns_are_refused_and_left_turns_not():
    for turn, flag in ((-1, StepFlag.RIGHT_TURN), (1, 0)):
        path = compensate_path(line(kind=1, turn=turn), SHEET, constant())
        assert np.all(path.flag == flag)
        assert path.offset.any() == (turn == 1)
    straight = compensate_path(line(turn=-1), SHEET, constant())
    assert not straight.flag.any()


@pytest.mark.parametrize('config', [RAMP, CompensationConfig(), CompensationConfig(passes=2)])
def test_points_given_twice_are_skipped(config):
    plain = compensate_path(line(), SHEET, true_compensation, config=config, gate=Box())
    again = np.insert(line().points, [5, 5, 20], line().points[[5, 5, 20]], axis=0)
    path = StitchPath(again, depth=6e-3, step=3e-3)
    doubled = compensate_path(path, SHEET, true_compensation, config=config, gate=Box())
    kept = np.delete(np.arange(24), [6, 7, 23])
    np.testing.assert_allclose(doubled.offset[kept], plain.offset, atol=1e-15)
    np.testing.assert_array_equal(doubled.offset[[6, 7]], doubled.offset[[5, 5]])
    assert np.flatnonzero(doubled.flag == StepFlag.ZERO_LENGTH).tolist() == [5, 6, 22]


def test_the_model_is_cut_at_the_largest_rate():
    path = compensate_path(line(), SHEET, constant(30.0, 1.0), config=RAMP)
    assert np.all(path.flag == StepFlag.RATE_LIMITED)
    np.testing.assert_allclose(path.compensation, np.tile([7.5, 1.0], (20, 1)))
    np.testing.assert_allclose(np.diff(path.offset[:, 0]), 0.15 * 3e-3)


def test_support_is_that_of_the_nominal_values():
    config = CompensationConfig(passes=2)
    path = compensate_path(
        PATH, SHEET, true_compensation, config=config, support=lambda x: -x[:, 0]
    )
    np.testing.assert_allclose(path.support[:40], [0.0] * 23 + [-45.0] * 17, atol=1e-9)


def test_later_passes_take_compensated_steps_and_judge_no_more():
    seen = []

    def predict(x):
        seen.append(x)
        return true_compensation(x)

    config = CompensationConfig(passes=2)
    path = compensate_path(PATH, SHEET, predict, config=config, gate=Box())
    assert not path.flag.any()
    nominal, compensated = seen
    assert set(nominal[:, 0].round(6)) == {0.0, 45.0}
    assert set(nominal[:, 3]) == {3.0}
    assert len(set(compensated[:, 3].round(6))) > 10
    assert compensated[:, 0].min() == 0.0  # the bases lean below 0 deg and are cut at the box
    unbound = []
    compensate_path(
        PATH,
        SHEET,
        lambda x: unbound.append(x) or true_compensation(x),
        config=config,
    )
    assert np.mean(unbound[1][:, 0] < 0.0) == pytest.approx(0.575)


@settings(max_examples=60, deadline=None)
@given(
    st.floats(-60.0, 60.0),
    st.floats(-60.0, 60.0),
    st.sampled_from(['leaky', 'ramp']),
    st.floats(0.02, 0.5),
    st.floats(0.2, 2.8),
)
def test_limits_hold_whatever_the_model_says(x, y, accumulate, rate_max, angle):
    track = FoamTrack.parallelogram(angle)
    config = CompensationConfig(accumulate=accumulate, rate_max=rate_max, offset_max=8e-3)
    wide = SheetMaterial(15e-3)
    path = StitchPath(track.points, depth=6e-3, step=3e-3)
    found = compensate_path(path, wide, constant(x, y), config=config)
    assert np.hypot(*found.offset.T).max() <= 8e-3 + 1e-12
    nominal, commanded = np.diff(track.points, axis=0), np.diff(found.commanded, axis=0)
    progress = (nominal * commanded).sum(axis=1) / (nominal**2).sum(axis=1)
    assert progress.min() >= 0.2 - 1e-9
    clamped = compensate_path(path, SheetMaterial(15e-3, (0.15, 0.1)), constant(x, y))
    assert np.all(
        (clamped.commanded >= -1e-15) & (clamped.commanded <= [0.15 + 1e-15, 0.1 + 1e-15])
    )


def test_limits_say_what_they_did():
    nominal = np.column_stack([np.arange(6) * 3e-3, np.full(6, 1e-3)])
    wanted = np.zeros((6, 2))
    wanted[1] = [0.0, 20e-3]
    offset, flag = limit_offsets(nominal, wanted)
    assert flag.tolist() == [StepFlag.OFFSET_LIMITED, 0, 0, 0, 0]
    assert offset[1].tolist() == [0.0, 15e-3]
    wanted[1] = [4e-3, 0.0]
    offset, flag = limit_offsets(nominal, wanted)
    assert flag.tolist() == [0, StepFlag.PROGRESS_LIMITED, 0, 0, 0]
    assert offset[2, 0] == pytest.approx(4e-3 - 0.8 * 3e-3)
    wanted[1] = [0.0, -2e-3]
    offset, flag = limit_offsets(nominal, wanted, size=(0.1, 0.1))
    assert flag.tolist() == [StepFlag.CLIPPED, 0, 0, 0, 0]
    assert offset[1].tolist() == [0.0, -1e-3]
    wanted[2:, 0] = 8e-3
    _, flag = limit_offsets(nominal, wanted, size=(15e-3, 0.1))
    assert flag[-1] == StepFlag.CLIPPED | StepFlag.NO_PROGRESS


def test_a_path_left_alone():
    path = OffsetPath.unchanged(TRACK.points)
    np.testing.assert_array_equal(path.commanded, TRACK.points)
    assert not path.refused.any()


@pytest.mark.parametrize(
    'setting', [{'passes': 0}, {'rate_max': 0.0}, {'accumulate': 'both'}, {'leak_length': -1.0}]
)
def test_settings_out_of_range_are_refused(setting):
    with pytest.raises(ValueError, match=next(iter(setting))):
        CompensationConfig(**setting)

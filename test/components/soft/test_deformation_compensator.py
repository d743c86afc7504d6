# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Component `deformation_compensator`: what it publishes, refuses, limits and says of it."""

from dataclasses import replace

import numpy as np
import pytest
from benches.component_bench import Bench
from benches.pattern_bench import (
    FRAME,
    SIDES,
    TRACK,
    Compensator,
    material,
    model_text,
    pattern,
    points,
    with_travel,
)
from hypothesis import given, settings
from hypothesis import strategies as st

from fuzzycnc_ros.components.motion.tool_paths import tool_path_segments
from fuzzycnc_ros.components.soft.deformation_compensator import (
    DeformationCompensator,
    DeformationCompensatorConfig,
)
from fuzzycnc_ros.core.deformation.compensation import StepFlag, compensate_path
from fuzzycnc_ros.core.deformation.model import read_model, write_model
from fuzzycnc_ros.core.deformation.network import TSFuzzyNetwork
from fuzzycnc_ros.core.deformation.offset_file import StitchOffsets, write_offsets
from fuzzycnc_ros.core.deformation.stitch_path import Primitive, SheetMaterial, StitchPath
from fuzzycnc_ros.core.names import text_hash
from fuzzycnc_ros.runtime.enums import Junction, PrimitiveKind, SegmentKind
from fuzzycnc_ros.runtime.records import nanoseconds
from fuzzycnc_ros.simulation.soft.foam_samples import foam_samples


@pytest.fixture(scope='module')
def model():
    """Text of a model of simulated samples."""
    return model_text()


def test_a_pattern_is_compensated_as_by_the_core(model):
    path, tool = Compensator(model).stitch(pattern())
    trained = read_model(model)
    expected = compensate_path(
        StitchPath(TRACK.points, depth=6e-3, step=3e-3),
        SheetMaterial(15e-3, (0.15, 0.1)),
        trained.predict,
        gate=trained,
        support=trained.support,
    )
    np.testing.assert_allclose(points(path.nominal), TRACK.points, atol=1e-15)
    np.testing.assert_allclose(points(path.offset), expected.offset, atol=1e-12)
    np.testing.assert_allclose(points(path.compensation), expected.compensation / 50.0, atol=1e-9)
    np.testing.assert_allclose(path.support, expected.support, atol=1e-9)
    assert np.abs(path.offset).max() > 1e-3
    assert not path.flag.any()
    assert (path.stamp, path.frame_id, path.path_id) == (nanoseconds(2.0), FRAME, 'track')
    assert (path.material, path.thickness, path.model) == ('foam', 15e-3, text_hash(model))
    assert np.bincount(path.primitive).tolist() == [23, 17, 23, 17]
    assert set(path.kind.tolist()) == {PrimitiveKind.LINE}
    assert (set(path.depth.tolist()), set(path.step.tolist())) == ({6e-3}, {3e-3})
    assert (tool.stamp, tool.path_id, tool.includes_compensation) == (path.stamp, 'track', True)


def test_the_tool_path_goes_through_the_commanded_points(model):
    path, tool = Compensator(model).stitch(pattern())
    commanded = points(path.nominal + path.offset)
    segments = tool_path_segments(tool)
    ends = np.array([segment.end for segment in segments])
    np.testing.assert_array_equal(segments.start[:2], commanded[0])
    np.testing.assert_array_equal(ends[:, :2], commanded[1:])
    assert tool.axis == ('X', 'Y')
    assert set(tool.kind.tolist()) == {SegmentKind.LINE}
    assert set(tool.feedrate.tolist()) == {0.021}
    # stops at the corners of the nominal pattern and at the end
    stops = np.flatnonzero(tool.junction == Junction.EXACT_STOP) + 1
    assert stops.tolist() == list(TRACK.corners[1:])


def test_without_a_model_patterns_pass_as_they_are():
    bench = Compensator()
    path, tool = bench.stitch(pattern())
    assert not path.offset.any()
    assert np.isnan(path.support).all()
    assert path.model == ''
    np.testing.assert_allclose(points(tool.data), TRACK.points[1:], atol=1e-15)
    assert 'not compensated: no model' in bench.health()


def test_arcs_lines_and_corners():
    """A tangent arc is gone into at speed; a corner beyond the angle is stopped at."""
    line = Primitive((0.02, 0.02), (0.05, 0.02), 6e-3, 3e-3)
    arc = Primitive((0.05, 0.02), (0.07, 0.04), 6e-3, 3e-3, (0.05, 0.04), np.pi / 2)
    bend = Primitive((0.07, 0.04), (0.0717, 0.0595), 6e-3, 3e-3)  # 4.98 deg from upwards
    back = Primitive((0.0717, 0.0595), (0.0717, 0.03), 6e-3, 3e-3)
    path, tool = Compensator().stitch(pattern([line, arc, bend, back]))
    count = np.bincount(path.primitive)
    assert count.tolist() == [10, 10, 7, 10]
    assert path.kind.tolist() == np.repeat([0, 1, 0, 0], count).tolist()
    np.testing.assert_array_equal(path.turn, np.repeat([0.0, np.pi / 2, 0.0, 0.0], count))
    stops = np.flatnonzero(tool.junction == Junction.EXACT_STOP)
    assert stops.tolist() == [26, 36]
    _, sharper = Compensator(corner_angle=0.08).stitch(pattern([line, arc, bend, back]))
    assert np.flatnonzero(sharper.junction).tolist() == [19, 26, 36]


LINES = [
    Primitive((0.03, 0.03), (0.06, 0.045), 6e-3, 3e-3),
    Primitive((0.06, 0.045), (0.09, 0.06), 6e-3, 3e-3),
    Primitive((0.05, 0.06), (0.08, 0.075), 6e-3, 3e-3),
]
TRAVEL = {0: (PrimitiveKind.STOP,), 1: (PrimitiveKind.TRIM,), 2: (PrimitiveKind.TRIM,)}


def test_only_stitches_are_compensated_each_run_by_itself(model):
    """A jump of 40 mm is neither compensated nor does it add to the offset behind it."""
    path, tool = Compensator(model).stitch(with_travel(LINES, TRAVEL))
    trained, sheet = read_model(model), SheetMaterial(15e-3, (0.15, 0.1))
    first, last = (
        compensate_path(
            StitchPath.of_primitives(run), sheet, trained.predict, gate=trained,
            support=trained.support,
        )
        for run in (LINES[:2], LINES[2:])
    )  # fmt: skip
    sides = [11, 11, 11]
    assert path.kind.tolist() == [*sides[0] * [0], 4, *sides[1] * [0], 3, 2, *sides[2] * [0], 3]
    offset = points(path.offset)
    stop, trim, landing = 12, 24, 25
    np.testing.assert_array_equal(offset[:stop], first.offset[:stop])
    np.testing.assert_array_equal(offset[stop + 1 : trim], first.offset[stop:])
    np.testing.assert_array_equal(offset[landing:-1], last.offset)
    assert np.abs(first.offset[-1]).max() > 1e-3
    # what does not move stays where the tool is, and a jump leads to where stitches begin
    np.testing.assert_array_equal(offset[[stop, trim, -1]], offset[[stop - 1, trim - 1, -2]])
    assert not offset[landing].any()
    travel = path.kind > PrimitiveKind.ARC
    assert not path.depth[travel].any()
    assert np.isnan(path.support[travel]).all()
    assert not path.flag.any()
    moving = ~np.isin(path.kind, (PrimitiveKind.TRIM, PrimitiveKind.STOP))
    commanded = points(path.nominal + path.offset)[1:]
    np.testing.assert_array_equal(points(tool.data), commanded[moving])
    assert np.flatnonzero(tool.junction).tolist() == [10, 21, 22, 33]
    assert tool.feedrate[22] == 0.05


def test_learnt_offsets_are_of_the_stitches_alone():
    made = with_travel(LINES, TRAVEL)
    runs = [StitchPath.of_primitives(run).points for run in (LINES[:2], LINES[2:])]
    nominal = np.concatenate(runs)
    shift = 1e-4 * np.sin(np.arange(nominal.size)).reshape(-1, 2)
    learnt = write_offsets(StitchOffsets('track', 'foam', nominal, shift))
    path, _ = Compensator(offsets=learnt).stitch(made)
    kept = np.append(True, path.kind != PrimitiveKind.STOP)
    kept[[24, -1]] = False  # trims behind which nothing is stitched
    np.testing.assert_allclose(points(path.offset)[kept], shift, atol=1e-12)
    assert path.model == text_hash(learnt)


def test_refused_steps_get_no_offset_a_flag_and_a_warning(model):
    bench = Compensator(model)
    up = [Primitive((0.07, 0.02), (0.07, 0.08), 6e-3, 3e-3)]  # 90 deg, beyond the training
    path, tool = bench.stitch(pattern(up))
    assert set(path.flag.tolist()) == {StepFlag.OUTSIDE_DOMAIN}
    assert not path.offset.any()
    assert not path.compensation.any()
    assert tool is not None
    assert 'WARN state: track: 20 of 20 steps are unlike the training' in bench.health()
    assert bench.component.health()[0].values['refused [%]'] == '100.0'


def test_refused_steps_stop_the_pattern_if_asked_for(model):
    bench = Compensator(model, on_refused='stop')
    up = [Primitive((0.07, 0.02), (0.07, 0.08), 6e-3, 3e-3)]
    assert 'not stitched, as on_refused says' in bench.refusal(pattern(up))
    assert bench.stitch(pattern(time=3.0))[0] is not None


def test_arcs_to_the_right_are_refused(model):
    arc = Primitive((0.05, 0.05), (0.07, 0.03), 6e-3, 3e-3, (0.05, 0.03), -np.pi / 2)
    path, _ = Compensator(model).stitch(pattern([arc]))
    assert (path.flag & StepFlag.RIGHT_TURN).all()
    assert not path.offset.any()
    assert (path.turn < 0.0).all()


@settings(max_examples=40, deadline=None)
@given(
    thickness=st.sampled_from([5e-3, 15e-3, 20e-3, 25e-3, 35e-3]),
    ratio=st.floats(0.601, 0.799),
    angle=st.floats(-30.0, 149.9),
)
def test_gate_refuses_every_deep_foot(model, thickness, ratio, angle):
    """Depth over thickness above 0.6 is refused whatever the direction."""
    path = _single(model, thickness, ratio * thickness, angle)
    assert set(path.flag.tolist()) == {StepFlag.OUTSIDE_DOMAIN}
    assert not path.offset.any()


@settings(max_examples=40, deadline=None)
@given(
    thickness=st.sampled_from([15e-3, 20e-3, 25e-3, 35e-3]),
    ratio=st.floats(0.3, 0.5),
    angle=st.one_of(st.floats(-30.0, -0.01), st.floats(60.01, 149.9)),
    opposite=st.booleans(),
)
def test_gate_refuses_every_other_direction(model, thickness, ratio, angle, opposite):
    path = _single(model, thickness, ratio * thickness, angle + 180.0 * opposite)
    assert set(path.flag.tolist()) == {StepFlag.OUTSIDE_DOMAIN}
    assert not path.offset.any()


def _single(model, thickness, depth, angle):
    """Return the compensated path of one line of 51 mm in the middle of a sheet."""
    along = 25.5e-3 * np.array([np.cos(np.radians(angle)), np.sin(np.radians(angle))])
    middle = np.array([0.1, 0.06])
    start, end = (middle - along).tolist(), (middle + along).tolist()
    bench = Compensator(model, sheet=False)
    bench.give('material', material(thickness=thickness, size=np.array([0.2, 0.12])))
    path, _ = bench.stitch(pattern([Primitive(tuple(start), tuple(end), depth, 3e-3)]))
    return path


def test_gain_scales_the_models_output(model):
    plain, _ = Compensator(model).stitch(pattern())
    scaled, _ = Compensator(model, gain=(0.5, 2.0), rate_max=0.5).stitch(pattern())
    np.testing.assert_allclose(
        points(scaled.compensation), points(plain.compensation) * [0.5, 2.0], atol=1e-12
    )


def test_limits_are_reported(model):
    bench = Compensator(model, offset_max=1e-3)
    path, _ = bench.stitch(pattern())
    assert np.hypot(*points(path.offset).T).max() <= 1e-3 + 1e-12
    assert (path.flag & StepFlag.OFFSET_LIMITED).any()
    values = bench.component.health()[0].values
    assert float(values['limited [%]']) > 50.0
    assert values['largest offset [mm]'] == '1.000'


def test_offsets_that_lead_off_the_sheet_are_cut_and_reported(model):
    bench = Compensator(model)
    edge = [Primitive((0.02, 0.0001), (0.08, 0.0001), 6e-3, 3e-3)]
    path, tool = bench.stitch(pattern(edge))
    assert (path.flag & StepFlag.CLIPPED).any()
    commanded = points(path.nominal + path.offset)
    assert commanded.min() > -1e-12
    assert tool.data.min() > -1e-12
    assert float(bench.component.health()[0].values['cut at the edge [%]']) > 50.0


def test_points_given_twice_are_skipped():
    """A line without a length is no primitive, and the numbers of the others stay."""
    twice = pattern(SIDES[:2])
    row = [0, 0, 1]
    doubled = replace(
        twice,
        kind=twice.kind[row],
        end=points(twice.end)[row].ravel(),
        centre=points(twice.centre)[row].ravel(),
        **{name: getattr(twice, name)[row] for name in ('turn', 'depth', 'step', 'feedrate')},
    )
    path, tool = Compensator().stitch(doubled)
    assert np.unique(path.primitive).tolist() == [0, 2]
    assert len(path.nominal) == 2 * 41
    assert np.flatnonzero(tool.junction).tolist() == [22, 39]


def test_a_sheet_of_unknown_size_has_no_edge():
    bench = Compensator(sheet=False)
    bench.give('material', material(size=np.zeros(0)))
    path, _ = bench.stitch(pattern(start=np.array([-0.03, 0.032322])))
    assert path.nominal[0] == -0.03


def test_the_newest_sheet_counts(model):
    bench = Compensator(model)
    thin, _ = bench.stitch(pattern())
    bench.give('material', material(time=3.0, thickness=25e-3, name='thick'))
    thick, _ = bench.stitch(pattern(time=4.0))
    assert (thick.material, thick.thickness) == ('thick', 25e-3)
    assert np.abs(thick.offset).max() < np.abs(thin.offset).max()


def test_inactive_it_publishes_nothing(model):
    bench = Bench(DeformationCompensator())
    bench.give('material', material())
    assert bench.give('stitch_pattern', pattern()) == []
    assert 'dropped: inactive' in bench.health()
    assert not bench.request('deactivate').success
    assert bench.request('activate').success
    assert bench.request('activate').message == 'already active'
    assert bench.give('stitch_pattern', pattern(time=3.0))
    assert bench.request('deactivate').success
    assert bench.give('stitch_pattern', pattern(time=4.0)) == []


def test_a_latched_pattern_is_taken_once(model):
    bench = Compensator(model)
    first = pattern()
    assert bench.stitch(first)[0] is not None
    assert bench.stitch(first) == (None, None)
    assert bench.component.health()[0].level.name == 'OK'
    assert bench.stitch(pattern(time=3.0))[0] is not None


def test_another_model_takes_effect_with_the_next_pattern(model):
    bench = Compensator(model)
    other = write_model(TSFuzzyNetwork(consequent='sts').fit(*foam_samples(1)).model_)
    first, _ = bench.stitch(pattern())
    answer = bench.request('use_model', model=other)
    assert answer.success
    assert text_hash(other)[:8] in answer.message
    assert bench.component.model_text == other
    second, _ = bench.stitch(pattern(time=3.0))
    assert (first.model, second.model) == (text_hash(model), text_hash(other))
    assert np.abs(second.offset - first.offset).max() > 1e-5
    assert bench.request('use_model', model='').success
    assert bench.component.model_text == ''
    assert not bench.stitch(pattern(time=4.0))[0].offset.any()


def learnt(**changes):
    """Return learnt offsets of the track."""
    offset = np.full_like(TRACK.points, 2e-4)
    values = {'path_id': 'track', 'material': 'foam', 'nominal': TRACK.points, 'offset': offset}
    return write_offsets(StitchOffsets(**{**values, **changes}))


def test_learnt_offsets_take_the_place_of_the_models(model):
    text = learnt()
    bench = Compensator(model, offsets=text)
    path, tool = bench.stitch(pattern())
    np.testing.assert_allclose(path.offset, 2e-4, atol=1e-15)
    assert path.model == text_hash(text)
    assert not path.compensation.any()
    np.testing.assert_allclose(points(tool.data), TRACK.points[1:] + 2e-4, atol=1e-15)
    assert 'OK state: track: learnt offsets' in bench.health()
    assert bench.request('use_offsets', offsets='').success
    assert bench.stitch(pattern(time=3.0))[0].model == text_hash(model)


def test_learnt_offsets_are_taken_as_a_model_too(model):
    as_offsets, _ = Compensator(model, offsets=learnt()).stitch(pattern())
    bench = Compensator(learnt())
    as_model, _ = bench.stitch(pattern())
    assert as_model.offset.tolist() == as_offsets.offset.tolist()
    assert as_model.model == as_offsets.model
    assert 'OK state: track: learnt offsets' in bench.health()
    other = Compensator(learnt(path_id='other'))
    unchanged, _ = other.stitch(pattern())
    assert not np.any(unchanged.offset)
    assert 'WARN offsets: learnt offsets not used' in other.health()


def test_learnt_offsets_keep_the_limits(model):
    far = np.zeros_like(TRACK.points)
    far[40:60] = (0.0, 20e-3)
    path, _ = Compensator(model, offsets=learnt(offset=far)).stitch(pattern())
    assert np.hypot(*points(path.offset).T).max() <= 15e-3 + 1e-12
    assert (path.flag & StepFlag.OFFSET_LIMITED).any()


@pytest.mark.parametrize(
    ('changes', 'text'),
    [
        ({'path_id': 'other'}, "offsets of the pattern 'other', not of 'track'"),
        ({'material': 'felt'}, "offsets for the material 'felt', not for 'foam'"),
        ({'nominal': TRACK.points + 2e-6}, 'offsets of other points: number'),
        (
            {'nominal': TRACK.points[:-1], 'offset': TRACK.points[:-1]},
            'offsets of 80 points, not of 81',
        ),
    ],
)
def test_offsets_of_something_else_are_not_used(model, changes, text):
    bench = Compensator(model, offsets=learnt(**changes))
    assert bench.stitch(pattern())[0].model == text_hash(model)
    assert text in bench.health()
    assert 'WARN offsets: learnt offsets not used' in bench.health()


def test_damaged_offsets_are_refused():
    answer = Compensator().request('use_offsets', offsets='{"format": "something"}')
    assert not answer.success
    assert 'offsets file, format: expected' in answer.message


def test_a_gain_of_one_axis_is_refused():
    with pytest.raises(ValueError, match='gain: expected two factors, X and Y, but found 1'):
        DeformationCompensatorConfig(gain=(1.0,))
    with pytest.raises(ValueError, match='gain'):
        DeformationCompensatorConfig(gain=(0.4, 1.0))


def test_unknown_requests_are_refused():
    assert not Compensator().request('fly').success

# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fuzzycnc_ros.core.deformation.stitch_path import Primitive, SheetMaterial, StitchPath

POINTS = [[0.0, 0.0], [3e-3, 0.0], [6e-3, 0.0]]
PROCESS = {'depth': 6e-3, 'step': 3e-3}


@pytest.mark.parametrize(
    ('change', 'message'),
    [
        ({'points': POINTS[:1]}, r'points: expected two or more points.*found shape \(1, 2\)'),
        ({'points': [0.0, 1.0]}, r'points: expected two or more points.*found shape \(2,\)'),
        ({'points': np.zeros((4, 3))}, r'points: .*found shape \(4, 3\)'),
        (
            {'points': [[0.0, 0.0], [np.nan, 1.0]]},
            r'points: expected finite coordinates \[m\] but found \[nan, 1.0\] at index 1',
        ),
        ({'kind': 3}, r'kind: expected 1 \(arc\) or 2 \(line\) but found 3 in step 0'),
        ({'kind': [2, 0]}, r'kind: .* but found 0 in step 1'),
        ({'depth': [6e-3, 0.0]}, 'depth: expected more than 0 m but found 0 in step 1'),
        ({'depth': np.nan}, 'depth: expected more than 0 m but found nan in step 0'),
        ({'step': -1e-3}, r'step: expected more than 0 m but found -0.001 in step 0'),
        ({'step': np.inf}, 'step: expected more than 0 m but found inf in step 0'),
        ({'turn': 2}, 'turn: expected 1 .* but found 2 in step 0'),
        ({'depth': [6e-3] * 3}, r'depth: .* each of the 2 steps but found shape \(3,\)'),
    ],
)
def test_paths_that_cannot_be_stitched_are_refused(change, message):
    with pytest.raises(ValueError, match=message):
        StitchPath(**{'points': POINTS, **PROCESS, **change})


@pytest.mark.parametrize(
    ('change', 'message'),
    [
        ({'thickness': 0.0}, 'thickness: expected more than 0 mm but found 0'),
        ({'thickness': np.nan}, 'thickness: expected more than 0 mm but found nan'),
        ({'size': (0.0, 1.0)}, 'size X: expected more than 0 mm but found 0'),
        ({'size': (1.0, np.inf)}, 'size Y: expected more than 0 mm but found inf'),
    ],
)
def test_sheets_that_are_none_are_refused(change, message):
    with pytest.raises(ValueError, match=message):
        SheetMaterial(**{'thickness': 15e-3, **change})


@pytest.mark.parametrize(
    ('change', 'message'),
    [
        ({'end': (np.nan, 0.0)}, 'primitive: expected finite figures'),
        ({'depth': 0.0}, 'depth: expected more than 0 mm but found 0'),
        ({'step': 0.0}, 'step: expected more than 0 mm but found 0'),
        ({'step': 31e-3}, 'at most the length of the primitive of 30 mm but found 31 mm'),
        ({'end': (0.0, 0.0)}, 'at most the length of the primitive of 0 mm but found 3 mm'),
        ({'centre': (0.0, 0.0)}, 'arc: expected a radius and a turn .* found 0 mm and 0 deg'),
        ({'centre': (15e-3, 0.0), 'turn': 1.0}, r'turn of 57.2958 deg to lead to its end'),
        (
            {'centre': (15e-3, 0.0), 'turn': np.pi, 'step': 48e-3},
            r'length of the primitive of 47.1239 mm but found 48 mm',
        ),
    ],
)
def test_primitives_that_are_none_are_refused(change, message):
    with pytest.raises(ValueError, match=message):
        Primitive(**{'start': (0.0, 0.0), 'end': (30e-3, 0.0), **PROCESS, **change})


def test_primitives_must_follow_one_another():
    line = Primitive((0.0, 0.0), (30e-3, 0.0), **PROCESS)
    with pytest.raises(ValueError, match='expected one or more but found none'):
        StitchPath.of_primitives([])
    with pytest.raises(ValueError, match=r'number 1 to begin where the last ends .* 30\.000 mm'):
        StitchPath.of_primitives([line, line])


def test_a_path_does_not_follow_its_callers_array():
    points = np.array(POINTS)
    path = StitchPath(points, **PROCESS)
    points[:] = 0.0
    np.testing.assert_allclose(path.lengths, 3e-3)
    moved = path.moved(np.full((3, 2), 1e-3))
    np.testing.assert_allclose(moved.points, np.array(POINTS) + 1e-3)
    np.testing.assert_allclose(path.points, POINTS)


@settings(max_examples=50, deadline=None)
@given(
    st.floats(-6.2, 6.2).filter(lambda turn: abs(turn) > 0.3),
    st.floats(0.0, 6.2),
    st.floats(1e-3, 4e-3),
)
def test_an_arc_stays_on_its_circle_in_equal_steps(turn, begin, step):
    centre, radius = np.array([0.05, 0.04]), 20e-3
    start, end = (
        centre + radius * np.array([np.cos(at), np.sin(at)]) for at in (begin, begin + turn)
    )
    arc = Primitive(tuple(start), tuple(end), 6e-3, step, tuple(centre), turn)
    path = StitchPath.of_primitives([arc])
    np.testing.assert_allclose(np.hypot(*(path.points - centre).T), radius, atol=1e-12)
    np.testing.assert_allclose(path.lengths, path.lengths[0], rtol=1e-9)
    # Half a step more or less is a matter of the last digit.
    assert abs(len(path.lengths) - abs(turn) * radius / step) <= 0.5 + 1e-9
    first, second = np.diff(path.points, axis=0)[:2]
    turned = first[0] * second[1] - first[1] * second[0]
    assert np.all(path.turn == np.sign(turned))
    assert np.all(path.kind == 1)

# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Tool paths: nothing is lost on the way into a message and out, and nonsense is refused."""

from dataclasses import fields, replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fuzzycnc_ros.components.motion.tool_paths import (
    curve_tool_path,
    program_tool_path,
    segments_tool_path,
    tool_path_segments,
)
from fuzzycnc_ros.core.feedrate.gcode.reader import read_program
from fuzzycnc_ros.core.feedrate.gcode.segments import ArcSegment, DwellSegment
from fuzzycnc_ros.core.feedrate.path.curves import butterfly
from fuzzycnc_ros.core.feedrate.path.nurbs import NurbsCurve
from fuzzycnc_ros.runtime.enums import SegmentKind
from fuzzycnc_ros.runtime.records import ToolPath

PROGRAM = """G21 G90 G17
G0 Z5
G0 X10 Y0
G1 Z0 F300
G1 X20 F600
G2 X30 Y10 I0 J10
G3 X30 Y10 I-5 J0 Z-1
G4 P0.5
G18 G3 X40 Z-1 I5 K0
G1 X50
G61
G17 G1 Y20
G5.2 X60 Y20 P1 L3
X70 Y30 P2
X80 Y20
G5.3
M30
"""


def sample() -> ToolPath:
    """Return a path with every kind of segment."""
    return program_tool_path(read_program(PROGRAM), path_id='part', stamp=7, frame_id='mill/w')


def in_order(path: ToolPath) -> None:
    """Check that a path's segments can be moved along."""
    segments = tool_path_segments(path)
    assert len(segments) == len(path.kind)
    place = np.array(segments.start)
    for segment in segments:
        length = segment.length
        assert np.isfinite(length)
        assert length >= 0.0
        assert np.linalg.norm(np.subtract(segment.start, place)) <= 1e-9
        points = segment.points(4)
        assert np.isfinite(points).all()
        assert np.abs(points[-1] - segment.end).max() <= 1e-9
        place = np.array(segment.end)


def test_program_survives_the_message():
    program = read_program(PROGRAM)
    path = sample()
    segments = tool_path_segments(path)
    wanted = [s for s in program.segments if s.length > 0.0 or isinstance(s, DwellSegment)]
    assert len(segments) == len(wanted)
    for found, given_one in zip(segments, wanted, strict=True):
        assert type(found) is type(given_one)
        assert (found.line, found.rapid, found.feed) == (
            given_one.line,
            given_one.rapid,
            given_one.feed,
        )
        np.testing.assert_allclose(found.points(7), given_one.points(7), rtol=0.0, atol=1e-15)
        assert found.length == pytest.approx(given_one.length, rel=1e-14)
        if isinstance(found, ArcSegment):
            assert (found.axes, found.sweep) == (given_one.axes, given_one.sweep)
    runs = [[a.run == b.run for a, b in pairwise(s)] for s in (segments, wanted)]
    assert runs[0] == runs[1]
    assert segments.exact_stop.tolist() == [not same for same in runs[1]] + [True]
    assert segments.block.tolist() == [s.line for s in wanted]
    assert (path.path_id, path.stamp, path.frame_id) == ('part', 7, 'mill/w')
    assert set(path.kind) == {0, 1, 2, 3}


def test_curve_survives_the_message():
    curve = butterfly()
    path = curve_tool_path(curve, path_id='butterfly', feed=0.1)
    assert path.axis == ('X', 'Y')
    (segment,) = tool_path_segments(path)
    u = np.linspace(*curve.domain, 50)
    np.testing.assert_array_equal(segment.curve.point(u)[:, :2], curve.point(u))
    np.testing.assert_array_equal(segment.curve.point(u)[:, 2], 0.0)
    assert segment.feed == 0.1
    in_order(path)


def test_curve_in_space_and_axes_in_any_order():
    curve = NurbsCurve(np.eye(3) * 0.1, np.ones(3), [0, 0, 0, 1, 1, 1], 2)
    path = curve_tool_path(curve, path_id='a', feed=0.1)
    assert path.axis == ('X', 'Y', 'Z')
    turned = replace(path, axis=('Z', 'X', 'Y'))
    segments = tool_path_segments(turned)
    assert segments.columns == (2, 0, 1)
    np.testing.assert_allclose(segments.start, [0.0, 0.0, 0.1])
    np.testing.assert_allclose(segments[0].end, [0.1 * 0, 0.1, 0.0], atol=1e-18)


def test_lazy_sequence():
    segments = tool_path_segments(sample())
    assert segments[-2] == segments[len(segments) - 2]
    assert len(segments[2:5]) == 3
    with pytest.raises(IndexError, match='expected an index below'):
        segments[len(segments)]


def test_chain_with_a_gap_is_refused():
    segments = list(tool_path_segments(sample()))
    with pytest.raises(ValueError, match='expected a start where line 3 ends but found a gap'):
        segments_tool_path([*segments[:2], *segments[3:]], path_id='a')
    with pytest.raises(ValueError, match='expected at least one that moves'):
        segments_tool_path([], path_id='a')


@pytest.mark.parametrize(
    ('text', 'message'),
    [
        ('G0 X1\nG81 X2 Z-1 R1 F100\n', 'line 2: expected a motion whose place'),
        ('G28\nG1 X1 F100\n', 'line 1: expected a motion whose place'),
        ('G1 X1 A5 F100\n', 'line 1: expected motion of X, Y and Z'),
        ('G95 G1 X1 F0.1\n', 'line 1: expected a feed in length per time'),
        ('M3 S1000\n', 'expected at least one that moves'),
    ],
)
def test_program_that_is_up_to_the_machine_cannot_run(text, message):
    with pytest.raises(ValueError, match=message):
        program_tool_path(read_program(text))


def change(path: ToolPath, kind: SegmentKind, place: int, value: float) -> ToolPath:
    """Return a path with another number in the first segment of a kind."""
    data = path.data.copy()
    data[int(path.offset[int(np.argmax(path.kind == kind))]) + place] = value
    return replace(path, data=data)


ARC, NURBS, LINE, DWELL = (
    SegmentKind.ARC,
    SegmentKind.NURBS,
    SegmentKind.LINE,
    SegmentKind.DWELL,
)
SPOILED = {
    'no name': (lambda p: replace(p, path_id=''), 'path_id: expected a name'),
    'axis unknown': (lambda p: replace(p, axis=('X', 'Y', 'A')), 'axis: expected distinct names'),
    'axis twice': (lambda p: replace(p, axis=('X', 'Y', 'X')), 'axis: expected distinct names'),
    'no axis': (lambda p: replace(p, axis=()), 'axis: expected distinct names .* found none'),
    'start short': (lambda p: replace(p, start=p.start[:2]), 'start: expected 3 values'),
    'start NaN': (lambda p: replace(p, start=p.start * np.nan), 'start: expected finite'),
    'start far': (lambda p: replace(p, start=p.start + 1e9), 'start: expected'),
    'nothing': (
        lambda p: replace(p, kind=p.kind[:0], junction=p.junction[:0]),
        'kind: expected at least one',
    ),
    'kind': (lambda p: replace(p, kind=p.kind + 9), 'kind: expected 0 to 3'),
    'junction': (lambda p: replace(p, junction=p.junction + 2), 'junction: expected 0 or 1'),
    'junction short': (lambda p: replace(p, junction=p.junction[1:]), 'junction: expected'),
    'block short': (lambda p: replace(p, block=p.block[1:]), 'block: expected'),
    'feed short': (lambda p: replace(p, feedrate=p.feedrate[1:]), 'feedrate: expected'),
    'feed 0': (lambda p: replace(p, feedrate=0.0 * p.feedrate), 'feedrate: expected more than 0'),
    'feed inf': (lambda p: replace(p, feedrate=p.feedrate + np.inf), 'feedrate: expected more'),
    'offset short': (lambda p: replace(p, offset=p.offset[1:]), 'offset: expected'),
    'offset from 1': (
        lambda p: replace(p, offset=p.offset + np.uint32(1)),
        'offset: expected numbers that rise from 0',
    ),
    'offset falls': (
        lambda p: replace(
            p, offset=np.concatenate([p.offset[:1], p.offset[3:0:-1], p.offset[4:]])
        ),
        'falling on the way',
    ),
    'data short': (lambda p: replace(p, data=p.data[:-1]), 'offset: expected numbers'),
    'data NaN': (lambda p: replace(p, data=p.data * np.nan), 'data: expected finite'),
    'line too long': (
        lambda p: replace(p, kind=np.where(p.kind == ARC, LINE, p.kind).astype(np.uint8)),
        'expected 3 numbers of a line',
    ),
    'line far': (
        lambda p: change(p, LINE, 0, 1e7),
        r'segment 0 \(block 2\): expected coordinates',
    ),
    'dwell': (lambda p: change(p, DWELL, 0, -1.0), 'expected a dwell of 0 s or more'),
    'arc end': (lambda p: change(p, ARC, 0, 0.0), 'equally far from its centre'),
    'arc centre': (lambda p: change(p, ARC, 3, 0.03), 'equally far from its centre'),
    'arc angle': (lambda p: change(p, ARC, 9, 1.0), 'expected an end where the angle of'),
    'arc no angle': (lambda p: change(p, ARC, 9, 0.0), 'expected an angle other than 0'),
    'arc turns': (lambda p: change(p, ARC, 9, 1e5), 'expected an angle other than 0, up to'),
    'arc axis': (lambda p: change(p, ARC, 6, 0.5), 'expected a turn axis of length 1'),
    'curve degree': (lambda p: change(p, NURBS, 0, 2.5), 'expected the whole numbers degree'),
    'curve degree 0': (lambda p: change(p, NURBS, 0, 0.0), 'expected a degree from 1 to'),
    'curve points': (lambda p: change(p, NURBS, 1, 3.0), 'numbers of a curve of degree 2'),
    'curve knots': (lambda p: change(p, NURBS, 4, 9.0), 'expected knots that never fall'),
    'curve knots near': (lambda p: change(p, NURBS, 5, 1e-12), 'expected knots that are equal or'),
    'curve weight': (lambda p: change(p, NURBS, 9, 0.0), 'expected positive weights'),
    'curve weights': (lambda p: change(p, NURBS, 9, 1e9), 'expected weights no more than'),
    'curve far': (lambda p: change(p, NURBS, 13, 1e4), 'expected coordinates up to'),
    'curve elsewhere': (lambda p: change(p, NURBS, 13, 0.051), 'expected a curve that begins'),
}


@pytest.mark.parametrize('name', SPOILED)
def test_malformed_paths_are_refused_with_what_is_wrong(name):
    spoil, message = SPOILED[name]
    with pytest.raises(ValueError, match=message):
        tool_path_segments(spoil(sample()))


def test_arc_that_needs_an_axis_the_path_lacks():
    arc = program_tool_path(read_program('G18 F100 G2 X2 I1\n'))
    flat = replace(
        arc,
        axis=('X', 'Y'),
        start=arc.start[:2],
        data=np.delete(arc.data, [2, 5]),
        offset=np.array([0, 8], np.uint32),
    )
    with pytest.raises(ValueError, match='in the plane of X, Y but found one about Y'):
        tool_path_segments(flat)


def mutated(path: ToolPath, rng: np.random.Generator) -> ToolPath:
    """Return a path with one to three things wrong, or different."""
    for _ in range(int(rng.integers(1, 4))):
        name = str(
            rng.choice(['start', 'kind', 'junction', 'block', 'feedrate', 'offset', 'data'])
        )
        values = getattr(path, name).copy()
        what = int(rng.integers(6))
        if len(values) and what == 0:
            values = np.delete(values, int(rng.integers(len(values))))
        elif what == 1:
            values = np.append(values, values[:1])
        elif what == 2:
            values = rng.permutation(values)
        elif len(values):
            at = int(rng.integers(len(values)))
            if values.dtype.kind == 'f':
                scale = rng.choice([1.0, 1.0, 1.0 + 1e-12, 1.0 + 1e-6, -1.0, 1e-9, 1e9, 1e300])
                extra = rng.choice([0.0, 0.0, 1e-10, 1e-3, 1.0, np.nan, np.inf, -np.inf, 1e-320])
                with np.errstate(over='ignore', invalid='ignore'):
                    values[at] = values[at] * scale + extra
            else:
                info = np.iinfo(values.dtype)
                values[at] = rng.choice([0, 1, 2, 3, 5, int(info.max)]) % info.max
        path = replace(path, **{name: values})
        if rng.random() < 0.1:
            path = replace(path, axis=tuple(rng.choice(['X', 'Y', 'Z'], int(rng.integers(4)))))
    return path


@settings(max_examples=700, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_mutated_paths_are_refused_or_can_be_moved_along(seed):
    rng = np.random.default_rng(seed)
    path = mutated(FLIGHT if rng.random() < 0.3 else sample_once(), rng)
    try:
        tool_path_segments(path)
    except ValueError as error:
        assert str(error)  # noqa: PT017 - the refusal is one of two good ends
        return
    in_order(path)


FLIGHT = curve_tool_path(butterfly(), path_id='butterfly', feed=0.1)
_SAMPLES: list[ToolPath] = []


def sample_once() -> ToolPath:
    """Return the path of `sample`, read once."""
    if not _SAMPLES:
        _SAMPLES.append(sample())
    return _SAMPLES[0]


def test_every_field_of_the_message_is_checked_or_copied():
    """A field that is added to the message must be thought of here."""
    assert [item.name for item in fields(ToolPath)] == [
        'stamp',
        'frame_id',
        'path_id',
        'includes_compensation',
        'axis',
        'start',
        'kind',
        'junction',
        'block',
        'feedrate',
        'offset',
        'data',
    ]

# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The sheet in the simulated machine: stitches where the tool comes by, programme, faults."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from benches.component_bench import Bench
from benches.trajectory_bench import line, parts, record, trapezoid

from fuzzycnc_ros.components.machine.machine_operator import machine_operator, material_record
from fuzzycnc_ros.components.machine.machine_patterns import parse_patterns, sample_primitive
from fuzzycnc_ros.components.machine.simulated_machine import (
    SimulatedMachine,
    SimulatedMachineConfig,
)
from fuzzycnc_ros.components.machine.stitching import Stitching
from fuzzycnc_ros.core.deformation.stitch_path import ARC, StitchPath
from fuzzycnc_ros.runtime.component import Emission
from fuzzycnc_ros.runtime.enums import MachineMode, PrimitiveKind
from fuzzycnc_ros.runtime.records import (
    SECOND,
    AxisState,
    CompensatedPath,
    nanoseconds,
)
from fuzzycnc_ros.simulation.soft.foam_samples import foam_samples, true_compensation
from fuzzycnc_ros.simulation.soft.foam_sheet import FoamSheet
from fuzzycnc_ros.simulation.soft.foam_tracks import FoamTrack

SHEET = FoamSheet(15e-3, (0.15, 0.1))
PERIOD = nanoseconds(1e-3)


def compensated(points, path_id='p', depth=6e-3, turn=0.0):
    """Return the compensated path of commanded points."""
    nominal = np.array(points, float)
    steps = len(nominal) - 1
    return CompensatedPath(
        stamp=0,
        path_id=path_id,
        material='foam',
        thickness=15e-3,
        model='',
        nominal=nominal.ravel(),
        offset=np.zeros(nominal.size),
        primitive=np.zeros(steps, np.uint32),
        kind=np.zeros(steps, np.uint8),
        turn=np.full(steps, turn),
        depth=np.full(steps, depth),
        step=np.full(steps, 3e-3),
        compensation=np.zeros(2 * steps),
        support=np.full(steps, np.nan),
        flag=np.zeros(steps, np.uint8),
    )


def machine_with(*names, **changes):
    """Return a machine that stitches patterns."""
    values = {'duties': (), 'patterns': names, 'path_timeout': 2.0, 'sheet_seed': -1, **changes}
    return SimulatedMachine(SimulatedMachineConfig(**values))


class Axes:
    """Axes that are where the test says, period by period."""

    def __init__(self, sheet=SHEET, seed=-1):
        self.stitching = Stitching(sheet, seed)
        self.stamp, self.way, self.over, self.found = 0, 0.0, False, []

    def place(self, path_id):
        return self.way if path_id == 'p' else 0.0

    def finished(self, path_id):
        return self.over and path_id == 'p'

    def at(self, x, y):
        """Bring the tool somewhere within a period."""
        self.stamp += PERIOD
        state = AxisState(
            stamp=self.stamp,
            axis=('X', 'Y', 'Z'),
            reference=np.zeros(3),
            position=np.array([x, y, 0.0]),
            velocity=np.zeros(3),
        )
        moved = [Emission('axis_state', state)]
        self.found += self.stitching.tick(moved, self, 'mill/workpiece')

    def along(self, corners, step=20e-6, rest=3):
        """Move in straight lines, resting at each corner."""
        self.at(*corners[0])
        self.way = 1e-6
        for begin, end in pairwise(np.array(corners, float)):
            count = int(np.ceil(np.linalg.norm(end - begin) / step - 1e-9))
            for share in np.arange(1, count + 1) / count:
                self.at(*(begin + share * (end - begin)))
            for _ in range(rest):
                self.at(*end)

    @property
    def path(self):
        """The stitched path, if there is one."""
        assert [item.output for item in self.found] == ['stitched_path']
        return self.found[0].record


L_SHAPE = np.array([[30, 20], [33, 20], [36, 20], [39, 20], [39, 23], [39, 26]]) * 1e-3
CORNERS = L_SHAPE[[0, 3, 5]]


@pytest.mark.parametrize('step', [7e-6, 20.3e-6, 173e-6, 3e-3])
def test_stitches_are_made_at_their_points_however_fast_the_tool_is(step):
    axes = Axes()
    axes.stitching.load(compensated(L_SHAPE))
    axes.along(CORNERS, step)
    tool = axes.path.tool.reshape(-1, 2)
    np.testing.assert_allclose(tool, L_SHAPE, atol=1e-9)
    expected = SHEET.stitch(L_SHAPE, 6e-3)
    np.testing.assert_allclose(axes.path.stitched.reshape(-1, 2), expected, atol=1e-8)


def test_time_of_each_stitch_is_when_the_tool_was_there():
    axes = Axes()
    axes.stitching.load(compensated(L_SHAPE))
    axes.along(CORNERS, 20e-6, rest=100)
    # 150 periods of 20 um each step; at the corner the tool has arrived once it rests
    np.testing.assert_allclose(
        axes.path.time, np.array([0, 150, 300, 451, 700, 851]) * 1e-3, atol=1e-9
    )
    assert axes.path.stamp == axes.stamp - 99 * PERIOD


def test_a_tool_that_passes_beside_a_point_stitches_where_it_is_nearest():
    axes = Axes()
    axes.stitching.load(compensated([[0.03, 0.02], [0.033, 0.02], [0.036, 0.02]]))
    axes.along([[0.03, 0.02], [0.033, 0.02002], [0.036, 0.02]])
    tool = axes.path.tool.reshape(-1, 2)
    assert 1e-6 < np.hypot(*(tool[1] - (0.033, 0.02))) <= 20e-6
    assert axes.path.stitched[1] != SHEET.stitch(L_SHAPE[:2], 6e-3)[1, 0]


def test_a_point_given_twice_is_stitched_twice():
    doubled = L_SHAPE[[0, 1, 1, 2, 3, 4, 5, 5]]
    axes = Axes()
    axes.stitching.load(compensated(doubled))
    axes.along(CORNERS)
    np.testing.assert_allclose(axes.path.tool.reshape(-1, 2), doubled, atol=1e-9)
    expected = SHEET.stitch(doubled, 6e-3)
    np.testing.assert_allclose(axes.path.stitched.reshape(-1, 2), expected, atol=1e-8)


def test_jumps_trims_and_stops_are_not_stitched():
    first, second = L_SHAPE, np.add(L_SHAPE[:4], (0.02, 0.03))
    points = np.concatenate([first[:3], first[2:], first[-1:], second])
    path = compensated(points)
    kind = path.kind.copy()
    kind[[2, 6, 7]] = PrimitiveKind.STOP, PrimitiveKind.TRIM, PrimitiveKind.JUMP
    axes = Axes()
    axes.stitching.load(replace(path, kind=kind, depth=np.where(kind > 1, 0.0, path.depth)))
    axes.along([*CORNERS, second[0], second[3]])
    np.testing.assert_allclose(axes.path.tool.reshape(-1, 2), points, atol=1e-9)
    stitched = axes.path.stitched.reshape(-1, 2)
    rows = [0, 1, 2, 4, 5, 6]
    np.testing.assert_allclose(stitched[rows], SHEET.stitch(first, 6e-3), atol=1e-8)
    np.testing.assert_allclose(stitched[8:], SHEET.stitch(second, 6e-3), atol=1e-8)
    assert np.abs(SHEET.stitch(points[5:], 6e-3)[3:] - stitched[8:]).max() > 1e-4


def test_left_turns_twist_the_drag():
    axes = Axes()
    axes.stitching.load(compensated(L_SHAPE[:4], turn=0.5))
    axes.along(CORNERS[:2])
    expected = SHEET.stitch(L_SHAPE[:4], 6e-3, 1)
    np.testing.assert_allclose(axes.path.stitched.reshape(-1, 2), expected, atol=1e-8)
    assert np.abs(expected - SHEET.stitch(L_SHAPE[:4], 6e-3)).max() > 1e-5


def test_scatter_and_noise_are_those_of_the_seed_counted_up():
    axes = Axes(seed=3)
    for number in range(2):
        axes.way = 0.0
        axes.stitching.load(compensated(L_SHAPE))
        axes.along(CORNERS)
        rng = np.random.default_rng(3 + number)
        expected = SHEET.scattered(rng).stitch(L_SHAPE, 6e-3, rng=rng)
        found = axes.found.pop().record.stitched.reshape(-1, 2)
        np.testing.assert_allclose(found, expected, atol=1e-8)


def test_a_rest_on_the_way_is_no_stitch():
    """A tool that is held between two points, even within reach of one, has not come by."""
    axes = Axes()
    axes.stitching.load(compensated(L_SHAPE))
    axes.along([L_SHAPE[0], (0.0321, 0.02)], rest=50)
    assert '1 of 6 stitches' in axes.stitching.health().message
    axes.along([(0.0321, 0.02), L_SHAPE[3], L_SHAPE[5]])
    np.testing.assert_allclose(axes.path.tool.reshape(-1, 2), L_SHAPE, atol=1e-9)


def test_a_path_whose_points_are_missed_fails_by_name():
    axes = Axes()
    axes.stitching.load(compensated(L_SHAPE))
    axes.along([L_SHAPE[0], L_SHAPE[1] + (0.0, 5e-3), L_SHAPE[2]])
    axes.over = True
    axes.at(*L_SHAPE[2])
    assert axes.found == []
    assert axes.stitching.failure.startswith('p: 1 of 6 stitches')
    assert axes.stitching.health().level.name == 'ERROR'


def test_a_pattern_is_stitched_again_under_its_name():
    """The axes tell of its earlier motion until the new one begins."""
    axes = Axes()
    for _ in range(2):
        axes.stitching.load(compensated(L_SHAPE))
        for _ in range(5):
            axes.at(*CORNERS[-1])
        assert axes.stitching.failure == ''
        axes.over, axes.way = False, 0.0
        axes.along(CORNERS)
        np.testing.assert_allclose(axes.path.tool.reshape(-1, 2), L_SHAPE, atol=1e-9)
        axes.found.clear()
        axes.over = True


def test_other_paths_are_not_stitched():
    axes = Axes()
    axes.along(CORNERS)
    axes.stitching.load(compensated(L_SHAPE, path_id='another'))
    axes.along(CORNERS)
    assert axes.found == []
    assert axes.stitching.health().message == 'another loaded'


def test_what_is_left_or_replaced_is_told():
    axes = Axes()
    axes.stitching.load(compensated(L_SHAPE))
    axes.along(CORNERS[:2])
    axes.stitching.load(compensated(L_SHAPE))
    assert axes.stitching.health().message == 'p loaded'
    axes.along(CORNERS[:2])
    axes.stitching.drop('estop')
    assert axes.stitching.health().message == 'p: 4 of 6 stitches, then left: estop'
    axes.along(CORNERS)
    assert axes.found == []


def test_a_clamped_sheet_keeps_the_friction():
    axes = Axes(FoamSheet(15e-3, (0.15, 0.1), friction=0.2))
    thick = FoamSheet(25e-3, friction=0.7)
    axes.stitching.clamp(material_record(thick, 0, ''))
    axes.stitching.load(compensated(L_SHAPE))
    axes.along(CORNERS)
    expected = FoamSheet(25e-3, friction=0.2).stitch(L_SHAPE, 6e-3)
    np.testing.assert_allclose(axes.path.stitched.reshape(-1, 2), expected, atol=1e-8)


def test_a_track_is_that_of_the_method_sheet():
    (found,) = parse_patterns(['parallelogram:45'], SHEET)
    track = FoamTrack.parallelogram(np.radians(45.0))
    path = StitchPath.of_primitives(found.primitives)
    np.testing.assert_allclose(path.points, track.points, atol=1e-15)
    assert set(path.depth.tolist()) == {6e-3}
    assert found.sheet == SHEET
    assert found.length == pytest.approx(0.24)


def test_a_track_on_another_sheet():
    name = 'parallelogram:30:thickness=0.02:depth=0.008:step=0.004:base=0.06:side=0.04'
    (found,) = parse_patterns([name], SHEET)
    assert (found.name, found.sheet) == (name, FoamSheet(20e-3, (0.15, 0.1)))
    assert {(item.depth, item.step) for item in found.primitives} == {(8e-3, 4e-3)}
    assert [round(item.length, 9) for item in found.primitives] == [0.06, 0.04, 0.06, 0.04]


def test_calibration_is_the_samples_of_the_method_sheet():
    """What single primitives of the programme call for is what the sample generator says."""
    rows = foam_samples(0).x
    found = parse_patterns(['calibration'], SHEET)
    assert len(found) == len(rows) == 265
    assert np.all(np.diff([item.sheet.thickness for item in found]) >= 0.0)
    for row, item in zip(rows[::11], found[::11], strict=True):
        path = StitchPath.of_primitives(item.primitives)
        stitched = item.sheet.stitch(path.points, path.depth, (path.kind == ARC).astype(int))
        drift = path.points - stitched
        way = np.cumsum(path.lengths)
        needed = 50.0 * way @ drift[1:] / (way @ way)
        np.testing.assert_allclose(needed, true_compensation([row])[0], rtol=1e-9)
        assert path.step[0] == pytest.approx(1e-3 * row[3])


def test_an_arc_of_a_sample_lies_in_the_middle():
    arc = sample_primitive(30.0, 6e-3, ARC, 3e-3, FoamSheet(15e-3))
    points = StitchPath.of_primitives([arc]).points
    np.testing.assert_allclose(points[5], (0.1, 0.06), atol=1e-12)
    direction = np.degrees(np.arctan2(*(points[6] - points[4])[::-1]))
    assert direction == pytest.approx(30.0)


def test_fewer_samples_are_spread_over_all():
    found = parse_patterns(['calibration:5'], SHEET)
    thickness = [round(1e3 * item.sheet.thickness) for item in found]
    assert thickness == [5, 15, 20, 25, 35]
    assert [item.name for item in found] == [f'calibration_{k}' for k in range(1, 6)]


@pytest.mark.parametrize(
    ('name', 'text'),
    [
        ('circle:3', "patterns: 'circle:3': expected parallelogram:ANGLE or calibration"),
        ('parallelogram', 'expected parallelogram:ANGLE'),
        ('parallelogram:wide', "expected an angle in degrees but found 'wide'"),
        ('parallelogram:200', 'angle: expected more than 0 and less than 180 deg'),
        ('parallelogram:45:depth', 'expected depth, step, base, side, thickness as depth=0.008'),
        ('parallelogram:45:width=1', "but found 'width=1'"),
        ('parallelogram:45:depth=deep', "expected depth in m but found 'deep'"),
        ('parallelogram:45:depth=-0.001', 'depth: expected more than 0 mm'),
        ('parallelogram:45:thickness=0', 'thickness: expected more than 0 mm'),
        ('calibration:0', 'expected 1 to 265 samples but found 0'),
        ('calibration:2.5', 'expected 1 to 265 samples but found 2.5'),
        ('calibration:many', "expected a number of samples but found 'many'"),
        ('calibration:1:2', 'expected parallelogram:ANGLE or calibration'),
    ],
)
def test_unknown_patterns_are_refused(name, text):
    with pytest.raises(ValueError, match='patterns: ') as caught:
        machine_with(name)
    assert text in str(caught.value)


@pytest.mark.parametrize(
    ('changes', 'text'),
    [
        ({'paths': ('trident',)}, 'patterns: expected neither paths nor servo_axes'),
        ({'servo_axes': ('X:lathe',)}, 'patterns: expected neither paths nor servo_axes'),
        ({'sheet_size': (0.1,)}, 'sheet_size: expected the lengths along X and Y'),
    ],
)
def test_a_machine_that_cannot_stitch_is_refused(changes, text):
    with pytest.raises(ValueError, match=text):
        machine_with('parallelogram:45', **changes)


def test_the_operator_clamps_a_sheet_before_its_patterns():
    names = ('parallelogram:45', 'parallelogram:45', 'parallelogram:30:thickness=0.02')
    operator = machine_operator(SimulatedMachineConfig(patterns=names))
    told, stamp = [], 0
    while not operator.over:
        stamp += nanoseconds(0.1)
        told += [
            (item.output, round(stamp / SECOND, 1), getattr(item.record, 'path_id', ''))
            for item in operator.load(stamp, 'mill/workpiece')
        ]
    assert told == [
        ('material', 0.1, ''),
        ('stitch_pattern', 0.6, 'parallelogram:45'),
        ('stitch_pattern', 0.7, 'parallelogram:45_2'),
        ('material', 0.8, ''),
        ('stitch_pattern', 1.3, 'parallelogram:30:thickness=0.02'),
    ]


def test_a_machine_without_compensator_gives_up_and_says_which_nodes():
    machine = machine_with('parallelogram:45')
    machine.machine = 'mill'
    told = []
    while machine.next_tick is not None:
        told += [item.output for item in machine.tick()]
    assert [name for name in told if name in ('material', 'stitch_pattern')] == [
        'material',
        'stitch_pattern',
    ]
    assert 'stitched_path' not in told
    assert machine.failure == (
        'path parallelogram:45 was not followed to its end: no trajectory for 2 s of machine time '
        '(idle); are deformation_compensator and feedrate_scheduler active?'
    )


@pytest.mark.parametrize('stopped', [False, True])
def test_the_machine_stitches_what_its_axes_follow(stopped):
    """In a straight line from rest to rest; an emergency stop drops what was begun."""
    bench = Bench(machine_with('parallelogram:45', path_timeout=1.0))
    machine = bench.component
    while not bench.records('stitch_pattern'):
        bench.emitted += machine.tick()
    way = trapezoid(0.02)
    points = line(np.linspace(0.0, way[-1], 8))[:, :2]
    bench.push('compensated_path', compensated(points, path_id='parallelogram:45'))
    now = bench.records('stitch_pattern')[0].stamp
    begin = now + nanoseconds(0.1)
    for part in parts(line, way, start=begin, path_id='parallelogram:45', chunk=len(way)):
        assert bench.push('trajectory', record(part, now))
    bench.emitted += bench.merger.advance(now)
    while machine.next_tick is not None:
        if stopped and machine.next_tick > begin + nanoseconds(0.2):
            machine.set_mode(MachineMode.ESTOP)
            assert 'of 8 stitches, then left: estop' in machine.health()[-2].message
            machine.set_mode(MachineMode.ON)
            stopped = False
            points = None
        bench.emitted += machine.tick()
    if points is None:
        assert not bench.records('stitched_path')
        return
    (found,) = bench.records('stitched_path')
    np.testing.assert_allclose(found.tool.reshape(-1, 2), points, atol=2e-6)
    expected = FoamSheet(15e-3, (0.15, 0.1)).stitch(points, 6e-3)
    np.testing.assert_allclose(found.stitched.reshape(-1, 2), expected, atol=2e-6)
    assert np.all(np.diff(found.time) > 0.0)
    assert machine.failure == ''

# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Patterns compensated, scheduled and stitched in one process; the same figures from a bag."""

import numpy as np
import pytest

from fuzzycnc_ros.bags.errors import BagError
from fuzzycnc_ros.components.machine.machine_patterns import parse_patterns
from fuzzycnc_ros.components.machine.simulated_machine import SimulatedMachineConfig
from fuzzycnc_ros.components.motion.feedrate_scheduler_config import FeedrateSchedulerConfig
from fuzzycnc_ros.components.soft.deformation_compensator import (
    DeformationCompensatorConfig,
)
from fuzzycnc_ros.core.deformation.compensation import OffsetPath, StepFlag, learn_offsets
from fuzzycnc_ros.core.deformation.model import write_model
from fuzzycnc_ros.core.deformation.network import TSFuzzyNetwork
from fuzzycnc_ros.core.deformation.offset_file import StitchOffsets, write_offsets
from fuzzycnc_ros.core.deformation.stitch_path import StitchPath
from fuzzycnc_ros.replay.replay import replay
from fuzzycnc_ros.simulation.soft.foam_samples import foam_samples, true_compensation
from fuzzycnc_ros.simulation.soft.foam_sheet import FoamSheet
from fuzzycnc_ros.simulation.soft.foam_tracks import FoamTrack
from fuzzycnc_ros.studies.published_bag import PublishedBag
from fuzzycnc_ros.studies.soft.pattern import TRACK, PatternError, PatternLog, run_patterns

SHEET = FoamSheet(15e-3, (0.15, 0.1))
EXACT = SimulatedMachineConfig(sheet_seed=-1, path_timeout=2.0)
SMALL = 'parallelogram:45:base=0.024:side=0.018'


@pytest.fixture(scope='module')
def model():
    """Text of a model, of samples that none of its settings was chosen on."""
    return write_model(TSFuzzyNetwork().fit(*foam_samples(1000)).model_)


@pytest.fixture(scope='module')
def recorded(model, tmp_path_factory):
    """The test track without and with the model on exact sheets, with bags."""
    found = {}
    for name, text in (('none', ''), ('model', model)):
        bag = tmp_path_factory.mktemp('pattern') / name
        with PublishedBag(bag) as sink:
            (pattern,) = run_patterns((TRACK,), text, machine=EXACT, sink=sink)
        found[name] = (pattern, bag)
    return found


@pytest.mark.replay
@pytest.mark.parametrize('name', ['none', 'model'])
def test_stitches_are_those_of_the_commanded_points(recorded, name):
    """Blends and contour errors of the axes move no stitch by 30 um."""
    pattern, _ = recorded[name]
    expected = SHEET.stitch(pattern.commanded, 6e-3)
    assert np.hypot(*(pattern.stitched - expected).T).max() < 30e-6
    assert np.hypot(*(pattern.tool - pattern.commanded).T).max() < 30e-6
    track = FoamTrack.parallelogram(np.radians(45.0))
    np.testing.assert_allclose(pattern.nominal, track.points, atol=1e-12)


@pytest.mark.replay
def test_the_track_is_straightened(recorded):
    before, after = (recorded[name][0].quality() for name in ('none', 'model'))
    # as on the page about soft material
    assert np.degrees(before.angle_error) == pytest.approx(5.1822, abs=0.01)
    assert 1e3 * before.straightness == pytest.approx(0.4073, abs=0.005)
    assert after.angle_error <= 0.2 * before.angle_error
    assert after.straightness <= 0.65 * before.straightness
    assert after.max_deviation <= 0.4 * before.max_deviation


@pytest.mark.replay
def test_time_is_that_of_the_stitches(recorded):
    for pattern, _ in recorded.values():
        sides = pattern.primitive_time
        assert np.all(np.diff(pattern.time) > 0.0)
        assert sides.sum() == pytest.approx(pattern.time[-1])
        length = np.hypot(*np.diff(pattern.commanded, axis=0).T).sum()
        # at the programmed feed, and a rest of 0.1 s and more at each corner
        assert length / 0.021 < pattern.time[-1] < length / 0.021 + 2.0
    before, after = (recorded[name][0].quality().time for name in ('none', 'model'))
    assert before < after < 1.15 * before


@pytest.mark.replay
@pytest.mark.parametrize('name', ['none', 'model'])
def test_the_bag_gives_the_same(recorded, name):
    pattern, bag = recorded[name]
    (again,) = PatternLog.from_bag(bag).patterns()
    assert again.name == pattern.name == TRACK
    for field in ('time', 'tool', 'stitched', 'nominal', 'commanded'):
        np.testing.assert_array_equal(getattr(again, field), getattr(pattern, field))
    assert again.quality() == pattern.quality()
    report = replay(bag)
    assert report.identical, report.topics
    assert {'/mill/compensated_path', '/mill/tool_path'} <= {item.topic for item in report.topics}
    assert not report.notes


@pytest.mark.slow
@pytest.mark.replay
def test_learnt_offsets_are_stitched_and_replayed(recorded, tmp_path):
    """The second cycle of learning; the bag holds the offsets."""
    pattern, _ = recorded['none']
    path = learn_offsets(OffsetPath.unchanged(pattern.nominal), pattern.stitched, gain=1.0)
    offsets = StitchOffsets(TRACK, 'foam 15 mm', path.nominal, path.offset)
    with PublishedBag(tmp_path / 'bag') as sink:
        (learnt,) = run_patterns(
            (TRACK,), offsets=write_offsets(offsets), machine=EXACT, sink=sink
        )
    np.testing.assert_allclose(learnt.commanded, path.commanded, atol=1e-12)
    assert learnt.quality().angle_error < 0.4 * pattern.quality().angle_error
    report = replay(tmp_path / 'bag')
    assert report.identical, report.topics


@pytest.mark.slow
@pytest.mark.replay
def test_calibration_calls_for_what_the_samples_say():
    """Single primitives, each from a fresh start on its own sheet."""
    names = ('calibration:6',)
    machine = SimulatedMachineConfig(sheet_seed=-1, pattern_feed=0.1)
    found = run_patterns(names, machine=machine)
    programme = parse_patterns(names, SHEET)
    assert [item.name for item in found] == [item.name for item in programme]
    rows = foam_samples(0).x[np.linspace(0, 264, 6).round().astype(int)]
    for row, item, made in zip(rows, programme, found, strict=True):
        assert made.path.thickness == item.sheet.thickness == 1e-3 * row[4]
        drift = made.nominal - made.stitched
        way = np.cumsum(StitchPath.of_primitives(item.primitives).lengths)
        needed = 50.0 * way @ (drift - drift[0])[1:] / (way @ way)
        # 20 um over 50 mm are 0.02 mm
        np.testing.assert_allclose(needed, true_compensation([row])[0], atol=0.03)


@pytest.mark.slow
@pytest.mark.replay
def test_patterns_follow_each_other_on_their_sheets(model):
    """Scatter differs from path to path; the same track again has a number."""
    found = run_patterns(
        (SMALL, SMALL, f'{SMALL}:thickness=0.02'), model, machine=SimulatedMachineConfig()
    )
    assert [item.name for item in found] == [SMALL, f'{SMALL}_2', f'{SMALL}:thickness=0.02']
    assert [item.path.material for item in found] == ['foam 15 mm', 'foam 15 mm', 'foam 20 mm']
    np.testing.assert_array_equal(found[0].commanded, found[1].commanded)
    assert np.abs(found[0].stitched - found[1].stitched).max() > 10e-6
    assert all(item.quality().max_deviation < 2e-3 for item in found)


@pytest.mark.slow
@pytest.mark.replay
def test_a_compensated_path_stops_at_its_stitches_without_a_blend(model):
    fast, slow = (
        run_patterns(
            (SMALL,), model, scheduler=FeedrateSchedulerConfig(blend=blend), machine=EXACT
        )[0]
        for blend in (10e-6, 0.0)
    )
    assert np.hypot(*(fast.stitched - slow.stitched).T).max() < 30e-6
    assert slow.time[-1] > 1.3 * fast.time[-1]


def test_refused_steps_are_stitched_where_they_are_drawn(model):
    name = 'parallelogram:90:base=0.02:side=0.02'
    (found,) = run_patterns((name,), model, machine=EXACT)
    up = np.isin(found.path.primitive, (1, 3))
    assert (found.path.flag[up] & StepFlag.OUTSIDE_DOMAIN).all()
    assert not found.path.flag[~up].any()


@pytest.mark.parametrize(
    ('name', 'text'),
    [
        (f'{TRACK}:depth=0.0125', 'the foot would go through the sheet'),
        (f'{TRACK}:base=0.2', 'expected all within the clamped area of 150 x 100 mm'),
    ],
)
def test_refused_patterns_are_told(name, text):
    with pytest.raises(PatternError, match=text):
        run_patterns((name,), machine=EXACT)


def test_a_pattern_that_is_to_be_stopped_is_told(model):
    with pytest.raises(PatternError, match='not stitched, as on_refused says'):
        run_patterns(
            ('parallelogram:90',),
            model,
            compensator=DeformationCompensatorConfig(on_refused='stop'),
            machine=EXACT,
        )


@pytest.mark.parametrize('what', ['model', 'offsets'])
def test_files_that_are_none_are_refused(what):
    with pytest.raises(ValueError, match=f'{what}: {what} file: expected JSON'):
        run_patterns((TRACK,), **{what: 'nothing'})


@pytest.mark.replay
def test_a_bag_without_stitches_is_refused():
    with pytest.raises(BagError, match='compensated_path'):
        PatternLog.from_bag('bags/mill_warm_up')


def test_stitches_without_their_path_are_refused(recorded):
    _, bag = recorded['none']
    log = PatternLog.from_bag(bag)
    log._records['compensated_path'].clear()
    with pytest.raises(ValueError, match='expected as many stitches as the compensated_path'):
        log.patterns()

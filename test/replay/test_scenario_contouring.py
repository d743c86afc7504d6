# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Paths scheduled, streamed and followed in one process; the same figures from a bag."""

import numpy as np
import pytest

from fuzzycnc_ros.bags.errors import BagError
from fuzzycnc_ros.components.machine.simulated_machine import SimulatedMachineConfig
from fuzzycnc_ros.components.motion.feedrate_scheduler_config import FeedrateSchedulerConfig
from fuzzycnc_ros.core.feedrate.path.curves import CURVES, SHEET_SCALES
from fuzzycnc_ros.core.machine.path_loop import ContouringConfig
from fuzzycnc_ros.replay.replay import replay
from fuzzycnc_ros.simulation.motion.contour import Contour
from fuzzycnc_ros.studies.contour.contouring import (
    SETTLE,
    ContouringError,
    ContouringLog,
    run_contouring,
)
from fuzzycnc_ros.studies.published_bag import PublishedBag

TOLERANCE = 1e-4
SCHEDULER = FeedrateSchedulerConfig(tolerance=TOLERANCE, settle=SETTLE)
MACHINE = SimulatedMachineConfig(path_timeout=2.0)


@pytest.fixture(scope='module')
def recorded(tmp_path_factory):
    """Two paths, as they came out and as a bag."""
    bag = tmp_path_factory.mktemp('contouring') / 'bag'
    told = []
    with PublishedBag(bag) as sink:
        found = run_contouring(
            ('trident', 'infinity'),
            SCHEDULER,
            MACHINE,
            sink=sink,
            progress=lambda done, total: told.append((done, total)),
        )
    return found, bag, told


@pytest.mark.replay
def test_paths_are_followed_within_the_tolerance(recorded):
    found, _, told = recorded
    assert [item.name for item in found] == ['trident', 'infinity']
    for item in found:
        assert item.finished
        assert (item.method, item.tolerance) == ('log_fuzzy', TOLERANCE)
        assert 0.5 * TOLERANCE < item.error_max <= 1.05 * TOLERANCE
        assert 0.0 < item.error_mean < item.error_max
        curve = CURVES[item.name](SHEET_SCALES[item.name])
        assert item.arc_length.max() == pytest.approx(curve.length, rel=1e-4)
        np.testing.assert_allclose(item.reference[-1, :2], curve.point([1.0])[0], atol=1e-9)
        assert item.schedule.arc_length[-1] == pytest.approx(curve.length, rel=1e-4)
        assert np.all(item.schedule.speed <= item.schedule.feed * (1 + 1e-9))
    done, total = np.transpose(told)
    assert np.all(np.diff(done) >= 0)
    assert done[-1] <= total[-1]


@pytest.mark.replay
def test_errors_are_the_distances_to_the_exact_curve(recorded):
    delay = ContouringConfig().delay
    for item in recorded[0]:
        curve = CURVES[item.name](SHEET_SCALES[item.name])
        contour = Contour.curve(curve.point, vertices=200_001)
        on = item.time >= 0.0
        step = np.linalg.norm(np.diff(item.reference[on], axis=0), axis=1)
        way = np.append(0.0, np.cumsum(step))
        way *= contour.length / way[-1]
        delayed = np.interp(item.time[on] - delay, item.time[on], way)
        exact = contour.distance(item.position[on][:, :2], delayed, 5e-3)
        assert item.error_max == pytest.approx(exact.distance.max(), rel=1e-3)
        # before the path is under way its nearest point may be one that is still to come
        under_way = item.time[on] > delay
        error, distance = item.error[on][under_way], exact.distance[under_way]
        np.testing.assert_allclose(error, distance, rtol=1e-3, atol=3e-8)


@pytest.mark.replay
def test_the_bag_gives_the_same_figures(recorded):
    found, bag, _ = recorded
    again = ContouringLog.from_bag(bag).paths()
    assert len(again) == len(found)
    for ours, theirs in zip(found, again, strict=True):
        assert (ours.name, ours.finished, ours.axis) == (theirs.name, theirs.finished, theirs.axis)
        assert ours.error_max == theirs.error_max
        assert ours.error_mean == theirs.error_mean
        assert ours.duration == theirs.duration
        for name in ('time', 'reference', 'position', 'velocity', 'arc_length', 'error'):
            np.testing.assert_array_equal(getattr(ours, name), getattr(theirs, name))
        np.testing.assert_array_equal(ours.schedule.feed, theirs.schedule.feed)


@pytest.mark.replay
def test_the_scheduler_is_replayed_from_the_bag(recorded):
    report = replay(recorded[1])
    assert report.identical, report.topics
    assert {item.topic for item in report.topics} == {'/mill/trajectory', '/mill/feed_schedule'}
    assert not report.notes


@pytest.mark.replay
def test_a_bag_without_motion_is_refused():
    with pytest.raises(BagError, match='contour_error'):
        ContouringLog.from_bag('bags/mill_warm_up')


def test_a_scheduler_that_asks_too_much_of_the_machine_is_refused():
    greedy = FeedrateSchedulerConfig(path_acceleration=20.0, axis_acceleration=(20.0,) * 3)
    with pytest.raises(ContouringError, match=r'path trident .* acceleration of .* at most 4 m/s'):
        run_contouring(('trident',), greedy, MACHINE)


def test_unknown_path_is_refused():
    with pytest.raises(ValueError, match='paths: expected names among'):
        run_contouring(('circle',))

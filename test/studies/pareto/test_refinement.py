# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fuzzycnc_ros.studies.pareto.refinement import (
    UnreachableToleranceError,
    knob_at_error,
    local_error,
    refine,
)

ARC = np.linspace(0.0, 0.3, 400)
CURVATURE = 150.0 * (1.0 + np.cos(40.0 * ARC)) + 1.0
CONSTANT = 2.15e-4


def measured(error, arc=(0.0,), duration=1.0):
    return SimpleNamespace(
        error=np.array(error, dtype=float), arc_length=np.array(arc), duration=duration
    )


class Quadratic:
    """A machine whose error is C curvature v^2, measured at other places than the schedule's."""

    def __init__(self, constant=CONSTANT):
        self.constant = constant
        self.driven = []

    def __call__(self, feed):
        self.driven.append(feed)
        arc = np.linspace(0.0, 0.3, 3001)
        error = self.constant * np.interp(arc, ARC, CURVATURE) * np.interp(arc, ARC, feed) ** 2
        step = np.diff(ARC) * 2.0 / (feed[1:] + feed[:-1])
        return measured(error, arc, step.sum())


@given(
    power=st.floats(0.5, 4.0),
    size=st.floats(1e-6, 1e3),
    guess=st.floats(1e-4, 1e3),
    precision=st.sampled_from([1e-2, 1e-3, 1e-5]),
)
@settings(max_examples=60, deadline=None)
def test_knob_is_found_from_any_guess(power, size, guess, precision):
    found = knob_at_error(
        lambda knob: measured([size * knob**power]), size * 0.7**power, guess, precision=precision
    )
    assert 0.7 * (1.0 - 1.01 * precision) <= found.knob <= 0.7 * (1 + 1e-9)
    assert found.run.error.max() <= size * 0.7**power


def test_knob_stays_below_the_tolerance_where_the_error_jumps():
    found = knob_at_error(lambda knob: measured([1e-6 if knob < 0.3 else 1e-3]), 1e-5, 4.0)
    assert found.run.error.max() == 1e-6
    assert 0.3 * (1.0 - 1e-3) <= found.knob < 0.3


def test_a_guess_that_fits_is_taken():
    calls = []

    def drive(knob):
        calls.append(knob)
        return measured([knob])

    assert knob_at_error(drive, 0.25, 0.25).knob == 0.25
    assert calls == [0.25]


@pytest.mark.parametrize(
    ('tolerance', 'words'),
    [
        (1e-9, r'largest contour error is 1e-06 mm but at 0.001 it is still 0.001 mm'),
        (1.0, r'largest contour error is 1000 mm but at 0.1 it is still 10 mm'),
    ],
)
def test_an_unreachable_tolerance_is_said(tolerance, words):
    driven = []

    def drive(knob):
        driven.append(knob)
        return measured([knob**2])

    with pytest.raises(UnreachableToleranceError, match=words):
        knob_at_error(drive, tolerance, 0.01, low=1e-3, high=0.1)
    assert min(driven) >= 1e-3
    assert max(driven) <= 0.1


def test_knob_refuses():
    for name in ('tolerance', 'guess', 'precision', 'low'):
        for value in (0.0, -1.0, np.nan, np.inf):
            given_ = {'tolerance': 1.0, 'guess': 1.0, name: value}
            with pytest.raises(ValueError, match=f'{name}: expected a finite number above 0'):
                knob_at_error(lambda knob: measured([knob]), **given_)
    with pytest.raises(ValueError, match=r'guess: expected 1e-09 to 0\.5 but found 1'):
        knob_at_error(lambda knob: measured([knob]), 1.0, 1.0, high=0.5)
    with pytest.raises(ValueError, match='expected a finite contour error but found nan at 1'):
        knob_at_error(lambda knob: measured([np.nan]), 1.0, 1.0)


def test_local_error_is_the_largest_nearby():
    run = measured([1.0, 5.0, 2.0, 9.0, 3.0], [0.0, 0.9, 1.1, 5.0, 8.0])
    # at the points themselves: 1, 5, gaps filled 6 7 8, 9, gaps 7 5, 3
    found = local_error(run, np.arange(9.0))
    np.testing.assert_allclose(found, [5.0, 6.0, 7.0, 8.0, 9.0, 9.0, 9.0, 7.0, 5.0])
    # before the first sample and behind the last the nearest one counts
    run = measured([4.0], [2.0])
    np.testing.assert_array_equal(local_error(run, np.arange(6.0)), np.full(6, 4.0))


@pytest.mark.parametrize('start', [0.001, 0.05, 0.2])
def test_refined_schedule_is_the_best_one_for_a_quadratic_machine(start):
    machine = Quadratic()
    tolerance = 2e-5
    best = np.minimum(0.2, np.sqrt(tolerance / (CONSTANT * CURVATURE)))
    refined = refine(np.full(400, start), ARC, machine, tolerance, feed_max=0.2, rounds=60)
    assert refined.run.error.max() <= tolerance
    assert refined.feed.max() <= 0.2
    assert np.all(refined.feed > 0.0)
    assert refined.run.duration <= 1.02 * machine(best).duration


def test_refinement_learns_a_constant_that_nobody_told_it():
    start = np.sqrt(2e-5 / (CONSTANT * CURVATURE))
    runs = [
        refine(start, ARC, Quadratic(constant), 2e-5, feed_max=10.0).run
        for constant in (CONSTANT, 4.0 * CONSTANT)
    ]
    assert runs[1].duration == pytest.approx(2.0 * runs[0].duration, rel=0.01)


def test_without_rounds_the_schedule_is_only_scaled():
    start = 0.01 + 0.001 * np.sin(30.0 * ARC)
    refined = refine(start, ARC, Quadratic(), 1e-6, feed_max=0.2, rounds=0)
    ratio = refined.feed / start
    np.testing.assert_allclose(ratio, ratio[0], rtol=1e-12)
    assert refined.run.error.max() == pytest.approx(1e-6, rel=3e-3)


def test_where_the_largest_feed_is_good_enough_it_is_taken():
    refined = refine(np.full(400, 0.01), ARC, Quadratic(), 1.0, feed_max=0.2, rounds=3)
    np.testing.assert_array_equal(refined.feed, np.full(400, 0.2))
    straight = refine([0.1, 0.1], [0.0, 1.0], lambda feed: measured([0.0]), 1e-6, feed_max=0.2)
    assert straight.feed.tolist() == [0.2, 0.2]


def test_a_machine_that_errs_at_any_feed_is_told():
    with pytest.raises(UnreachableToleranceError, match='is still 1 mm'):
        refine([0.1, 0.1], [0.0, 1.0], lambda feed: measured([1e-3]), 1e-5, feed_max=0.2)


@pytest.mark.parametrize(
    ('feed', 'arc', 'changes', 'words'),
    [
        ([0.1], [0.0], {}, 'two or more arc lengths and as many feeds'),
        ([0.1, 0.1], [0.0, 1.0, 2.0], {}, r'found the shapes \(3,\) and \(2,\)'),
        ([0.1, 0.1], [0.0, 0.0], {}, 'drop duplicate points'),
        ([0.1, 0.0], [0.0, 1.0], {}, 'feed: expected finite numbers above 0 m/s'),
        ([0.1, np.nan], [0.0, 1.0], {}, 'feed: expected finite numbers above 0 m/s'),
        ([0.1, 0.1], [0.0, 1.0], {'tolerance': 0.0}, 'tolerance: expected a finite number'),
        ([0.1, 0.1], [0.0, 1.0], {'feed_max': -1.0}, 'feed_max: expected a finite number'),
        ([0.1, 0.1], [0.0, 1.0], {'rounds': -1}, 'rounds: expected 0 or more but found -1'),
    ],
)
def test_refinement_refuses_before_it_drives(feed, arc, changes, words):
    driven = []
    arguments = {'tolerance': 1e-5, 'feed_max': 0.2, **changes}
    with pytest.raises(ValueError, match=words):
        refine(feed, arc, driven.append, **arguments)
    assert driven == []

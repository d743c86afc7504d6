# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Holes in what is sampled evenly."""

import itertools

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fuzzycnc_ros.bags.holes import Hole, HoleCounter, not_explained

STEP = 10_000


def found(stamps):
    """Return the holes in some stamps."""
    counter = HoleCounter()
    for stamp in stamps:
        counter.update(stamp)
    return [(hole.start, hole.stop) for hole in counter.holes]


@given(
    lost=st.sets(st.integers(2, 98), max_size=5),
    shifts=st.lists(st.integers(-STEP // 20, STEP // 20), min_size=100, max_size=100),
    start=st.integers(0, 10**12),
)
def test_every_lost_sample_is_a_hole_and_jitter_is_none(lost, shifts, start):
    kept = [n for n in range(100) if n not in lost]
    stamps = [start + STEP * n + shifts[n] for n in kept]
    wanted = [
        (stamps[i], stamps[i + 1])
        for i, (one, other) in enumerate(itertools.pairwise(kept))
        if other - one > 1
    ]
    assert found(stamps) == wanted


def test_a_slower_source_is_no_hole_for_ever():
    stamps = [*range(0, 1000, 10), *range(1000, 100_000, 100)]
    assert 0 < len(found(stamps)) < 15


def test_another_run_begins_anew():
    assert found([10, 20, 30, 5, 15, 25]) == []


@pytest.mark.parametrize(
    ('jump', 'left'),
    [((25, 485), 0), ((30, 480), 1), ((130, 480), 1), ((0, 1000), 0), ((600, 900), 1)],
)
def test_time_that_jumps_leaves_no_hole(jump, left):
    holes = [Hole(20, 490, 10.0)]
    assert len(not_explained(holes, [Hole(*jump, 10.0)])) == left

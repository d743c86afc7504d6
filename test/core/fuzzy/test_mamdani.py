# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Mamdani inference with two inputs and triangular sets."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fuzzycnc_ros.core.fuzzy.mamdani import Mamdani, MamdaniTable, memberships, tabulated

SYSTEM = Mamdani(
    (0.0, 1.0, 4.0), (-1.0, 0.0, 0.5), (0.0, 1.0, 1.5, 4.0), ((3, 2, 1), (2, 2, 0), (1, 0, 0))
)


def sampled_centroid(system, first, second, samples):
    """Eq. (11) as printed: sums over samples of the output axis."""
    centre = np.array(system.output)
    centre = np.array([2 * centre[0] - centre[1], *centre, 2 * centre[-1] - centre[-2]])
    axis = np.linspace(centre[0], centre[-1], samples)
    rows = memberships(np.array([first]), system.first)[:, 0]
    columns = memberships(np.array([second]), system.second)[:, 0]
    union = np.zeros(samples)
    for row, levels in zip(rows, system.rules, strict=True):
        for column, level in zip(columns, levels, strict=True):
            triangle = np.interp(axis, centre[level : level + 3], [0.0, 1.0, 0.0])
            union = np.maximum(union, np.minimum(triangle, min(row, column)))
    return (axis * union).sum() / union.sum()


@given(st.floats(-1.0, 5.0), st.floats(-2.0, 1.0))
def test_closed_form_is_the_limit_of_samples(first, second):
    expected = sampled_centroid(SYSTEM, first, second, 20_001)
    # A strength near 0 leaves next to no samples for the sum.
    assert SYSTEM(first, second) == pytest.approx(expected, abs=2e-3)


def test_output_of_each_rule_alone_is_its_sets_centre_where_the_set_is_symmetric():
    system = Mamdani((0.0, 1.0), (0.0, 1.0), (0.1, 0.4, 0.7), ((2, 1), (1, 0)))
    assert system([0.0, 0.0, 1.0, 1.0], [0.0, 1.0, 0.0, 1.0]) == pytest.approx(
        [0.7, 0.4, 0.4, 0.1], abs=1e-15
    )


def test_inputs_beyond_the_end_centres_count_as_those():
    assert SYSTEM([-9.0, 9.0], [-9.0, 9.0]) == pytest.approx(SYSTEM([0.0, 4.0], [-1.0, 0.5]))


def test_shapes_broadcast():
    grid = SYSTEM(np.linspace(0.0, 4.0, 5)[:, np.newaxis], np.linspace(-1.0, 0.5, 4))
    assert grid.shape == (5, 4)
    assert grid[2, 3] == SYSTEM(2.0, 0.5)
    assert SYSTEM(2.0, 0.5).shape == ()


@given(st.floats(-1.0, 5.0))
def test_memberships_sum_to_one_and_no_more_than_two_are_positive(value):
    degree = memberships(np.array([value]), SYSTEM.first)
    assert degree.min() >= 0.0
    assert degree.sum() == pytest.approx(1.0, abs=1e-15)
    assert np.count_nonzero(degree) <= 2


@given(st.floats(-1e9, 1e9), st.floats(-1e9, 1e9))
def test_outputs_stay_between_the_end_centres(first, second):
    for output in (SYSTEM(first, second), tabulated(SYSTEM)(*np.array([[first], [second]]))):
        assert 0.0 - 1e-12 <= output <= 4.0 + 1e-12


def test_table_is_exact_at_its_nodes_and_near_between():
    table = MamdaniTable(SYSTEM)
    assert table.nodes.shape == (301, 129)
    first, second = np.linspace(0.0, 4.0, 301), np.linspace(-1.0, 0.5, 129)
    for i, j in ((0, 0), (300, 128), (17, 99), (300, 5), (120, 128)):
        assert table(first[i : i + 1], second[j : j + 1]) == pytest.approx(
            SYSTEM(first[i : i + 1], second[j : j + 1]), abs=1e-9
        )
    rng = np.random.default_rng(0)
    pairs = rng.uniform(0.0, 4.0, 20_000), rng.uniform(-1.0, 0.5, 20_000)
    assert np.abs(table(*pairs) - SYSTEM(*pairs)).max() < 0.01 * 4.0


def test_table_cannot_be_written_and_is_shared_by_equal_systems():
    same = Mamdani(SYSTEM.first, SYSTEM.second, SYSTEM.output, SYSTEM.rules)
    assert tabulated(same) is tabulated(SYSTEM)
    with pytest.raises(ValueError, match='read-only'):
        tabulated(SYSTEM).nodes[0, 0] = 1.0


@pytest.mark.parametrize(
    ('change', 'message'),
    [
        ({'first': (0.0, 0.0, 1.0)}, 'first: expected at least two increasing centres'),
        ({'second': (0.0, float('nan'), 1.0)}, 'second: expected at least two increasing'),
        ({'output': (1.0,)}, 'output: expected at least two increasing centres'),
        ({'rules': ((0, 1, 2), (0, 1, 2))}, 'expected 3 rows of 3.*found 2 rows of length 3'),
        ({'rules': ((0, 1, 2), (0, 1), (0, 1, 2))}, 'found 3 rows of length 2, 3'),
        ({'rules': ((0, 1, 2), (0, 1, 4), (0, 1, 2))}, 'output sets 0 to 3, but found 0 to 4'),
    ],
)
def test_refusals(change, message):
    parts = {name: getattr(SYSTEM, name) for name in ('first', 'second', 'output', 'rules')}
    with pytest.raises(ValueError, match=message):
        Mamdani(**(parts | change))

# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Rule tables of the variable-universe controller, their checks, and learning them."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fuzzycnc_ros.core.machine.axis_models import LatheAxisConfig
from fuzzycnc_ros.core.servo.rule_learning import (
    DATA,
    EMPTY,
    FILLED,
    MIRRORED,
    learn_rules,
    records_of_run,
)
from fuzzycnc_ros.core.servo.rule_table import (
    CENTRES,
    CENTRES_WITH_ZERO,
    SETS_WITH_ZERO,
    RuleTable,
    RuleTableWarning,
    published_rules,
)
from fuzzycnc_ros.core.servo.variable_universe import VariableUniverseController
from fuzzycnc_ros.simulation.servo.axes import LatheAxis
from fuzzycnc_ros.simulation.servo.positioning import position

RULES = published_rules()
NUMBER = st.floats(-2.0, 2.0)


@given(NUMBER, NUMBER)
def test_surface_is_odd_and_bounded(x, y):
    value = RULES(x, y)
    assert RULES(-x, -y) == pytest.approx(-value, abs=1e-15)
    assert abs(value) <= 1.0 + 1e-14


@given(NUMBER, NUMBER, NUMBER)
def test_surface_never_rises_with_the_error(x, other, y):
    low, high = sorted((x, other))
    assert RULES(high, y) <= RULES(low, y) + 1e-15


def test_surface_meets_the_table_at_the_centres():
    grid = RULES.surface(np.array(CENTRES)[:, np.newaxis], CENTRES)
    assert grid == pytest.approx(np.array(RULES.values), abs=1e-14)


def test_printed_consequents_are_a_variant_of_their_own():
    assert published_rules(0.677).values[0][4] == 0.677
    assert published_rules(2 / 3).values[0][4] == 2 / 3


def rules_with_zero():
    """The published surface on seven sets, one of them about zero."""
    grid = np.array(CENTRES_WITH_ZERO)
    values = np.clip(RULES.surface(grid[:, np.newaxis], grid), -1.0, 1.0)  # rounding
    return RuleTable(CENTRES_WITH_ZERO, tuple(map(tuple, values.tolist())))


def test_seven_sets_carry_the_published_surface():
    rules = rules_with_zero()
    grid = np.linspace(-1.0, 1.0, 201)
    apart = rules.surface(grid[:, np.newaxis], grid) - RULES.surface(grid[:, np.newaxis], grid)
    assert np.abs(apart).max() < 0.005
    assert rules.is_odd
    assert rules(0.0, 0.0) == 0.0
    assert rules.slopes == pytest.approx(RULES.slopes, rel=0.011)
    assert len(SETS_WITH_ZERO) == len(rules.centres)


@pytest.mark.parametrize(('centres', 'bound'), [(CENTRES, 0.180), (CENTRES_WITH_ZERO, 0.046)])
def test_only_seven_sets_keep_the_bound_that_the_source_asks_for(centres, bound):
    # a surface with the second derivatives of the source, 1.96 and 1.35
    def bent(x, y):
        return 0.49 * np.asarray(x) ** 2 + 0.3375 * np.asarray(y) ** 2

    grid = np.array(centres)
    values = bent(grid[:, np.newaxis], grid)
    with pytest.warns(RuleTableWarning):
        table = RuleTable(centres, tuple(tuple(row) for row in values.tolist()))
    fine = np.linspace(-1.0, 1.0, 1201)
    off = np.abs(table.surface(fine[:, np.newaxis], fine) - bent(fine[:, np.newaxis], fine)).max()
    assert 2.0 * off == pytest.approx(bound, abs=0.001)  # the table cannot hold the whole of it


def test_rules_are_learnt_on_seven_sets_too():
    rng = np.random.default_rng(5)
    x, y = rng.uniform(-1.0, 1.0, (2, 4000))
    rules = rules_with_zero()
    records = np.column_stack([x, y, rules.surface(x, y)])
    found = learn_rules(records, 'lsq', centres=CENTRES_WITH_ZERO, smoothing=1e-6)
    assert found.values == pytest.approx(np.array(rules.values), abs=1e-5)
    assert learn_rules(records, centres=CENTRES_WITH_ZERO).complete().table().is_odd


@pytest.mark.parametrize(
    ('centres', 'values', 'message'),
    [
        ((-1.0, -1.0), ((1.0, 0.0), (0.0, -1.0)), 'two increasing centres'),
        ((-1.0, 1.0), ((1.0, 0.0),), 'expected 2 rows of 2.*found 1 rows of length 2'),
        ((-1.0, 1.0), ((1.0, 0.0), (-1.0,)), 'found 2 rows of length 1, 2'),
        ((-1.0, 1.0), ((1.5, 0.0), (0.0, -1.5)), 'numbers from -1 to 1, but found 1.5'),
        ((-1.0, 1.0), ((float('nan'), 0.0), (0.0, -1.0)), 'found nan'),
    ],
)
def test_refusals_of_a_table(centres, values, message):
    with pytest.raises(ValueError, match=message):
        RuleTable(centres, values)


def test_a_table_that_is_not_odd_or_rises_is_warned_of():
    with pytest.warns(RuleTableWarning, match='not odd'):
        RuleTable((-1.0, 1.0), ((1.0, 1.0), (-0.5, -1.0)))
    with pytest.warns(RuleTableWarning, match='never rise'):
        RuleTable((-1.0, 1.0), ((-1.0, -1.0), (1.0, 1.0)))


def test_wang_mendel_says_where_it_has_data_and_where_records_conflict():
    rules = learn_rules([(-1.0, 1.0, 1.0), (-1.0, 0.95, 0.6), (0.0, 0.0, 0.0), (0.0, 0.3, 0.2)])
    assert rules.values[0, 5] == 1.0
    assert rules.count[0, 5] == 2
    assert rules.conflicts[0, 5] == 1
    assert rules.winner[0, 5] == 0
    assert rules.used == 2  # the last names no set of the error
    assert rules.source[0][5] == DATA
    assert sum(row.count(EMPTY) for row in rules.source) == 35
    with pytest.raises(ValueError, match='found 35 empty ones'):
        rules.table()


def test_completion_is_odd_and_says_what_it_made_up():
    rules = learn_rules([(-1.0, 1.0, 1.0), (-0.3, 0.3, 0.3)]).complete()
    assert rules.source[0][5] == DATA
    assert rules.source[5][0] == MIRRORED
    assert rules.source[0][0] == FILLED
    assert rules.values == pytest.approx(-rules.values[::-1, ::-1])
    assert (rules.values[:3] > 0.0).all()
    table = rules.table()
    assert table.is_odd
    assert table(-1.0, 1.0) == pytest.approx(1.0)


def test_least_squares_finds_the_table_that_made_the_records():
    rng = np.random.default_rng(3)
    x, y = rng.uniform(-1.0, 1.0, (2, 4000))
    found = learn_rules(np.column_stack([x, y, RULES.surface(x, y)]), 'lsq', smoothing=1e-6)
    assert found.values == pytest.approx(np.array(RULES.values), abs=1e-6)
    assert found.coverage == 1.0


def test_a_cut_duty_is_a_lower_bound_alone():
    rng = np.random.default_rng(3)
    x, y = rng.uniform(-1.0, 1.0, (2, 4000))
    duty = RULES.surface(x, y)
    kept = np.clip(duty, -0.6, 0.6)
    cut = np.column_stack([x, y, kept, np.abs(kept) == 0.6])
    as_it_is = learn_rules(cut[:, :3], 'lsq', smoothing=1e-6)
    bounded = learn_rules(cut, 'lsq', smoothing=1e-6)
    inner = np.array(RULES.values)[2:4, 2:4]
    assert bounded.values[2:4, 2:4] == pytest.approx(inner, abs=1e-3)
    assert np.abs(as_it_is.values[2:4, 2:4] - inner).max() > 0.01


@pytest.mark.parametrize(
    ('records', 'options', 'message'),
    [
        ([(0.0, 0.0)], {}, 'rows of three or four finite numbers'),
        ([(0.0, float('nan'), 1.0)], {}, 'with NaN'),
        ([(0.0, 0.0, 0.0)], {}, 'not zero throughout but found none'),
        ([(1.0, 0.0, 1.0)], {'method': 'best'}, 'expected one of wm, lsq'),
        ([(1.0, 0.0, 1.0)], {'method': 'lsq', 'smoothing': 0.0}, 'smoothing: expected a positive'),
        ([(1.0, 0.0, 1.0)], {'centres': (1.0, 0.0)}, 'increasing centres'),
    ],
)
def test_refusals_of_records(records, options, message):
    with pytest.raises(ValueError, match=message):
        learn_rules(records, **options)


def test_records_of_a_run_must_be_as_long_as_each_other(controller):
    with pytest.raises(ValueError, match=r'found the shapes \(2,\), \(3,\), \(2,\)'):
        records_of_run([0.0, 0.0], [0.0] * 3, [0.0, 0.0], controller)
    with pytest.raises(ValueError, match='finite'):
        records_of_run([0.0, 0.0], [0.0, float('nan')], [0.0, 0.0], controller)


def test_records_of_its_own_run_are_the_controllers_own_rules(controller):
    run = position(controller, LatheAxis(), -0.02, 0.3)
    records = records_of_run(run.reference, run.measured, run.duty, controller)
    free = records[:, 3] == 0.0
    assert 50 < free.sum() < 299
    x, y, output = records[free, :3].T
    assert output == pytest.approx(controller.params.rules.surface(x, y), abs=1e-9)


@pytest.fixture
def controller():
    return VariableUniverseController(LatheAxisConfig().linear(), stick_slip=None)

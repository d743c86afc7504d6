# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Many judged runs in one table."""

from dataclasses import replace

import numpy as np
import pytest

from fuzzycnc_ros.core.thermal.fit import Evaluation
from fuzzycnc_ros.studies.thermal.many_runs import (
    median_of,
    overall_document,
    overall_table,
    runs_table,
    worst_of,
)


def judged(name, **rms):
    """Return an evaluation whose largest residuals are twice the root mean square ones [um]."""
    figures = {key: 1e-6 * np.array(value, dtype=float) for key, value in rms.items()}
    return Evaluation(
        run=name,
        channel=('Y', 'Z'),
        axis=('Y', 'Z'),
        samples=(10, 10),
        default=('lag_ridge', 'lag_ridge'),
        rms=figures,
        largest={key: 2.0 * value for key, value in figures.items()},
        in_domain=0.5,
        warm={},
        trained_on={},
        covered=np.ones(2),
        half_width=1e-6 * np.ones(2),
        independent=np.full(2, 5.0),
        band_ratio=np.full(2, 0.5),
        time=np.arange(10.0),
        measured=np.zeros((10, 2)),
        predicted={},
    )


RUNS = (
    judged('a', uncompensated=(9, 8), lag_ridge=(1, np.inf), odd=(1, 1), default=(1, 4)),
    judged('b', uncompensated=(7, 6), lag_ridge=(3, 1), default=(3, np.nan)),
    judged('c', uncompensated=(5, 4), lag_ridge=(2, 1), odd=(1, 1), default=(2, 6)),
)


def test_median_and_worst():
    figures = np.array([[1.0, np.nan, np.inf], [3.0, np.nan, 2.0], [2.0, np.nan, np.nan]])
    np.testing.assert_array_equal(median_of(figures), [2.0, np.nan, np.inf])
    np.testing.assert_array_equal(worst_of(figures), [3.0, np.nan, np.inf])


def test_a_row_per_run_then_median_and_worst():
    table = runs_table(RUNS)
    assert [row[0] for row in table.rows] == ['a', 'b', 'c', 'Median', 'Worst']
    assert table.rows[0][:5] == ('a', '0', '9', '10', '50')
    assert table.rows[3][5:8] == ('14.0', '2.0', '4.0')
    assert table.rows[4][5:8] == ('18.0', '3.0', '6.0')
    assert table.rows[3][9] == '5.0'  # what was not measured in one run does not count
    assert table.highlight == {3, 4}
    assert [column.group for column in table.columns[5:]] == ['Y'] * 3 + ['Z'] * 3


def test_a_run_that_the_default_made_worse_warns():
    table = runs_table(RUNS)
    # 6 um are left of 4 um in Z of the last run, in no other.
    assert table.warning == {(2, 0), (2, 9)}
    assert table.columns[9].full_heading == 'Z rms'


def test_samples_of_channels_that_were_probed_apart():
    apart = replace(RUNS[0], samples=(10, 4))
    assert runs_table([apart]).rows[0][3] == '10/4'


def test_candidates_that_all_runs_have():
    table = overall_table(RUNS, refused={'lag_ridge'})
    assert [row[0] for row in table.rows] == ['Uncompensated', 'LagRidge *', 'Default']
    assert table.rows[1][1:5] == ('2.0', '3.0', '4.0', '6.0')
    assert table.highlight == {2}
    document = overall_document(RUNS)
    assert list(document) == ['uncompensated', 'lag_ridge', 'default']
    assert document['default']['Y'] == pytest.approx(
        {'median_rms_um': 2.0, 'worst_rms_um': 3.0, 'median_max_um': 4.0, 'worst_max_um': 6.0}
    )
    assert document['lag_ridge']['Z']['worst_max_um'] == np.inf

# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
import io
import json
import math
import sys

import numpy as np
import pytest

from fuzzycnc_ros.studies.page.table import Column, Table
from fuzzycnc_ros.studies.requirement import require
from fuzzycnc_ros.studies.thermal.report_data import (
    CompensationRun,
    Latency,
    ReportData,
    ReportDataError,
    Score,
    SensorCountCurve,
)
from fuzzycnc_ros.studies.thermal.summary import candidate_label, summary_document, summary_table


def make_run(name='T2', rows=40, **changes):
    time = 60.0 * np.arange(rows)
    measured = 1e-6 * np.column_stack([np.linspace(0, 30, rows), np.linspace(0, 20, rows)])
    fields = {
        'name': name,
        'time': time,
        'sensor': ['T1', 'T2', 'T3'],
        'temperature': 20.0 + time[:, None] / 3600.0 * np.array([1.0, 2.0, 3.0]),
        'cluster': [0, 1, 0],
        'chosen': ['T2', 'T3'],
        'channel': ['Y', 'Z'],
        'measured': measured,
        'predicted': {
            'static_ridge': measured + 2e-6,
            'classical_grey': np.full_like(measured, np.inf),
            'lag_ridge': measured - 1e-6,
        },
        'default': 'lag_ridge',
        **changes,
    }
    return CompensationRun(**fields)


@pytest.mark.parametrize(
    ('changes', 'message'),
    [
        ({'time': np.zeros(40)}, 'increasing times'),
        ({'time': [0.0]}, 'increasing times'),
        (
            {'temperature': np.zeros((40, 2))},
            r'temperature of shape \(40, 3\) but found \(40, 2\)',
        ),
        ({'measured': np.zeros((40, 1))}, 'measured of shape'),
        ({'predicted': {'lag_ridge': np.zeros(3)}}, r"predicted\['lag_ridge'\] of shape"),
        ({'applied': np.zeros((39, 2))}, 'applied of shape'),
        ({'in_domain': np.ones((40, 2), bool)}, 'in_domain of shape'),
        ({'cluster': [0, 1]}, 'cluster of 3 labels'),
        ({'chosen': ['T9']}, 'chosen sensors .* T9'),
        ({'default': 'magic'}, 'default among static_ridge, .* but found magic'),
        ({'default': ['lag_ridge']}, 'default of one name or 2'),
    ],
)
def test_arrays_that_do_not_fit_are_refused(changes, message):
    with pytest.raises(ReportDataError, match=message):
        make_run(**changes)


def test_report_needs_runs_with_names_of_their_own():
    with pytest.raises(ReportDataError, match='at least one run'):
        ReportData('title', [])
    with pytest.raises(ReportDataError, match='T2, T2'):
        ReportData('title', [make_run(), make_run()])
    with pytest.raises(ReportDataError, match='residual_max of shape'):
        SensorCountCurve((1, 2), ('Y',), np.zeros((1, 2)), 'T2', 'MLP')
    with pytest.raises(ReportDataError, match='latency'):
        Latency(np.array([]))


def test_score_judges_what_was_measured_and_predicted():
    residual = np.array([3.0, -4.0, 100.0, np.nan]) * 1e-6
    measured = np.array([0.0, 0.0, np.nan, 0.0])
    assert Score.of(residual, measured) == Score(4e-6, pytest.approx(math.sqrt(12.5) * 1e-6))
    assert Score.of(np.array([1.0, -np.inf]), np.zeros(2)) == Score(math.inf, math.inf)
    assert math.isnan(Score.of(np.ones(2), np.full(2, np.nan)).max)
    assert Score.of(np.zeros(2), np.zeros(2)) == Score(0.0, 0.0)
    assert Score.of(np.array([1e300]), np.zeros(1)).rms == 1e300  # its square has no double


def test_residual_is_what_the_applied_offset_leaves():
    run = make_run()
    np.testing.assert_allclose(run.residual(), 1e-6)
    applied = make_run(applied=-run.measured + 0.5e-6)
    np.testing.assert_allclose(applied.residual(), 0.5e-6, rtol=1e-9)
    assert [s.max for s in applied.scores()['applied']] == pytest.approx([0.5e-6, 0.5e-6])
    assert applied.scores_in_use() == applied.scores()['applied']


def test_each_channel_may_have_its_own_default():
    run = make_run(default=['static_ridge', 'lag_ridge'])
    np.testing.assert_allclose(run.residual(), np.tile([-2e-6, 1e-6], (40, 1)), rtol=1e-9)


def test_summary_shows_every_candidate_on_every_run():
    table = summary_table([make_run(), make_run('T3', default='static_ridge')])
    assert [row[0] for row in table.rows] == [
        'Uncompensated',
        'Static ridge',
        'Classical GM(1,N)',
        'LagRidge',
    ]
    assert [c.full_heading for c in table.columns[:4]] == [
        'Model',
        'T2 Y max',
        'T2 Y rms',
        'T2 Z max',
    ]
    assert table.rows[0][1:5] == ('30.0', '17.4', '20.0', '11.6')
    assert table.rows[1][1:3] == ('2.0', '2.0')
    assert set(table.rows[2][1:]) == {'diverged'}
    assert table.highlight == {1, 3}
    assert table.strong == {(3, column) for column in range(1, 9)}


def test_summary_leaves_a_gap_where_a_run_lacks_a_candidate():
    run = make_run('T3', predicted={'lag_ridge': np.zeros((40, 2))})
    table = summary_table([make_run(applied=np.zeros((40, 2))), run])
    assert table.rows[1][5:] == ('-',) * 4
    assert table.rows[-1][0] == 'As applied on the machine'


def test_document_holds_the_same_figures_as_json():
    document = json.loads(json.dumps(summary_document([make_run()]), allow_nan=False))
    assert document['T2']['uncompensated']['y']['max_um'] == pytest.approx(30.0)
    assert document['T2']['lag_ridge']['z'] == {
        'max_um': pytest.approx(1.0),
        'rms_um': pytest.approx(1.0),
    }
    assert document['T2']['classical_grey']['y'] == {'max_um': None, 'rms_um': None}


def test_labels():
    assert candidate_label('lag_ridge') == 'LagRidge'
    assert candidate_label('gaussian_process') == 'Gaussian process'


TABLE = Table(
    'Residual [µm]',
    (Column('Model', numeric=False), Column('max', 'T2 Y'), Column('rms', 'T2 Y')),
    (('a|b', '2.4', '1.0'), ('[red]c', '12.0', '0.9')),
    strong=frozenset({(0, 1)}),
    highlight=frozenset({1}),
)


def test_plain_text_is_aligned():
    assert TABLE.to_text().splitlines() == [
        'Residual [µm]',
        'Model   T2 Y max  T2 Y rms',
        '------  --------  --------',
        'a|b          2.4       1.0',
        '[red]c      12.0       0.9',
    ]


def test_markdown_escapes_and_emphasises():
    assert TABLE.to_markdown().splitlines() == [
        '**Residual [µm]**',
        '',
        '| Model | T2 Y max | T2 Y rms |',
        '| :--- | ---: | ---: |',
        '| a\\|b | **2.4** | 1.0 |',
        '| [red]c | 12.0 | 0.9 |',
    ]


def test_rich_table_shows_cells_literally():
    console = pytest.importorskip('rich.console', reason='rich is not installed')
    stream = io.StringIO()
    console.Console(file=stream, width=100).print(TABLE.to_rich())
    shown = stream.getvalue()
    for text in ('Residual [µm]', '[red]c', '12.0', 'T2 Y'):
        assert text in shown


def test_columns_of_a_group_share_a_heading():
    assert TABLE.groups() == [('', 1), ('T2 Y', 2)]


def test_rows_must_fit_the_columns():
    with pytest.raises(ValueError, match=r'row 0 .* expected 2 cells but found 1'):
        Table('t', (Column('a'), Column('b')), (('1',),))


@pytest.mark.parametrize(
    ('module', 'remedy'),
    [
        ('matplotlib.figure', 'python3-matplotlib'),
        ('jinja2', 'python3-jinja2'),
        ('rich.table', 'python3-rich'),
    ],
)
def test_missing_package_is_named_with_its_remedy(monkeypatch, module, remedy):
    package = module.partition('.')[0]
    for name in (package, module):
        monkeypatch.setitem(sys.modules, name, None)  # as if it were not installed
    with pytest.raises(ModuleNotFoundError, match=remedy) as failure:
        require(module)
    assert "pip install 'fuzzycnc_ros[report]'" in str(failure.value)

# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Tables, marks, plots and pages of comparisons."""

import re
from dataclasses import replace

import numpy as np
import pytest

from fuzzycnc_ros.core.thermal.candidate import CANDIDATES
from fuzzycnc_ros.core.thermal.fit import Evaluation
from fuzzycnc_ros.core.thermal.fit.comparison import Comparison, HeldOut
from fuzzycnc_ros.core.thermal.fit.selection import SensorCount
from fuzzycnc_ros.studies.page.drawing import AFTER, BEFORE, LIMIT, WARNING
from fuzzycnc_ros.studies.page.html import Remark
from fuzzycnc_ros.studies.thermal import comparison_page
from fuzzycnc_ros.studies.thermal.comparison import (
    best_candidates,
    best_lines,
    best_of,
    by_channel,
    comparison_document,
    held_out_remarks,
    held_out_table,
    pooled_refusal_lines,
    pooled_remarks,
    pooled_table,
    refusal_lines,
    refused_anywhere,
    refused_on,
    residual_table,
)
from fuzzycnc_ros.studies.thermal.judged import training_remark
from fuzzycnc_ros.studies.thermal.summary import candidate_label

CHANNEL = ('Y', 'Z')


def um(*values):
    return 1e-6 * np.array(values, dtype=np.float64)


def held_out(run='T2', samples=(8, 8), refused=None, default='lag_ridge', **rms):
    """Return figures of one run; the largest residual is twice the rms."""
    rms = {'uncompensated': um(20, 10), 'static_ridge': um(3, 4), 'lag_ridge': um(2, 5), **rms}
    rms['default'] = rms[default]
    measured = np.column_stack([um(*range(8)), um(*range(8, 16))])
    evaluation = Evaluation(
        run=run,
        channel=CHANNEL,
        axis=CHANNEL,
        samples=samples,
        default=(default,) * 2,
        rms=rms,
        largest={name: 2.0 * values for name, values in rms.items()},
        in_domain=0.5,
        warm={},
        trained_on={},
        covered=np.array([0.95, 0.5]),
        half_width=um(4, 6),
        independent=np.array([8.0, 1.0]),
        band_ratio=np.array([1.0, 1.5]),
        time=60.0 * np.arange(8),
        measured=measured,
        predicted={name: measured - values for name, values in rms.items()},
    )
    return HeldOut(evaluation=evaluation, inputs=('T1', 'T7'), refused=refused or {})


def cells(table):
    return {row[0]: row[1:] for row in table.rows}


def strong(table):
    """Return the label of the best of each column; the default may be alike."""
    return {
        table.columns[column].full_heading: table.rows[row][0]
        for row, column in sorted(table.strong, reverse=True)
    }


def test_table_of_a_run_marks_what_is_refused_and_never_calls_it_best():
    item = held_out(mlp=um(1, 1), arma=um(np.inf, 3), refused={'mlp': 'it is vague'})
    table = held_out_table(item)
    assert cells(table) == {
        'Uncompensated': ('20.0', '40.0', '10.0', '20.0'),
        'Static ridge': ('3.0', '6.0', '4.0', '8.0'),
        'LagRidge': ('2.0', '4.0', '5.0', '10.0'),
        'MLP † *': ('1.0', '2.0', '1.0', '2.0'),
        'ARMA † *': ('diverged', 'diverged', '3.0', '6.0'),
        'Default': ('2.0', '4.0', '5.0', '10.0'),
    }
    assert strong(table) == {
        'Y rms': 'LagRidge',
        'Y max': 'LagRidge',
        'Z rms': 'Static ridge',
        'Z max': 'Static ridge',
    }
    assert table.highlight == {5}
    assert table.title == 'T2: residual thermal error [µm]'
    assert refusal_lines(item) == [
        'MLP is not to be trusted: it is vague',
        'ARMA is not to be trusted: its prediction diverged',
    ]


def test_table_of_a_training_shows_what_is_in_use():
    rms = {'static_ridge': um(3, 4), 'lag_ridge': um(2, 5)}
    table = residual_table('Held out', CHANNEL, rms, rms, in_use=('static_ridge', 'lag_ridge'))
    assert table.strong == {(0, 1), (0, 2), (1, 3), (1, 4)}
    assert table.highlight == frozenset()


@pytest.mark.parametrize(
    ('figures', 'refused', 'best'),
    [
        ({'a': 2.0, 'b': 1.0}, (), ['b']),
        ({'a': 1.0, 'b': 1.0}, (), ['a', 'b']),
        ({'a': 2.0, 'b': 1.0}, ('b',), ['a']),
        ({'a': np.nan, 'b': np.inf}, (), []),
        ({'uncompensated': 4.0, 'default': 0.2, 'a': 3.0}, (), ['a']),
        ({'uncompensated': 0.1, 'default': 0.2, 'a': 3.0}, (), ['uncompensated']),
        ({'uncompensated': 3.0, 'a': 3.0}, (), ['uncompensated']),
        ({}, (), []),
    ],
)
def test_best(figures, refused, best):
    assert best_of(figures, refused) == best


def test_best_over_all_runs_is_trusted_on_each():
    two = Comparison(
        (
            held_out('T2', mlp=um(1, 1), arma=um(1, 1)),
            held_out('T3', (8, 8), {'mlp': 'vague'}, mlp=um(1, 1), arma=um(np.inf, np.inf)),
        )
    )
    assert refused_anywhere(two) == {
        'mlp': {'T3': 'vague'},
        'arma': {'T3': 'its prediction diverged'},
    }
    assert best_candidates(two) == {'Y': 'lag_ridge', 'Z': 'static_ridge'}
    assert cells(pooled_table(two))['ARMA † *'] == ('diverged',) * 4
    assert pooled_refusal_lines(two) == [
        'MLP is not to be trusted: refused on 1 of 2 held-out runs, T3',
        'ARMA is not to be trusted: refused on 1 of 2 held-out runs, T3',
    ]


def test_what_could_not_be_fitted_on_one_run_is_left_out_of_the_whole():
    two = Comparison((held_out('T2', mlp=um(1, 1)), held_out('T3', refused={'mlp': 'no data'})))
    assert 'MLP † *' not in cells(pooled_table(two))
    assert pooled_refusal_lines(two) == [
        'MLP was left out: refused on 1 of 2 held-out runs, T3',
    ]
    assert refusal_lines(two.held_out[1]) == ['MLP was left out: no data']
    assert best_candidates(two)['Y'] == 'lag_ridge'


def test_no_compensation_is_best_where_nothing_that_is_trusted_beats_it():
    everything = dict.fromkeys(('static_ridge', 'lag_ridge'), 'vague')
    one = Comparison((held_out(refused=everything),))
    assert best_candidates(one) == {'Y': 'uncompensated', 'Z': 'uncompensated'}
    assert by_channel(best_candidates(one)) == 'none'
    worse = held_out(uncompensated=um(20, 3))
    assert best_candidates(Comparison((worse,))) == {'Y': 'lag_ridge', 'Z': 'uncompensated'}
    assert strong(held_out_table(worse))['Z rms'] == 'Uncompensated'


def test_what_is_worse_than_no_compensation_warns_in_table_sentence_and_document():
    worse = held_out(uncompensated=um(20, 3))
    table = held_out_table(worse)
    row = [line[0] for line in table.rows].index('Default')
    assert table.warning == {(row, 0), (row, 3), (row, 4)}
    assert '! 5.0' in table.to_text()
    text = 'worse than no compensation on Z: 5.0 µm remain of 3.0 µm'
    assert Remark(f'T2: {text}', True) in held_out_remarks(worse)
    both = Comparison((worse, held_out('T3', uncompensated=um(20, 3))))
    assert pooled_remarks(both) == [Remark(f'All held-out runs: {text}', True)]
    document = comparison_document(both)
    assert document['worse_than_none'] == ['Z']
    assert document['held_out']['T3']['worse_than_none'] == ['Z']
    assert comparison_document(Comparison((held_out(),)))['worse_than_none'] == []


def test_a_training_that_uses_what_is_worse_warns():
    rms = {'uncompensated': um(20, 3), 'lag_ridge': um(2, 5)}
    forced = residual_table('Held out', CHANNEL, rms, rms, in_use=('lag_ridge',) * 2)
    assert forced.warning == {(1, 0), (1, 3), (1, 4)}
    chosen = residual_table('Held out', CHANNEL, rms, rms, in_use=('lag_ridge', 'uncompensated'))
    assert chosen.warning == frozenset()
    assert chosen.strong == {(1, 1), (1, 2), (0, 3), (0, 4)}


def test_a_held_out_run_says_what_was_judged():
    item = held_out(samples=(8, 5))
    window, band = (line.text for line in held_out_remarks(item))
    assert window == (
        'T2: judged from 0 to 420 s, samples: 8 of Y, 5 of Z; 50 % of them in the domain of the '
        'training'
    )
    assert band == (
        'T2: the band of two standard deviations holds 95 % of Y (±4.0 µm), 50 % of Z (±6.0 µm)'
    )
    known = replace(item.evaluation, trained_on={'monday': 0.71}, warm={'front': 6.2, 'rear': -2})
    lines = held_out_remarks(replace(item, evaluation=known))
    assert [line.warning for line in lines] == [False, True, True, False]
    assert lines[1].text == (
        'about 71 % of the judged samples of T2 were trained on (monday): this is no test'
    )
    assert 'was warm when the run began: front +6.2 K, rear -2.0 K' in lines[2].text


@pytest.mark.parametrize(
    ('trained_on', 'recognised', 'training', 'expected'),
    [
        ({}, True, ('a',), Remark('T2: no model was trained on these samples')),
        (
            {},
            True,
            ('T2',),
            Remark(
                'T2: no model was trained on these samples, but on others of a run of that name'
            ),
        ),
        (
            {'a': 0.5, 'b': 0.25},
            False,
            ('a', 'b'),
            Remark(
                'about 75 % of the judged samples of T2 were trained on (a, b): this is no test',
                True,
            ),
        ),
    ],
)
def test_that_a_run_is_no_test_is_said_only_where_it_is_so(
    trained_on, recognised, training, expected
):
    assert training_remark('T2', trained_on, recognised, training) == expected


def test_that_nothing_was_trained_on_is_not_said_where_it_is_not_known():
    remark = training_remark('T2', {}, False, ('a',))
    assert remark.warning
    assert 'is unknown' in remark.text


def test_what_was_never_measured_is_neither_best_nor_diverged():
    absent = {'uncompensated': um(20, np.nan), 'static_ridge': um(3, np.nan)}
    item = held_out(**absent, lag_ridge=um(2, np.nan))
    assert best_candidates(Comparison((item,)))['Z'] is None
    assert refused_on(item) == {}
    assert cells(held_out_table(item))['LagRidge'] == ('2.0', '4.0', '-', '-')
    assert set(strong(held_out_table(item))) == {'Y rms', 'Y max'}


def test_document():
    document = comparison_document(
        Comparison((held_out('T2', mlp=um(1, 1), refused={'mlp': 'vague'}), held_out('T3')))
    )
    assert document['held_out']['T2'] == {
        'window_s': [0.0, 420.0],
        'samples': {'Y': 8, 'Z': 8},
        'in_domain': 0.5,
        'warm_K': {},
        'trained_on': {},
        'covered': {'Y': 0.95, 'Z': 0.5},
        'half_width_um': pytest.approx({'Y': 4.0, 'Z': 6.0}),
        'independent': {'Y': 8.0, 'Z': 1.0},
        'band_ratio': {'Y': 1.0, 'Z': 1.5},
        'false_band': [],
        'worse_than_none': [],
        'default': {'Y': 'lag_ridge', 'Z': 'lag_ridge'},
        'inputs': ['T1', 'T7'],
        'figures': {
            name: {
                'Y': {'rms_um': pytest.approx(y), 'max_um': pytest.approx(2 * y)},
                'Z': {'rms_um': pytest.approx(z), 'max_um': pytest.approx(2 * z)},
            }
            for name, y, z in (
                ('uncompensated', 20, 10),
                ('static_ridge', 3, 4),
                ('lag_ridge', 2, 5),
                ('mlp', 1, 1),
                ('default', 2, 5),
            )
        },
        'refused': {'mlp': 'vague'},
    }
    assert document['best'] == {'Y': 'lag_ridge', 'Z': 'static_ridge'}
    assert document['refused'] == {'mlp': {'T2': 'vague'}}
    assert document['pooled']['lag_ridge']['Y']['rms_um'] == pytest.approx(2.0)


def test_every_candidate_has_a_label_of_its_own():
    labels = [candidate_label(name) for name in CANDIDATES]
    assert len(set(labels)) == len(labels)
    assert not [label for label in labels if '_' in label]


# Plots and pages


def bars(rows, refused=()):
    """Return share and colour of the bar of each row and channel."""
    table = residual_table('a run', CHANNEL, rows, rows, refused)
    return [[table.bars.get((row, column)) for row in range(len(rows))] for column in (1, 3)]


def test_bars_are_blue_only_where_less_is_left_than_without():
    rows = {'uncompensated': um(9, 10), 'mlp': um(19, 4), 'arma': um(3, 3), 'default': um(3, 50)}
    first, second = bars(rows, refused=('arma',))
    assert [colour for _, colour in first] == [BEFORE, LIMIT, WARNING, AFTER]
    assert [colour for _, colour in second] == [BEFORE, AFTER, WARNING, LIMIT]
    same = {'uncompensated': um(9, 10), 'default': um(9, 10)}
    assert bars(same) == 2 * [2 * [(1.0, BEFORE)]]


def test_bars_are_as_long_as_their_figures_beside_the_largest_that_has_not_diverged():
    rows = {
        'uncompensated': um(20, 10),
        'mlp': um(5, np.nan),
        'arma': um(np.inf, 1e6),
        'default': um(2, 5),
    }
    first, second = bars(rows, refused=('arma',))
    assert [share for share, _ in first] == pytest.approx([1.0, 0.25, 1.0, 0.1])
    assert second[1] is None
    assert [share for share, _ in (second[0], *second[2:])] == pytest.approx([1.0, 1.0, 0.5])


def test_traces_are_what_is_left_and_leave_gaps_where_nothing_was():
    left = {'uncompensated': np.stack([um(1, 2), um(3, np.nan)]), 'default': np.zeros((2, 2))}
    chart = comparison_page.traces_chart(
        np.array([0.0, 60.0]), CHANNEL, left, {n: n for n in left}
    )
    bare, default = chart.panels[1].series
    assert (bare.name, bare.colour) == ('uncompensated', BEFORE)
    assert (default.name, default.colour) == ('default', AFTER)
    assert bare.y[0] == pytest.approx(2.0)
    assert np.isnan(bare.y[1])
    assert list(default.y) == [0.0, 0.0]


def test_what_looks_equal_is_marked_alike_but_not_what_leaves_all_as_it_is():
    rows = {
        'uncompensated': um(20, 2.41),
        'static_ridge': um(2.41, 2.44),
        'lag_ridge': um(2.44, 2.41),
        'default': um(2.41, 2.44),
    }
    table = residual_table('a run', CHANNEL, rows, rows)
    assert {cell for cell in table.strong if cell[1] == 1} == {(1, 1), (2, 1), (3, 1)}
    # of Z LagRidge is the machine without compensation, and static ridge looks as good
    assert {cell for cell in table.strong if cell[1] == 3} == {(0, 3), (1, 3), (3, 3)}


def curves():
    from fuzzycnc_ros.studies.thermal.sensor_curve import HeldOutCurve, SensorCurves

    def point(count, rms):
        return SensorCount(count, ('T1',) * count, um(*rms), 3.0 * um(*rms))

    return SensorCurves(
        (1, 4),
        CHANNEL,
        (
            HeldOutCurve('T2', (point(1, (5, 6)), point(4, (1, np.inf)))),
            HeldOutCurve('T3', (point(1, (7, 2)), point(4, (3, 4)))),
        ),
    )


def test_sensor_curves_over_runs():
    from fuzzycnc_ros.studies.thermal.sensor_curve import (
        clusters_line,
        sensor_curve_document,
        sensor_curve_table,
    )

    assert '--clusters 1 ' in clusters_line(curves())
    table = sensor_curve_table(curves())
    assert table.rows == (
        ('1', '6.0', '7.0', '21.0', '4.0', '6.0', '18.0'),
        ('4', '2.0', '3.0', '9.0', 'diverged', 'diverged', 'diverged'),
    )
    assert table.strong == {(1, 1), (1, 2), (1, 3), (0, 4), (0, 5), (0, 6)}
    document = sensor_curve_document(curves())
    assert document['over_runs']['4']['Y'] == pytest.approx(
        {'mean_rms_um': 2.0, 'worst_rms_um': 3.0, 'max_um': 9.0}
    )
    assert document['held_out']['T3']['1']['sensors'] == ['T1']
    item = curves()
    chart = comparison_page.sensor_counts_chart(
        item.count, item.channel, item.mean(), item.worst(), item.largest()
    )
    assert [list(series.y) for series in chart.panels[0].series] == [
        pytest.approx([21, 9]),
        pytest.approx([7, 3]),
        pytest.approx([6, 2]),
    ]
    assert np.isnan(chart.panels[1].series[0].y[1])  # a gap, not the edge of the plot


def test_page_of_a_comparison():
    pytest.importorskip('jinja2', reason='jinja2 is not installed')
    from fuzzycnc_ros.studies.page.html import render_page

    two = Comparison(
        (held_out('T<2>', mlp=um(1, 1), refused={'mlp': 'a & b'}), held_out('T3', mlp=um(1, 1)))
    )
    page = render_page(comparison_page.comparison_page(two, {'Seed': '7'}))
    assert page == render_page(comparison_page.comparison_page(two, {'Seed': '7'}))
    assert re.findall(r'<h2>(.*?)</h2>', page) == [
        'All held-out runs',
        'Held out: T&lt;2&gt;',
        'Held out: T3',
        'Provenance',
    ]
    assert re.findall(r'<b>Figure (\d)\.', page) == list('12')
    assert 'MLP is not to be trusted: a &amp; b' in page
    assert 'LagRidge (Y), Static ridge (Z)' in page
    assert page.count('<table class="dense">') == 3
    assert 'T<2>' not in page
    assert '<dt>Judged</dt><dd>T&lt;2&gt;: ' in page
    one = render_page(comparison_page.comparison_page(Comparison(two.held_out[1:]), {}))
    assert 'All held-out runs' not in one
    assert 'one held-out run' in one
    assert 'Provenance' not in one


def test_what_no_machine_runs_is_never_the_best_and_is_said_where_it_is_better():
    item = held_out(gaussian_process=um(1, 9))
    comparison = Comparison((item,))
    assert best_candidates(comparison) == {'Y': 'lag_ridge', 'Z': 'static_ridge'}
    assert best_lines(comparison) == [
        'best candidate: LagRidge (Y), Static ridge (Z)',
        'better, but only compared, as no machine runs it: Gaussian process on Y, 1.0 µm instead '
        'of 2.0 µm',
    ]
    assert best_lines(Comparison((held_out(gaussian_process=um(2, 9)),)))[1:] == []
    document = comparison_document(comparison)
    assert document['best'] == {'Y': 'lag_ridge', 'Z': 'static_ridge'}
    assert document['best_compared'] == {'Y': 'gaussian_process', 'Z': 'static_ridge'}
    table = held_out_table(item)
    labels = [row[0] for row in table.rows]
    assert labels[1:4] == ['Static ridge', 'LagRidge', 'Gaussian process †']
    assert not any(row == 3 for row, _ in table.strong)


def test_a_default_that_is_much_worse_than_least_squares_is_called_so():
    item = held_out(least_squares=um(1, 5))
    (line,) = [line for line in held_out_remarks(item) if 'plain' in line.text]
    assert line == (
        'T2: the default leaves much more than plain least squares: 2.0 µm instead of 1.0 µm on Y',
        True,
    )
    assert comparison_document(Comparison((item,)))['worse_than_plain'] == ['Y']
    # Neither what is not to be trusted nor a difference that no table shows is held against it.
    for other in (
        held_out(least_squares=um(1, 5), refused={'least_squares': 'no samples'}),
        held_out(least_squares=um(1.4, 5)),
        held_out(least_squares=um(0.01, 5), lag_ridge=um(0.02, 5)),
    ):
        assert not [line for line in held_out_remarks(other) if 'plain' in line.text]

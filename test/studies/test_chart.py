# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Figures as they are declared: what a browser gets, what is kept of many rows."""

import json

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fuzzycnc_ros.studies.page.chart import (
    ROWS_MAX,
    Axis,
    Band,
    Chart,
    Panel,
    Rule,
    Series,
    Shades,
    kept_rows,
)
from fuzzycnc_ros.studies.page.drawing import AFTER, BEFORE, PALETTE, THEME


def decoded(column):
    """Return the numbers of an encoded column, as `charts.js` does; NaN for gaps."""
    total, values = 0, []
    for step in column['steps']:
        total += step or 0
        values.append(np.nan if step is None else total / 10.0 ** column['decimals'])
    return np.array(values)


def chart(x, *series, y_axis=None, x_axis=None, **options):
    panel = Panel(x, y_axis or Axis('error', 'µm'), series, **options)
    return Chart(x_axis or Axis('time', 's'), [panel])


def only_panel(found):
    (panel,) = found.document()['panels']
    return panel


def test_a_document_is_json_and_holds_the_declaration():
    x = np.array([0.0, 0.5, 1.0])
    found = chart(
        x,
        Series('after', [1.0, np.nan, -3.25], AFTER, dashes=(2.0, 2.0)),
        Series('own', [5.0, 6.0], '#123456', x=[0.25, 0.75], kind='dots', text=['a', 'b']),
        bands=[Band('band', x - 1.0, x + 1.0, BEFORE)],
        rules=[Rule(2.0, BEFORE, 'limit', upright=True)],
    )
    document = json.loads(json.dumps(found.document(), allow_nan=False))
    assert document['x']['label'] == 'time [s]'
    (panel,) = document['panels']
    assert decoded(panel['x']) == pytest.approx([0.0, 0.25, 0.5, 0.75, 1.0])
    after, own = panel['series']
    assert (after['colour'], own['colour']) == ('--after', '#123456')
    assert decoded(after['y']) == pytest.approx([1.0, np.nan, np.nan, np.nan, -3.25], nan_ok=True)
    assert decoded(own['y']) == pytest.approx([np.nan, 5.0, np.nan, 6.0, np.nan], nan_ok=True)
    assert own['text'] == ['', 'a', '', 'b', '']
    assert decoded(panel['bands'][0]['high'])[[0, 2, 4]] == pytest.approx([1.0, 1.5, 2.0])
    assert panel['rules'][0]['name'] == 'limit'
    assert 'kept' not in panel


@pytest.mark.parametrize('scale', [1e-9, 1.0, 1e9])
def test_numbers_keep_four_digits_of_their_range(scale):
    rng = np.random.default_rng(3)
    y = scale * (100.0 + rng.normal(size=200))
    panel = only_panel(chart(np.arange(200.0), Series('y', y, AFTER)))
    assert np.abs(decoded(panel['series'][0]['y']) - y).max() <= 1e-4 * np.ptp(y)


def test_small_numbers_on_logarithmic_axes_keep_their_digits():
    y = np.array([1e-4, 2.5e-3, 1.0, 300.0])
    log = only_panel(chart(np.arange(4.0), Series('y', y, AFTER), y_axis=Axis('y', scale='log')))
    assert decoded(log['series'][0]['y']) == pytest.approx(y, rel=1e-3)
    near = np.array([45e3, 10.0, 0.12, -0.03])
    axis = Axis('error', 'µm', 'symlog', linear_to=2.0)
    symlog = only_panel(chart(np.arange(4.0), Series('y', near, AFTER), y_axis=axis))
    assert decoded(symlog['series'][0]['y']) == pytest.approx(near, abs=0.02)


@pytest.mark.parametrize('y', [np.full(3, np.nan), np.zeros(3), np.full(3, 7.0), [np.inf, 1, 2]])
def test_odd_values_are_encoded(y):
    panel = only_panel(chart(np.arange(3.0), Series('y', y, AFTER)))
    finite = np.where(np.isfinite(y), y, np.nan)
    assert decoded(panel['series'][0]['y']) == pytest.approx(finite, nan_ok=True, rel=1e-3)


def test_of_many_rows_all_extremes_of_all_series_stay():
    rng = np.random.default_rng(1)
    count = 40_000
    first, second = rng.normal(size=(2, count))
    first[12_345], second[31_000] = 50.0, -60.0
    found = chart(
        np.arange(count), Series('first', first, AFTER), Series('second', second, BEFORE)
    )
    panel = only_panel(found)
    assert panel['kept'] == [len(panel['x']['steps']), count]
    assert panel['kept'][0] <= ROWS_MAX
    for series, values in zip(panel['series'], (first, second), strict=True):
        kept = decoded(series['y'])
        assert np.nanmax(kept) == pytest.approx(values.max(), abs=0.02)
        assert np.nanmin(kept) == pytest.approx(values.min(), abs=0.02)
    x = decoded(panel['x'])
    assert (x[0], x[-1]) == (0.0, count - 1.0)
    # each row that is kept is one of the recording
    assert decoded(panel['series'][0]['y']) == pytest.approx(first[x.astype(int)], abs=0.02)


def test_a_series_with_an_x_of_its_own_is_thinned_too():
    x = np.linspace(0.0, 1.0, 30_000)
    found = chart(np.array([0.0, 1.0]), Series('own', np.sin(40.0 * x), AFTER, x=x))
    panel = only_panel(found)
    assert panel['kept'][1] == 30_000
    assert len(panel['x']['steps']) <= ROWS_MAX + 2


@given(st.integers(1, 300), st.integers(1, 4), st.integers(8, 120), st.integers(0, 2**32 - 1))
def test_rows_that_are_kept_hold_the_extremes_of_each_column(count, columns, most, seed):
    rng = np.random.default_rng(seed)
    table = rng.normal(size=(count, columns))
    table[rng.random(table.shape) < 0.1] = np.nan
    rows = kept_rows(table, most)
    assert len(rows) <= max(most, 2 * columns + 2 + most // 4)
    assert {0, count - 1} <= set(rows.tolist())
    assert (np.diff(rows) > 0).all()
    for column in table.T:
        if np.isfinite(column).any():
            assert np.nanmax(column[rows]) == np.nanmax(column)
            assert np.nanmin(column[rows]) == np.nanmin(column)


def test_a_gap_stays_a_gap():
    values = np.sin(np.linspace(0.0, 9.0, 9000))
    values[4000:4400] = np.nan
    rows = kept_rows(values[:, np.newaxis], 300)
    inside = rows[(rows >= 4000) & (rows < 4400)]
    assert inside.size


def test_measurements_that_stand_alone_are_dots():
    sparse = np.full(60, np.nan)
    sparse[::6] = 1.0
    assert Series('probed', sparse, AFTER).kind == 'dots'
    sparse[:] = 1.0
    sparse[20:30] = np.nan
    assert Series('gap', sparse, AFTER).kind == 'line'


def test_panels_are_linked_where_they_show_the_same_stretch():
    one = Panel(np.arange(3.0), Axis('y'), [])
    other = Panel(np.arange(5.0), Axis('y'), [])
    assert Chart(Axis('x'), [one, one]).linked
    assert not Chart(Axis('x'), [one, other]).linked
    assert not Chart(Axis('x'), [one]).linked


def test_a_series_of_another_length_is_refused():
    with pytest.raises(ValueError, match="series 'y' of panel 'P': expected 3 values"):
        Panel(np.arange(3.0), Axis('y'), [Series('y', [1.0], AFTER)], title='P')


def test_a_plane_keeps_the_order_of_its_places_and_their_levels():
    x, y = np.array([3.0, 1.0, np.nan, 2.0]), np.array([0.0, 1.0, np.nan, 2.0])
    level = np.array([np.nan, 5.0, np.nan, 7.5])
    shades = Shades(Axis('error', 'µm'), [(0.0, '#ffffff'), (7.5, AFTER)], (5.0, 'tolerance'))
    series = [Series('tool', y, AFTER, x=x, level=level)]
    panel = Panel([], Axis('Y', 'mm'), series, plane=1.0, shades=shades)
    found = only_panel(Chart(Axis('X', 'mm'), [panel]))
    (drawn,) = found['series']
    assert decoded(drawn['x']) == pytest.approx(x, nan_ok=True)
    assert decoded(drawn['y']) == pytest.approx(y, nan_ok=True)
    assert decoded(drawn['level']) == pytest.approx(level, nan_ok=True)
    assert found['shades']['stops'] == [[0.0, '#ffffff'], [7.5, '--after']]
    assert not Chart(Axis('X', 'mm'), [panel, panel]).linked


def test_each_colour_has_one_name():
    assert len(THEME) == len(PALETTE)

# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Paths as they are drawn: by feed, by error, flat and shallow parts."""

from types import SimpleNamespace

import numpy as np
import pytest

from fuzzycnc_ros.studies.contour.contouring_page import path_chart as error_chart
from fuzzycnc_ros.studies.page.drawing import AFTER, BEFORE, LIMIT
from fuzzycnc_ros.studies.programs.program_page import path_chart


def trace(height):
    """A helix of 100 mm by 80 mm."""
    turn = np.linspace(0.0, 6.0 * np.pi, 91)
    place = np.column_stack(
        [0.05 * np.cos(turn), 0.04 * np.sin(turn), np.linspace(0.0, height, len(turn))]
    )
    ends = np.stack([place[:-1], place[1:]], axis=1)
    return SimpleNamespace(edges=(ends, np.full(len(ends), 0.02)), stride=1)


def views(chart):
    """Return scale and label of y of each view."""
    assert chart.x_axis.label == 'X [mm]'
    return [(panel.plane, panel.y_axis.label) for panel in chart.panels]


def test_a_flat_part_is_drawn_in_its_plane():
    assert views(path_chart(trace(0.0))) == [(1.0, 'Y [mm]')]


def test_a_shallow_part_is_enlarged_in_height_and_that_is_said():
    assert views(path_chart(trace(4e-3))) == [
        (1.0, 'Y [mm]'),
        (6.0, 'Z (drawn 6 times as high) [mm]'),
    ]


def test_a_tall_part_is_drawn_as_it_is():
    assert views(path_chart(trace(60e-3))) == [(1.0, 'Y [mm]'), (1.0, 'Z [mm]')]


def test_a_path_is_one_line_with_its_feed_and_gaps_where_edges_do_not_meet():
    part = trace(4e-3)
    (ends, feed) = part.edges
    part.edges = (np.delete(ends, 10, axis=0), np.delete(feed, 10))
    (series,) = path_chart(part).panels[0].series
    known = np.isfinite(series.y)
    assert np.flatnonzero(~known).tolist() == [0, 12]
    assert series.x[1] == pytest.approx(50.0)
    assert series.x[[11, 13]] == pytest.approx(1e3 * ends[[9, 11], [1, 0], 0])
    assert np.isnan(series.level[[1, 13]]).all()
    assert series.level[[2, 11, 14, -1]] == pytest.approx(np.full(4, 1200.0))


def shade(shades, level):
    """Return the colours between which a level lies, as a page mixes them."""
    at = next(n for n, (stop, _) in enumerate(shades.stops) if stop >= level)
    return {colour for _, colour in shades.stops[max(at - 1, 0) : at + 1]}


@pytest.mark.parametrize('tolerance', [20e-6, 200e-6])
def test_within_the_tolerance_is_blue_and_beyond_it_red(tolerance):
    error = np.array([1e-6, 10e-6, 19e-6, 25e-6, 80e-6, 100e-6])
    point = np.column_stack([np.linspace(0.0, 1e-2, len(error)), np.zeros(len(error))])
    (panel,) = error_chart(point, error, 'XY', tolerance).panels
    blue = [AFTER in shade(panel.shades, 1e6 * value) for value in error]
    red = [{BEFORE, LIMIT} <= shade(panel.shades, 1e6 * value) for value in error]
    assert blue == (error <= tolerance).tolist()
    assert red == (error > tolerance).tolist()
    assert panel.shades.mark == (pytest.approx(1e6 * tolerance), 'tolerance')
    assert np.nanmax(panel.series[0].level) == pytest.approx(100.0)


def test_of_a_long_path_the_largest_error_is_drawn():
    error = np.full(50_000, 1e-6)
    error[31_234] = 70e-6
    point = np.column_stack([np.linspace(0.0, 1.0, len(error)), np.zeros(len(error))])
    (series,) = error_chart(point, error, 'XY').panels[0].series
    assert len(series.x) <= 2_500
    assert np.nanmax(series.level) == pytest.approx(70.0)

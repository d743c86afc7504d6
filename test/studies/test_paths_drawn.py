# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Paths as they are drawn: by feed, by error, flat and shallow parts."""

from types import SimpleNamespace

import numpy as np
import pytest

pytest.importorskip('matplotlib', reason='matplotlib is not installed')

from matplotlib.collections import LineCollection

from fuzzycnc_ros.studies.contour.contouring_page import path_picture as error_picture
from fuzzycnc_ros.studies.programs.program_page import path_picture


def trace(height):
    """A helix of 100 mm by 80 mm."""
    turn = np.linspace(0.0, 6.0 * np.pi, 91)
    place = np.column_stack(
        [0.05 * np.cos(turn), 0.04 * np.sin(turn), np.linspace(0.0, height, len(turn))]
    )
    ends = np.stack([place[:-1], place[1:]], axis=1)
    return SimpleNamespace(edges=(ends, np.full(len(ends), 0.02)), stride=1)


def views(picture):
    """Return aspect and label of y of each view."""
    return [
        (axes.get_aspect(), axes.get_ylabel())
        for axes in picture.figure.axes
        if axes.get_xlabel() == 'X [mm]'
    ]


def test_a_flat_part_is_drawn_in_its_plane():
    assert views(path_picture(trace(0.0))) == [(1.0, 'Y [mm]')]


def test_a_shallow_part_is_enlarged_in_height_and_that_is_said():
    assert views(path_picture(trace(4e-3))) == [
        (1.0, 'Y [mm]'),
        (6.0, 'Z [mm], drawn 6 times as high'),
    ]


def test_a_tall_part_is_drawn_as_it_is():
    assert views(path_picture(trace(60e-3))) == [(1.0, 'Y [mm]'), (1.0, 'Z [mm]')]


def test_a_drawn_path_has_its_numbers():
    columns = path_picture(trace(4e-3)).columns
    assert list(columns)[:3] == ['from X [mm]', 'from Y [mm]', 'from Z [mm]']
    assert columns['from X [mm]'][0] == pytest.approx(50.0)
    assert columns['to Z [mm]'][-1] == pytest.approx(4.0)
    assert columns['feed [mm/min]'] == pytest.approx(np.full(90, 1200.0))


@pytest.mark.parametrize('tolerance', [20e-6, 200e-6])
def test_within_the_tolerance_is_blue_and_beyond_it_red(tolerance):
    error = np.array([1e-6, 10e-6, 19e-6, 25e-6, 80e-6, 100e-6])
    point = np.column_stack([np.linspace(0.0, 1e-2, len(error)), np.zeros(len(error))])
    picture = error_picture(point, error, 'XY', tolerance)
    (lines,) = (
        item for item in picture.figure.axes[0].collections if isinstance(item, LineCollection)
    )
    shown = lines.to_rgba(1e6 * error)
    blue = shown[:, 2] > shown[:, 0]
    assert blue.tolist() == (error <= tolerance).tolist()
    assert picture.columns['contour error [µm]'].max() == pytest.approx(100.0)


def test_of_a_long_path_the_largest_error_is_drawn():
    error = np.full(50_000, 1e-6)
    error[31_234] = 70e-6
    point = np.column_stack([np.linspace(0.0, 1.0, len(error)), np.zeros(len(error))])
    columns = error_picture(point, error, 'XY').columns
    assert len(columns['X [mm]']) <= 2_500
    assert columns['contour error [µm]'].max() == pytest.approx(70.0)

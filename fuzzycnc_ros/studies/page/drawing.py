# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""What all plots share: matplotlib figures without pyplot and its global state.

Every figure is made inside `plot_style`, which sets type sizes and colours.  The neutral colours
are also the marks by which `fuzzycnc_ros.studies.page.html` makes a figure follow the page's
theme.
"""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from math import ceil
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fuzzycnc_ros.studies.page.requirement import require

INK, MUTED, FAINT, GRID = '#14181d', '#56616d', '#8f99a5', '#e3e7ec'
"""Neutral colours: text and measurements, labels, background curves, grid lines."""

ACCENT, SECOND, THIRD, WARNING = '#2a74c4', '#d9772b', '#8d5fc4', '#d99a1c'
"""Colours of the model in use, two others, and what calls for attention."""

CLUSTER_COLOURS = (
    '#2a74c4',
    '#d9772b',
    '#2e9e74',
    '#b84a8f',
    '#a9891b',
    '#6a62cc',
    '#2399b4',
    '#cc4b5a',
    '#6f9130',
    '#94735c',
)

_STYLE = {
    'axes.axisbelow': True,
    'axes.edgecolor': MUTED,
    'axes.facecolor': 'none',
    'axes.grid': True,
    'axes.labelcolor': MUTED,
    'axes.linewidth': 0.6,
    'axes.spines.right': False,
    'axes.spines.top': False,
    'axes.titlecolor': INK,
    'axes.titlelocation': 'left',
    'axes.titlesize': 9.5,
    'axes.titleweight': 'bold',
    'font.family': 'sans-serif',
    'font.sans-serif': ['DejaVu Sans'],
    'font.size': 8.5,
    'grid.color': GRID,
    'grid.linewidth': 0.6,
    'legend.frameon': False,
    'legend.labelcolor': INK,
    'lines.linewidth': 1.4,
    'lines.solid_capstyle': 'round',
    'text.color': INK,
    'text.parse_math': False,  # a name with $ is no formula
    'xtick.color': MUTED,
    'xtick.major.width': 0.6,
    'ytick.color': MUTED,
    'ytick.major.width': 0.6,
    'svg.fonttype': 'none',
    'svg.hashsalt': 'fuzzycnc',
}

_WIDTH, _LEGEND_HEIGHT = 10.0, 0.3  # [in]
_LEGEND_KEY, _CHARACTER = 0.5, 0.064
"""Widths of a line with its gaps and, about, of a character of a legend [in]."""


@contextmanager
def plot_style() -> Iterator[None]:
    """Hold the report's matplotlib settings while figures are made and saved."""
    with require('matplotlib').rc_context(_STYLE):
        yield


def time_axis(time: NDArray[np.float64]) -> tuple[NDArray[np.float64], str]:
    """Return time since the first row in the unit that reads best, and its label."""
    elapsed = time - time[0]
    if elapsed[-1] > 7200.0:
        return elapsed / 3600.0, 'time [h]'
    return elapsed / 60.0, 'time [min]'


def new_figure(height: float) -> Any:
    """Return an empty figure of the page's width, some inches high."""
    figure = require('matplotlib.figure').Figure(figsize=(_WIDTH, height), layout='constrained')
    figure.patch.set_alpha(0.0)
    return figure


def panel_grid(count: int, *, columns: int, height: float) -> tuple[Any, list[Any]]:
    """Return a figure with a grid of panels [in] high."""
    rows = ceil(count / columns)
    figure = new_figure(0.3 + height * rows)
    panels = list(figure.subplots(rows, columns, squeeze=False).flat)
    for axes in panels[count:]:
        axes.remove()
    return figure, panels[:count]


def add_legend(figure: Any, handles: Sequence[Any], labels: Sequence[str]) -> None:
    """Put one legend above all panels, in as few rows as the page's width allows."""
    widest = _LEGEND_KEY + _CHARACTER * max(map(len, labels), default=0)
    columns = max(1, min(len(handles), 6, int(_WIDTH / widest)))
    rows = ceil(len(handles) / columns)
    # loc='outside upper left' would do both, but needs matplotlib 3.7.
    room = rows * _LEGEND_HEIGHT / figure.get_figheight()
    figure.get_layout_engine().set(rect=(0.0, 0.0, 1.0, 1.0 - room))
    figure.legend(
        handles,
        labels,
        loc='upper left',
        ncol=columns,
        columnspacing=1.6,
        handlelength=1.6,
        borderaxespad=0.2,
    )

# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Common part of all plots: colours, each with one meaning on all pages; the style on paper."""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager

import numpy as np
from numpy.typing import NDArray

from fuzzycnc_ros.studies.requirement import require

PALETTE: Mapping[str, tuple[str, str]] = {
    'ink': ('#14181d', '#e8ecf1'),
    'muted': ('#56616d', '#a3adb9'),
    'faint': ('#8f99a5', '#76818e'),
    'grid': ('#e3e7ec', '#2c343d'),
    'before': ('#d9772b', '#ee9550'),
    'after': ('#2a74c4', '#6aa8ea'),
    'other': ('#8d5fc4', '#b48fe6'),
    'another': ('#2e9e74', '#4cc498'),
    'limit': ('#c2395b', '#f07a97'),
    'caution': ('#d99a1c', '#f0bf5a'),
}
"""Colours by name, each on a light and on a dark page."""

INK, MUTED, FAINT, GRID = (PALETTE[name][0] for name in ('ink', 'muted', 'faint', 'grid'))
"""Neutral colours: text, labels, background curves, grid lines."""

MEASURED = INK
"""Colour of measured values without anything done to them."""

BEFORE, AFTER = PALETTE['before'][0], PALETTE['after'][0]
"""A machine as it is, and with what this package does: the model, controller or feed in use."""

OTHER, ANOTHER = PALETTE['other'][0], PALETTE['another'][0]
"""Colours of what is drawn beside the one in use for comparison."""

LIMIT = PALETTE['limit'][0]
"""A limit, a tolerance, and what lies beyond it."""

WARNING = PALETTE['caution'][0]
"""Colour of warnings: not to be trusted, outside the training."""

THEME: Mapping[str, str] = {light: f'--{name}' for name, (light, _) in PALETTE.items()}
"""Colour -> variable of the page's style sheet, which follows the reader's theme."""

CLUSTER_COLOURS = (
    AFTER,
    BEFORE,
    ANOTHER,
    '#b84a8f',
    '#a9891b',
    '#6a62cc',
    '#2399b4',
    '#cc4b5a',
    '#6f9130',
    '#94735c',
)
"""Colours of clusters, tracks and methods, which have no order."""

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


@contextmanager
def plot_style() -> Iterator[None]:
    """Hold matplotlib's settings of the PDF and the docs while figures are made and saved."""
    with require('matplotlib').rc_context(_STYLE):
        yield


def time_axis(time: NDArray[np.float64]) -> tuple[NDArray[np.float64], str]:
    """Return time since the first row in the unit that reads best, and that unit."""
    elapsed = time - time[0]
    if elapsed[-1] > 7200.0:
        return elapsed / 3600.0, 'h'
    return elapsed / 60.0, 'min'

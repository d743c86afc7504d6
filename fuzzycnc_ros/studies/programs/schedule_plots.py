# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Plots of a scheduled program: its path by feed, and its motion over time."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from fuzzycnc_ros.studies.page.drawing import ACCENT, MUTED, add_legend, new_figure, plot_style
from fuzzycnc_ros.studies.page.requirement import require
from fuzzycnc_ros.studies.programs.schedule_tables import MINUTE

if TYPE_CHECKING:
    from fuzzycnc_ros.studies.programs.program_drive import Drive
    from fuzzycnc_ros.studies.programs.schedule_trace import PathTrace

FLAT = 0.02
"""Extent of an axis, as a share of the largest one, below which a path counts as flat."""

COLUMNS = 1500
"""Columns into which a curve over time is gathered."""

_AXES = 'XYZ'


def plot_path(trace: PathTrace) -> Any:
    """Plot a path coloured by feed: in its plane, or from above and from the side."""
    ends, feed = trace.edges
    extent = np.ptp(ends.reshape(-1, 3), axis=0)
    flat = extent < FLAT * extent.max()
    if flat.any():
        level = int(np.argmin(extent))
        views = [tuple(axis for axis in range(3) if axis != level)]
    else:
        views = [(0, 1), (0, 2)]
    with plot_style():
        figure = new_figure(6.0 if len(views) == 1 else 5.0)
        panels = list(figure.subplots(1, len(views), squeeze=False).flat)
        colours = require('matplotlib.colors').Normalize(
            0.0, max(1e3 * MINUTE * float(feed.max()), 1e-9)
        )
        for axes, view in zip(panels, views, strict=True):
            lines = require('matplotlib.collections').LineCollection(
                1e3 * ends[:, :, view], norm=colours, cmap='turbo', linewidths=1.3
            )
            lines.set_array(1e3 * MINUTE * feed)
            axes.add_collection(lines)
            axes.set_aspect('equal', adjustable='datalim')
            axes.autoscale_view()
            axes.set_xlabel(f'{_AXES[view[0]]} [mm]')
            axes.set_ylabel(f'{_AXES[view[1]]} [mm]')
        figure.colorbar(lines, ax=panels, label='feed [mm/min]', shrink=0.8, pad=0.02)
        return figure


def plot_motion(chosen: Drive, programmed: Drive | None, names: tuple[str, str]) -> Any:
    """Plot feed, acceleration and jerk along the path over time, with those as programmed."""
    quantities = (
        ('feed\n[mm/min]', 'speed', 1e3 * MINUTE),
        ('acceleration\n[m/s²]', 'acceleration', 1.0),
        ('jerk\n[m/s³]', 'jerk', 1.0),
    )
    drives = [(programmed, MUTED, names[1])] if programmed is not None else []
    drives.append((chosen, ACCENT, names[0]))
    with plot_style():
        figure = new_figure(5.4)
        panels = list(figure.subplots(3, 1, sharex=True, height_ratios=(2, 1, 1)).flat)
        handles = []
        for drive, colour, _ in drives:
            for axes, (_, name, unit) in zip(panels, quantities, strict=True):
                time, low, high = envelope(drive.time, unit * getattr(drive, name))
                if low is high:
                    (line,) = axes.plot(time, low, color=colour, linewidth=1.0)
                else:
                    line = axes.fill_between(
                        time, low, high, color=colour, linewidth=0.6, alpha=0.75
                    )
            handles.append(line)
        for axes, (label, *_) in zip(panels, quantities, strict=True):
            axes.set_ylabel(label)
        panels[0].set_ylim(bottom=0.0)
        panels[-1].set_xlabel('time [s]')
        figure.align_ylabels(panels)
        add_legend(figure, handles, [name for *_, name in drives])
        return figure


def envelope(
    time: NDArray[np.float64], values: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Return times with the least and the largest value about each; the same where few."""
    if len(time) <= 2 * COLUMNS:
        return time, values, values
    first = np.linspace(0, len(time), COLUMNS, endpoint=False).astype(int)
    return (
        time[first],
        np.minimum.reduceat(values, first),
        np.maximum.reduceat(values, first),
    )

# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Plots of stitched tracks, of their learning, and of predictions on held-out samples."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from fuzzycnc_ros.studies.page.drawing import (
    ACCENT,
    CLUSTER_COLOURS,
    FAINT,
    MUTED,
    SECOND,
    add_legend,
    new_figure,
    panel_grid,
    plot_style,
)

if TYPE_CHECKING:
    from fuzzycnc_ros.core.arrays import Array
    from fuzzycnc_ros.simulation.soft.foam_tracks import TrackQuality


def plot_tracks(tracks: Mapping[str, tuple[Array, Array, Array]]) -> Any:
    """Plot tracks as they are meant, and stitched before and after compensation.

    Parameters
    ----------
    tracks : mapping
        Nominal points, stitches without and with compensation, each of shape (n + 1, 2) [m], by
        the title of the panel.
    """
    with plot_style():
        figure, panels = panel_grid(len(tracks), columns=min(2, len(tracks)), height=2.9)
        handles: list[Any] = []
        for axes, (title, (nominal, before, after)) in zip(panels, tracks.items(), strict=True):
            handles = [
                axes.plot(*(1e3 * nominal.T), color=MUTED, linewidth=0.9)[0],
                axes.plot(*(1e3 * before.T), 'o', color=SECOND, markersize=1.8)[0],
                axes.plot(*(1e3 * after.T), 'o', color=ACCENT, markersize=1.8)[0],
            ]
            axes.set_aspect('equal', adjustable='datalim')
            axes.set_title(title)
            axes.set_xlabel('X [mm]')
        for axes in panels[::2]:
            axes.set_ylabel('Y [mm]')
        add_legend(figure, handles, ['nominal', 'stitched before', 'stitched after'])
        return figure


def plot_deviation(way: Mapping[str, Array], deviation: Mapping[str, Mapping[str, Array]]) -> Any:
    """Plot how far stitches lie from their places along the track.

    Parameters
    ----------
    way : mapping
        Way along the nominal track [m], by the title of the panel.
    deviation : mapping
        Distances [m] by title and method.
    """
    with plot_style():
        figure, panels = panel_grid(len(way), columns=min(2, len(way)), height=2.3)
        handles: dict[str, Any] = {}
        for axes, (title, place) in zip(panels, way.items(), strict=True):
            for number, (name, distance) in enumerate(deviation[title].items()):
                (handles[name],) = axes.plot(
                    1e3 * place, 1e3 * distance, color=CLUSTER_COLOURS[number], linewidth=1.2
                )
            axes.set_ylim(bottom=0.0)
            axes.set_title(title)
            axes.set_xlabel('way along the track [mm]')
        for axes in panels[::2]:
            axes.set_ylabel('distance from\nits place [mm]')
        add_legend(figure, list(handles.values()), list(handles))
        return figure


def plot_learning(courses: Mapping[str, Mapping[str, Sequence[TrackQuality]]]) -> Any:
    """Plot the angle error over the cycles of learning.

    Parameters
    ----------
    courses : mapping
        Qualities before each cycle and after the last one, by what learning began with and by
        the track.
    """
    with plot_style():
        figure = new_figure(2.8)
        panels = list(figure.subplots(1, len(courses), sharey=True, squeeze=False).flat)
        handles: dict[str, Any] = {}
        for axes, (title, tracks) in zip(panels, courses.items(), strict=True):
            for number, (name, course) in enumerate(tracks.items()):
                errors = [float(np.degrees(quality.angle_error)) for quality in course]
                (handles[name],) = axes.plot(
                    errors, 'o-', color=CLUSTER_COLOURS[number], markersize=3.0
                )
            axes.set_title(title)
            axes.set_xlabel('cycles of learning')
            axes.set_xticks(range(len(course)))
            axes.set_ylim(bottom=0.0)
        panels[0].set_ylabel('angle error [deg]')
        add_legend(figure, list(handles.values()), list(handles))
        return figure


def plot_predictions(needed: Array, predicted: Array) -> Any:
    """Plot predicted over needed compensations, shape (k, 2) [mm per 50 mm], held out."""
    with plot_style():
        figure = new_figure(3.2)
        panels = figure.subplots(1, 2)
        for number, (axes, name) in enumerate(zip(panels, 'XY', strict=True)):
            both = np.concatenate([needed[:, number], predicted[:, number]])
            ends = [float(both.min()), float(both.max())]
            axes.plot(ends, ends, color=FAINT, linewidth=0.8)
            axes.plot(needed[:, number], predicted[:, number], 'o', color=ACCENT, markersize=2.4)
            axes.set_title(name)
            axes.set_xlabel('needed [mm per 50 mm]')
        panels[0].set_ylabel('predicted\n[mm per 50 mm]')
        return figure

# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Residuals on held-out runs against the number of sensors: tables, figures, a page."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from fuzzycnc_ros.studies.page.html import Figure, Page, Section
from fuzzycnc_ros.studies.page.table import Column, Table, tied
from fuzzycnc_ros.studies.thermal.comparison_page import sensor_counts_chart
from fuzzycnc_ros.studies.thermal.summary import micrometres

if TYPE_CHECKING:
    from fuzzycnc_ros.core.thermal.fit import SensorCount


@dataclass(frozen=True, eq=False)
class HeldOutCurve:
    """The curve on one held-out run.

    Parameters
    ----------
    run : str
        Name of the run.
    points : sequence of SensorCount
        One entry per number of sensors.
    """

    run: str
    points: 'Sequence[SensorCount]'


@dataclass(frozen=True, eq=False)
class SensorCurves:
    """The curves on all held-out runs.

    Parameters
    ----------
    count : tuple of int, length k
        Numbers of sensors, increasing.
    channel : tuple of str, length c
        Channels.
    held_out : sequence of HeldOutCurve
        One curve per held-out run.
    """

    count: tuple[int, ...]
    channel: tuple[str, ...]
    held_out: Sequence[HeldOutCurve]

    def mean(self) -> NDArray[np.float64]:
        """Return the rms residual, mean over the runs, shape (k, c) [m]."""
        return np.asarray(self._rms().mean(axis=0))

    def worst(self) -> NDArray[np.float64]:
        """Return the rms residual on the worst of the runs, shape (k, c) [m]."""
        return np.asarray(self._rms().max(axis=0))

    def largest(self) -> NDArray[np.float64]:
        """Return the largest residual on any run, shape (k, c) [m]."""
        values = [[point.largest for point in item.points] for item in self.held_out]
        return np.asarray(np.max(values, axis=0))

    def _rms(self) -> NDArray[np.float64]:
        return np.array([[point.rms for point in item.points] for item in self.held_out])


def sensor_curve_table(curves: SensorCurves) -> Table:
    """Return mean and worst rms and the largest residual of each number of sensors."""
    columns = [Column('Sensors')]
    for name in curves.channel:
        columns += [Column(heading, name) for heading in ('mean', 'worst', 'max')]
    figures = np.stack([curves.mean(), curves.worst(), curves.largest()], axis=2)
    rows = tuple(
        (str(count), *(micrometres(float(value)) for value in figures[row].ravel()))
        for row, count in enumerate(curves.count)
    )
    # Every figure is compared with its like, of the same channel.
    best = np.argmin(figures, axis=0).ravel()
    strong = {
        (row, column)
        for column, least in enumerate(best, start=1)
        for row in tied({row: cells[column] for row, cells in enumerate(rows)}, [int(least)])
    }
    title = 'Held-out runs: rms, mean and worst of them, and largest residual [µm]'
    return Table(title, tuple(columns), rows, frozenset(strong))


def clusters_line(curves: SensorCurves) -> str:
    """Return the number of sensors with the least mean rms over all channels, as an option."""
    count = curves.count[int(np.argmin(curves.mean().sum(axis=1)))]
    return f'least mean rms: {count} sensors; fuzzycnc train --clusters {count} takes so many'


def sensor_curve_document(curves: SensorCurves) -> dict[str, Any]:
    """Return all figures.

    Returns
    -------
    dict
        `held_out`: run -> number of sensors -> `sensors` and `figures`, channel -> `rms_um` and
        `max_um`; `over_runs`: number of sensors -> channel -> `mean_rms_um`, `worst_rms_um` and
        `max_um`.
    """
    mean, worst, largest = 1e6 * curves.mean(), 1e6 * curves.worst(), 1e6 * curves.largest()
    return {
        'counts': list(curves.count),
        'held_out': {
            item.run: {
                str(point.count): {
                    'sensors': list(point.chosen),
                    'figures': {
                        name: {
                            'rms_um': 1e6 * float(point.rms[c]),
                            'max_um': 1e6 * float(point.largest[c]),
                        }
                        for c, name in enumerate(curves.channel)
                    },
                }
                for point in item.points
            }
            for item in curves.held_out
        },
        'over_runs': {
            str(count): {
                name: {
                    'mean_rms_um': float(mean[k, c]),
                    'worst_rms_um': float(worst[k, c]),
                    'max_um': float(largest[k, c]),
                }
                for c, name in enumerate(curves.channel)
            }
            for k, count in enumerate(curves.count)
        },
    }


def sensor_curve_page(
    curves: SensorCurves, facts: Mapping[str, str], remarks: Sequence[str] = ()
) -> Page:
    """Return the page of the curves."""
    runs = ', '.join(item.run for item in curves.held_out)
    plot = sensor_counts_chart(
        curves.count, curves.channel, curves.mean(), curves.worst(), curves.largest()
    )
    figure = Figure(
        'How many sensors are worth having',
        'Residual of the stable grey model on runs that it was not trained on, against the number '
        'of sensors that it reads. Where the curve turns flat, more sensors add cost and failures '
        'but no accuracy.',
        plot,
    )
    return Page(
        title='How many sensors a machine needs',
        summary=f'Judged on {runs}, each held out. The sensors are clustered; the best ranked '
        'one of each cluster is an input of the stable grey model.',
        sections=[
            Section(
                'Residual against the number of sensors',
                tables=[sensor_curve_table(curves)],
                remarks=remarks,
                figures=[figure],
            )
        ],
        facts={'Judged': f'{runs}, each held out', **facts},
    )

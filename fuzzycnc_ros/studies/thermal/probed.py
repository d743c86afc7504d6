# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""What probing now and then leaves of a run, with the model and without: tables and plots."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from fuzzycnc_ros.studies.page.drawing import (
    ACCENT,
    FAINT,
    MUTED,
    SECOND,
    add_legend,
    panel_grid,
    plot_style,
    time_axis,
)
from fuzzycnc_ros.studies.page.html import Figure, Section
from fuzzycnc_ros.studies.page.table import Table
from fuzzycnc_ros.studies.thermal.comparison import LEFT, residual_document, residual_table
from fuzzycnc_ros.studies.thermal.many_runs import overall_document, overall_table
from fuzzycnc_ros.studies.thermal.summary import candidate_label

if TYPE_CHECKING:
    from fuzzycnc_ros.studies.thermal.probed_evaluation import ProbedEvaluation

Floats = NDArray[np.float64]
Counts = NDArray[np.int64]

_DRAWN = (('unprobed', FAINT, 0.9), ('held', SECOND, 0.9), ('kalman', ACCENT, 1.4))
"""Rows that are drawn, each with its colour and width, from the back to the front."""

RULE = (
    'Samples count once their channel has been probed, and each is judged against the probes '
    'before it.'
)
"""What counts, for whoever reads the figures."""


def probed_table(probed: Sequence[ProbedEvaluation]) -> Table:
    """Return what is left of a run in each way to use its probes, or over all of several runs."""
    first = probed[0]
    if len(probed) > 1:
        title = f'Over {len(probed)} runs, {_every(first)}: {LEFT} [µm]'
        return replace(overall_table(probed), title=title)
    return residual_table(
        f'{first.run}, {_every(first)}: {LEFT}', first.channel, first.rms, first.largest
    )


def probed_lines(probed: Sequence[ProbedEvaluation]) -> list[str]:
    """Return what else is to be said below the table, a line each."""
    lines = [RULE]
    for item in probed:
        parts = [
            f'{item.run}: {_range(item.samples)} samples, {_range(item.probes)} probes a channel'
        ]
        parts += [
            f'{int(count.sum())} of them doubted ({candidate_label(name)})'
            for name, count in item.doubted.items()
            if count.any()
        ]
        beaten = _no_better_than_held(item)
        if beaten:
            parts.append(f'on {", ".join(beaten)} the last probe, held, does as well alone')
        lines.append('; '.join(parts))
    return lines


def probed_document(probed: Sequence[ProbedEvaluation]) -> dict[str, Any]:
    """Return all figures of probed runs.

    Returns
    -------
    dict
        `every_s`; `runs`: run -> row -> channel -> `rms_um` and `max_um`; `overall`: row ->
        channel -> median and worst of both; `samples`, `probes`: run -> channel -> number;
        `doubted`: run -> row -> channel -> number.
    """
    return {
        'every_s': probed[0].every,
        'runs': {
            item.run: residual_document(item.channel, item.rms, item.largest) for item in probed
        },
        'overall': overall_document(probed),
        'samples': {item.run: _by_channel(item, item.samples) for item in probed},
        'probes': {item.run: _by_channel(item, item.probes) for item in probed},
        'doubted': {
            item.run: {name: _by_channel(item, count) for name, count in item.doubted.items()}
            for item in probed
        },
    }


def probed_section(item: ProbedEvaluation) -> Section:
    """Return a section on a probed run, for a page."""
    return Section(
        f'Run {item.run}, {_every(item)}',
        tables=(probed_table([item]),),
        remarks=probed_lines([item]),
        figures=(
            Figure(
                f'{item.run}: error that is left, {_every(item)}',
                'What the model adds to probing is the distance between the line of the last '
                'probe, held without any model, and that of the model corrected by the same '
                'probes.',
                plot_probed(item),
            ),
        ),
    )


def plot_probed(item: ProbedEvaluation) -> Any:
    """Plot what is left unprobed, with the last probe held, and with the corrected model."""
    with plot_style():
        count = len(item.channel)
        figure, panels = panel_grid(count, columns=min(2, count), height=2.6)
        x, x_label = time_axis(item.time)
        for c, (axes, channel) in enumerate(zip(panels, item.channel, strict=True)):
            axes.axhline(0.0, color=MUTED, linewidth=0.7)
            for name, colour, width in _DRAWN:
                left = 1e6 * item.residual[name][:, c]
                label = candidate_label(name)
                axes.plot(x, left, color=colour, linewidth=width, label=label)
            axes.set_title(channel)
            axes.set_xlim(x[0], x[-1])
            axes.set_xlabel(x_label)
            axes.set_ylabel('thermal error [µm]')
        add_legend(figure, *panels[0].get_legend_handles_labels())
        return figure


def _no_better_than_held(item: ProbedEvaluation) -> list[str]:
    """Return the channels on which probes say as much without the model as with it."""
    with_model = np.fmin(item.rms['offset'], item.rms['kalman'])
    worse = with_model >= item.rms['held']
    return [name for name, beaten in zip(item.channel, worse, strict=True) if beaten]


def _every(item: ProbedEvaluation) -> str:
    return f'probed every {item.every / 60.0:g} min'


def _range(count: Counts) -> str:
    """Return the numbers of the channels as one, or from the least to the most."""
    low, high = int(count.min()), int(count.max())
    return str(low) if low == high else f'{low} to {high}'


def _by_channel(item: ProbedEvaluation, count: Counts) -> dict[str, int]:
    return {name: int(number) for name, number in zip(item.channel, count, strict=True)}

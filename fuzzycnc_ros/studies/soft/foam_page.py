# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Tables, documents and pages on soft material: tracks, learning, trainings."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from fuzzycnc_ros.studies.page.chart import Axis, Chart, Panel, Series
from fuzzycnc_ros.studies.page.drawing import (
    AFTER,
    ANOTHER,
    BEFORE,
    CLUSTER_COLOURS,
    FAINT,
    MUTED,
    OTHER,
)
from fuzzycnc_ros.studies.page.html import Figure, Page, Section
from fuzzycnc_ros.studies.page.table import Column, Table, case_table
from fuzzycnc_ros.studies.soft.foam_comparison import (
    METHODS,
    NONE,
    NTS,
    PUBLISHED,
    PUBLISHED_MEANS,
    STS,
)

if TYPE_CHECKING:
    from collections.abc import Sequence

    from fuzzycnc_ros.core.arrays import Array
    from fuzzycnc_ros.simulation.soft.foam_tracks import TrackQuality
    from fuzzycnc_ros.studies.soft.foam_comparison import FoamComparison, TrackFigures
    from fuzzycnc_ros.studies.soft.foam_training import FoamTraining

_COLOURS = {
    METHODS[NONE]: BEFORE,
    METHODS[STS]: OTHER,
    METHODS[NTS]: AFTER,
    METHODS[PUBLISHED]: ANOTHER,
}

_STARTS = {NONE: 'from nothing', NTS: 'from the model (NTS)'}


def tracks_table(found: FoamComparison) -> Table:
    """Return the qualities of all tracks under all methods."""

    def length(figure: str) -> Callable[..., str]:
        return lambda track, name, figures: f'{1e3 * getattr(figures.mean, figure):.3f}'

    def angle(track: Any, name: str, figures: Any) -> str:
        mean, spread = np.degrees(figures.mean.angle_error), np.degrees(figures.angle_spread)
        return f'{mean:.2f} ± {spread:.2f}'

    return case_table(
        f'Stitched tracks, means of {found.runs} runs; time of a side at constant feed',
        ((track, *item) for track in found.tracks for item in track.methods.items()),
        {
            Column('Track', numeric=False): lambda track, name, _: (
                track.title if name == NONE else ''
            ),
            Column('compensation', numeric=False): lambda track, name, _: METHODS[name],
            Column('angle error [°]'): angle,
            Column('straightness [mm]'): length('straightness'),
            Column('closure gap [mm]'): length('closure_gap'),
            Column('rms [mm]', 'deviation'): length('rms_deviation'),
            Column('max [mm]', 'deviation'): length('max_deviation'),
            Column('time [s]'): lambda track, name, figures: f'{figures.mean.time:.2f}',
            Column('refused [%]'): lambda track, name, figures: (
                f'{100.0 * figures.refused / (len(track.nominal) - 1):.0f}'
            ),
        },
    )


def published_table(found: FoamComparison) -> Table:
    """Return the published averages beside those of the first track."""
    columns = (
        Column('Compensation', numeric=False),
        *(
            Column(heading, group)
            for group in ('angle error [°]', 'straightness [mm]', 'time [s]')
            for heading in ('published', 'here')
        ),
    )
    first = found.tracks[0]
    rows = []
    for name, figures in first.methods.items():
        mean = figures.mean
        here = (
            f'{np.degrees(mean.angle_error):.2f}',
            f'{1e3 * mean.straightness:.2f}',
            f'{mean.time:.2f}',
        )
        known = PUBLISHED_MEANS.get(name)
        printed = ('-',) * len(here) if known is None else tuple(f'{v:.2f}' for v in known)
        cells = [cell for pair in zip(printed, here, strict=True) for cell in pair]
        rows.append((METHODS[name], *cells))
    return Table(
        f'Published averages beside those of the track {first.title}', columns, tuple(rows)
    )


def learning_table(found: FoamComparison) -> Table:
    """Return the angle errors over the cycles of learning."""
    cycles = range(len(next(iter(found.tracks[0].learning.values()))))
    columns = (
        Column('Track', numeric=False),
        Column('learning', numeric=False),
        *(Column(str(cycle), 'angle error [°] after cycle') for cycle in cycles),
        Column('max deviation [mm]', 'last'),
    )
    rows = []
    for track in found.tracks:
        for number, (name, course) in enumerate(track.learning.items()):
            errors = (f'{np.degrees(quality.angle_error):.2f}' for quality in course)
            last = f'{1e3 * course[-1].max_deviation:.2f}'
            rows.append((track.title if number == 0 else '', _STARTS[name], *errors, last))
    return Table(
        f'Learning from recorded runs, one in a cycle; means of {found.runs} courses',
        columns,
        tuple(rows),
    )


def comparison_remarks(found: FoamComparison) -> list[str]:
    """Return what the default compensation takes away on each track, in words."""
    lines = []
    for track in found.tracks:
        before, after = track.methods[NONE].mean, track.methods[NTS].mean
        cut = [
            f'{name} {100.0 * (1.0 - getattr(after, field) / getattr(before, field)):.0f} %'
            for name, field in (
                ('angle error', 'angle_error'),
                ('straightness', 'straightness'),
                ('max deviation', 'max_deviation'),
            )
        ]
        lines.append(f'{track.title}: the default takes away {", ".join(cut)}')
    return lines


def comparison_page(found: FoamComparison, facts: Mapping[str, str]) -> Page:
    """Return the page of a comparison."""
    shown = {track.title: track for track in found.tracks}
    sections = [
        Section(
            'Tracks',
            tables=[tracks_table(found)],
            remarks=comparison_remarks(found),
            figures=[
                Figure(
                    'Nominal, stitched before and stitched after',
                    'The first run of each track without compensation, and with the default one. '
                    'The relaxed sheet shows what was dragged along: sides lean, and the figure '
                    'does not close.',
                    tracks_chart(
                        {
                            name: (
                                track.nominal,
                                track.methods[NONE].stitched,
                                track.methods[NTS].stitched,
                            )
                            for name, track in shown.items()
                        }
                    ),
                ),
                Figure(
                    'Distance of the stitches from their places',
                    'First runs. Offsets that pile up along the track as published straighten '
                    'the angles and carry the figure away; offsets that fade, as the drift does, '
                    'keep it in its place.',
                    deviation_chart(
                        {name: _way(track) for name, track in shown.items()},
                        {name: _deviations(track) for name, track in shown.items()},
                        _COLOURS,
                    ),
                ),
            ],
        ),
        Section(
            'Published averages',
            ['The sheet is a model that was tuned to the published means without compensation; '
             'its track has their angle, and dimensions of its own. So the first row says '
             'nothing, the others do.'],
            tables=[published_table(found)],
        ),
        Section(
            'Learning from recorded runs',
            tables=[learning_table(found)],
            figures=[
                Figure(
                    'Angle error over the cycles',
                    'Each cycle takes 70\u00a0% of the deviations of one recorded run into the '
                    'offsets.',
                    learning_chart(
                        {
                            title: {name: t.learning[start] for name, t in shown.items()}
                            for start, title in _STARTS.items()
                        }
                    ),
                )
            ],
        ),
    ]  # fmt: skip
    return Page(
        title='Patterns on soft material, straightened beforehand',
        summary='The presser foot drags the sheet along, and the pattern is off once the sheet '
        'relaxes. A T-S fuzzy neural network learns from samples how far; the path is shifted by '
        'that much beforehand.',
        sections=sections,
        facts={
            'Machine': 'simulated foam sheets',
            'Judged': f'all stitches of {found.runs} runs of each track',
            **facts,
        },
    )


def training_table(found: FoamTraining) -> Table:
    """Return held-out errors by thickness."""
    thicknesses = list(found.errors[0].by_thickness)
    columns = (
        Column('Model', numeric=False),
        Column('all'),
        *(Column(f'{1e3 * thickness:g} mm thick') for thickness in thicknesses),
    )
    rows = [
        (
            f'{item.name}, in use' if place == found.used else item.name,
            f'{item.rms:.3f}',
            *(f'{item.by_thickness[t]:.3f}' for t in thicknesses),
        )
        for place, item in enumerate(found.errors)
    ]
    title = (
        f'Error on held-out samples, rms of both axes [mm per 50 mm]; {found.folds} parts, '
        f'{found.groups} groups'
    )
    return Table(
        title, columns, tuple(rows), highlight=frozenset({found.used}), highlight_means='in use'
    )


def coverage_table(found: FoamTraining) -> Table:
    """Return what the samples cover."""
    return case_table(
        'What the samples cover',
        zip(found.coverage),
        {
            Column('thickness [mm]'): lambda item: f'{1e3 * item.thickness:g}',
            Column('lines'): lambda item: str(item.lines),
            Column('arcs'): lambda item: str(item.arcs),
            Column('direction [°]'): lambda item: _range(*np.degrees(item.direction)),
            Column('depth [mm]'): lambda item: _range(*(1e3 * end for end in item.depth)),
            Column('depth / thickness'): lambda item: _range(
                *(end / item.thickness for end in item.depth)
            ),
            Column('step [mm]'): lambda item: _range(*(1e3 * end for end in item.step)),
        },
    )


def training_document(found: FoamTraining) -> dict[str, Any]:
    """Return errors [m per m of feed], and what the samples cover, in SI."""
    per_feed = 1e-3 / 50e-3
    return {
        'folds': found.folds,
        'groups': found.groups,
        'coverage': found.coverage,
        'errors': {
            item.name: {
                'rms': per_feed * item.rms,
                'by_thickness': {f'{t:g}': per_feed * e for t, e in item.by_thickness.items()},
            }
            for item in found.errors
        },
    }


def training_page(found: FoamTraining, lines: Sequence[str], facts: Mapping[str, str]) -> Page:
    """Return the page of a training."""
    used = found.errors[found.used]
    return Page(
        title='Model of feed compensation',
        summary=f'{used.name}: {used.rms:.3f} mm per 50 mm of feed on samples that it was not '
        'trained on.',
        sections=[
            Section('Samples', tables=[coverage_table(found)], remarks=lines),
            Section(
                'Held-out samples',
                tables=[training_table(found)],
                figures=[
                    Figure(
                        'Predicted over needed compensation',
                        'Each sample predicted by a model that was trained without its group.',
                        predictions_chart(found.needed, used.predicted),
                    )
                ],
            ),
        ],
        facts={
            'Judged': f'{len(found.needed)} samples, each held out once',
            **facts,
        },
    )


def _way(track: TrackFigures) -> Any:
    return np.append(0.0, np.cumsum(np.hypot(*np.diff(track.nominal, axis=0).T)))


def _deviations(track: TrackFigures) -> dict[str, Any]:
    return {
        METHODS[name]: np.hypot(*(figures.stitched - track.nominal).T)
        for name, figures in track.methods.items()
    }


def _range(low: float, high: float) -> str:
    return f'{low:.3g}' if low == high else f'{low:.3g} to {high:.3g}'


def tracks_chart(tracks: Mapping[str, tuple[Array, Array, Array]]) -> Chart:
    """Declare tracks as they are meant, and stitched before and after compensation.

    Parameters
    ----------
    tracks : mapping
        Nominal points, stitches without and with compensation, each of shape (n + 1, 2) [m], by
        the title of the panel.
    """
    panels = [
        Panel(
            np.empty(0),
            Axis('Y', 'mm'),
            [
                Series('nominal', 1e3 * nominal[:, 1], MUTED, 0.9, x=1e3 * nominal[:, 0]),
                *(
                    Series(name, 1e3 * place[:, 1], colour, kind='dots', x=1e3 * place[:, 0])
                    for name, place, colour in (
                        ('stitched before', before, BEFORE),
                        ('stitched after', after, AFTER),
                    )
                ),
            ],
            title,
            plane=1.0,
        )
        for title, (nominal, before, after) in tracks.items()
    ]
    return Chart(Axis('X', 'mm'), panels, columns=min(2, len(panels)), height=3.4)


def deviation_chart(
    way: Mapping[str, Array],
    deviation: Mapping[str, Mapping[str, Array]],
    colours: Mapping[str, str],
) -> Chart:
    """Declare how far stitches lie from their places along the track.

    Parameters
    ----------
    way : mapping
        Way along the nominal track [m], by the title of the panel.
    deviation : mapping
        Distances [m] by title and method.
    colours : mapping
        Colour of each method.
    """
    panels = [
        Panel(
            1e3 * place,
            Axis('distance from its place', 'mm', low=0.0),
            [
                Series(name, 1e3 * distance, colours[name], 1.2)
                for name, distance in deviation[title].items()
            ],
            title,
        )
        for title, place in way.items()
    ]
    columns = min(2, len(panels))
    return Chart(Axis('way along the track', 'mm'), panels, columns=columns, height=2.3)


def learning_chart(courses: Mapping[str, Mapping[str, Sequence[TrackQuality]]]) -> Chart:
    """Declare the angle error over the cycles of learning.

    Parameters
    ----------
    courses : mapping
        Qualities before each cycle and after the last one, by what learning began with and by
        the track.
    """
    top = max(
        float(np.degrees(quality.angle_error))
        for tracks in courses.values()
        for course in tracks.values()
        for quality in course
    )
    panels, cycles = [], np.empty(0)
    for title, tracks in courses.items():
        cycles = np.arange(len(next(iter(tracks.values()))), dtype=np.float64)
        series = [
            Series(
                name,
                np.degrees([quality.angle_error for quality in course]),
                CLUSTER_COLOURS[number],
                kind='both',
            )
            for number, (name, course) in enumerate(tracks.items())
        ]
        axis = Axis('angle error', '°', low=0.0, high=1.08 * top)
        panels.append(Panel(cycles, axis, series, title))
    x_axis = Axis('cycles of learning', ticks=tuple(cycles))
    return Chart(x_axis, panels, columns=len(panels), height=2.5)


def predictions_chart(needed: Array, predicted: Array) -> Chart:
    """Declare predicted over needed compensations, shape (k, 2) [mm per 50 mm], held out."""
    unit = 'mm per 50 mm'
    panels = []
    for number, name in enumerate('XY'):
        order = np.argsort(needed[:, number], kind='stable')
        x, y = needed[order, number], predicted[order, number]
        ends = np.array([min(x[0], y.min()), max(x[-1], y.max())])
        series = [
            Series('predicted as needed', ends, FAINT, 0.8, x=ends),
            Series('predicted', y, AFTER, kind='dots'),
        ]
        panels.append(Panel(x, Axis('predicted', unit), series, name))
    return Chart(Axis('needed', unit), panels, columns=2, height=3.0)

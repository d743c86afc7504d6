# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Page on a track that was stitched on soft material, without compensation and with it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING

import numpy as np

from fuzzycnc_ros.studies.page import drawing
from fuzzycnc_ros.studies.page.html import Figure, Page, Section
from fuzzycnc_ros.studies.page.table import Column, Table, case_table
from fuzzycnc_ros.studies.soft.foam_comparison import NONE, PUBLISHED, PUBLISHED_MEANS
from fuzzycnc_ros.studies.soft.foam_page import deviation_chart, tracks_chart

if TYPE_CHECKING:
    from fuzzycnc_ros.studies.soft.pattern import StitchedPattern


BEFORE, TRAINED, AFTER = 'before', 'trained', 'after'
"""Runs of a track by name: without compensation, by a model as it was trained where gains were
fitted to the run before, and compensated."""

PUBLISHED_OF = {BEFORE: PUBLISHED_MEANS[NONE], AFTER: PUBLISHED_MEANS[PUBLISHED]}
"""Published averages beside each: angle error [deg], straightness [mm], time of a side [s]."""

_COLOURS = {BEFORE: drawing.BEFORE, TRAINED: drawing.OTHER, AFTER: drawing.AFTER}

_RUNS = {BEFORE: 'no compensation', TRAINED: 'model as trained', AFTER: 'compensated'}


def pattern_table(runs: Mapping[str, StitchedPattern]) -> Table:
    """Return the figures of a track beside the published averages.

    Parameters
    ----------
    runs : mapping
        The track by `BEFORE` and `AFTER`, and `TRAINED` if there is one.
    """

    def published(place: int) -> Callable[..., str]:
        return lambda name, found: (
            f'{PUBLISHED_OF[name][place]:.2f}' if name in PUBLISHED_OF else '-'
        )

    def millimetres(figure: str) -> Callable[..., str]:
        return lambda name, found: f'{1e3 * getattr(found, figure):.2f}'

    angle, straightness, time = 'angle error [°]', 'straightness [mm]', 'time of a side [s]'
    return case_table(
        'One run on the simulated sheet, beside the published averages',
        ((name, run.quality()) for name, run in runs.items()),
        {
            Column('Track', numeric=False): lambda name, found: _RUNS[name],
            Column('here', angle): lambda name, found: f'{np.degrees(found.angle_error):.2f}',
            Column('published', angle): published(0),
            Column('here', straightness): lambda name, found: f'{1e3 * found.straightness:.3f}',
            Column('published', straightness): published(1),
            Column('here', time): lambda name, found: f'{found.time:.2f}',
            Column('published', time): published(2),
            Column('closure gap [mm]'): millimetres('closure_gap'),
            Column('rms [mm]', 'deviation'): millimetres('rms_deviation'),
            Column('max [mm]', 'deviation'): millimetres('max_deviation'),
        },
    )


def pattern_page(runs: Mapping[str, StitchedPattern], facts: Mapping[str, str]) -> Page:
    """Return the page on a track that was stitched twice.

    Parameters
    ----------
    runs : mapping
        As for `pattern_table`.
    facts : mapping of str to str
        Provenance.
    """
    before, after = runs[BEFORE], runs[AFTER]
    name = after.name
    way = np.append(0.0, np.cumsum(np.hypot(*np.diff(after.nominal, axis=0).T)))
    section = Section(
        'What the compensation does',
        texts=(
            'Both runs draw the same stiffness, friction and noise. The time of a side is taken '
            'from its stitches and holds the rest at its corner; the compensated path is longer, '
            'and so takes longer at the same feed.',
            'The published figures are averages of 11 runs on a real machine, on a track of '
            'unknown size. The simulated sheet was tuned so that its figures without compensation '
            'are the published ones; those with compensation follow from the method alone. '
            'Ours are better because the offsets fade along the path as the sheet does. '
            'Straightness alone hides most of that: deviation and closure gap show it.',
        ),
        tables=(pattern_table(runs),),
        figures=(
            Figure(
                'The track',
                'Where the stitches are to lie, and where they lie once the sheet has relaxed.',
                tracks_chart({name: (after.nominal, before.stitched, after.stitched)}),
            ),
            Figure(
                'Deviation along the track',
                'Distance of each stitch from its nominal place.',
                deviation_chart(
                    {name: way},
                    {name: {_RUNS[key]: run.deviation for key, run in runs.items()}},
                    {_RUNS[key]: colour for key, colour in _COLOURS.items()},
                ),
            ),
        ),
    )
    return Page(
        title='A pattern on soft material',
        summary='A parallelogram, stitched live over DDS on the simulated foam sheet: as drawn, '
        'and shifted beforehand by what a T-S fuzzy neural network expects the sheet to do.',
        sections=(section,),
        facts={
            'Machine': 'simulated foam sheet',
            'Judged': f'all stitches of {name}, once the sheet has relaxed',
            **facts,
        },
    )

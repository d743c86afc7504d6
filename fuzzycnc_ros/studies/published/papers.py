# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Figures of five papers beside those of the same methods on the simulated machines here."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from fuzzycnc_ros.core.servo.rule_table import published_rules
from fuzzycnc_ros.studies.grinder.grinder_comparison import (
    ResidualSize,
    compare_on_grinder,
    grinder_trials,
)
from fuzzycnc_ros.studies.grinder.grinder_rivals import RIVALS
from fuzzycnc_ros.studies.page.table import Column, Table, case_table
from fuzzycnc_ros.studies.published.contouring_rows import ROWS
from fuzzycnc_ros.studies.published.mill_residuals import MillResiduals
from fuzzycnc_ros.studies.servo.servo_cases import FRICTION_CASE, compare_controllers
from fuzzycnc_ros.studies.soft.foam_comparison import compare_foam
from fuzzycnc_ros.studies.soft.foam_page import published_table

Tell = Callable[[str, int, int], None]
Cells = tuple[str, ...]

MILL_PUBLISHED = {
    'uncompensated': (41.5, 33.8),
    'least_squares': (9.2, 8.6),
    'classical': (4.8, 4.6),
}
"""Largest residuals of Y and Z [um] as [ding_zeng] prints them."""

GRINDER_PUBLISHED = {
    'arma': ((5.0, 7.4), (4.9, 7.9), (4.2, 6.9), (2.6, 4.7)),
    'dynamic_network': ((3.4, 4.8), (3.0, 5.1), (3.9, 6.1), (2.2, 4.0)),
    'linear_network': ((3.5, 5.1), (2.6, 3.9), (2.8, 4.6), (1.5, 3.2)),
    'hybrid_network': ((2.4, 3.9), (1.9, 3.5), (1.9, 3.8), (1.1, 2.4)),
}
"""Root mean square and largest residuals [um] of E2 Y, E2 Z, E3 Y, E3 Z, table 2 of [kang2007]."""

GRINDER_COLUMNS = ('E2 Y', 'E2 Z', 'E3 Y', 'E3 Z')
GRINDER_TRIAL = 'one_run_machine_sensors'
GRINDER_SEEDS = 5
"""Seeds of noise and networks whose median counts."""

EXAMPLE = (-0.25, 0.12, 0.722)
"""Error, its rate and last duty of the worked example of [long2014], as shares of their ranges."""

SERVO_PUBLISHED = {'example': '0.4998', '-50 smooth': 'about 1.0 s', '-170 smooth': 'about 1.25 s'}
"""Duty and settling times as [long2014] prints or draws them."""


@dataclass(frozen=True)
class Paper:
    """A paper and how its figures are computed here.

    Parameters
    ----------
    key : str
        Name in the bibliography.
    title : str
        What it is about.
    page : str
        Its page in docs/explanation/methods.
    text : str
        What reproduces and what does not.
    compute : callable
        Told of progress; returns the table.
    """

    key: str
    title: str
    page: str
    text: str
    compute: Callable[[Tell], Table]


def grey_table(tell: Tell) -> Table:
    """Return the largest residuals on the mill, for [ding_zeng]."""
    tell('recording the mill', 0, 1)
    judged = MillResiduals.as_published()
    labels = {
        'uncompensated': 'no compensation',
        'least_squares': 'least squares',
        'classical': 'grey model',
        'stable': 'grey model, repaired',
    }
    rows = []
    for done, (name, label) in enumerate(labels.items()):
        tell(label, done, len(labels))
        ours = [
            judged.uncompensated(run) if name == 'uncompensated' else judged.median(name, run)
            for run in ('D0', 'T2')
        ]
        printed = MILL_PUBLISHED.get(name, ('-', '-'))
        rows.append((label, *map(str, printed), *(f'{v:.1f}' for v in np.ravel(ours))))
    return Table(
        'Largest residual [µm]',
        (
            Column('Model', numeric=False),
            *(
                Column(axis, group)
                for group in ('published', 'here, samples fitted', 'here, unseen duty')
                for axis in 'YZ'
            ),
        ),
        tuple(rows),
    )


def grinder_scores(seeds: int = GRINDER_SEEDS) -> Mapping[str, list[ResidualSize]]:
    """Return the median scores of the models of [kang2007] in `GRINDER_COLUMNS`."""
    rivals = [rival for rival in RIVALS if rival.name in GRINDER_PUBLISHED]
    found = []
    for seed in range(seeds):
        trials = [trial for trial in grinder_trials(seed) if trial.name == GRINDER_TRIAL]
        found.append(compare_on_grinder(seed=seed, rivals=rivals, trials=trials))
    return {
        name: [
            ResidualSize(*np.median([
                (score.rms, score.largest)
                for score in (one.score(GRINDER_TRIAL, name, column) for one in found)
            ], axis=0).tolist())
            for column in GRINDER_COLUMNS
        ]
        for name in GRINDER_PUBLISHED
    }  # fmt: skip


def network_table(tell: Tell) -> Table:
    """Return the residuals on unseen experiments of the grinder, for [kang2007]."""
    tell('training networks', 0, 1)
    scores = grinder_scores()
    labels = {
        'arma': 'ARMA',
        'dynamic_network': 'FNN',
        'linear_network': 'LR/NN',
        'hybrid_network': 'hybrid',
    }
    rows: list[Cells] = []
    for name, label in labels.items():
        printed = [f'{rms:.1f} ({largest:.1f})' for rms, largest in GRINDER_PUBLISHED[name]]
        ours = [f'{1e6 * one.rms:.2f} ({1e6 * one.largest:.1f})' for one in scores[name]]
        rows += [(label, 'published', *printed), (label, 'here', *ours)]
    return Table(
        'Residual, RMS (largest) [µm], trained on E1',
        (
            Column('Model', numeric=False),
            Column('', numeric=False),
            *(Column(name) for name in GRINDER_COLUMNS),
        ),
        tuple(rows),
    )


def feedrate_table(tell: Tell) -> Table:
    """Return tables 10 to 12 of [lin2021] and the same rules at the same feeds."""
    cases = []
    for done, row in enumerate(ROWS):
        tell(f'{row.shape}, {row.method}', done, len(ROWS))
        cases.append((row, row.driven()))
    return case_table(
        'Largest contour error [mm] and time [s]',
        cases,
        {
            Column('Shape', numeric=False): lambda row, run: row.shape,
            Column('Method', numeric=False): lambda row, run: row.method,
            Column('feed [mm/min]'): lambda row, run: f'{row.feed:g}',
            Column('published', 'error'): lambda row, run: f'{row.error_max:.3f}',
            Column('here', 'error'): lambda row, run: f'{1e3 * run.error_max:.5f}',
            Column('published', 'time'): lambda row, run: f'{row.duration:g}',
            Column('here', 'time'): lambda row, run: f'{run.duration:.1f}',
        },
    )


def example_duty() -> float:
    """Return the duty of the worked example of [long2014], by equations (19) and (21)."""

    def size(value: float) -> float:
        return float(abs(value) ** 0.9 + 1e-4)

    error, rate, duty = EXAMPLE
    return size(duty) * published_rules()(error / size(error), rate / size(rate))


def servo_table(tell: Tell) -> Table:
    """Return what the controller of [long2014] does on the lathe's axis, printed and default."""
    names = ('variable_universe_paper', 'variable_universe')
    figures = compare_controllers(names, moves=0, progress=tell).figures

    def settled(name: str, case: str) -> str:
        step = figures[name].steps[case]
        if np.isfinite(step.settle):
            return f'{step.settle:.3f} s'
        return f'never, {1e3 * step.steady_error:.1f} mm left'

    rows: list[Cells] = [
        ('duty of the worked example', SERVO_PUBLISHED['example'], f'{example_duty():.4f}', '-')
    ]
    for case, label in (
        ('-50 smooth', '-50 mm without friction, to 2 µm'),
        ('-170 smooth', '-170 mm without friction, to 2 µm'),
        (FRICTION_CASE, '-50 mm with friction, to 2 µm'),
    ):
        printed = SERVO_PUBLISHED.get(case, 'not said')
        rows.append((label, printed, *(settled(name, case) for name in names)))
    return Table(
        'Positioning of the axis of a lathe',
        tuple(
            Column(text, numeric=False)
            for text in ('', 'published', 'here, as printed', 'default')
        ),
        tuple(rows),
    )


def soft_table(tell: Tell) -> Table:
    """Return the averages of [deng2014] and those of the same track on the simulated sheet."""
    return published_table(compare_foam(progress=tell))


PAPERS = (
    Paper(
        'ding_zeng',
        'Thermal error of a milling machine by fuzzy clustering and a grey model',
        'published-grey.md',
        'On the samples that were fitted nearly every model is better than the published figure, '
        'so that it says little; the grey model as printed does not reach it there. The mill was '
        'made so that its error without compensation is the published one. Largest residual, '
        'median of 12 noise seeds.',
        grey_table,
    ),
    Paper(
        'kang2007',
        'Thermal deformation of a grinder by a network with hybrid filters',
        'published-hybrid-network.md',
        'The published residuals can be reached. That the hybrid is the best model does not '
        'reproduce: linear models are level with it. Experiments that were not trained on, 28 '
        'sensors, median of five seeds.',
        network_table,
    ),
    Paper(
        'lin2021',
        'Feeds of a tool path from its curvature by fuzzy rules',
        'published-feedrate.md',
        'The times of the fuzzy method reproduce on infinity and trident. The errors cannot: at '
        '5 mm/s a servo loop leaves micrometres, so that what was cut and scanned holds '
        'alignment, tool and scanner. Parameters of the other methods are not published.',
        feedrate_table,
    ),
    Paper(
        'long2014',
        "Position control of a lathe's axis with a variable universe",
        'published-servo.md',
        'The worked example reproduces. The published curves were not made by the published '
        'equation: by it the duty fades and the axis crawls.',
        servo_table,
    ),
    Paper(
        'deng2014',
        'Feed compensation on soft material by a fuzzy neural network',
        'published-soft-material.md',
        'The angle reproduces about, the straightness does not: offsets that pile up along the '
        'path cannot bend a side. The sheet was tuned to the first row, so that row proves '
        'nothing. Means of eleven runs.',
        soft_table,
    ),
)
"""The papers, in the order of their numbers."""


def find_paper(name: str) -> Paper:
    """Return a paper by its number, from 1, or its key.

    Raises
    ------
    ValueError
        If there is none.
    """
    for number, paper in enumerate(PAPERS, 1):
        if name in (str(number), paper.key):
            return paper
    known = ', '.join(f'{number} ({paper.key})' for number, paper in enumerate(PAPERS, 1))
    raise ValueError(f'papers: expected one of {known} but found {name!r}')

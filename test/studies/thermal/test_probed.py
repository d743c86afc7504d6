# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""What is said of a probed run."""

from dataclasses import dataclass, field

import numpy as np
import pytest

from fuzzycnc_ros.studies.thermal.probed import (
    probed_document,
    probed_lines,
    probed_section,
    probed_table,
)
from fuzzycnc_ros.studies.thermal.summary import micrometres

ROWS = ('uncompensated', 'unprobed', 'held', 'learnt')
RMS = {
    'uncompensated': (20.0, 9.0),
    'unprobed': (4.0, 5.0),
    'held': (3.0, 1.0),
    'learnt': (1.0, 1.5),
}
"""Root mean square of two channels [um]; on the second the model is of no use."""


@dataclass(frozen=True)
class Run:
    run: str = 'monday'
    every: float = 5400.0
    channel: tuple = ('Y', 'Z')
    samples: np.ndarray = field(default_factory=lambda: np.array([10, 8]))
    probes: np.ndarray = field(default_factory=lambda: np.array([3, 3]))
    doubted: np.ndarray = field(default_factory=lambda: np.array([1, 1]))
    covered: np.ndarray = field(default_factory=lambda: np.array([0.9, 1.0]))
    half_width: np.ndarray = field(default_factory=lambda: 1e-6 * np.array([2.0, 3.0]))
    rms: dict = field(default_factory=lambda: {name: 1e-6 * np.array(RMS[name]) for name in ROWS})
    largest: dict = field(
        default_factory=lambda: {name: 3e-6 * np.array(RMS[name]) for name in ROWS}
    )
    time: np.ndarray = field(default_factory=lambda: 600.0 * np.arange(12))
    residual: dict = field(
        default_factory=lambda: {name: 1e-6 * np.ones((12, 2)) * RMS[name] for name in ROWS}
    )


def test_table_of_one_run_has_a_row_for_each_way_and_the_best_of_them_strong():
    table = probed_table([Run()])
    assert table.title == 'monday, probed every 90 min: residual thermal error [µm]'
    assert [row[0] for row in table.rows] == [
        'Uncompensated',
        'Default, not probed',
        'Last probe held, no model',
        'Default, learnt from the probes',
    ]
    assert [row[1] for row in table.rows] == [micrometres(1e-6 * RMS[name][0]) for name in ROWS]
    assert table.strong == {(3, 1), (3, 2), (2, 3), (2, 4)}


def test_several_runs_share_a_table():
    table = probed_table([Run(), Run('tuesday')])
    assert table.title == 'Over 2 runs, probed every 90 min: residual thermal error [µm]'
    assert len(table.rows) == len(ROWS)


def test_lines_say_what_counts_what_was_doubted_and_where_the_model_adds_nothing():
    rule, line = probed_lines([Run()])
    assert 'judged against the probes before it' in rule
    assert line == (
        'monday: 8 to 10 samples, 3 probes a channel; '
        '2 of them doubted; band: Y ±2.0 µm holds 90 %, Z ±3.0 µm holds 100 %; '
        'on Z the last probe, held, does as well alone'
    )


def test_document_has_every_figure():
    document = probed_document([Run()])
    assert document['every_s'] == 5400.0
    assert document['samples'] == {'monday': {'Y': 10, 'Z': 8}}
    assert document['probes'] == {'monday': {'Y': 3, 'Z': 3}}
    assert document['doubted']['monday'] == {'Y': 1, 'Z': 1}
    assert document['covered']['monday'] == {'Y': 0.9, 'Z': 1.0}
    assert document['half_width_um']['monday']['Z'] == pytest.approx(3.0)
    assert document['runs']['monday']['held']['Z']['rms_um'] == pytest.approx(1.0)
    assert document['overall']['held']['Y']['worst_max_um'] == pytest.approx(9.0)


def test_section_draws_the_rows_that_are_to_be_compared():
    section = probed_section(Run())
    assert section.heading == 'Run monday, probed every 90 min'
    (figure,) = section.figures
    for number, panel in enumerate(figure.plot.panels):
        drawn = {series.name: series.y for series in panel.series}
        assert list(drawn) == [
            'Default, not probed',
            'Last probe held, no model',
            'Default, learnt from the probes',
        ]
        np.testing.assert_allclose(drawn['Last probe held, no model'], RMS['held'][number])

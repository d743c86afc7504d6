# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Tables, documents and pages of positioning, from runs and figures made up here."""

import numpy as np
import pytest
from tiers import rest_slow

from fuzzycnc_ros.core.servo.axis_control import make_controller
from fuzzycnc_ros.core.servo.rule_learning import learn_rules
from fuzzycnc_ros.core.servo.rule_table import SETS
from fuzzycnc_ros.core.servo.stability import StabilityReport
from fuzzycnc_ros.simulation.servo.positioning import PositioningRun
from fuzzycnc_ros.studies.page.document import to_document
from fuzzycnc_ros.studies.page.html import render_page
from fuzzycnc_ros.studies.servo import positioning_compare
from fuzzycnc_ros.studies.servo import positioning_page as positioning
from fuzzycnc_ros.studies.servo.positioning_page import LABELS
from fuzzycnc_ros.studies.servo.positioning_rules import rules_table, stability_table
from fuzzycnc_ros.studies.servo.servo_cases import (
    RADIUS,
    ControllerFigures,
    RandomFigures,
    ServoComparison,
    StepFigures,
    drive_many,
    servo_cases,
    step_names,
)


def make_run(left=1e-6, fault='', rows=1000):
    """Return a move to 10 mm that comes within `left` of it after half its time."""
    time = 1e-3 * np.arange(rows)
    place = np.where(time < 0.5 * time[-1], 0.012 * time / time[-1], 0.01 - left)
    duty = np.linspace(0.5, -0.4, rows)
    return PositioningRun(time, np.full(rows, 0.01), place, place, duty, 0.01, 0.0, fault)


@pytest.mark.parametrize(
    ('length', 'text'),
    [
        (4.6e-7, '0.46'),
        (1.234e-5, '12.3'),
        (9.96e-6, '10.0'),
        (9.96e-5, '100'),
        (0.0123, '12.30 mm'),
        (-0.0123, '-12.30 mm'),
        (np.inf, '-'),
    ],
)
def test_lengths_read_well(length, text):
    assert positioning.microns(length) == text


def test_table_and_document_of_a_move():
    run = make_run()
    table = positioning.positioning_table(run, LABELS['pid'], 'a move')
    assert table.rows == ((LABELS['pid'], '0.500', '0.00', '1.00', '50'),)
    assert 'after 0.75 s' in table.columns[3].heading
    assert positioning.positioning_remarks(run) == []
    document = positioning.positioning_document(run, 'pid', {'axis': 'lathe'})
    assert document['settle'] == pytest.approx(0.5)
    assert document['steady_error'] == pytest.approx(1e-6)
    assert document['settings'] == {'axis': 'lathe'}


@pytest.mark.parametrize(
    ('run', 'remark'),
    [
        (make_run(5e-6), 'not settled: 5.00 µm from the target after 1 s'),
        (make_run(5e-3), 'not settled: 5.00 mm from the target after 1 s'),
        (make_run(5e-3, 'reading has jumped'), 'fault: reading has jumped; the duty is zero'),
    ],
)
def test_what_went_wrong_is_said(run, remark):
    (line,) = positioning.positioning_remarks(run)
    assert line.startswith(remark)
    assert positioning.positioning_table(run, LABELS['pid'], 'a move').rows[0][1] == '-'


def test_page_of_a_move_is_whole_and_always_the_same():
    pytest.importorskip('jinja2')
    run = make_run()
    label = LABELS['variable_universe']
    table = positioning.positioning_table(run, label, 'a move')
    pages = [
        render_page(positioning.positioning_page(run, label, table, {'Axis': 'lathe'}))
        for _ in range(2)
    ]
    assert pages[0] == pages[1]
    assert pages[0].count('class="chart"') == 1
    assert label in pages[0]


def comparison(moves=10):
    good, bad = StepFigures(0.5, 1e-7, 2e-7), StepFigures(np.inf, 0.0, 0.045)
    cases = step_names()
    random = {kind: RandomFigures(0.985, 1.0, 1.7e-5, 2) for kind in ('moderate', 'hard')}

    def figures(step, random, fault=''):
        runs = {
            case: make_run(0.0 if step is good else 5e-3, fault if case == '20 um' else '', 6000)
            for case in (*cases, *positioning_compare.DRAWN)
        }
        return ControllerFigures(
            dict.fromkeys(cases, step), 2.2e-4, 0.23, (9e-5, 1.6e-5), (4e-5, 1.9e-5), random, runs
        )

    found = {
        'variable_universe_static': figures(bad, {}, 'lost'),
        'variable_universe': figures(good, random if moves else {}),
    }
    return ServoComparison(cases, found, moves, 0)


def test_tables_of_a_comparison():
    made = comparison()
    moves = positioning_compare.moves_table(made)
    assert moves.rows[1][1:] == ('0.500 / 0.10 / 0.20',) * 8
    assert moves.rows[0][1] == '- / 0.00 / 45.00 mm'
    assert moves.highlight == {1}
    others = positioning_compare.others_table(made)
    assert others.rows[1][1:4] == ('220 / 0.230', '90.0 / 16.0', '19.0')
    assert others.rows[1][4] == '98.5 / 100.0 / 17.0'
    assert others.rows[0][4:] == ('', '')
    lines = positioning_compare.comparison_remarks(made)
    assert 'variable_universe_static gave up on: 20 um' in lines
    assert 'variable_universe gave up on 4 random moves' in lines
    assert len(positioning_compare.others_table(comparison(moves=0)).columns) == 4
    document = to_document(positioning_compare.comparison_document(made))
    assert document['controllers']['variable_universe']['random']['hard']['within_1'] == 0.985


def test_page_of_a_comparison_draws_those_that_settle():
    pytest.importorskip('jinja2')
    made = comparison()
    tables = [positioning_compare.moves_table(made), positioning_compare.others_table(made)]
    page = render_page(positioning_compare.comparison_page(made, tables, ['a remark'], {}))
    assert 'a remark' in page
    _, chart = page.split('class="chart">')
    assert LABELS['variable_universe'] in chart
    assert LABELS['variable_universe_static'] not in chart


def test_page_of_a_comparison_of_which_none_settles_has_no_courses():
    made = comparison()
    alone = ServoComparison(
        made.cases, {'variable_universe_static': made.figures['variable_universe_static']}, 0, 0
    )
    page = positioning_compare.comparison_page(
        alone, [positioning_compare.moves_table(alone)], [], {}
    )
    assert [section.heading for section in page.sections] == ['Figures']


def test_rules_say_where_they_are_from():
    learned = learn_rules([(-0.932, 0.497, 1.0), (0.801, -0.965, -0.921)]).complete()
    table = rules_table(learned, SETS)
    assert table.rows[0][4] == '1.000'
    assert table.rows[5][3] == '-1.000*'
    assert table.rows[1][1].endswith('~')
    assert table.rows[0][-2:] == ('1', '0')


def test_stability_says_what_swings():
    report = StabilityReport(
        error_gain=284.6, rate_gain=7.38, ultimate_gain=496.0, error_floor_min=0.04,
        gain_margin=(0.0, np.inf), phase_margin=0.5, crossover=100.0,
        spectral_radius={1.0: 0.97, 2.0: 1.02}, limit_cycle=1.9e-3, limit_cycle_frequency=62.832,
    )  # fmt: skip
    rows = dict(stability_table(report, 'a loop').rows)
    assert rows['spectral radius, gain x2'] == '1.0200 swings'
    assert rows['spectral radius, gain x1'] == '0.9700'
    assert rows['lasting oscillation (describing function)'] == '1.90 mm at 10.0 Hz'
    assert rows['gain of the axis at which it swings, above'] == 'none'


@pytest.mark.parametrize('name', rest_slow(('20 um', 'circle X'), 0))
def test_cases_side_by_side_are_those_one_by_one(name):
    from fuzzycnc_ros.core.machine.axis_models import LatheAxisConfig
    from fuzzycnc_ros.simulation.servo.axes import LatheAxis
    from fuzzycnc_ros.simulation.servo.positioning import position

    case, axis = servo_cases()[name], LatheAxisConfig().linear()
    (batch,) = drive_many([make_controller('variable_universe', axis)], [case], seed=3)
    plant = LatheAxis(LatheAxisConfig(seed=3, **case.knobs), position=case.start)
    alone = position(
        make_controller('variable_universe', axis), plant, case.reference, case.duration
    )
    assert len(batch.time) == len(alone.time)
    np.testing.assert_allclose(batch.position, alone.position, atol=2e-7)


def test_the_circle_is_one():
    cases = servo_cases()
    x, y = (cases[f'circle {axis}'].reference for axis in 'XY')
    np.testing.assert_allclose(np.hypot(x.position, y.position), RADIUS)
    np.testing.assert_allclose(np.hypot(x.velocity, y.velocity), 0.04)
    np.testing.assert_allclose(np.diff(x.position) / 1e-3, x.velocity[:-1], atol=5e-5)

# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The table of what fuzzy is worth: its rows, its counts, and what its plain laws are."""

import json
import sys
from importlib import import_module
from math import inf, nan
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from fuzzycnc_ros.core.feedrate.schedule.tolerance_feed import ToleranceFeed
from fuzzycnc_ros.core.machine.axis_models import LatheAxisConfig
from fuzzycnc_ros.core.servo.params import VariableUniverseParams
from fuzzycnc_ros.core.servo.variable_universe import VariableUniverseController
from fuzzycnc_ros.studies.pareto.pareto_path import CURVES, curve_path

BENCHMARKS = Path(__file__).parents[2] / 'benchmarks'
NAMES = ('fuzzy_worth', *(f'fuzzy_worth_{part}' for part in ('rows', 'feedrate', 'servo', 'foam')))


@pytest.fixture(scope='module')
def worth():
    """The benchmark's modules."""
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(BENCHMARKS))
        yield SimpleNamespace(
            **{name.removeprefix('fuzzy_'): import_module(name) for name in NAMES}
        )
    for name in NAMES:
        sys.modules.pop(name, None)


def test_rules_without_guard_and_approach_are_the_square_root(worth):
    assert worth.worth_feedrate.identity() < 1e-12


@pytest.mark.parametrize('name', list(CURVES))
def test_the_law_takes_the_place_of_the_rules_alone(worth, name):
    path = curve_path(name).sampled
    settings = {'feed_max': 0.2, 'tolerance': 5e-5, 'machine_constant': 2.15e-4}
    rules = worth.worth_feedrate.RuledFeed(**settings).feed(path)
    law = ToleranceFeed(**settings).feed(path)
    np.testing.assert_allclose(law, rules, rtol=1e-12)
    # centroids ripple about it
    centroid = worth.worth_feedrate.RuledFeed(**settings, centroid=True).feed(path)
    np.testing.assert_allclose(centroid, law, rtol=0.12)
    assert not np.allclose(centroid, law, rtol=1e-3)
    # guard and approach are left in it
    (alone,) = (one for one in worth.worth_feedrate.METHODS if one.name.endswith('alone'))
    assert not np.allclose(law, alone.scheduler(5e-5).feed(path), rtol=0.02)


def test_the_tangent_is_linear_with_the_slopes_of_the_rules(worth):
    params, axis = VariableUniverseParams(), LatheAxisConfig().linear()
    linear = worth.worth_servo.tangent(params)
    assert linear.error_gain == pytest.approx(params.error_gain)
    assert linear.rate_gain == pytest.approx(params.rate_gain)
    error, rate = np.meshgrid(np.linspace(-0.05, 0.05, 11), np.linspace(-0.2, 0.2, 11))
    duty = VariableUniverseController(axis, linear).surface(error, rate)
    np.testing.assert_allclose(
        duty, linear.error_gain * error + linear.rate_gain * rate, rtol=1e-3, atol=1e-12
    )
    assert not np.allclose(duty, VariableUniverseController(axis).surface(error, rate), rtol=0.1)


def test_a_course_begins_and_ends_at_rest_and_keeps_within_its_bounds(worth):
    for seed in range(5):
        course = worth.worth_servo.course(seed)
        assert course.position[0] == course.velocity[0] == course.velocity[-1] == 0.0
        assert np.abs(course.position).max() <= 0.06
        assert np.abs(np.diff(course.position)).max() <= 0.2e-3 * (1.0 + 1e-9)


def test_spread_and_count_of_a_part(worth):
    rows = worth.worth_rows
    part = rows.Part(
        'Job',
        tuple('abcd'),
        (
            rows.Way('rules', rows.FUZZY, {'error': (1.0, 2.005, 4.0, inf)}),
            rows.Way('law', rows.LAW, {'error': (2.0, 2.0, 3.0, inf)}),
            rows.Way('nothing', rows.NOTHING, {'error': (nan, nan, nan, nan)}),
        ),
        ('a note',),
    )
    table = part.table()
    assert table.rows[0] == ('rules', 'fuzzy', '1 / 3 / never', '1 / 2 / 1')
    assert table.rows[1] == ('law', 'plain law', '2 / 2.5 / never', '-')
    assert table.rows[2][2] == ''
    assert part.document()['ways'][0]['figures']['error'] == [1.0, 2.005, 4.0, None]


@pytest.mark.qualify
def test_a_quick_run_judges_every_system(worth, tmp_path, monkeypatch, capsys):
    pytest.importorskip('sklearn', reason='scikit-learn is not installed here')
    data = tmp_path / 'data'
    (data / 'gcode' / 'ccby-5axis').mkdir(parents=True)
    name = worth.worth_feedrate.PROGRAMS[2]
    (data / 'gcode' / name).write_text(
        'G21 G90 G17\nG0 X0 Y0\nG1 X10 F2000\nG3 X10 Y4 J2\nG1 X0\n'
    )
    monkeypatch.setattr(worth.worth, 'DATA', data)
    files = {kind: tmp_path / f'worth.{kind}' for kind in ('json', 'markdown')}
    options = [text for kind, file in files.items() for text in (f'--{kind}', str(file))]
    monkeypatch.setattr(sys, 'argv', ['fuzzy_worth.py', '--quick', *options])
    assert worth.worth.main() == 0
    printed, written = capsys.readouterr().out, files['markdown'].read_text()
    parts = json.loads(files['json'].read_text())
    assert [part['title'].split(':')[0] for part in parts] == (
        ['Feedrate'] * 2 + ['Servo'] * 3 + ['Soft material'] * 2
    )
    for part in parts:
        assert part['title'] in printed
        assert part['title'] in written
        kinds = [way['rules'] for way in part['ways']]
        assert set(kinds) == {'fuzzy', 'plain law', 'baseline', 'nothing'}
        for way in part['ways']:
            assert f'| {way["name"]} |' in written
            for values in way['figures'].values():
                assert len(values) == len(part['cases']) > 0
        # doing nothing leaves more than the best way does
        heading = list(part['ways'][0]['figures'])[-1]
        found = {
            kind: min(
                way['figures'][heading][0] or inf for way in part['ways'] if way['rules'] == kind
            )
            for kind in ('fuzzy', 'nothing')
        }
        assert found['fuzzy'] < found['nothing']

# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""`fuzzycnc servo learn` and `stability` for axes of a machine file, and what they refuse."""

import json

import numpy as np
import pytest
from benches.positioning_run import run_positioning

from fuzzycnc_ros.components.servo.servo_controller_config import ServoControllerConfig
from fuzzycnc_ros.core.servo.axis_control import AXIS_CONTROLLERS
from fuzzycnc_ros.machine_file.parameters import node_parameters
from fuzzycnc_ros.machine_file.reader import read_machine_file
from fuzzycnc_ros.studies.published_bag import PublishedBag
from fuzzycnc_ros.studies.servo.axis_tuning_tables import LABELS

FILE = """\
axes:
  X:
    plant: {model: lags, gain: 200 mm/s, velocity_lag: 20 ms}
    controller: {name: variable_universe, settings: {bandwidth: 2.5}}
  P:
    plant: {model: mass}
    controller: {name: pid}
  T:
    plant: {model: lags, delay: 2 ms}
    controller: {name: linear_tangent}
"""


LIGHT = """\
axes:
  X:
    plant:
      {model: mass, mass: 1 kg, viscous_forward: 4.4 N s/m, viscous_backward: 4.4 N s/m,
       coulomb_forward: 0 N, coulomb_backward: 0 N, force_constant: 7.2 N/V, count: 0.1 um}
"""


@pytest.fixture(autouse=True)
def my_file(tmp_path, fuzzycnc):
    """Three axes: with rules, without, and with their tangent."""
    (tmp_path / 'my.yaml').write_text(FILE)


def test_rules_are_learnt_of_a_bag_and_used(fuzzycnc, tmp_path):
    """From the node's own moves on that axis to a move with the learnt rules."""
    parameters = node_parameters(read_machine_file(tmp_path / 'my.yaml'))['servo_controller']
    config = ServoControllerConfig(**{**parameters, 'axes': ('X:machine_file',)})
    with PublishedBag(tmp_path / 'run') as sink:
        run_positioning(('X:-0.05', 'X:0.02'), config, sink=sink)
    options = ('--machine-file', 'my.yaml', '--axis', 'X')
    outcome = fuzzycnc(
        'servo', 'learn', 'run', *options, '--out', 'rules.yaml', '--json', 'l.json'
    )
    assert outcome.code == 0, outcome.err
    assert 'fuzzycnc position --machine-file my.yaml --axis X --params rules.yaml' in ' '.join(
        outcome.out.split()
    )
    learnt = json.loads((tmp_path / 'l.json').read_text())
    assert learnt['used'] > 500
    arguments = ('position', *options, '--to', '-20mm', '--profile', '--json', 'p.json')
    figures = []
    for extra in ((), ('--params', 'rules.yaml')):
        done = fuzzycnc(*arguments, *extra)
        assert done.code == 0, done.err
        figures.append((tmp_path / 'p.json').read_text())
    assert figures[0] != figures[1]
    assert fuzzycnc('servo', 'stability', *options, '--params', 'rules.yaml').code == 0


def test_rules_are_learnt_of_an_axis_that_never_comes_near_its_speed_at_full_duty(
    fuzzycnc, tmp_path, root
):
    """What hardly rubs would end up at 30 m/s; its own recording is no other axis' for that."""
    path = root / 'test' / 'support' / 'axes' / 'light.csv.gz'
    time, reference, position, duty = np.loadtxt(path, delimiter=',', skiprows=1).T[:, :6000]
    (tmp_path / 'light.yaml').write_text(LIGHT)
    options = ('--machine-file', 'light.yaml', '--axis', 'X', '--unit', 'mm')
    codes = []
    for name, scale in (('honest', 1.0), ('metres', 1e-3)):
        moves = np.column_stack([time, scale * reference, scale * position, duty])
        header = 't,reference,position,duty'
        np.savetxt(tmp_path / f'{name}.csv', moves, delimiter=',', header=header, comments='')
        done = fuzzycnc('servo', 'learn', f'{name}.csv', *options, '--out', f'{name}.yaml')
        codes.append(done.code)
        assert done.code == 0 or 'is it this axis, and the unit right?' in ' '.join(
            done.err.split()
        )
    assert codes == [0, 2]


@pytest.mark.parametrize('name', AXIS_CONTROLLERS)
def test_an_axis_is_moved_with_whatever_tuning_may_write_for_it(fuzzycnc, tmp_path, name):
    (tmp_path / 'tuned.yaml').write_text(f"""\
axes:
  X:
    plant: {{model: lags, gain: 200 mm/s, velocity_lag: 20 ms}}
    controller: {{name: {name}, settings: {{bandwidth: 2.5, damping: 1.1, estimator: 2.0}}}}
""")
    outcome = fuzzycnc(
        *('position', '--machine-file', 'tuned.yaml', '--axis', 'X', '--to', '2mm'),
        *('--duration', '1s', '--report', 'move.html', '--json', 'p.json'),
    )
    assert outcome.code == 0, outcome.err
    assert LABELS[name] in outcome.out
    assert json.loads((tmp_path / 'p.json').read_text())['controller'] == name
    assert LABELS[name] in (tmp_path / 'move.html').read_text()


def test_rules_are_used_on_an_axis_without_a_controller_of_its_own(fuzzycnc, tmp_path):
    table = 'rules: {centres: [-1.0, 1.0], values: [[1.0, 0.0], [0.0, -1.0]]}\n'
    (tmp_path / 'r.yaml').write_text(f'axis: X\n{table}')
    (tmp_path / 'plain.yaml').write_text('axes: {X: {plant: {model: mass}}}\n')
    options = ('--machine-file', 'plain.yaml', '--axis', 'X', '--to', '2mm', '--duration', '0.5s')
    outcome = fuzzycnc('position', *options, '--params', 'r.yaml', '--json', 'p.json')
    assert outcome.err == ''
    assert json.loads((tmp_path / 'p.json').read_text())['controller'] == 'variable_universe'
    analysed = fuzzycnc('servo', 'stability', *options[:4], '--params', 'r.yaml')
    assert analysed.code == 0, analysed.err
    assert 'variable_universe on the X axis' in analysed.out


def test_stability_is_that_of_the_axis_and_its_settings(fuzzycnc, tmp_path):
    found = {}
    for name, options in {
        'X': ('--axis', 'X'),
        'T': ('--axis', 'T'),
        'untuned': ('--axis', 'X', '--controller', 'linear_tangent'),
    }.items():
        outcome = fuzzycnc(
            *('servo', 'stability', '--machine-file', 'my.yaml', *options, '--json', 'out.json')
        )
        assert outcome.code == 0, outcome.err
        found[name] = json.loads((tmp_path / 'out.json').read_text())
        assert ('dead time of 2 ms is left out' in outcome.out) == (name == 'T')
    # without settings X is not tuned
    assert found['X'] != found['untuned']
    assert found['X'] != found['T']


@pytest.mark.parametrize(
    ('arguments', 'naming'),
    [
        (('stability', '--axis', 'P'), ['variable_universe or linear_tangent', 'pid', 'compare']),
        (('stability', '--axis', 'Q'), ['--axis', 'X, P, T', "'Q'"]),
        (('stability',), ['--axis', 'X, P, T']),
        (('stability', '--axis', 'X', '--controller', 'fuzzy'), ['controller', "'fuzzy'"]),
        (('stability', '--axis', 'X', '--params', 's.yaml'), ['s.yaml', 'expected rules alone']),
        (('stability', '--axis', 'X', '--params', 'r.yaml'), ['r.yaml', 'axis X', 'lathe']),
        (
            ('stability', '--axis', 'T', '--params', 'x.yaml'),
            ['rules: expected none for linear_tangent', 'variable_universe'],
        ),
        (
            ('learn', 'moves.csv', '--unit', 'mm', '--out', 'o.yaml', '--axis', 'P'),
            ['my.yaml', 'variable_universe for P', 'pid', 'no rules to learn', 'servo tune'],
        ),
        (
            ('learn', 'moves.csv', '--unit', 'mm', '--out', 'o.yaml', '--reversed'),
            ['--reversed', '--machine-file'],
        ),
    ],
)
def test_refusals(refused, tmp_path, arguments, naming):
    table = 'rules: {centres: [-1.0, 1.0], values: [[1.0, 0.0], [0.0, -1.0]]}\n'
    (tmp_path / 's.yaml').write_text('settings: {error_range: 0.1}\n')
    (tmp_path / 'r.yaml').write_text(f'axis: lathe\n{table}')
    (tmp_path / 'x.yaml').write_text(table)
    (tmp_path / 'moves.csv').write_text('t,reference,position,duty\n0,0,0,0\n')
    refused('servo', *arguments, '--machine-file', 'my.yaml', naming=naming)

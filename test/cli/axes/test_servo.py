# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""`fuzzycnc servo`: compare, learn, tune, stability, and what they refuse."""

import json

import numpy as np
import pytest
import yaml
from benches.positioning_run import run_positioning

from fuzzycnc_ros.cli.axes.servo import COMMANDS
from fuzzycnc_ros.components.machine.simulated_machine import SimulatedMachineConfig
from fuzzycnc_ros.components.servo.servo_controller_config import ServoControllerConfig
from fuzzycnc_ros.core.machine.axis_models import LatheAxisConfig
from fuzzycnc_ros.core.servo.params import VariableUniverseParams
from fuzzycnc_ros.core.servo.pid_cascade import PidController
from fuzzycnc_ros.core.servo.profile import point_to_point
from fuzzycnc_ros.core.servo.variable_universe import VariableUniverseController
from fuzzycnc_ros.runtime.enums import ServoStatus
from fuzzycnc_ros.runtime.records import (
    AxisCommand,
    AxisState,
    ServoState,
)
from fuzzycnc_ros.simulation.servo.axes import LatheAxis
from fuzzycnc_ros.simulation.servo.positioning import position
from fuzzycnc_ros.studies.published_bag import PublishedBag
from fuzzycnc_ros.studies.servo.positioning_rules import swinging
from fuzzycnc_ros.studies.servo.recorded_moves import read_bag

MILLISECOND = 10**6


def recorded(direction=1.0):
    """Return the rows t [s], reference, position [m], duty of four moves with pauses between."""
    rows, start = [], 1.0
    for seed, target in enumerate((-0.19, -0.05, 0.05, 0.19)):
        axis = LatheAxis(LatheAxisConfig(seed=seed, direction=direction))
        run = position(PidController(axis.config.linear()), axis, target, 1.0)
        rows.append(np.column_stack([start + run.time, run.reference, run.measured, run.duty]))
        start += 2.0
    return np.concatenate(rows)


@pytest.fixture(scope='module')
def moves():
    return recorded()


def write_csv(path, rows, scale=1e3):
    lines = ['t,note,reference,position,duty']
    for time, reference, place, duty in rows.tolist():
        lines.append(f'{time:.3f},,{scale * reference:.7f},{scale * place:.7f},{duty:.6f}')
    path.write_text('\n'.join(lines) + '\n')


def write_bag(path, rows, axis='X', fault_from=None):
    with PublishedBag(path, machine='lathe') as bag:
        for number, (time, *values) in enumerate(rows.tolist()):
            stamp = round(1e3 * time) * MILLISECOND
            reference, place, duty = (np.array([value]) for value in values)
            common = {'stamp': stamp, 'axis': (axis,)}
            nothing = np.array([np.nan])
            bag('axis_state', AxisState(
                reference=nothing, position=place, velocity=np.zeros(1), **common,
            ))  # fmt: skip
            bag('axis_command', AxisCommand(
                epoch=1, duty=duty, valid_until=stamp + 10 * MILLISECOND, **common,
            ))  # fmt: skip
            faulty = fault_from is not None and number >= fault_from
            bag('servo_state', ServoState(
                epoch=1, status=ServoStatus.FAULT if faulty else ServoStatus.MOVING,
                reason='run-away' if faulty else '', reference=reference, error=reference - place,
                disturbance=nothing, saturated=np.array([False]), missed=0, **common,
            ))  # fmt: skip


@pytest.mark.parametrize('name', COMMANDS)
def test_every_manual_has_an_example_on_a_line_of_its_own(fuzzycnc, name):
    outcome = fuzzycnc('servo', name, '--help')
    assert outcome.code == 0
    lines = [line.strip() for line in outcome.out.splitlines()]
    assert any(line.startswith(f'fuzzycnc servo {name}') for line in lines)


def test_help_lists_the_commands_where_they_belong(fuzzycnc):
    listed = fuzzycnc('--help').out.split('Axes:')[1]
    assert listed.index('position') < listed.index('servo') < listed.index('Soft material:')
    inner = fuzzycnc('servo', '--help').out.split('Commands')[1]
    assert all(name in inner for name in COMMANDS)


def test_no_or_an_unknown_command(refused):
    refused('servo', naming=['Missing command', 'fuzzycnc servo --help'])
    refused('servo', 'tnue', naming=["'tnue'", 'fuzzycnc servo --help'])


@pytest.mark.slow
def test_compare(fuzzycnc, tmp_path):
    outcome = fuzzycnc(
        'servo', 'compare', '--controllers', 'variable_universe,variable_universe_static',
        '--moves', '2', '--json', 'out.json', '--report', 'page.html',
    )  # fmt: skip
    assert outcome.code == 0, outcome.err
    document = json.loads((tmp_path / 'out.json').read_text())
    assert list(document['controllers']) == ['variable_universe_static', 'variable_universe']
    found = document['controllers']['variable_universe']
    assert len(found['steps']) == 8
    for name, move in found['steps'].items():
        assert move['settle'] < 1.3, name
        assert move['overshoot'] < 1e-6, name
        assert move['steady_error'] < 1e-6, name
    assert found['load']['dip'] < 260e-6
    assert found['load']['recovery'] < 0.35
    assert found['sine']['rms'] < 20e-6
    assert found['circle']['rms'] < 22e-6
    assert set(found['random']) == {'moderate', 'hard'}
    plain = document['controllers']['variable_universe_static']
    assert plain['steps']['-50']['settle'] is None
    assert plain['steps']['-50']['steady_error'] == pytest.approx(156e-6, rel=0.02)
    assert plain['random'] == {}
    assert 'do not settle with friction at all' in outcome.out
    page = (tmp_path / 'page.html').read_text()
    assert 'class="chart"' in page
    assert 'variable, observer (default)' in page


def test_seven_sets_may_be_learnt(fuzzycnc, tmp_path, moves):
    write_csv(tmp_path / 'moves.csv', moves)
    outcome = fuzzycnc(
        'servo', 'learn', 'moves.csv', '--unit', 'mm', '--sets', '7', '--out', 'rules.yaml'
    )
    assert outcome.code == 0, outcome.err
    assert 'of 49 cells' in outcome.out
    assert len(yaml.safe_load((tmp_path / 'rules.yaml').read_text())['rules']['centres']) == 7
    move = fuzzycnc('position', '--to', '-50mm', '--params', 'rules.yaml', '--json', 'move.json')
    assert move.code == 0, move.err
    assert json.loads((tmp_path / 'move.json').read_text())['settle'] < 0.6


def test_rules_that_swing_off_the_nominal_gain_are_named(fuzzycnc, tmp_path, moves):
    write_csv(tmp_path / 'moves.csv', moves)
    outcome = fuzzycnc('servo', 'learn', 'moves.csv', '--unit', 'mm', '--out', 'rules.yaml')
    assert outcome.code == 0, outcome.err
    assert "note: at x1.5 of the axis' gain the loop swings, spectral radius 1.00" in outcome.out


@pytest.mark.parametrize('source', ['csv', 'bag'])
def test_learnt_rules_position_the_axis(fuzzycnc, tmp_path, moves, source):
    if source == 'csv':
        write_csv(tmp_path / 'moves.csv', moves)
        arguments = ('moves.csv', '--unit', 'mm')
    else:
        write_bag(tmp_path / 'moves', moves)
        arguments = ('moves',)
    outcome = fuzzycnc('servo', 'learn', *arguments, '--out', 'rules.yaml', '--json', 'out.json')
    assert outcome.code == 0, outcome.err
    assert 'data in 14 of 36 cells' in outcome.out
    document = json.loads((tmp_path / 'out.json').read_text())
    assert document['coverage'] == pytest.approx(14 / 36)
    written = yaml.safe_load((tmp_path / 'rules.yaml').read_text())
    assert np.array(written['rules']['values']) == pytest.approx(
        np.array(document['values']), abs=1e-6
    )
    move = ('position', '--to', '-50mm', '--json', 'move.json')
    settle = []
    for options in (('--params', 'rules.yaml'), ('--controller', 'pid')):
        assert fuzzycnc(*move, *options).code == 0
        settle.append(json.loads((tmp_path / 'move.json').read_text())['settle'])
    assert settle[0] <= 1.5 * settle[1]


def record_run(path, targets, **limits):
    """Record moves of the simulated machine under our PID; return their settling times [s]."""
    servo = ServoControllerConfig(controller='pid', **limits)
    machine = SimulatedMachineConfig(servo_axes=('X:lathe',), move_time=1.0)
    with PublishedBag(path) as bag:
        return [move.settle() for move in run_positioning(targets, servo, machine, sink=bag)]


def test_rules_of_a_recorded_run_position_as_the_recorded_controller(fuzzycnc, tmp_path):
    stepping = {'velocity_max': 10.0, 'acceleration_max': 1000.0, 'jerk_max': 1e6}
    record_run(tmp_path / 'run', ('X:-0.19', 'X:0.0', 'X:0.05', 'X:0.0'), **stepping)
    outcome = fuzzycnc('servo', 'learn', 'run', '--out', 'rules.yaml', '--json', 'out.json')
    assert outcome.code == 0, outcome.err
    document = json.loads((tmp_path / 'out.json').read_text())
    # all of the four seconds, but for what is not certain at the end and rests on target
    assert document['used'] > 3800
    table = np.array(document['values'])
    assert table == pytest.approx(-table[::-1, ::-1])
    move = ('position', '--to', '-50mm', '--json', 'move.json')
    settle = []
    for options in (('--params', 'rules.yaml'), ('--controller', 'pid')):
        assert fuzzycnc(*move, *options).code == 0
        settle.append(json.loads((tmp_path / 'move.json').read_text())['settle'])
    assert settle[0] <= 1.5 * settle[1]


def test_moves_by_profile_are_said_to_teach_little(fuzzycnc, tmp_path):
    record_run(tmp_path / 'run', ('X:-0.02', 'X:0.0'))
    outcome = fuzzycnc('servo', 'learn', 'run', '--out', 'rules.yaml')
    assert outcome.code == 0, outcome.err
    assert 'record moves that step' in outcome.out


def test_reference_of_a_bag_is_that_of_the_run(tmp_path):
    record_run(tmp_path / 'run', ('X:-0.02', 'X:0.01'))
    moves = read_bag(tmp_path / 'run', 'X')
    assert 1e3 * np.diff(moves.time) == pytest.approx(1.0)
    course = point_to_point(0.0, -0.02).sample(1e-3).position
    assert moves.reference[: len(course)] == pytest.approx(course, abs=1e-6)
    assert moves.reference[-1] == 0.01
    assert np.abs(moves.position - moves.reference).max() < 1e-3


def test_rows_in_a_fault_do_not_count(fuzzycnc, tmp_path, moves):
    write_bag(tmp_path / 'moves', moves, fault_from=2000)
    outcome = fuzzycnc('servo', 'learn', 'moves', '--out', 'rules.yaml')
    assert outcome.code == 0, outcome.err
    assert '1,998 records' in outcome.out


def test_rules_that_swing_are_named(fuzzycnc, tmp_path, moves):
    write_csv(tmp_path / 'moves.csv', moves)
    outcome = fuzzycnc(
        'servo', 'learn', 'moves.csv', '--unit', 'mm', '--method', 'wm', '--out', 'rules.json'
    )
    assert outcome.code == 0, outcome.err
    assert 'spectral radius 1.0' in outcome.out
    assert '1.000~' in outcome.out
    shown = fuzzycnc('servo', 'stability', '--params', 'rules.json')
    assert shown.code == 0, shown.err
    assert 'swings' in shown.out


def test_tune_without_a_machine_file_is_about_a_built_in_one(fuzzycnc, tmp_path):
    outcome = fuzzycnc(
        'servo', 'tune', '--search', 'output_gain,disturbance', '--population', '3',
        '--generations', '1', '--seed', '1', '--out', 't.yaml', '--json', 'out.json',
    )  # fmt: skip
    assert outcome.code == 0, outcome.err
    document = json.loads((tmp_path / 'out.json').read_text())
    # PID and cascade have no such settings
    tuned = {one['name'] for one in document['controllers']}
    assert tuned == {'linear_tangent', 'variable_universe'}
    written = yaml.safe_load((tmp_path / 't.yaml').read_text())['axes']['X']['controller']
    assert set(written['settings']) == {'output_gain', 'disturbance'}
    move = fuzzycnc('position', '--machine-file', 't.yaml', '--to', '5mm', '--duration', '0.3s')
    assert move.code == 0, move.err
    # Before, the file had settings alone.
    outcome = fuzzycnc('position', '--to', '5mm', '--params', 't.yaml')
    assert outcome.code == 2
    assert "t.yaml: expected 'settings' or 'rules' but found the axes of a machine" in outcome.err


@pytest.mark.parametrize(
    ('options', 'axis', 'generations'),
    [
        ((), 'lathe', 8),
        (('--axis', 'ballscrew'), 'ballscrew', 8),
        (('--machine-file', 'ballscrew', '--generations', '5'), 'ballscrew', 5),
    ],
)
def test_tune_searches_for_as_many_generations_as_its_help_says(
    fuzzycnc, monkeypatch, options, axis, generations
):
    searched = []

    def search(file, *arguments):
        searched.append((file, arguments[2].generations))
        raise ValueError('searched')

    monkeypatch.setattr('fuzzycnc_ros.cli.axes.servo_machine.tune_machine_axis', search)
    outcome = fuzzycnc('servo', 'tune', '--out', 's.yaml', *options)
    assert 'searched' in outcome.err
    assert searched == [(axis, generations)]


def test_settings_that_swing_off_the_nominal_gain_are_named():
    axis = LatheAxisConfig().linear()
    assert swinging(VariableUniverseController(axis)) == []
    sharp = VariableUniverseParams(error_floor=0.025744, error_exponent=0.56426)
    (line,) = swinging(VariableUniverseController(axis, sharp))
    assert 'x1.5' in line
    assert 'swings' in line


def test_stability(fuzzycnc, tmp_path):
    outcome = fuzzycnc('servo', 'stability', '--json', 'out.json', '--report', 'page.html')
    assert outcome.code == 0, outcome.err
    document = json.loads((tmp_path / 'out.json').read_text())
    radius = document['spectral_radius']
    assert radius['1.0'] == pytest.approx(0.9682, abs=5e-4)
    assert radius['1.75'] == pytest.approx(1.014, abs=5e-4)
    assert '1.0139 swings' in outcome.out
    assert 'class="chart"' in (tmp_path / 'page.html').read_text()
    for options in (
        ('--controller', 'variable_universe_static'),
        ('--axis', 'ballscrew', '--gains', '1'),
    ):
        assert fuzzycnc('servo', 'stability', *options).code == 0


BALLSCREW = ('--machine-file', 'ballscrew')


@pytest.mark.parametrize(
    ('arguments', 'naming'),
    [
        (('compare', '--controllers', 'magic'), ['--controllers', "'magic'", 'cascade']),
        (('compare', '--moves', '-1'), ['--moves', '0 or more']),
        (('compare', '--report', 'no/page.html'), ['no/page.html', 'folder']),
        (('tune', '--out', 's.yaml', '--axis', 'mill'), ['--axis', "'mill'"]),
        (('tune', '--out', 's.yaml', '--generations', '0'), ['--generations', '1 or more']),
        (('tune', '--out', 's.yaml', '--search', 'luck'), ['--search', "'luck'", 'rate_range']),
        (
            ('tune', '--out', 's.yaml', '--search', 'rate_range', '--population', '2'),
            ['--population', 'five', '2'],
        ),
        (('tune', '--out', 'here.yaml'), ['here.yaml', 'exists']),
        (('tune',), ['--out', 'fuzzycnc servo tune --help']),
        (('stability', '--gains', '0'), ['--gains', "'0'"]),
        (('stability', '--gains', 'x'), ['--gains', "'x'"]),
        (('stability', '--gains', ','), ['--gains', 'found none']),
        (('stability', '--controller', 'pid'), ['--controller', 'variable_universe', "'pid'"]),
        (('stability', '--axis', 'mill'), ['--axis', "'mill'"]),
        (('stability', '--params', 'none.yaml'), ['none.yaml']),
        (('learn', 'none', '--out', 'r.yaml'), ['none', 'nothing is there']),
        (('learn', 'good.csv', '--out', 'r.yaml'), ['--unit', 'mm, um', 'None']),
        (('learn', 'good.csv', '--unit', 'ell', '--out', 'r.yaml'), ['--unit', "'ell'"]),
        (('learn', 'a_bag', '--unit', 'mm', '--out', 'r.yaml'), ['--unit', 'none for a bag']),
        (('learn', 'good.csv', '--unit', 'um', '--out', 'r.yaml'), ['good.csv', '286 mm/s']),
        (('learn', 'good.csv', '--unit', 'm', '--out', 'r.yaml'), ['good.csv', 'unit right?']),
        (
            ('learn', 'good.csv', '--unit', 'mm', '--reversed', '--out', 'r.yaml'),
            ['good.csv', 'the opposite', 'leave out --reversed'],
        ),
        (
            ('learn', 'good.csv', '--unit', 'mm', '--method', 'guess', '--out', 'r.yaml'),
            ['--method', "'guess'"],
        ),
        (('learn', 'good.csv', '--unit', 'mm', '--out', 'here.yaml'), ['here.yaml', 'exists']),
        (('learn', 'good.csv', '--unit', 'mm', '--axis', 'c', '--out', 'r.yaml'), ['--axis']),
        (('learn', 'here.yaml', '--out', 'r.yaml'), ['here.yaml']),
        (('learn', 'good.csv', '--unit', 'mm', '--sets', '5', '--out', 'r.yaml'), ['--sets', '5']),
        (('learn', 'good.csv', '--unit', 'mm', '--out', 'no/r.yaml'), ['no/r.yaml', 'folder']),
        (
            ('learn', 'good.csv', '--unit', 'mm', '--out', 'r.yaml', '--json', 'no/j.json'),
            ['no/j.json', 'folder'],
        ),
        (('learn', 'empty', '--out', 'r.yaml'), ['empty', 'expected a bag']),
        (('learn', 'damaged.mcap', '--out', 'r.yaml'), ['damaged.mcap', 'MCAP']),
        (('learn', 'damaged.csv', '--unit', 'mm', '--out', 'r.yaml'), ['damaged.csv', 'text']),
        (('tune', '--out', 'no/s.yaml'), ['no/s.yaml', 'folder']),
        (('tune', '--out', 's.yaml', '--json', 'no/j.json'), ['no/j.json', 'folder']),
        (('tune', '--out', 's.yaml', '--seed', '-1'), ['--seed', '0 or more', '-1']),
        (('tune', '--out', 's.yaml', '--population', '0'), ['--population', '1 or more']),
        (('tune', '--linuxcnc', 'b', '--out', 's.yaml'), ['--linuxcnc', '--on-machine']),
        (
            ('tune', '--on-machine', '--linuxcnc', 'b', *BALLSCREW, '--out', 's.yaml'),
            ['standard input', 'terminal'],
        ),
        (
            ('tune', '--on-machine', '--linuxcnc', 'here.yaml', *BALLSCREW, '--out', 's.yaml'),
            ['here.yaml'],
        ),
        (('stability', '--params', 'damaged.csv'), ['damaged.csv', 'settings']),
        (('stability', '--params', 'here.yaml'), ['here.yaml', "'settings' or 'rules'"]),
        (('stability', '--params', 'oblong.yaml'), ['oblong.yaml', 'rules', '3 rows of length 2']),
        (('stability', '--report', 'no/page.html'), ['no/page.html', 'folder']),
        (('compare', '--json', 'no/j.json'), ['no/j.json', 'folder']),
        (('compare', '--seed', '-1'), ['--seed', '0 or more', '-1']),
        (('compare', '--controllers', ','), ['--controllers', 'found none']),
    ],
)
def test_wrong_calls_are_refused_and_write_nothing(refused, tmp_path, moves, arguments, naming):
    write_csv(tmp_path / 'good.csv', moves[:1000])
    (tmp_path / 'here.yaml').write_text('')
    (tmp_path / 'empty').mkdir()
    for name in ('damaged.csv', 'damaged.mcap'):
        (tmp_path / name).write_bytes(bytes(range(255, 0, -1)))
    table = 'rules: {centres: [-1, 0, 1], values: [[1, 1], [0, 0], [-1, -1]]}'
    (tmp_path / 'oblong.yaml').write_text(table)
    before = sorted(tmp_path.rglob('*'))
    refused('servo', *arguments, naming=naming)
    assert sorted(tmp_path.rglob('*')) == before


@pytest.mark.parametrize(
    ('text', 'naming'),
    [
        ('', ['line 1', 't, reference, position, duty']),
        ('t,reference,position\n0,0,0\n', ['line 1', 'no duty']),
        ('t,reference,position,duty\n', ['rows below the header']),
        ('t,reference,position,duty\n0,0,0,0\n0.001,0,x,0\n', ['line 3', "'0.001,0,x,0'"]),
        ('t,reference,position,duty\n0,0,nan,0\n', ['line 2', 'finite']),
        ('t,reference,position,duty\n0,0,0\n', ['line 2', '4 finite numbers']),
        ('t,reference,position,duty\n0,0,0,50\n', ['duty', '-1 to 1', '50']),
        ('t,reference,position,duty\n0,0,0,0\n0.1,1,1,0\n', ['1 ms apart', 'among 2 rows']),
    ],
)
def test_wrong_tables_are_refused(refused, tmp_path, text, naming):
    (tmp_path / 'wrong.csv').write_text(text)
    refused(
        'servo', 'learn', 'wrong.csv', '--unit', 'mm', '--out', 'r.yaml',
        naming=['wrong.csv', *naming],
    )  # fmt: skip
    assert not (tmp_path / 'r.yaml').exists()


def test_a_bag_of_another_axis_or_without_moves_is_refused(refused, tmp_path, moves):
    write_bag(tmp_path / 'moves', moves[:100])
    learn = ('servo', 'learn', 'moves', '--out', 'r.yaml')
    refused(*learn, '--name', 'Z', naming=['--name', 'X', "'Z'"])
    write_bag(tmp_path / 'faulty', moves[:100], fault_from=0)
    refused(
        'servo', 'learn', 'faulty', '--out', 'r.yaml', naming=['faulty', 'moves of the axis X']
    )


def test_a_bag_without_a_recorded_run_is_refused(refused, bag):
    refused('servo', 'learn', bag(), '--out', 'r.yaml', naming=['log', 'servo_state'])

# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""`fuzzycnc machine identify`: files, columns, refusals, and what is written."""

import json

import numpy as np
import pytest

from fuzzycnc_ros.core.identify.loop_fit import following
from fuzzycnc_ros.core.machine.axis_models import BallscrewAxisConfig
from fuzzycnc_ros.simulation.servo.axes import BallscrewAxis

AXIS = ('--columns', 'command=volts,position=place', '--full', '10', '--out', 'axis.yaml')


@pytest.fixture(scope='module')
def rows():
    """Time, voltage and position [s, V, mm] of a ball screw that swings on a weak spring."""
    plant = BallscrewAxis(BallscrewAxisConfig(count=1e-6))
    found = []
    for step in range(1500):
        place = plant.measure()
        aim = 0.08 * np.sin(3e-3 * step) * (1.0 + 0.5 * np.sin(1.7e-2 * step))
        volts = float(np.clip(400.0 * (aim - place) - 20.0 * plant.velocity, -10.0, 10.0))
        found.append((1e-3 * step, volts, 1e3 * place))
        plant.drive(volts / 10.0)
    return np.array(found)


def written(path, table, header='t,volts,place', sign=','):
    names = header.replace(',', sign)
    np.savetxt(path, table, delimiter=sign, header=names, comments='', fmt='%.9g')


def test_an_axis_from_a_table(fuzzycnc, tmp_path, rows):
    written(tmp_path / 'drive.csv', rows)
    outcome = fuzzycnc(
        'machine', 'identify', 'drive.csv', *AXIS, '--force', '351.5', '--json', 'out.json'
    )
    assert outcome.code == 0, outcome.err
    assert 'command is volts, position is place' in outcome.out
    document = json.loads((tmp_path / 'out.json').read_text())
    found = {one['name']: one for one in document['parameters']}
    assert found['gain']['value'] == pytest.approx(351.5 / 95.1, rel=0.05)
    outcome = fuzzycnc('machine', 'show', 'axis.yaml', '--json', 'show.json')
    assert outcome.code == 0, outcome.err
    values = json.loads((tmp_path / 'show.json').read_text())['values']
    assert values['axes.X.plant.mass'] == pytest.approx(95.1, rel=0.05)
    assert fuzzycnc('position', '--machine-file', 'axis.yaml', '--to', '20mm').code == 0


@pytest.mark.slow
def test_what_another_file_says_is_kept(fuzzycnc, tmp_path, rows):
    written(tmp_path / 'drive.txt', rows, header='', sign=' ')
    (tmp_path / 'mill.yaml').write_text('machine: old\naxes: {"Y": {}}\npath: {velocity: 0.1}\n')
    outcome = fuzzycnc(
        'machine', 'identify', 'drive.txt', '--machine-file', 'mill.yaml', '--axis', 'X',
        '--columns', 't=1,command=2,position=3', '--full', '10', '--out', 'new.yaml',
    )  # fmt: skip
    assert outcome.code == 0, outcome.err
    assert 'unknown without --force' in outcome.out
    text = (tmp_path / 'new.yaml').read_text()
    assert 'machine: old' in text
    assert 'velocity: 100 mm/s' in text
    assert '# identified from drive.txt' in text


def test_loops_from_a_circle(fuzzycnc, tmp_path):
    angle = 2.0 * np.pi * np.cumsum(np.linspace(0.4, 4.0, 2500)) * 1e-3
    first, second = 20.0 * np.cos(angle) - 20.0, 20.0 * np.sin(angle)
    slow, fast = (40.0, 250.0, 0.0, 2e-3), (30.0, 250.0, 0.0, 2e-3)
    table = np.column_stack(
        [first, following(first, 1e-3, slow), second, following(second, 1e-3, fast)]
    )
    written(tmp_path / 'circle.csv', table, header='xc,xa,yc,ya', sign=';')
    outcome = fuzzycnc(
        'machine', 'identify', 'circle.csv', '--period', '1ms', '--out', 'mill.yaml',
        '--columns', 'commanded_X=xc,actual_X=xa,commanded_Y=yc,actual_Y=ya',
    )  # fmt: skip
    assert outcome.code == 0, outcome.err
    assert 'circles become ovals' in outcome.out
    assert 'XY: 0.000422' in (tmp_path / 'mill.yaml').read_text()


@pytest.mark.parametrize(
    ('text', 'arguments', 'said'),
    [
        ('', AXIS, ['empty']),
        ('t,a,b\n0,1,2\n', AXIS, ['expected a column volts', 't, a, b']),
        ('t,volts,place\n', AXIS, ['expected rows below']),
        ('t,volts,place\n0,1\n', AXIS, ['row 1', '3 columns', 'found 2']),
        ('t,volts,place\n0,1,x\n1,1,1\n', AXIS, ['row 1', 'place']),
        ('t,volts,place\n0,1,1\n0,1,1\n', AXIS, ['times that rise']),
        ('t,volts,place\n0,1,1\n5,1,1\n', AXIS, ['are they ms']),
        ('a,b\n1,2\n', ('--out', 'axis.yaml'), ['one column that is the command', 'a, b']),
        ('a,b\n1,2\n', ('--columns', 'commanded_X=a', '--out', 'a.yaml'), ['actual_X']),
        ('a,b\n1,2\n', ('--columns', 'a', '--out', 'a.yaml'), ['--columns', "'a'"]),
        ('a,b\n1,2\n', (*AXIS, '--unit', 'furlong'), ['--unit', 'furlong']),
        ('a,b\n1,2\n', (*AXIS, '--force', '-1'), ['--force', '-1']),
    ],
)
def test_refusals_name_the_thing(fuzzycnc, tmp_path, text, arguments, said):
    (tmp_path / 'drive.csv').write_text(text)
    outcome = fuzzycnc('machine', 'identify', 'drive.csv', *arguments)
    assert outcome.code == 2
    assert len(outcome.err.splitlines()) == 1
    for word in said:
        assert word in outcome.err


def test_a_binary_file_is_named_as_one(fuzzycnc, tmp_path):
    (tmp_path / 'drive.mat').write_bytes(bytes(range(256)))
    outcome = fuzzycnc('machine', 'identify', 'drive.mat', *AXIS)
    assert outcome.code == 2
    assert 'save .mat files as CSV' in outcome.err

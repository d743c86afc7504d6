# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""From a trial on a sheet over its photograph to a compensated design."""

import csv
import json
import os

import numpy as np
import pytest

from fuzzycnc_ros.core.deformation.model import write_model
from fuzzycnc_ros.core.deformation.regression import no_correction, ridge_regression
from fuzzycnc_ros.simulation.soft.foam_samples import foam_samples

SHEET = ('--thickness', '15mm', '--depth', '6mm', '--size', '200x120mm')
MARKS = ('--marks', 'marks.csv')
QUILT = (
    '<svg xmlns="http://www.w3.org/2000/svg" width="200mm" height="120mm" viewBox="0 0 200 120">'
    '<polygon points="40,80 90,80 125,45 75,45"/><polyline points="120,90 160,90 160,60"/></svg>'
)


@pytest.fixture
def done(fuzzycnc):
    def run(*arguments):
        outcome = fuzzycnc('soft', *arguments)
        assert outcome.code == 0, outcome
        return outcome.out

    return run


def off(path):
    """Return how far the stitches of a measured design lie off it, root mean square [mm]."""
    with open(path, newline='') as file:
        rows = list(csv.DictReader(file))
    apart = [
        [
            float(row[f'stitched_{axis}_mm'])
            - float(row[f'{axis}_mm'])
            + float(row[f'offset_{axis}_mm'])
            for axis in 'xy'
        ]
        for row in rows
    ]
    return float(np.sqrt((np.square(apart)).sum(axis=1).mean()))


@pytest.mark.slow
def test_a_design_is_learnt_from_photographs_of_two_rounds(done, tmp_path):
    (tmp_path / 'quilt.svg').write_text(QUILT)
    (tmp_path / 'zero.json').write_text(write_model(no_correction(*foam_samples(0))))
    done('pattern', '--out', 'trial.dst', *MARKS)
    options = ('--model', 'zero.json', *SHEET, '--step', '3mm', '--out', 'now.dst')
    done('compensate', 'quilt.svg', *options)
    (tmp_path / 'quilt.dst').write_bytes((tmp_path / 'now.dst').read_bytes())
    found = []
    for number in range(3):
        done(
            'simulate', 'now.dst', '--pattern', 'quilt.dst', *MARKS, '--seed', str(20 + number),
            '--out', f'{number}.png',
        )  # fmt: skip
        done(
            'measure', f'{number}.png', '--pattern', 'quilt.dst', '--stitched', 'now.dst', *MARKS,
            '--out', f'{number}.csv',
        )  # fmt: skip
        found.append(off(tmp_path / f'{number}.csv'))
        track = ('--path', 'quilt', '--material', 'foam', *SHEET[:2], *SHEET[4:])
        done('learn', f'{number}.csv', *track, '--out', 'offsets.json', '--force')
        options = ('--model', 'offsets.json', *SHEET, '--stitch-min', '0mm', '--out', 'now.dst')
        done('compensate', 'quilt.dst', *options)
    assert found[2] < found[0] / 3.0


@pytest.mark.slow
def test_the_commands_of_the_tutorial_work(fuzzycnc, tmp_path, root):
    page = (root / 'docs' / 'tutorials' / 'straight-patterns.md').read_text()
    drawing = page.split('```xml\n')[1].split('```')[0]
    (tmp_path / 'quilt.svg').write_text(drawing)
    lines = [line.strip() for line in page.splitlines() if line.startswith('    fuzzycnc ')]
    assert len(lines) == 6
    for line in lines:
        outcome = fuzzycnc(*line.split()[1:])
        assert outcome.code == 0, (line, outcome)
    assert {'marks.svg', 'model.json', 'quilt.html', 'quilt.png'} <= set(os.listdir(tmp_path))


def test_a_trial_gives_the_samples_of_its_lines(done, tmp_path):
    done('pattern', '--out', 'trial.pes', *MARKS, '--directions', '4', '--marks-page', 'm.svg')
    done('simulate', 'trial.pes', *MARKS, '--out', 'photo.png')
    options = ('--samples', 's.csv', *SHEET, '--json', 'o.json', '--out', 'm.csv')
    said = done('measure', 'photo.png', '--pattern', 'trial.pes', *MARKS, *options)
    assert 's.csv: 10 samples' in said
    document = json.loads((tmp_path / 'o.json').read_text())
    assert document['stitches'] + len(document['lost']) == 184
    samples = np.genfromtxt(tmp_path / 's.csv', delimiter=',', names=True)
    # the same lines, stitched twice
    assert samples['s_x_mm'][-2:] == pytest.approx(samples['s_x_mm'][:2], abs=0.6)
    # a step of two thirds drifts half as much again
    assert abs(samples['s_x_mm'][4]) > 1.2 * abs(samples['s_x_mm'][5])
    done('train', 's.csv', '--no-baselines', '--out', 'model.json')


def test_a_compensated_design_is_stitched_off_the_design_it_was_made_of(done, tmp_path):
    (tmp_path / 'model.json').write_text(write_model(ridge_regression(*foam_samples(0))))
    done('pattern', '--out', 'trial.dst', *MARKS, '--directions', '4')
    options = ('--model', 'model.json', *SHEET, '--stitch-min', '0mm', '--out', 'now.dst')
    done('compensate', 'trial.dst', *options)
    rms = []
    for name in ('trial.dst', 'now.dst'):
        drawn = ('--pattern', 'trial.dst', *MARKS, '--pixel', '0.5mm', '--out', f'{name}.png')
        said = done('simulate', name, *drawn)
        rms.append(float(said.split('stitches lie ')[1].split(' mm rms off the design')[0]))
    assert rms[1] < 0.8 * rms[0]


@pytest.mark.slow
def test_a_list_of_stitches_is_measured_learnt_and_compensated(done, tmp_path):
    """Its places are those on the sheet: it is not centred on it."""
    rows = [f'{x},30,{int(x == 40)}' for x in range(40, 101, 3)]
    rows += [f'100,{y},{int(y == 40)}' for y in range(40, 80, 3)]
    (tmp_path / 'plan.csv').write_text('\n'.join(['x_mm,y_mm,jump', *rows, '']))
    done('pattern', '--out', 'trial.dst', *MARKS, '--directions', '4')
    drawn = ('--pattern', 'plan.csv', *MARKS)
    done('simulate', 'plan.csv', *MARKS, '--pixel', '0.15mm', '--out', 'photo.png')
    done('measure', 'photo.png', *drawn, '--out', 'm.csv')
    track = ('--path', 'plan', '--material', 'foam', *SHEET[:2], *SHEET[4:])
    done('learn', 'm.csv', *track, '--out', 'offsets.json')
    options = ('--model', 'offsets.json', *SHEET, '--step', '3mm', '--out', 'now.csv')
    done('compensate', 'plan.csv', *options)
    said = done('simulate', 'now.csv', *drawn, '--pixel', '0.5mm', '--out', 'now.png')
    rms = float(said.split('stitches lie ')[1].split(' mm rms off the design')[0])
    assert rms < 0.5 * off(tmp_path / 'm.csv')


def test_what_cannot_be_is_refused(refused, done, tmp_path):
    done('pattern', '--out', 'trial.dst', *MARKS, '--directions', '4')
    (tmp_path / 'photo.jpg').write_bytes(b'no photo')
    (tmp_path / 'a.svg').write_text(QUILT)
    (tmp_path / 'a.ngc').write_text('G0 X20 Y20\nG1 X50 F600\n')
    measure = ('measure', 'photo.jpg', '--pattern', 'trial.dst', *MARKS, '--out', 'm.csv')
    for arguments, naming in (
        (('pattern', '--out', 'a.doc'), ['--out a.doc', '.dst']),
        (('pattern', '--out', 'a.dst', '--directions', '2'), ['--directions', '3 to 24']),
        (('pattern', '--out', 'a.dst', '--size', '80x80mm'), ['larger sheet']),
        (('pattern', '--out', 'trial.dst'), ['trial.dst', '--force']),
        (('simulate', 'trial.dst', *MARKS, '--out', 'a.jpg'), ['--out a.jpg', '.png']),
        (('simulate', 'trial.dst', '--marks', 'no.csv', '--out', 'a.png'), ['no.csv']),
        (measure, ['photo.jpg', 'cannot be read']),
        ((*measure, '--samples', 's.csv'), ['--thickness', '--samples']),
        (('simulate', 'a.svg', *MARKS, '--out', 'a.png'), ['a.svg', 'as .dst or .csv']),
        (('simulate', 'a.ngc', *MARKS, '--out', 'a.png'), ['a.ngc', 'as .dst or .csv']),
    ):
        refused('soft', *arguments, naming=naming)
    assert sorted(path.name for path in tmp_path.iterdir()) == [
        'a.ngc', 'a.svg', 'marks.csv', 'photo.jpg', 'trial.dst',
    ]  # fmt: skip

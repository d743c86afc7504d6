# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""`fuzzycnc soft compensate` on embroidery files, drawings, and lists with jumps."""

import csv
import json

import numpy as np
import pyembroidery as pe
import pytest
from designs import embroidery

from fuzzycnc_ros.core.deformation.model import write_model
from fuzzycnc_ros.core.deformation.offset_file import StitchOffsets, write_offsets
from fuzzycnc_ros.core.deformation.regression import no_correction, ridge_regression
from fuzzycnc_ros.simulation.soft.foam_samples import foam_samples
from fuzzycnc_ros.simulation.soft.foam_tracks import FoamTrack
from fuzzycnc_ros.studies.soft.design_files import read_design

SHEET = ('--model', 'model.json', '--thickness', '15mm', '--depth', '6mm')


@pytest.fixture
def model(tmp_path):
    (tmp_path / 'model.json').write_text(write_model(ridge_regression(*foam_samples(0))))


def stitched(path):
    found = read_design(path, None)
    return [found.design.points[run] for run in found.design.runs()]


@pytest.mark.parametrize('ending', ['.dst', '.jef'])
def test_a_model_without_correction_leaves_a_design_as_it_is(fuzzycnc, tmp_path, ending):
    (tmp_path / 'model.json').write_text(write_model(no_correction(*foam_samples(0))))
    path, own = embroidery(tmp_path / f'in{ending}'), tmp_path / f'own{ending}'
    pe.write(pe.read(str(path)), str(own), {'date': '20000101000000'})
    outcome = fuzzycnc(
        'soft', 'compensate', path.name, *SHEET, '--step', '3mm', '--out', f'out{ending}'
    )
    assert outcome.code == 0, outcome.err
    assert (tmp_path / f'out{ending}').read_bytes() == own.read_bytes()
    assert 'holds no correction' in outcome.out


def test_runs_are_compensated_each_by_itself(fuzzycnc, tmp_path, model):
    path = embroidery(tmp_path / 'in.dst')
    options = ('--step', '3mm', '--out', 'out.dst', '--json', 'o.json', '--report', 'page.html')
    outcome = fuzzycnc('soft', 'compensate', 'in.dst', *SHEET, *options)
    assert outcome.code == 0, outcome.err
    plan, found = stitched(path), stitched(tmp_path / 'out.dst')
    assert len(plan) == len(found) == 3
    for one, other in zip(plan, found, strict=True):
        assert other[0].tolist() == one[0].tolist()
    assert np.hypot(*(found[2][-1] - plan[2][-1])) > 5e-4
    document = json.loads((tmp_path / 'o.json').read_text())
    assert (document['runs'], document['steps']) == (3, sum(map(len, plan)) - 3)
    assert '3 runs on 47.5 x 35.0 mm' in outcome.out
    page = (tmp_path / 'page.html').read_text()
    assert 'Largest gaps between neighbouring runs' not in page  # they lie far apart
    assert '"true_scale":true' in page.replace(' ', '')


def test_a_jump_of_a_list_is_not_compensated(fuzzycnc, tmp_path, model):
    rows = [(20.0 + 3 * k, 40.0, 0) for k in range(12)] + [
        (20.0 + 3 * k, 80.0, int(k == 0)) for k in range(12)
    ]
    text = ['x_mm,y_mm,jump', *(f'{x},{y},{jump}' for x, y, jump in rows)]
    (tmp_path / 'in.csv').write_text('\n'.join(text) + '\n')
    outcome = fuzzycnc('soft', 'compensate', 'in.csv', *SHEET, '--step', '3mm', '--out', 'out.csv')
    assert outcome.code == 0, outcome.err
    with open(tmp_path / 'out.csv', newline='') as file:
        table = list(csv.DictReader(file))
    offset = np.array([[float(row['offset_x_mm']), float(row['offset_y_mm'])] for row in table])
    assert offset[12].tolist() == [0.0, 0.0]
    np.testing.assert_allclose(offset[:12], offset[12:], atol=2e-3)
    assert [row['jump'] for row in table] == [str(jump) for *_, jump in rows]


@pytest.mark.parametrize('cell', ['2', 'yes'])
def test_a_jump_is_0_or_1(refused, tmp_path, model, cell):
    (tmp_path / 'in.csv').write_text(f'x_mm,y_mm,jump\n20,20,0\n23,20,{cell}\n26,20,0\n')
    refused(
        'soft', 'compensate', 'in.csv', *SHEET, '--step', '3mm', '--out', 'out.csv',
        naming=['in.csv', 'line 3', 'jump'],
    )  # fmt: skip


def test_learnt_offsets_are_taken_for_the_runs_of_a_design(fuzzycnc, tmp_path):
    path = embroidery(tmp_path / 'in.dst')
    runs = stitched(path)
    points = np.concatenate(runs)
    offset = np.broadcast_to([4e-4, -3e-4], points.shape)
    text = write_offsets(StitchOffsets('leaf', 'foam', points, offset))
    (tmp_path / 'model.json').write_text(text)
    outcome = fuzzycnc('soft', 'compensate', 'in.dst', *SHEET, '--out', 'out.dst')
    assert outcome.code == 0, outcome.err
    for one, other in zip(runs, stitched(tmp_path / 'out.dst'), strict=True):
        np.testing.assert_allclose(other[1:], one[1:] + offset[0], atol=1e-9)


@pytest.mark.parametrize('ending', ['.dst', '.csv'])
@pytest.mark.parametrize(
    ('moved', 'thickness', 'naming'),
    [
        (0.0, 20e-3, ['offsets for a sheet of 20 mm, not of 15 mm']),
        (4e-3, 15e-3, ['lies 4000 µm from the one they were learnt at, as all do']),
    ],
)
def test_learnt_offsets_are_for_the_whole_design_on_one_sheet(
    refused, tmp_path, ending, moved, thickness, naming
):
    runs = stitched(embroidery(tmp_path / 'in.dst'))
    rows = [f'{x:.4f},{y:.4f},{int(n == 0)}' for r in runs for n, (x, y) in enumerate(1e3 * r)]
    (tmp_path / 'in.csv').write_text('\n'.join(['x_mm,y_mm,jump', *rows, '']))
    points = np.add(np.concatenate(runs), [moved, 0.0])
    learnt = StitchOffsets('leaf', 'foam', points, np.full_like(points, 3e-4), thickness)
    (tmp_path / 'model.json').write_text(write_offsets(learnt))
    step = f'{1e3 * np.median(np.hypot(*np.diff(runs[0], axis=0).T)):.3f}mm'
    options = (f'in{ending}', *SHEET, '--step', step, '--out', f'out{ending}')
    remedy = ['--size'] if moved and ending == '.dst' else []
    refused('soft', 'compensate', *options, naming=[f'in{ending}', *naming, *remedy])
    assert not (tmp_path / f'out{ending}').exists()


def test_a_drawing_becomes_a_program_for_a_longarm(fuzzycnc, tmp_path, model):
    corners = 1e3 * FoamTrack.parallelogram(np.radians(45.0)).points[[0, 23, 40, 63]]
    points = ' '.join(f'{x:.3f},{100 - y:.3f}' for x, y in corners)
    (tmp_path / 'in.svg').write_text(
        '<svg xmlns="http://www.w3.org/2000/svg" width="150mm" height="100mm" '
        f'viewBox="0 0 150 100"><polygon points="{points}"/></svg>'
    )
    options = ('--step', '3mm', '--size', '150x100mm', '--out', 'out.ngc')
    outcome = fuzzycnc('soft', 'compensate', 'in.svg', *SHEET, *options)
    assert outcome.code == 0, outcome.err
    lines = (tmp_path / 'out.ngc').read_text().splitlines()
    assert lines[0] == 'G21 G90'
    assert [line[:2] for line in lines[1:-1]] == ['G0', *['G1'] * 80]
    assert lines[2].endswith(' F1200')


def test_refusals_name_the_file_and_write_nothing(refused, tmp_path, model):
    path = embroidery(tmp_path / 'in.dst')
    for arguments, naming in (
        (('in.dst', *SHEET, '--out', 'out.doc'), ['--out out.doc', '.dst', '.doc']),
        (('in.dst', *SHEET, '--size', '20x20mm', '--out', 'out.dst'), ['in.dst', 'clamped area']),
        (('none.dst', *SHEET, '--out', 'out.dst'), ['none.dst', 'found no file']),
        (('in.dst', *SHEET, '--stitch-max', '7', '--out', 'out.dst'), ['--stitch-max', 'unit']),
        (('in.dst', *SHEET, '--out', 'in.dst'), ['--out in.dst', '--in-place']),
        (('in.svg', *SHEET, '--out', 'out.dst'), ['in.svg', 'found no file']),
        (('in.ngc', *SHEET, '--out', 'out.ngc'), ['--step']),
    ):
        (tmp_path / 'in.ngc').write_text('G0 X0 Y0\n')
        refused('soft', 'compensate', *arguments, naming=naming)
    assert sorted(item.name for item in tmp_path.iterdir()) == ['in.dst', 'in.ngc', 'model.json']
    assert path.exists()


def test_the_old_name_of_the_commands_is_taken_with_a_note(fuzzycnc, tmp_path):
    outcome = fuzzycnc('foam', 'train', '--help')
    assert outcome.code == 0
    assert 'fuzzycnc soft train' in outcome.out
    assert outcome.err.startswith('note: `fuzzycnc foam` is now `fuzzycnc soft`')

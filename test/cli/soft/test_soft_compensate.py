# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""`fuzzycnc soft compensate`: programs and lists of stitches, and what is refused."""

import csv
import json
from dataclasses import replace

import numpy as np
import pytest

from fuzzycnc_ros.core.deformation.compensation import compensate_path
from fuzzycnc_ros.core.deformation.model import write_model
from fuzzycnc_ros.core.deformation.network import TSFuzzyNetwork
from fuzzycnc_ros.core.deformation.offset_file import StitchOffsets, write_offsets
from fuzzycnc_ros.core.deformation.stitch_path import SheetMaterial, StitchPath
from fuzzycnc_ros.core.deformation.stitched_program import StitchedProgram
from fuzzycnc_ros.core.feedrate.gcode.reader import read_program
from fuzzycnc_ros.simulation.soft.foam_samples import foam_samples
from fuzzycnc_ros.simulation.soft.foam_sheet import FoamSheet
from fuzzycnc_ros.simulation.soft.foam_tracks import FoamTrack

TRACK = FoamTrack.parallelogram(np.radians(45.0))
CORNERS = 1e3 * TRACK.points[list(TRACK.corners)]
SHEET = ('--model', 'model.json', '--thickness', '15mm', '--depth', '6mm', '--step', '3mm')


@pytest.fixture(scope='module')
def trained():
    return TSFuzzyNetwork(ridge=0.03).fit(*foam_samples(1)).model_


@pytest.fixture
def model(tmp_path, trained):
    (tmp_path / 'model.json').write_text(write_model(trained))
    return trained


@pytest.fixture
def program(tmp_path):
    (x, y), *others = CORNERS[:-1].round(5).tolist()
    lines = ['G21 G90', 'G0 Z5', f'G0 X{x} Y{y}', 'G1 Z-1 F300']
    lines += [f'G1 X{a} Y{b} F1200 (side)' for a, b in [*others, (x, y)]]
    (tmp_path / 'quilt.ngc').write_text('\n'.join([*lines, 'G0 Z5', 'M30', '']))
    return lines


def expected(model):
    path = StitchPath(TRACK.points, depth=6e-3, step=3e-3)
    return compensate_path(path, SheetMaterial(15e-3, (0.15, 0.1)), model.predict, gate=model)


@pytest.fixture
def learnt(tmp_path):
    """Offsets of the track, as `soft learn` writes them."""
    angle = np.linspace(0.0, np.pi, len(TRACK.points))
    offset = 1e-3 * np.column_stack([np.sin(angle), np.sin(2.0 * angle)])
    found = StitchOffsets('track', 'foam', TRACK.points, offset, 15e-3)
    (tmp_path / 'model.json').write_text(write_offsets(found))
    return found


def test_learnt_offsets_are_taken_for_the_track_that_they_are_of(
    fuzzycnc, tmp_path, learnt, program
):
    quilt = tmp_path / 'quilt.ngc'
    circle = 'G0 X20 Y20\nG1 X40 Y20 F1200\nG0 Z5\n'
    quilt.write_text(quilt.read_text().replace('M30', f'{circle}M30'))
    outcome = fuzzycnc('soft', 'compensate', 'quilt.ngc', *SHEET, '--out', 'out.ngc')
    assert outcome.code == 0, outcome.err
    assert 'model.json is for one figure alone' in ' '.join(outcome.out.split())
    ends = np.array([s.end[:2] for s in read_program((tmp_path / 'out.ngc').read_text()).segments])
    wanted = TRACK.points[1:] + learnt.offset[1:]
    np.testing.assert_allclose(ends[3 : 3 + len(wanted)], wanted, atol=1e-6)


def test_offsets_learnt_with_jumps_are_taken_for_all_figures_of_a_program(fuzzycnc, tmp_path):
    (tmp_path / 'two.ngc').write_text(
        'G0 X20 Y20\nG1 X50 Y20 F1200\nX50 Y50\nG0 X80 Y20\nG1 X110 Y20\nM30\n'
    )
    figures = StitchedProgram((tmp_path / 'two.ngc').read_text().splitlines(True), 3e-3).figures
    points = np.concatenate([figure.path(6e-3, 3e-3).points for figure in figures])
    offset = np.full_like(points, 2e-4)
    text = write_offsets(StitchOffsets('two', 'foam', points, offset, 15e-3))
    (tmp_path / 'model.json').write_text(text)
    outcome = fuzzycnc('soft', 'compensate', 'two.ngc', *SHEET, '--out', 'out.ngc')
    assert outcome.code == 0, outcome.err
    found = read_program((tmp_path / 'out.ngc').read_text()).segments
    ends = np.array([segment.end[:2] for segment in found if not segment.rapid])
    wanted = np.delete(points + offset, [0, len(figures[0].path(6e-3, 3e-3).points)], axis=0)
    np.testing.assert_allclose(ends, wanted, atol=1e-6)


def test_offsets_of_an_unknown_thickness_are_taken_with_a_note(
    fuzzycnc, tmp_path, learnt, program
):
    (tmp_path / 'model.json').write_text(write_offsets(replace(learnt, thickness=None)))
    outcome = fuzzycnc('soft', 'compensate', 'quilt.ngc', *SHEET, '--out', 'out.ngc')
    assert outcome.code == 0, outcome.err
    assert 'model.json does not say for what thickness' in outcome.out


def test_learnt_offsets_are_of_one_thickness(fuzzycnc, tmp_path, learnt, program):
    sheet = ['20mm' if text == '15mm' else text for text in SHEET]
    outcome = fuzzycnc('foam', 'compensate', 'quilt.ngc', *sheet, '--out', 'out.ngc')
    assert outcome.code == 2
    assert 'offsets for a sheet of 15 mm, not of 20 mm' in ' '.join(outcome.err.split())
    assert not (tmp_path / 'out.ngc').exists()


def test_learnt_offsets_are_taken_for_a_list_of_stitches(fuzzycnc, tmp_path, learnt):
    rows = [f'{x:.4f},{y:.4f}' for x, y in 1e3 * TRACK.points]
    (tmp_path / 'in.csv').write_text('\n'.join(['x_mm,y_mm', *rows]) + '\n')
    outcome = fuzzycnc('soft', 'compensate', 'in.csv', *SHEET, '--out', 'out.csv')
    assert outcome.code == 0, outcome.err
    table = list(csv.DictReader((tmp_path / 'out.csv').read_text().splitlines()))
    offset = [[float(row['offset_x_mm']), float(row['offset_y_mm'])] for row in table]
    np.testing.assert_allclose(offset, 1e3 * learnt.offset, atol=1e-4)


def test_learnt_offsets_of_other_stitches_are_refused(refused, tmp_path, learnt):
    rows = [f'{x:.4f},{y:.4f}' for x, y in 1e3 * TRACK.points[:40]]
    (tmp_path / 'in.csv').write_text('\n'.join(['x_mm,y_mm', *rows]) + '\n')
    naming = ['in.csv', 'model.json was learnt on', 'offsets of 81 points, not of 40']
    refused('soft', 'compensate', 'in.csv', *SHEET, '--out', 'out.csv', naming=naming)
    assert not (tmp_path / 'out.csv').exists()


def test_offsets_have_no_gains_to_adapt(refused, tmp_path, learnt):
    (tmp_path / 's.csv').write_text(
        'direction_deg,depth_mm,type,step_mm,thickness_mm,s_x_mm,s_y_mm\n0,6,2,3,15,1,1\n'
    )
    options = ('s.csv', '--adapt', 'model.json', '--out', 'm.json')
    refused('soft', 'train', *options, naming=['model.json', 'offsets of one track'])


def test_a_program_is_compensated_as_its_path_is(fuzzycnc, tmp_path, model, program):
    options = ('--size', '150x100mm', '--out', 'out.ngc', '--json', 'out.json')
    outcome = fuzzycnc('soft', 'compensate', 'quilt.ngc', *SHEET, *options)
    assert outcome.code == 0, outcome.err
    text = (tmp_path / 'out.ngc').read_text()
    assert text.splitlines()[:4] == program[:4]
    assert text.endswith('\nG0 Z5\nM30\n')
    ends = np.array([segment.end[:2] for segment in read_program(text).segments])
    stitches = ends[3:-1]
    np.testing.assert_allclose(stitches, expected(model).commanded[1:], atol=0.2e-6)
    points = np.concatenate([TRACK.points[:1], stitches])
    before, after = (
        TRACK.measure(FoamSheet(15e-3, (0.15, 0.1)).stitch(path, 6e-3))
        for path in (TRACK.points, points)
    )
    assert after.angle_error < 0.2 * before.angle_error
    document = json.loads((tmp_path / 'out.json').read_text())
    assert (document['steps'], document['refused'], document['lines']) == (80, 0, [])
    assert f'{1e3 * document["largest_offset"]:.3f} mm' in outcome.out


def test_a_list_of_stitches_keeps_its_other_columns(fuzzycnc, tmp_path, model):
    rows = [['note', 'y_mm', 'x_mm']]
    rows += [
        [f'n{k}', f'{1e3 * y:.6f}', f'{1e3 * x:.6f}'] for k, (x, y) in enumerate(TRACK.points)
    ]
    rows[0].append('remark')  # no row has one
    with open(tmp_path / 'in.csv', 'w', newline='') as file:
        csv.writer(file).writerows(rows)
    options = ('--size', '150x100mm', '--out', 'out.csv')
    outcome = fuzzycnc('soft', 'compensate', 'in.csv', *SHEET, *options)
    assert outcome.code == 0, outcome.err
    with open(tmp_path / 'out.csv', newline='') as file:
        found = list(csv.DictReader(file))
    assert [row['note'] for row in found] == [row[0] for row in rows[1:]]
    assert {row['remark'] for row in found} == {''}
    commanded = 1e-3 * np.array([[float(row['x_mm']), float(row['y_mm'])] for row in found])
    wanted = expected(model)
    np.testing.assert_allclose(commanded, wanted.commanded, atol=0.1e-6)
    offset = [[float(row['offset_x_mm']), float(row['offset_y_mm'])] for row in found]
    np.testing.assert_allclose(offset, 1e3 * wanted.offset, atol=1e-4)
    assert {row['flag'] for row in found} == {'0'}


def test_refused_steps_are_named_by_their_lines(fuzzycnc, tmp_path, model):
    text = 'G0 X40 Y40\nG1 X70 F900\nY70\nG2 X85 Y55 I15\nG1 X55\n'
    (tmp_path / 'in.ngc').write_text(text)
    outcome = fuzzycnc(
        'soft', 'compensate', 'in.ngc', *SHEET, '--out', 'out.ngc', '--json', 'o.json'
    )
    assert outcome.code == 0, outcome.err
    document = json.loads((tmp_path / 'o.json').read_text())
    assert [(item['line'], item['refused']) for item in document['lines']] == [(3, 10), (4, 24)]
    assert 'unlike the samples' in document['lines'][0]['reasons']
    assert 'arc to the right' in document['lines'][1]['reasons']
    assert '54 stitches, 34 of them not compensated' in outcome.out
    # a program of which nothing can be compensated stays as it is
    (tmp_path / 'up.ngc').write_text('G0 X40 Y10\nG1 Y70 F900 (up)\nM30\n')
    outcome = fuzzycnc('soft', 'compensate', 'up.ngc', *SHEET, '--out', 'same.ngc')
    assert outcome.code == 0, outcome.err
    assert (tmp_path / 'same.ngc').read_text() == (tmp_path / 'up.ngc').read_text()


def test_limited_steps_are_named(fuzzycnc, tmp_path, model):
    (tmp_path / 'in.ngc').write_text('G0 X40 Y0.5\nG1 X100 F900\n')
    outcome = fuzzycnc(
        'soft', 'compensate', 'in.ngc', *SHEET, '--size', '150x100mm', '--out', 'out.ngc'
    )
    assert outcome.code == 0, outcome.err
    assert 'edge of the sheet' in outcome.out
    assert ' Y0.\n' in (tmp_path / 'out.ngc').read_text()


def test_standard_output_has_the_program_alone(fuzzycnc, model, program):
    outcome = fuzzycnc('soft', 'compensate', 'quilt.ngc', *SHEET, '--out', '-')
    assert outcome.code == 0
    assert outcome.out.splitlines()[:4] == program[:4]
    assert '80 stitches' in outcome.err


@pytest.mark.parametrize(
    ('option', 'value', 'naming'),
    [
        ('--thickness', '15', ['--thickness', 'unit', '15mm']),
        ('--thickness', '-1mm', ['--thickness', 'above 0']),
        ('--depth', '12.1mm', ['quilt.ngc', 'at most 0.8', 'through the sheet']),
        ('--step', '60mm', ['quilt.ngc: line 6', 'at least the stitch step of 60 mm']),
        ('--size', '150mm', ['--size', '150x100mm', "'150mm'"]),
        ('--size', '100x100mm', ['quilt.ngc: line 6', '100 x 100 mm']),
        ('--units', 'cm', ['--units', "'cm'"]),
        ('--model', 'no.json', ['no.json', 'model file']),
        ('--model', 'quilt.ngc', ['quilt.ngc', 'expected JSON']),
        ('--out', 'quilt.ngc', ['--out quilt.ngc', '--in-place']),
        ('--out', 'no/out.ngc', ['no/out.ngc', 'folder']),
    ],
)
def test_bad_options_are_refused(refused, tmp_path, model, program, option, value, naming):
    arguments = ['quilt.ngc', *SHEET, '--out', 'out.ngc', option, value]
    refused('soft', 'compensate', *arguments, naming=naming)
    assert not (tmp_path / 'out.ngc').exists()


@pytest.mark.parametrize(
    ('name', 'text', 'naming'),
    [
        ('a.csv', 'x,y\n1,2\n', ['a.csv: line 1', 'x_mm, y_mm']),
        ('a.csv', 'x_mm,y_mm\n1,2\n4,inf\n', ['line 3', 'y_mm', 'finite']),
        ('a.csv', 'x_mm,y_mm\n1,2\n4\n', ['line 3', 'y_mm', 'finite']),
        ('a.csv', 'x_mm,y_mm\n1,2\n4,2,9\n', ['line 3', '2 cells', 'found 3']),
        ('a.csv', 'x_mm,y_mm\n1,2\n', ['two points or more', '1']),
        ('a.csv', 'x_mm,y_mm\n1,2\n1,2\n', ['stitches, 3 mm apart', '0 mm']),
        ('a.csv', 'x_mm,y_mm\n1,2\n9,2\n', ['stitches, 3 mm apart', '8 mm', '--step']),
        ('a.csv', 'x_mm,y_mm,kind\n1,2,2\n4,2,7\n', ['kind: expected 1 (arc) or 2 (line)', '7']),
        ('a.csv', 'x_mm,y_mm,flag\n1,2,0\n4,2,0\n', ['flag', 'compensated already']),
        ('a.ngc', 'G1 X10 F100\nG1 X11\n', ['a.ngc: line 2', 'at least the stitch step']),
        ('a.ngc', 'G91 G1 X10 F100\n', ['a.ngc: line 1', 'G91']),
        ('a.ngc', 'G1 X10\n', ['a.ngc: line 1', 'feed']),
        ('a.ngc', 'M30\n', ['found none to stitch']),
        ('a.ngc', '', ['empty']),
    ],
)
def test_bad_paths_are_refused(refused, tmp_path, model, name, text, naming):
    (tmp_path / name).write_text(text)
    refused('soft', 'compensate', name, *SHEET, '--out', 'out', naming=naming)
    assert not (tmp_path / 'out').exists()
    refused('soft', 'compensate', 'nothing.ngc', *SHEET, '--out', 'out', naming=['nothing.ngc'])

# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Hostile files that commands work on: samples, records, axes, stitches, points of a path."""

import csv
import random
from functools import cache
from io import StringIO

import numpy as np
import pytest
from benches import pattern_bench
from designs import embroidery
from fuzzing.campaign import SEEDS, fuzz, refusal, refused_or_read
from fuzzing.file_mutations import damaged, mutated_bytes
from hypothesis import given

from fuzzycnc_ros.cli.soft.compensate import PathCompensator, shifted_points, shifted_program
from fuzzycnc_ros.core.deformation.model import read_model
from fuzzycnc_ros.core.deformation.stitch_path import SheetMaterial
from fuzzycnc_ros.core.identify.robustness import AxisModels
from fuzzycnc_ros.core.servo.axis_control import make_axis_controller
from fuzzycnc_ros.machine_file.reader import read_machine_file
from fuzzycnc_ros.simulation.soft.foam_samples import foam_samples
from fuzzycnc_ros.simulation.soft.foam_tracks import FoamTrack
from fuzzycnc_ros.studies.pareto.pareto_path import table_path
from fuzzycnc_ros.studies.servo.identify_recording import read_columns
from fuzzycnc_ros.studies.servo.recorded_moves import read_csv
from fuzzycnc_ros.studies.soft.design_files import WRITTEN, read_design
from fuzzycnc_ros.studies.soft.foam_records import COLUMNS, read_samples

pytestmark = pytest.mark.filterwarnings('ignore::RuntimeWarning')

TRACK = 1e3 * FoamTrack.parallelogram(np.radians(45.0)).points
PROGRAM = 'G21 G90\nG0 X22.3 Y32.3\nG1 X92.3 F1200\nG1 X127.6 Y67.6\nG3 X97.6 Y67.6 I-15\nM2\n'
MOVES = [
    f'{1e-3 * k:.3f},{10 * (k > 9)},{min(0.1 * k, 10):.3f},{0.2 * (k < 99):g}' for k in range(120)
]

IDENTIFIED = """machine: mill
axes:
  X:
    limits: {velocity: 140 mm/s, travel_low: -12.3 mm, travel_high: 258 mm, resonance: 0 Hz}
    plant: {model: mass, mass: 93.2 kg, count: 0.1 um, delay: 0.456 ms, mode: 60 Hz}
    knowledge:
      known_to: 68.1 Hz
      gain_low: 0.97
      gain_high: 1.03
      delay_low: 0.1 ms
      mode_low: 55 Hz
      mode_high: 66 Hz
      damping_low: 0.02
      unexplained: 0.06
      remainder: "1.19:4.8 13.45:0.35 53.8:0.43 107.6:6"
      not_fit_for_control: ""
"""


@pytest.fixture(scope='module')
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp('fuzz')


@cache
def job_parts():
    """Return a model and its sheet."""
    return read_model(pattern_bench.model_text()), SheetMaterial(15e-3, (0.15, 0.1))


@cache
def samples_text() -> str:
    """Return a table of samples."""
    x, s = foam_samples(0)
    rows = np.column_stack([x, s])[::9]
    lines = [','.join(f'{cell:.6g}' for cell in row) for row in rows]
    return '\n'.join(
        [f'{",".join(COLUMNS)},sheet'] + [f'{line},s{k}' for k, line in enumerate(lines)]
    )


@fuzz(25, share=0.2)
@given(seed=SEEDS)
def test_samples_of_soft_material(folder, seed):
    file = folder / 'samples.csv'
    file.write_bytes(damaged(samples_text(), random.Random(seed)))

    def read(path):
        found = read_samples([path])
        assert np.isfinite(found.x).all()
        assert np.isfinite(found.s).all()

    refused_or_read(read, file)


@fuzz(25, share=0.2)
@given(seed=SEEDS)
def test_records_of_an_axis(folder, seed):
    file = folder / 'moves.csv'
    text = '\n'.join(['t,reference,position,duty', *MOVES])
    file.write_bytes(damaged(text, random.Random(seed)))

    def read(path):
        found = read_csv(path, 1e-3)
        assert np.isfinite(found.position).all()

    refused_or_read(read, file)


@fuzz(25, share=0.2)
@given(seed=SEEDS)
def test_stitches(folder, seed):
    rng = random.Random(seed)
    rows = [f'{x:.3f},{y:.3f},2,0' for x, y in TRACK]
    file = folder / 'stitches.csv'
    file.write_bytes(damaged('\n'.join(['x_mm,y_mm,kind,turn', *rows]), rng))
    written = []
    job = PathCompensator(*job_parts(), 6e-3, 3e-3)
    if not refusal(ValueError, lambda: written.append(shifted_points(file, job))):
        header, *lines = csv.reader(StringIO(written[0]))
        places = [header.index(name) for name in ('x_mm', 'y_mm', 'offset_x_mm', 'offset_y_mm')]
        assert np.isfinite([[float(line[place]) for place in places] for line in lines]).all()


@fuzz(25, share=0.2)
@given(seed=SEEDS)
def test_identified_axes(folder, seed):
    file = folder / 'axis.yaml'
    file.write_bytes(damaged(IDENTIFIED, random.Random(seed)))

    def read(path):
        data = read_machine_file(path).axes.get('X')
        if data is None or data.plant is None or data.knowledge.not_fit_for_control:
            return
        models = AxisModels(data)
        margin = models.margin(make_axis_controller(data, 'pid'), spread=False)
        assert np.isfinite(models.deviation).all()
        assert np.isfinite([margin.distance, margin.radius, margin.yielding]).all()

    refused_or_read(read, file)


@fuzz(25, share=0.2)
@given(seed=SEEDS)
def test_recordings_of_an_axis(folder, seed):
    file = folder / 'recording.csv'
    text = '\n'.join(['t,set,actual,duty', *MOVES])
    file.write_bytes(damaged(text, random.Random(seed)))

    def read(path):
        wanted = {'t': 't', 'reference': 'set', 'position': 'actual', 'command': 'duty'}
        for part in read_columns(path, wanted, None):
            assert part.period > 0.0
            assert all(np.isfinite(values).all() for values in part.values.values())

    refused_or_read(read, file)


@fuzz(25, share=0.2)
@given(seed=SEEDS)
def test_stitched_programs(folder, seed):
    file = folder / 'quilt.ngc'
    file.write_bytes(damaged(PROGRAM, random.Random(seed)))
    written = []
    job = PathCompensator(*job_parts(), 6e-3, 3e-3)
    if not refusal(ValueError, lambda: written.append(shifted_program(file, 'mm', job))):
        assert 'nan' not in written[0].lower() or 'nan' in file.read_text(errors='replace').lower()


@fuzz(25, share=0.2)
@given(seed=SEEDS)
def test_points_of_a_path(seed):
    text = '\n'.join(['x,y', *(f'{x:.3f},{y:.3f}' for x, y in TRACK)])
    found = []
    hostile = damaged(text, random.Random(seed)).decode(errors='surrogateescape')
    if not refusal(ValueError, lambda: found.append(table_path(hostile))):
        assert np.isfinite(found[0].arc_length).all()


@pytest.mark.parametrize(
    'make', [samples_text, lambda: '\n'.join(['t,reference,position,duty', *MOVES])]
)
def test_the_tables_themselves_are_read(folder, make):
    file = folder / 'good.csv'
    file.write_text(make())
    assert read_samples([file]) if make is samples_text else read_csv(file, 1e-3)


def test_the_stitches_themselves_are_shifted(folder):
    file = folder / 'good.ngc'
    file.write_text(PROGRAM)
    text = shifted_program(file, 'mm', PathCompensator(*job_parts(), 6e-3, 3e-3))
    assert text.count('\n') > 30


@fuzz(25, share=0.2)
@given(seed=SEEDS)
def test_designs_of_stitching_machines(folder, seed):
    rng = random.Random(seed)
    file = embroidery(folder / f'design{rng.choice(WRITTEN)}')
    file.write_bytes(mutated_bytes(file.read_bytes(), rng))
    refused_or_read(lambda path: read_design(path, None), file)


DRAWING = """<svg xmlns="http://www.w3.org/2000/svg" width="90mm" viewBox="0 0 90 60">
<g transform="rotate(10) scale(1.5)"><path d="M 1 1 C 9 9 20 -9 30 2 A 5 5 0 0 1 9 9 Z"/>
<use href="#a"/><rect id="a" x="3" y="3" width="20" height="9" rx="2"/></g></svg>"""


@fuzz(25, share=0.2)
@given(seed=SEEDS)
def test_drawings_to_be_stitched(folder, seed):
    file = folder / 'drawing.svg'
    file.write_bytes(damaged(DRAWING, random.Random(seed)))
    refused_or_read(lambda path: read_design(path, 3e-3), file)

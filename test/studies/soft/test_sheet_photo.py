# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Stitches on photographs that were drawn: how exactly they are measured, and what is refused."""

from dataclasses import replace

import numpy as np
import pytest

from fuzzycnc_ros.core.deformation.trial_lines import trial_plan, trial_runs
from fuzzycnc_ros.simulation.soft.foam_sheet import FoamSheet
from fuzzycnc_ros.studies.soft.rendered_photo import Camera, rendered_photo
from fuzzycnc_ros.studies.soft.sheet_marks import (
    marks_around,
    printed_marks,
    read_marks,
    write_marks,
)
from fuzzycnc_ros.studies.soft.sheet_photo import measure_runs, read_photo, sheet_view

pytest.importorskip('cv2', reason="it is missing: pip install 'fuzzycnc_ros[camera]'")

SIZE = (0.2, 0.12)
MARKS = marks_around(SIZE)
RUNS = trial_runs(trial_plan(8, 3e-3), SIZE, 16e-3)
DARK = Camera(noise=4.0, shadow=0.6, exposure=0.35)
HARD = Camera(slant=0.12, turn=-0.08, bend=0.03, blur=1.2, noise=8.0, shadow=0.6)


def stitched(seed, runs=RUNS):
    rng = np.random.default_rng(seed)
    sheet = FoamSheet(15e-3, SIZE).scattered(rng)
    return [sheet.stitch(run, 6e-3, rng=rng) for run in runs], rng


@pytest.mark.parametrize(
    ('camera', 'seed'),
    [
        (Camera(), 40),
        (HARD, 41),
        pytest.param(Camera(pixel=0.13e-3), 42, marks=pytest.mark.slow),
        pytest.param(DARK, 43, marks=pytest.mark.slow),
    ],
)
def test_stitches_are_measured_to_a_tenth_of_a_millimetre(camera, seed):
    places, rng = stitched(seed)
    image = rendered_photo(places, MARKS, SIZE, camera, rng)
    view = sheet_view(image, MARKS)
    found = measure_runs(image, view, MARKS, RUNS, SIZE)
    error = np.concatenate(found.runs) - np.concatenate(places)
    assert np.sqrt((error**2).sum(axis=1).mean()) < 0.1e-3
    assert len(found.lost()) <= 3
    assert view.bend == pytest.approx(camera.bend, abs=5e-3)
    assert view.residual < 0.1e-3


def test_stitches_that_are_not_seen_are_named():
    runs = [RUNS[0]]
    places, rng = stitched(44, runs)
    seen = [places[0][:9], places[0][11:]]  # a stretch of the seam is hidden
    image = rendered_photo(seen, MARKS, SIZE, Camera(), rng)
    found = measure_runs(image, sheet_view(image, MARKS), MARKS, runs, SIZE)
    lost = found.lost()
    assert {'run 1: stitch 10', 'run 1: stitch 11'} <= set(lost)
    assert len(lost) <= 4
    np.testing.assert_allclose(found.runs[0], places[0], atol=0.4e-3)


def test_marks_that_are_hidden_are_named():
    places, rng = stitched(45, RUNS[:1])
    image = rendered_photo(places, MARKS[:2], SIZE, Camera(), rng)
    with pytest.raises(ValueError, match=r'expected 3 marks or more of 0, 1, .* but found 0, 1;'):
        sheet_view(image, MARKS)


def test_marks_are_read_as_they_are_written(tmp_path):
    (tmp_path / 'marks.csv').write_text(write_marks(MARKS))
    for found, mark in zip(read_marks(tmp_path / 'marks.csv'), MARKS, strict=True):
        assert found.number == mark.number
        np.testing.assert_allclose(found.corners(), mark.corners(), atol=1e-9)
    page = printed_marks(MARKS, SIZE)
    assert 'width="200mm" height="120mm"' in page
    assert page.count('<rect') > 100


@pytest.mark.parametrize(
    ('row', 'naming'),
    [
        ('7,10,10,10', 'line 10: id: expected each mark'),
        ('50,10,10,10', 'line 10: id'),
        ('1.5,10,10,10', 'line 10: id'),
        ('8,10,10,0', 'line 10: size_mm'),
        ('8,x,10,10', 'line 10'),
    ],
)
def test_marks_that_cannot_be_are_refused(tmp_path, row, naming):
    path = tmp_path / 'marks.csv'
    path.write_text(f'{write_marks(MARKS)}{row}\n')
    with pytest.raises(ValueError, match=naming):
        read_marks(path)


@pytest.mark.parametrize('content', [b'', b'no photo', b'\x89PNG\r\n\x1a\n' + bytes(50)])
def test_what_is_no_photograph_is_refused(tmp_path, content):
    path = tmp_path / 'photo.jpg'
    path.write_bytes(content)
    with pytest.raises(ValueError, match=r'photo\.jpg: expected a photograph'):
        read_photo(path)


def test_a_mark_off_its_place_shows():
    places, rng = stitched(46, RUNS[:1])
    moved = [replace(MARKS[0], middle=(12e-3, 8e-3)), *MARKS[1:]]
    image = rendered_photo(places, moved, SIZE, Camera(), rng)
    assert sheet_view(image, MARKS).residual > 0.1e-3

# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Component `deformation_compensator`: bad patterns, sheets and models, each by name."""

import numpy as np
import pytest
from benches.pattern_bench import CORNERS, Compensator, material, model_text, pattern

from fuzzycnc_ros.core.names import text_hash


@pytest.fixture(scope='module')
def model():
    """Text of a model of simulated samples."""
    return model_text()


BAD_PATTERNS = {
    'no name': ({'path_id': ''}, 'path_id: expected a name'),
    'no primitive': (
        {n: np.zeros(0) for n in ('kind', 'end', 'centre', 'turn', 'depth', 'step', 'feedrate')},
        'kind: expected at least one primitive but found none',
    ),
    'short array': ({'depth': np.full(3, 6e-3)}, 'depth: expected 4 values but found 3'),
    'start in space': ({'start': np.zeros(3)}, 'start: expected 2 values but found 3'),
    'kind': ({'kind': np.array([0, 0, 7, 0], np.uint8)}, r'kind: .* found 7 for primitive 2'),
    'trim that moves': (
        {'kind': np.array([0, 3, 0, 0], np.uint8)},
        'end: expected primitive 1 where the last one ends, since it is a trim, but found it 50',
    ),
    'jumps alone': (
        {'kind': np.full(4, 2, np.uint8)},
        'end: expected at least one primitive with a length but found none',
    ),
    'NaN point': (
        {'end': np.array([0.09, 0.03, np.nan, 0.0, 0.0, 0.0, 0.0, 0.0])},
        'end: expected coordinates .* found nan for primitive 1',
    ),
    'NaN start': ({'start': np.array([np.nan, 0.0])}, 'start: .* found nan'),
    'millimetres': ({'start': np.array([22322.0, 32.0])}, r'start: expected coordinates up to'),
    'no depth': ({'depth': np.zeros(4)}, 'depth: expected more than 0 m but found 0.0'),
    'NaN depth': ({'depth': np.full(4, np.nan)}, 'depth: expected more than 0 m but found nan'),
    'no step': ({'step': np.full(4, -3e-3)}, 'step: expected more than 0 m but found -0.003'),
    'long step': (
        {'step': np.full(4, 0.06)},
        'primitive 1: step: expected at most the length of the primitive of 50 mm',
    ),
    'tiny step': ({'step': np.full(4, 1e-9)}, 'step: expected up to 200000 stitches'),
    'no feed': ({'feedrate': np.zeros(4)}, 'feedrate: expected more than 0 m/s but found 0.0'),
    'endless feed': ({'feedrate': np.full(4, np.inf)}, 'feedrate: expected more than 0 m/s'),
    'NaN turn': ({'turn': np.full(4, np.nan)}, 'turn: expected a finite angle'),
    'through the sheet': (
        {'depth': np.full(4, 12.1e-3)},
        'expected at most 0.8 of the thickness of 15 mm but found 12.1 mm in step 0: the foot',
    ),
    'off the sheet': (
        {'start': np.array([-0.001, 0.03])},
        r'within the clamped area of 150 x 100 mm but found \[-1.0, 30.0\] mm at index 0',
    ),
    'frame': (
        {'frame_id': 'lathe/workpiece'},
        "frame_id of pattern: expected mill/workpiece but found 'lathe/workpiece'",
    ),
    'arc without centre': (
        {'kind': np.ones(4, np.uint8)},
        'centre: expected coordinates .* found nan for primitive 0',
    ),
    'arc in degrees': (
        {
            'kind': np.array([1, 0, 0, 0], np.uint8),
            'centre': np.array([0.0573, 0.0323] + 6 * [np.nan]),
            'turn': np.array([180.0, 0.0, 0.0, 0.0]),
        },
        'primitive 0: arc: expected its turn of 10313.* deg to lead to its end',
    ),
    'arc without turn': (
        {
            'kind': np.array([1, 0, 0, 0], np.uint8),
            'centre': np.array([0.0573, 0.0323] + 6 * [np.nan]),
        },
        'primitive 0: arc: expected a radius and a turn other than 0',
    ),
    'one place': (
        {'end': np.tile(CORNERS[0], 4)},
        'end: expected at least one primitive with a length but found none',
    ),
}


@pytest.mark.parametrize(('changes', 'text'), BAD_PATTERNS.values(), ids=BAD_PATTERNS)
def test_bad_patterns_are_refused_by_name(model, changes, text):
    bench = Compensator(model)
    why = bench.refusal(pattern(**changes))
    with pytest.raises(ValueError, match=text):
        raise ValueError(why)
    # and the next good one is taken
    assert bench.stitch(pattern(time=3.0))[0] is not None


BAD_SHEETS = {
    'no thickness': ({'thickness': 0.0}, 'material: thickness: expected more than 0 mm'),
    'NaN thickness': ({'thickness': np.nan}, 'material: thickness: expected more than 0 mm'),
    'no size': ({'size': np.array([0.15, -0.1])}, 'material: size Y: expected more than 0 mm'),
    'one length': ({'size': np.array([0.15])}, 'material: size: expected the lengths along X'),
    'frame': ({'frame_id': 'mill/machine'}, 'frame_id of material: expected mill/workpiece'),
}


@pytest.mark.parametrize(('changes', 'text'), BAD_SHEETS.values(), ids=BAD_SHEETS)
def test_bad_sheets_are_refused_with_the_pattern(changes, text):
    bench = Compensator(sheet=False)
    bench.give('material', material(**changes))
    assert text in bench.refusal(pattern())


def test_a_pattern_without_a_sheet_is_refused_and_not_kept():
    """A sheet that is told later must not set off what was loaded before."""
    bench = Compensator(sheet=False)
    assert 'no material: expected the sheet to be known' in bench.refusal(pattern())
    assert not bench.give('material', material(time=3.0))
    assert bench.stitch(pattern(time=4.0))[0] is not None


@pytest.mark.parametrize(
    ('damage', 'text'),
    [
        (lambda text: text[: len(text) // 2], 'model file: expected JSON'),
        (lambda text: '{}', "model file: expected an object with 'schema'"),
        (lambda text: text.replace('"depth_ratio"', '"width"'), 'inputs out of cos, sin'),
        (lambda text: text.replace('"schema_version": 1', '"schema_version": 3'), 'train the mod'),
    ],
    ids=['cut', 'empty', 'features', 'version'],
)
def test_a_damaged_model_is_refused_and_the_old_one_stays(model, damage, text):
    bench = Compensator(model)
    answer = bench.request('use_model', model=damage(model))
    assert not answer.success
    assert text in answer.message
    assert bench.stitch(pattern())[0].model == text_hash(model)

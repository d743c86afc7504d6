# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
import json
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fuzzycnc_ros.core.deformation.model import read_model
from fuzzycnc_ros.core.deformation.offset_file import (
    StitchOffsets,
    read_offsets,
    write_offsets,
)
from fuzzycnc_ros.core.deformation.soft_model import read_soft_model
from fuzzycnc_ros.core.document import (
    DEFORMATION_MODEL,
    DOCUMENT_KINDS,
    THERMAL_MODEL,
    TRACK_OFFSETS,
    ModelFileError,
)
from fuzzycnc_ros.core.thermal.model import ThermalModel

NOMINAL = np.array([[0.0, 0.0], [3e-3, 0.0], [6e-3, 1e-3]])
OFFSETS = StitchOffsets('square', 'foam', NOMINAL, 0.1 * NOMINAL, 15e-3)


@given(st.lists(st.tuples(*[st.floats(-1.0, 1.0)] * 4), min_size=2, max_size=5))
def test_written_offsets_are_read_to_the_last_digit(rows):
    table = np.array(rows)
    text = write_offsets(StitchOffsets('a b', '', table[:, :2], table[:, 2:]))
    found = read_offsets(text)
    np.testing.assert_array_equal(found.nominal, table[:, :2])
    np.testing.assert_array_equal(found.offset, table[:, 2:])
    assert (found.path_id, found.material) == ('a b', '')
    assert write_offsets(found) == text


@pytest.mark.parametrize(
    ('key', 'value', 'message'),
    [
        ('format', 'offsets', "format: expected the format 'fuzzycnc stitch offsets'"),
        ('version', 2, 'version: expected version 1; learn the offsets anew, but found 2'),
        ('version', True, 'version: expected version 1'),
        ('path_id', '', 'path_id: expected the name of a pattern'),
        ('path_id', 3, 'path_id: expected a text'),
        ('material', None, 'material: expected a text'),
        ('nominal', [[0.0, 0.0]], 'nominal: expected two points or more'),
        ('nominal', [[0.0, 0.0], [1.0]], r'nominal\[1\]: expected 2 numbers'),
        ('offset', [[0.0, 0.0], [0.0, 0.0]], 'offset: expected as many as .* points, 3'),
        ('offset', [[0.0, 0.0], [0.0, 'x'], [0.0, 0.0]], r'offset\[1\]\[1\]: expected a number'),
    ],
)
def test_documents_that_are_none_are_refused(key, value, message):
    document = json.loads(write_offsets(OFFSETS)) | {key: value}
    with pytest.raises(ModelFileError, match=message):
        read_offsets(json.dumps(document))


@pytest.mark.parametrize(
    ('text', 'message'),
    [
        ('{"format": NaN}', 'expected finite numbers, but found NaN'),
        ('{', 'expected JSON'),
        ('[' * 100_000, 'expected JSON'),
        ('[]', "expected an object with 'format'"),
    ],
)
def test_text_that_is_no_document_is_refused(text, message):
    with pytest.raises(ModelFileError, match=message):
        read_offsets(text)


@pytest.mark.parametrize(
    ('kind', 'name'),
    [
        ({'schema': THERMAL_MODEL}, 'a thermal model'),
        ({'schema': DEFORMATION_MODEL}, 'a model of soft material'),
        ({'format': TRACK_OFFSETS}, 'learnt offsets of one track'),
    ],
)
def test_a_file_of_another_kind_is_named(kind, name):
    readers = {
        THERMAL_MODEL: ThermalModel.from_json,
        DEFORMATION_MODEL: read_model,
        TRACK_OFFSETS: read_offsets,
    }
    for wanted, read in readers.items():
        if wanted not in kind.values():
            message = f'expected {DOCUMENT_KINDS[wanted]}, but found {name}'
            with pytest.raises(ModelFileError, match=message):
                read(json.dumps(kind))
    if kind == {'schema': THERMAL_MODEL}:
        with pytest.raises(ModelFileError, match='found a thermal model'):
            read_soft_model(json.dumps(kind))


def test_offsets_are_for_one_track_on_one_material():
    assert OFFSETS.mismatch('square', 'foam', 15e-3 + 1e-7, NOMINAL + 1.0e-6) == ''
    assert "pattern 'square', not of 'circle'" in OFFSETS.mismatch(
        'circle', 'foam', 15e-3, NOMINAL
    )
    assert "material 'foam', not for 'felt'" in OFFSETS.mismatch('square', 'felt', 15e-3, NOMINAL)
    assert '3 points, not of 2' in OFFSETS.mismatch('square', 'foam', 15e-3, NOMINAL[:2])
    assert 'sheet of 15 mm, not of 20 mm' in OFFSETS.mismatch('square', 'foam', 20e-3, NOMINAL)
    earlier = replace(OFFSETS, thickness=None)
    assert read_offsets(write_offsets(earlier)).mismatch('square', 'foam', 20e-3, NOMINAL) == ''
    moved = NOMINAL.copy()
    moved[1, 1] += 5e-6
    assert 'number 1 lies 5 µm' in OFFSETS.mismatch('square', 'foam', 15e-3, moved)
    assert 'other points' in OFFSETS.mismatch('square', 'foam', 15e-3, NOMINAL * np.nan)

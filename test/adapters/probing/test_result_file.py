# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""A result file that a control writes into: only what is new, whole lines, nothing foreign."""

import numpy as np
import pytest

from fuzzycnc_ros.adapters.probing.programs import BEGIN, END
from fuzzycnc_ros.adapters.probing.result_file import ResultFile
from fuzzycnc_ros.adapters.probing.touches import touch_of
from fuzzycnc_ros.runtime.component import Level
from fuzzycnc_ros.runtime.enums import TouchKind


def test_only_what_is_added_is_read_in_whole_lines(tmp_path):
    path = tmp_path / 'results.txt'
    path.write_text('1 2.5\n')
    file = ResultFile(path)
    assert file.read() == []
    with path.open('a') as stream:
        stream.write('999999 4711\n  1   -52.5\n2 -5')
    assert file.read() == [(999999.0, 4711.0), (1.0, -52.5)]
    with path.open('a') as stream:
        stream.write('2.5\n')
    assert file.read() == [(2.0, -52.5)]
    assert file.read() == []
    path.write_text('3 1.0\n')
    assert file.read() == [(3.0, 1.0)]
    assert file.health().level is Level.OK


def test_a_file_that_comes_later_or_holds_other_text_is_told(tmp_path):
    path = tmp_path / 'results.txt'
    file = ResultFile(path)
    assert file.read() == []
    assert file.health().level is Level.WARN
    path.write_text('%\n\nT1 M6\n4, 1.25\n')
    assert file.read() == [(4.0, 1.25)]
    assert "found b'T1 M6'" in file.health().message


@pytest.mark.parametrize(
    ('pair', 'wanted'),
    [
        ((BEGIN, 4711.0), (TouchKind.BEGIN, 4711)),
        ((7.0, -52.5), (TouchKind.TOUCH, 7)),
        ((-7.0, 0.0), (TouchKind.MISS, 7)),
        ((END, 0.0), (TouchKind.END, 0)),
    ],
)
def test_pairs_are_touches(pair, wanted):
    touch = touch_of(5, 'mill/machine', *pair, includes_offset=False)
    assert (touch.kind, touch.number) == wanted
    assert touch.position == -0.0525 if wanted[0] is TouchKind.TOUCH else np.isnan(touch.position)


@pytest.mark.parametrize('pair', [(0.0, 1.0), (np.nan, 1.0), (1.0, np.inf), (2e6, 0.0)])
def test_what_no_program_tells_is_no_touch(pair):
    assert touch_of(5, 'mill/machine', *pair, includes_offset=False) is None

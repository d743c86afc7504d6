# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The test of linear axes: changes at both ends and the middle, slope, what a line leaves."""

import numpy as np
import pytest

from fuzzycnc_ros.bags.csv_import import import_csv
from fuzzycnc_ros.bags.csv_mapping import CsvMapping
from fuzzycnc_ros.studies.thermal_test.phases import Phase, PhaseList
from fuzzycnc_ros.studies.thermal_test.recording import read_test
from fuzzycnc_ros.studies.thermal_test.report import axes_table, judge_test
from fuzzycnc_ros.studies.thermal_test.set_up import TestSetUp

pytest.importorskip('mcap', reason="bags need pip install 'fuzzycnc_ros[bags]'")

DISPLACEMENTS = ['far=X:um@-400mm', 'near=X:um@0mm', 'mid=X:um@-200mm', 'z=Z:um']


def test_of(tmp_path, displacements):
    """Judge half an hour in which an axis gets longer by 60 um at its far end."""
    file = tmp_path / 'day.csv'
    rows = [
        f'{60 * k},20.0,{-2.0 * k:.3f},{0.1 * k:.3f},{-0.8 * k:.3f},{0.2 * k:.3f}'
        for k in range(31)
    ]
    file.write_text('\n'.join(['t,a,far,near,mid,z', *rows]), encoding='utf-8')
    mapping = CsvMapping(time='t', temperatures=['a'], displacements=displacements)
    import_csv(file, tmp_path / 'bag', mapping)
    recording = read_test(tmp_path / 'bag')
    phases = PhaseList((Phase('axis X', 'axis', 0.0, 1800.0),), 'stated')
    return judge_test(recording, TestSetUp(), phases)


test_of.__test__ = False


def test_ends_and_middle_of_an_axis_are_one_row(tmp_path):
    table = axes_table(test_of(tmp_path, DISPLACEMENTS))
    assert table is not None
    (row,) = table.rows
    assert row[:3] == ('axis X', 'X', 'without')
    assert row[3] == '-60.0 at -400 mm; -24.0 at -200 mm; +3.0 at 0 mm'
    change, place = np.array([-60.0, -24.0, 3.0]), np.array([-0.4, -0.2, 0.0])
    slope, offset = np.polyfit(place, change, 1)
    assert float(row[4]) == pytest.approx(slope, abs=0.05)
    rest = np.abs(change - offset - slope * place).max()
    assert float(row[5]) == pytest.approx(rest, abs=0.05)


def test_without_positions_there_is_no_such_table(tmp_path):
    assert axes_table(test_of(tmp_path, ['far=X:um', 'near=X:um', 'z=Z:um'])) is None

# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The table of speed: the page has the rows of the benchmark, and absent libraries are named."""

import re
from importlib import import_module
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PAGE = ROOT / 'docs' / 'explanation' / 'performance.md'


@pytest.fixture
def performance(monkeypatch):
    monkeypatch.syspath_prepend(str(ROOT / 'benchmarks'))
    return import_module('performance')


def test_the_page_has_the_rows_of_the_benchmark(performance):
    table = re.findall(r'^\| (.+, beside .+?) \| (.+?) \|', PAGE.read_text(encoding='utf-8'), re.M)
    assert table == [(f'{row.work}, beside {row.library}', row.unit) for row in performance.ROWS]


@pytest.mark.parametrize(('unit', 'ratio'), [('ms', '4.00'), ('round trips/s', '0.250')])
def test_a_ratio_above_1_is_for_the_faster_one(performance, unit, ratio):
    row = performance.Row('Work', 'else', unit, lambda: performance.Found(2.0, 8.0, 'alike'))
    assert row.cells() == ('Work, beside else', unit, '2.00', '8.00', ratio, 'alike')


def test_a_library_that_is_absent_is_named(performance):
    def measure():
        raise ImportError("No module named 'else'")

    row = performance.Row('Work', 'else', 'ms', measure)
    assert row.cells()[-1] == "not compared: No module named 'else'"


def test_both_do_the_work_as_often(performance):
    calls = []
    performance.in_turn(lambda: calls.append('own'), lambda: calls.append('other'), 3)
    assert calls == ['own', 'other'] * 3


def test_two_motions_on_one_curve_take_nearly_the_same_time(performance, monkeypatch):
    pytest.importorskip('toppra', reason='needs toppra (pip install toppra)')
    monkeypatch.setattr(performance, 'REPEATS', 1)
    own, other = map(float, re.findall(r'([\d.]+) s', performance.motion().results))
    assert own == pytest.approx(other, rel=0.03)

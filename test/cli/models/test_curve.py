# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""How the error on unseen runs falls with the number of sensors."""

from pathlib import Path

import numpy as np
import pytest
from command_lines import read_json

from fuzzycnc_ros.bags.runs import read_run
from fuzzycnc_ros.core.thermal.fit import sensor_count_curve


def test_each_run_is_held_out_once(fuzzycnc, bag):
    bags = bag('a'), bag('b', rows=100), bag('c', rows=90)
    options = ('--counts', '3,1', '--counts', '2,1', '--json', 'c.json', '--report', 'c.html')
    outcome = fuzzycnc('curve', *bags, *options)
    assert outcome.code == 0, outcome
    figures = read_json('c.json')
    assert figures['counts'] == [1, 2, 3]
    assert figures['left_out'] == []
    runs = [read_run(path) for path in bags]
    rms = []
    for run in runs:
        rest = [other for other in runs if other is not run]
        points = sensor_count_curve(rest, run, counts=(1, 2, 3))
        rms.append([1e6 * point.rms[0] for point in points])
        found = figures['held_out'][run.name]
        assert [found[str(p.count)]['sensors'] for p in points] == [list(p.chosen) for p in points]
        assert [found[n]['figures']['dz']['rms_um'] for n in '123'] == pytest.approx(rms[-1])
        assert found['3']['figures']['dz']['max_um'] == pytest.approx(1e6 * points[2].largest[0])
    for row, count in enumerate('123'):
        over_runs = figures['over_runs'][count]['dz']
        assert over_runs['mean_rms_um'] == pytest.approx(np.mean(rms, axis=0)[row])
        assert over_runs['worst_rms_um'] == pytest.approx(np.max(rms, axis=0)[row])
        assert over_runs['max_um'] >= over_runs['worst_rms_um'] >= over_runs['mean_rms_um']
    assert 'judged on a, b, c, each held out' in outcome.out
    least = 1 + int(np.argmin(np.mean(rms, axis=0)))
    assert f'fuzzycnc train --clusters {least} takes so many' in outcome.out
    assert Path('c.html').read_text().count('class="chart"') == 1


def test_more_sensors_than_warm_up_are_left_out_and_named(fuzzycnc, bag):
    outcome = fuzzycnc('curve', bag('a'), bag('b', rows=100), '--json', 'c.json')
    assert outcome.code == 0, outcome
    figures = read_json('c.json')
    assert figures['counts'] == [1, 2, 3]
    assert figures['left_out'] == [5, 8, 10, 15]
    assert 'left out: 5, 8, 10, 15, as only 3 sensors warm up' in outcome.out


def test_a_single_run_is_chained_forward(fuzzycnc, bag):
    outcome = fuzzycnc('curve', bag('a', rows=200), '--counts', '1,2', '--json', 'c.json')
    assert outcome.code == 0, outcome
    found = read_json('c.json')['held_out']
    assert list(found) == ['a 6000-8358 s', 'a 8400-11940 s']
    run = read_run('a')
    points = sensor_count_curve([run.window(stop=8358.0)], run.window(start=8400.0), counts=(1,))
    last = found['a 8400-11940 s']['1']
    # The states of the held-out part are warm when its judging begins.
    assert last['sensors'] == list(points[0].chosen)
    assert last['figures']['dz']['rms_um'] < 1e6 * points[0].rms[0]


@pytest.mark.parametrize(
    ('options', 'naming'),
    [
        (('gone',), ['gone', 'nothing is there']),
        (('a', '--counts', 'few'), ['--counts', 'few', '1,2,5']),
        (('a', '--counts', '0,1'), ['--counts', '0, 1']),
        (('a', '--counts', ','), ['--counts', 'none']),
        (('a', '--counts', '7,8'), ['--counts', 'up to 3', '7, 8']),
        (('a', '--seed', '-1'), ['--seed', '-1']),
        (('a', '--interval', '7'), ["'a'", '7 s', '60 s']),
        (('a', 'other'), ['dz', 'probe']),
        (('a', '--report', 'no/such.html'), ['no/such.html', 'existing folder']),
    ],
)
def test_what_cannot_be_judged(refused, bag, options, naming):
    bag('a')
    if 'other' in options:
        bag('other', '--rename', 'dz=probe')
    refused('curve', *options, naming=naming)

# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""`make soak`: what it says, and what it ends with."""

import json
from math import inf
from pathlib import Path

import numpy as np
import pytest
from soak.run import HELD, SoakRun

from fuzzycnc_ros.core.thermal.fit import train_model
from fuzzycnc_ros.studies.shift.thermal_shift import record_calibration


@pytest.fixture
def mill_model(tmp_path):
    """A plain model of the simulated mill."""
    runs = record_calibration(('D0', 'T1')).runs
    path = tmp_path / 'mill.json'
    path.write_text(train_model(runs, candidates=('lag_ridge',)).to_json())
    return path


@pytest.fixture
def told(monkeypatch):
    """Let runs come out as they are given: `told(run, ...)`."""

    def give(*runs):
        monkeypatch.setattr('soak.command._model_text', lambda *_: '{}')
        monkeypatch.setattr('fuzzycnc_ros.cli.workers.in_workers', lambda *_: list(runs))

    return give


def soaked(growing=None, missed=(), hashes=(b'a', b'b', b'c', b'd')):
    """Return a run of 40 samples in which one figure grows by a third."""
    figures = (*HELD, 'compensator [us]')
    samples = np.tile(np.arange(1.0, 1.0 + len(figures)), (40, 1))
    if growing is not None:
        samples[:, figures.index(growing)] *= np.linspace(1.0, 1.4, 40)
    return SoakRun(6000, figures, samples, 4, dict(missed), np.array(hashes))


@pytest.mark.slow
def test_two_runs_of_the_real_graph(qualification, mill_model, monkeypatch):
    # Times are for people: on a busy host they mean nothing.
    monkeypatch.setattr('soak.run.LATENCY_GROWTH_MAX', inf)
    options = ('--model', mill_model, '--repeat', '2', '--json', 's.json')
    outcome = qualification('soak', '--hours', '20', *options)
    assert outcome.code == 0, outcome
    assert 'nothing grows, nothing was missed; 2 runs with the same hash' in outcome.out
    figures = json.loads(Path('s.json').read_text())
    first, second = figures['runs']
    assert (figures['hours'], figures['passed'], figures['problems']) == (20.0, True, [])
    assert first['ticks'] == 1200
    assert first['hash'] == second['hash']
    assert f'run 2: hash {first["hash"]}' in outcome.out
    assert set(first['growth']) == set(first['samples'])
    assert all(first['growth'][name]['growth'] <= 0.05 for name in HELD)


@pytest.mark.parametrize('name', HELD)
def test_what_grows_is_named_and_ends_with_1(qualification, told, name):
    told(soaked(name))
    outcome = qualification('soak', '--json', 's.json')
    assert outcome.code == 1, outcome
    assert f'PROBLEM {name} grew by 2' in outcome.out
    assert json.loads(Path('s.json').read_text())['passed'] is False


def test_a_time_may_grow_a_little(qualification, told):
    told(soaked('compensator [us]'))
    assert qualification('soak').code == 0


def test_a_missed_message_ends_with_1(qualification, told):
    told(soaked(missed={'compensator thermal_error': 3}))
    outcome = qualification('soak')
    assert outcome.code == 1
    assert 'PROBLEM compensator thermal_error: 3 missed' in outcome.out


def test_runs_that_part_end_with_1(qualification, told):
    told(soaked(), soaked(hashes=(b'a', b'b', b'x', b'd')))
    outcome = qualification('soak', '--repeat', '2')
    assert outcome.code == 1
    assert 'PROBLEM run 2: equals run 1 up to hour 50 only' in outcome.out


@pytest.mark.parametrize(
    ('options', 'naming'),
    [
        (('--hours', '19'), ['--hours', '20', '19']),
        (('--hours', 'nan'), ['--hours', '20', 'nan']),
        (('--hours', 'inf'), ['--hours', 'inf']),
        (('--repeat', '0'), ['--repeat', '0']),
        (('--seed', '-1'), ['--seed', '-1']),
        (('--model', 'none.json'), ['none.json']),
        (('--json', 'no/such.json'), ['no/such.json', 'existing folder']),
    ],
)
def test_refusals(refused, options, naming):
    refused('soak', *options, naming=naming)


def test_a_live_soak_has_to_outlast_its_queues(refused, mill_model):
    refused('soak', '--live', '--model', mill_model, naming=['--hours', '200', '--live', '100'])

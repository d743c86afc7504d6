# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""All models side by side on what none of them has seen."""

import re
from pathlib import Path

import numpy as np
import pytest
from command_lines import read_json

from fuzzycnc_ros.bags.runs import read_run
from fuzzycnc_ros.cli.models.compare import speed_missing
from fuzzycnc_ros.core.thermal.candidate import CANDIDATES, COMPARED_ONLY, SPEED_SUFFIX
from fuzzycnc_ros.core.thermal.fit.comparison import judge, splits
from fuzzycnc_ros.papers.names import COMPARED

LINEAR = ('least_squares', 'static_ridge', 'lag_ridge', 'stable_grey')
QUICK = ('--models', ','.join(LINEAR))


@pytest.fixture
def duties(fuzzycnc, table):
    """Return bags of one machine that turns in two or three duties, at several speeds."""

    def record(name, starts, speeds, seed=0, options=('--speed', 'rpm')):
        rng = np.random.default_rng(seed)
        time = 60.0 * np.arange(400)
        rpm = np.zeros(len(time))
        for start, speed in zip(starts, speeds, strict=True):
            rpm[(time >= start) & (time < start + 3600.0)] = speed
        heat = np.zeros((len(time), 3))
        for k in range(1, len(time)):
            heat[k] = heat[k - 1] + 60.0 / np.array([900.0, 2700.0, 1200.0]) * (
                np.array([8.0, 5.0, 12.0]) * (rpm[k] / 3000.0) ** 2 - heat[k - 1]
            )
        columns = {'t': time, 'rpm': rpm}
        columns['t1'], columns['t2'] = (
            20.0 + heat[:, c] + 0.02 * rng.standard_normal(len(time)) for c in (0, 1)
        )
        columns['t3'] = 0.4 * columns['t1'] + 0.6 * columns['t2']
        columns['dz'] = heat[:, 2] + 0.05 * rng.standard_normal(len(time))
        file = table(f'{name}.csv', columns)
        outcome = fuzzycnc(
            'import-csv', file, '--out', name, '--time', 't', '--temperature', 't*',
            '--displacement', 'dz=Z:um', *options,
        )  # fmt: skip
        assert outcome.code == 0, outcome
        return Path(name)

    return record


def test_every_run_is_held_out_once_and_figures_are_those_of_the_core(fuzzycnc, here, bag):
    bags = bag('a'), bag('b', rows=100), bag('c', rows=90)
    outcome = fuzzycnc(
        'compare', *bags, '--models', 'stable_grey,static_ridge,classical_grey', '--json',
        'c.json', '--report', 'c.html',
    )  # fmt: skip
    assert outcome.code == 0, outcome
    figures = read_json('c.json')
    assert list(figures['held_out']) == ['a', 'b', 'c']
    names = ('static_ridge', 'classical_grey', 'stable_grey')  # in the order of tables
    for split in splits([read_run(path) for path in bags]):
        expected = judge(split, candidates=names)
        found = figures['held_out'][split.name]
        assert found['samples'] == {'dz': len(split.held_out.time)}
        assert found['inputs'] == list(expected.inputs)
        assert found['default'] == {'dz': expected.evaluation.default[0]}
        assert tuple(found['figures']) == ('uncompensated', *names, 'default')
        for name, channels in found['figures'].items():
            if name not in found['refused']:
                rms = 1e6 * expected.evaluation.rms[name][0]
                assert channels['dz']['rms_um'] == pytest.approx(rms, rel=1e-9)
        assert found['figures']['default'] == found['figures'][found['default']['dz']]
    assert 'a: residual thermal error' not in outcome.out
    assert len(outcome.out.splitlines()) < 30
    assert 'All held-out runs: residual thermal error' in outcome.out
    page = Path('c.html').read_text()
    assert page.count('class="chart"') == 3
    assert page.count('Bars: the rms') == 4  # all runs together, and each
    assert 'Held out: b' in page


def test_best_candidate_is_trusted_on_every_run(fuzzycnc, here, bag):
    names = 'static_ridge,classical_grey,lag_ridge'
    outcome = fuzzycnc(
        'compare', bag('a'), bag('b', rows=100), '--models', names, '--json', 'c.json'
    )
    assert outcome.code == 0, outcome
    figures = read_json('c.json')
    trusted = {
        name: rows['dz']['rms_um']
        for name, rows in figures['pooled'].items()
        if name in names.split(',') and name not in figures['refused']
    }
    assert figures['best']['dz'] == min(trusted, key=trusted.get)
    assert 'best candidate: ' in outcome.out
    for name, runs in figures['refused'].items():
        assert all(figures['held_out'][run]['refused'][name] == why for run, why in runs.items())


@pytest.mark.slow
def test_figures_do_not_depend_on_the_number_of_processes(fuzzycnc, bag):
    bags = bag('a'), bag('b', rows=100)
    for jobs in ('1', '2'):
        options = ('--jobs', jobs, '--models', 'lag_ridge,mlp', '--json', f'{jobs}.json')
        outcome = fuzzycnc('compare', *bags, *options)
        assert outcome.code == 0, outcome
    assert Path('1.json').read_text() == Path('2.json').read_text()


def test_a_single_run_is_cut_at_the_asked_stretches(fuzzycnc, here, bag):
    options = ('--hold-out', '3600:5400', '--hold-out', '5460:7140', '--json', 'c.json')
    outcome = fuzzycnc('compare', bag('long', rows=120), *QUICK, *options)
    assert outcome.code == 0, outcome
    found = read_json('c.json')['held_out']
    assert {name: item['samples'] for name, item in found.items()} == {
        'long 3600-5400 s': {'dz': 31},
        'long 5460-7140 s': {'dz': 29},
    }
    assert 'spindle speed: not used, since it is not recorded in long' in outcome.out


def test_runs_with_a_speed_show_the_models_that_read_it_beside_the_others(fuzzycnc, here, duties):
    first = duties('first', (600.0, 12000.0), (3000.0, 2000.0))
    second = duties('second', (600.0, 9000.0), (1500.0, 3500.0), seed=1)
    names = 'lag_ridge,lag_ridge_speed'
    options = ('compare', first, second, '--models', names, '--json', 'c.json')
    with_speed = fuzzycnc(*options)
    assert with_speed.code == 0, with_speed
    rows = read_json('c.json')['pooled']
    assert set(rows) == {'uncompensated', 'default', *names.split(',')}
    assert 'LagRidge with speed' in with_speed.out
    assert 'not used' not in with_speed.out
    without = fuzzycnc(*options, '--no-speed')
    assert without.code == 0, without
    assert set(read_json('c.json')['pooled']) == {'uncompensated', 'default', 'lag_ridge'}
    assert 'spindle speed: not used, --no-speed' in without.out


def test_train_says_whether_the_speed_is_read(fuzzycnc, duties):
    runs = duties('first', (600.0, 12000.0), (3000.0, 2000.0)), duties('second', (600.0,), (1500,))
    for model, said in (
        (
            'lag_ridge_speed',
            'spindle speed: used; it has to come with machine_state',
        ),
        ('static_ridge', 'spindle speed: known, but not used'),
    ):
        options = ('--models', 'lag_ridge', '--model', model, '--json', 't.json')
        outcome = fuzzycnc('train', *runs, '--out', f'{model}.json', *options)
        assert outcome.code == 0, outcome
        assert said in outcome.out
        assert read_json('t.json')['needs_speed'] == model.endswith(SPEED_SUFFIX)
    options = ('--model', 'lag_ridge_speed', '--no-speed')
    outcome = fuzzycnc('train', *runs, '--out', 'none.json', *options)
    assert outcome.code == 2
    assert "'lag_ridge_speed'" in outcome.err


def test_a_run_without_speed_is_judged_by_the_models_that_do_without(fuzzycnc, refused, duties):
    run = duties('first', (600.0, 12000.0), (3000.0, 2000.0))
    silent = duties('silent', (600.0,), (2500.0,), seed=1, options=())
    for model in ('lag_ridge', 'lag_ridge_speed'):
        options = ('--models', 'lag_ridge,lag_ridge_speed', '--model', model)
        assert fuzzycnc('train', run, '--out', f'{model}.json', *options).code == 0
    options = ('--model', 'lag_ridge.json', '--json', 'e.json', '--report', 'e.html')
    outcome = fuzzycnc('evaluate', silent, *options)
    assert outcome.code == 0, outcome
    assert set(read_json('e.json')['runs']['silent']) == {'uncompensated', 'lag_ridge', 'default'}
    assert 'LagRidge with speed' not in Path('e.html').read_text()
    refused('evaluate', silent, '--model', 'lag_ridge_speed.json', naming=['silent', 'speed'])


def test_speed_that_one_run_lacks_is_not_used(duties):
    bags = [
        duties('with', (600.0,), (3000.0,)),
        duties('without', (600.0,), (3000.0,), options=()),
        duties('idle', (), ()),
    ]
    runs = [read_run(bag) for bag in bags]
    assert speed_missing(runs[:1], 60.0) == ''
    assert speed_missing(runs[:2], 60.0) == 'since it is not recorded in without'
    assert speed_missing(runs[2:], 60.0) == 'since it has gaps or never changes'


@pytest.mark.parametrize(
    ('options', 'naming'),
    [
        ((), ['bags', '--machine grinder']),
        (('gone',), ['gone', 'nothing is there']),
        (('a', '--models', 'magic'), ['--models', "'magic'", 'lag_ridge']),
        (('a', '--models', ','), ['--models', 'none']),
        (('a', '--hold-out', 'all'), ['--hold-out', 'START:END', "'all'"]),
        (('a', '--hold-out', '9:3'), ['--hold-out', "'9:3'"]),
        (('a', '--hold-out', 'nan:3'), ['--hold-out', "'nan:3'"]),
        (('a', '--hold-out', '1e6:2e6'), ['a', '1e+06', '7140']),
        (('a', 'b', '--hold-out', '0:600'), ['one run', '2']),
        (('a', '--jobs', '0'), ['--jobs', '0']),
        (('a', '--interval', '30'), ["'a'", '60 s', '30 s']),
        (('a', '--sensors', 'some'), ['sensors', "'some'"]),
        (('a', './a'), ['a', 'twice', 'rename']),
        (('a', '--models', 'mlp_speed'), ['--models', 'spindle speed', 'mlp_speed']),
        (('a', '--json', 'no/such.json'), ['no/such.json', 'existing folder']),
        (('--machine', 'lathe'), ['--machine', "'lathe'", 'grinder']),
        (('a', '--machine', 'grinder'), ['--machine', 'BAG']),
        (('--machine', 'grinder', '--hold-out', '0:9'), ['--machine', '--hold-out']),
        (('--machine', 'grinder', '--no-speed'), ['--machine', '--speed']),
        (('--machine', 'grinder', '--models', 'magic'), ["'magic'", 'hybrid_plain']),
    ],
)
def test_what_cannot_be_compared(refused, here, bag, options, naming):
    bag('a')
    if 'b' in options:
        bag('b', rows=100)
    refused('compare', *options, naming=naming)


def test_what_is_wrong_with_a_run_names_what_was_held_out(refused, here, bag):
    short = bag('short', rows=30)
    refused(
        'compare', short, *QUICK, '--models', 'lag_ridge', '--hold-out', '0:1500',
        naming=['short 0-1500 s held out', '8'],
    )  # fmt: skip


def test_runs_of_different_machines(fuzzycnc, refused, here, bag):
    other = bag('other', '--rename', 'dz=probe', rows=90)
    first = bag('a')
    refused('compare', first, other, *QUICK, naming=['held out', 'dz', 'probe'])
    outcome = fuzzycnc('compare', first, bag('b', rows=100), other, *QUICK)
    assert outcome.code == 1
    assert "left out other: run 'other': expected channel dz as in run 'a', but" in outcome.out


@pytest.mark.slow
def test_grinder(fuzzycnc):
    names = ('static_ridge', 'classical_grey', 'lag_ridge')
    options = ('--models', ','.join(names), '--json', 'g.json', '--report', 'g.html')
    outcome = fuzzycnc('compare', '--machine', 'grinder', *options)
    assert outcome.code == 0, outcome
    figures = read_json('g.json')
    assert figures['seed'] == 0
    assert list(figures['trials'])[:3] == ['one_run', 'one_run_machine_sensors', 'two_runs']
    two_runs = figures['trials']['two_runs']
    assert set(two_runs['models']) == {'uncompensated', *names}
    assert two_runs['models']['uncompensated']['E2 Y']['rms_um'] == pytest.approx(10.5, abs=0.1)
    assert two_runs['models']['lag_ridge']['E2 Y']['rms_um'] < 1.0
    assert 'classical_grey' in two_runs['problems']
    assert re.search(r'Classical GM\(1,N\) \* +\d', outcome.out)
    assert 'Classical GM(1,N) is not to be trusted: a = ' in outcome.out
    assert Path('g.html').read_text().count('Bars: the rms') == len(figures['trials'])


def test_help_names_every_model(fuzzycnc):
    assert set(COMPARED) == {*CANDIDATES, *COMPARED_ONLY}
    for command, names in (('compare', COMPARED), ('train', CANDIDATES)):
        text = ''.join(fuzzycnc(command, '--help').out.split())
        assert ','.join(names) in text
    assert any(name.endswith(SPEED_SUFFIX) for name in CANDIDATES)

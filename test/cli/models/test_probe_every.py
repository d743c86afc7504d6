# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""`fuzzycnc evaluate --probe-every`: table, figures, page and refusals."""

import json
import re
from pathlib import Path

import pytest

from fuzzycnc_ros.bags.runs import read_run
from fuzzycnc_ros.core.thermal.fit import evaluate
from fuzzycnc_ros.core.thermal.model import load_model
from fuzzycnc_ros.studies.thermal.learnt import learn_runs
from fuzzycnc_ros.studies.thermal.probed import evaluate_probed


def test_what_probing_leaves_is_in_table_figures_and_page(fuzzycnc, bag, model):
    held_out = bag('held_out', rows=100)
    outcome = fuzzycnc(
        'evaluate', held_out, '--model', model, '--start', '600', '--probe-every', '20 min',
        '--json', 'e.json', '--report', 'e.html',
    )  # fmt: skip
    assert outcome.code == 0, outcome
    trained, run = load_model(model), read_run(held_out)
    expected = evaluate_probed(trained, run, evaluate(trained, run, start=600.0), 1200.0)
    figures = json.loads(Path('e.json').read_text())['probed']
    assert figures['every_s'] == 1200.0
    assert figures['probes'] == {'held_out': {'dz': 5}}
    assert figures['samples'] == {'held_out': {'dz': 89}}
    for name, rms in expected.rms.items():
        assert figures['runs']['held_out'][name]['dz']['rms_um'] == pytest.approx(1e6 * rms[0])
    page = Path('e.html').read_text()
    for text in (outcome.out, page):
        assert 'held_out, probed every 20 min: residual thermal error' in text
        assert 'Last probe held, no model' in text
        assert 'held_out: 89 samples, 5 probes a channel' in text
    shown = re.search(r'Last probe held, no model +([\d.]+) +([\d.]+)', outcome.out)
    assert float(shown[1]) == pytest.approx(1e6 * expected.rms['held'][0], abs=0.05)
    assert float(shown[2]) == pytest.approx(1e6 * expected.largest['held'][0], abs=0.05)


def test_without_it_nothing_is_probed(fuzzycnc, bag, model):
    outcome = fuzzycnc('evaluate', bag('a'), '--model', model, '--json', 'e.json')
    assert outcome.code == 0, outcome
    assert 'probe' not in outcome.out
    assert json.loads(Path('e.json').read_text())['probed'] is None


@pytest.mark.slow
def test_several_bags_have_one_table_and_a_short_one_is_named(fuzzycnc, bag, model):
    bags = (bag('a'), bag('b', rows=100), bag('short', rows=40))
    outcome = fuzzycnc(
        'evaluate', *bags, '--model', model, '--probe-every', '1h', '--json', 'e.json'
    )
    assert outcome.code == 1, outcome
    assert 'Over 2 runs, probed every 60 min: residual thermal error' in outcome.out
    assert 'b: 96 samples, 2 probes a channel' in outcome.out
    assert re.search(r'left out short: .*at most 2340 s between two probes', outcome.out)
    figures = json.loads(Path('e.json').read_text())['probed']
    assert list(figures['runs']) == ['a', 'b']
    each = [figures['runs'][name]['learnt']['dz']['rms_um'] for name in 'ab']
    assert figures['overall']['learnt']['dz']['worst_rms_um'] == pytest.approx(max(each))


@pytest.mark.parametrize(
    ('text', 'naming'),
    [
        ('60', ['--probe-every', 'a unit, one of s, min, h', "'60'", '60min']),
        ('0min', ['--probe-every', 'above 0', "'0min'"]),
        ('often', ['--probe-every', "'often'", '60min']),
        ('30s', ['at least 60 s between two probes', '30 s']),
        ('3h', ['log', 'at most 7140 s', '10800 s', 'longer run']),
    ],
)
def test_time_that_cannot_be_meant_is_refused(refused, bag, model, text, naming):
    refused('evaluate', bag(), '--model', model, '--probe-every', text, naming=naming)


def test_from_nothing_all_is_learnt_from_probes(fuzzycnc, bag):
    bags = (bag('a', rows=100), bag('b', rows=98), bag('damaged'))
    (Path(bags[2]) / 'damaged_0.mcap').write_bytes(b'')
    outcome = fuzzycnc(
        'evaluate', *bags, '--from-nothing', '--carry', '--probe-every', '20min',
        '--probe-noise', '0.3um', '--json', 'e.json', '--report', 'e.html',
    )  # fmt: skip
    assert outcome.code == 1, outcome
    assert 'left out damaged' in outcome.out
    figures = json.loads(Path('e.json').read_text())
    assert list(figures['left_out']) == ['damaged']
    runs = [read_run(place) for place in bags[:2]]
    expected = list(learn_runs(runs, 1200.0, noise=0.3e-6))
    for item in expected:
        assert figures['probes'][item.run]['dz'] == item.probes[0] == 4
        for name, rms in item.rms.items():
            found = figures['runs'][item.run][name]['dz']['rms_um']
            assert found == pytest.approx(1e6 * rms[0])
    page = Path('e.html').read_text()
    for text in (outcome.out, page):
        assert 'Learnt from nothing, probed every 20 min' in text
    apart = fuzzycnc('evaluate', *bags[:2], '--from-nothing', '--probe-every', '20min')
    assert apart.code == 0, apart
    assert apart.out != outcome.out


@pytest.mark.parametrize(
    ('words', 'naming'),
    [
        ([], ['--model', '--from-nothing']),
        (['--carry', '--model', 'm.json'], ['--carry', '--from-nothing']),
        (['--from-nothing'], ['--from-nothing', '--probe-every']),
        (['--from-nothing', '--probe-every', '1h', '--model', 'm.json'], ['no --model']),
        (
            ['--from-nothing', '--probe-every', '1h', '--probe-noise', '0um'],
            ['--probe-noise', 'above 0'],
        ),
        (['--from-nothing', '--probe-every', '1s'], ['at least 60 s between two probes']),
    ],
)
def test_what_does_not_go_together_is_refused(refused, bag, words, naming):
    refused('evaluate', bag('a', rows=100), *words, naming=naming)

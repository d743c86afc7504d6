# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""`fuzzycnc model`: what probes have taught, shown, compared, handed on, and refused."""

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from benches.component_bench import Bench
from benches.predictor_bench import (
    bench_with_model,
    model_text,
    predict,
    probe_of,
    recordings,
)

from fuzzycnc_ros.bags.typestore import ROSBAGS, serialize
from fuzzycnc_ros.components.thermal.thermal_predictor import ThermalPredictor
from fuzzycnc_ros.components.thermal.thermal_predictor_config import ThermalPredictorConfig
from fuzzycnc_ros.core.thermal.model import load_model
from fuzzycnc_ros.runtime.convert import encode
from fuzzycnc_ros.studies.published_bag import PublishedBag

ROWS = range(30, 181, 30)


def learnt(text=''):
    """Return what probes of T3 teach, beside a model or from nothing."""
    run = recordings()['T3']
    if text:
        bench = bench_with_model(text, learn=True)
    else:
        bench = Bench(ThermalPredictor(ThermalPredictorConfig(learn=True)))
    predict(bench, run, range(200), probes=[probe_of(run, row) for row in ROWS])
    return bench.records('thermal_posterior')


@pytest.fixture
def bags(tmp_path):
    """Write a bag of what was learnt from nothing, and one of less."""
    found = learnt()
    for name, records in (('much', found), ('little', found[:2])):
        with PublishedBag(tmp_path / name) as bag:
            for record in records:
                bag('thermal_posterior', record)
    return found


def test_what_was_learnt_is_shown_side_by_side(fuzzycnc, bags):
    outcome = fuzzycnc('model', 'show', 'much', 'little', '--json', 'm.json')
    assert outcome.code == 0
    assert len(re.findall(r'^(?:much|little) +[XYZ] +\d+  ', outcome.out, re.M)) == 6
    assert 'much, Y, µm per 10 K of one sensor: ' in outcome.out
    figures = json.loads(Path('m.json').read_text())
    assert figures['much']['channels']['Y']['probes'] == len(ROWS)
    assert figures['little']['channels']['Y']['probes'] == 2
    assert figures['much']['channels']['X']['probes'] == 0
    sensors = figures['much']['channels']['Y']['sensors']
    assert set(sensors) == set(recordings()['T3'].sensor)
    assert max(abs(item['error_um']) for item in sensors.values()) > 0.5


def test_a_machine_begins_with_what_another_has_learnt(fuzzycnc, bags):
    outcome = fuzzycnc('model', 'export', 'much', '--out', 'kind.json')
    assert outcome.code == 0, outcome
    model = load_model(Path('kind.json'))
    assert model.prior is not None
    run = recordings()['T3']
    errors = {}
    for name, text in (('begun', Path('kind.json').read_text()), ('nothing', '')):
        bench = (
            bench_with_model(text, learn=True)
            if text
            else Bench(ThermalPredictor(ThermalPredictorConfig(learn=True)))
        )
        errors[name] = np.array([item.error[1:] for item in predict(bench, run, range(60))[10:]])
    bare = run.displacement[10:60]
    assert np.abs(errors['begun'] - bare).max() < 0.5 * np.abs(bare).max()
    assert not errors['nothing'].any()


def test_what_was_learnt_beside_a_model_needs_its_file(fuzzycnc, refused, tmp_path):
    with PublishedBag(tmp_path / 'bag') as bag:
        bag('thermal_posterior', learnt(model_text())[-1])
    Path('mill.json').write_text(model_text())
    refused('model', 'show', 'bag', naming=['--model'])
    assert fuzzycnc('model', 'show', 'bag', '--model', 'mill.json').code == 0
    assert fuzzycnc('model', 'export', 'bag', '--model', 'mill.json', '--out', 'm.json').code == 0
    exported, trained = load_model(Path('m.json')), load_model(Path('mill.json'))
    assert exported.prior.share == trained.prior.share
    assert (exported.prior.known[0].mean != trained.prior.known[0].mean).any()


def test_a_state_file_is_a_source(fuzzycnc, refused, bags):
    payload = serialize(encode(bags[-1], ROSBAGS), bags[-1].TYPE)
    Path('thermal_posterior.state').write_bytes(f'{bags[-1].TYPE}\n'.encode() + payload)
    Path('other.state').write_bytes(b'fuzzycnc_msgs/msg/PredictorState\n')
    outcome = fuzzycnc('model', 'show', 'thermal_posterior.state')
    assert outcome.code == 0, outcome
    refused('model', 'show', 'other.state', naming=['ThermalPosterior', 'PredictorState'])
    refused('model', 'show', 'missing.state', naming=['missing.state'])


def test_a_damaged_memory_is_refused_by_name(refused, tmp_path, bags):
    with PublishedBag(tmp_path / 'bad') as bag:
        bag('thermal_posterior', replace(bags[-1], memory=bags[-1].memory[:-1]))
    refused('model', 'show', 'bad', naming=['memory'])


def test_machines_of_one_kind_give_a_model_to_begin_with(fuzzycnc, refused, bags):
    for name in ('much', 'little'):
        assert fuzzycnc('model', 'export', name, '--out', f'{name}.json').code == 0
    outcome = fuzzycnc('fleet', 'prior', 'much.json', 'little.json', '--out', 'kind.json')
    assert outcome.code == 0, outcome
    assert 'written from 2 machines' in outcome.out
    known = {
        name: load_model(Path(f'{name}.json')).prior.known[1].mean
        for name in ('much', 'little', 'kind')
    }
    np.testing.assert_allclose(known['kind'], 0.5 * (known['much'] + known['little']))
    Path('mill.json').write_text(model_text())
    refused('fleet', 'prior', 'much.json', 'mill.json', '--out', 'k.json', naming=['mill.json'])
    refused('fleet', 'prior', 'much.json', '--out', 'k.json', naming=['two of one kind'])
    assert not Path('k.json').exists()

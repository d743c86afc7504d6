# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Hostile model files: refused by name, or a model that gives numbers."""

import json
import random

import numpy as np
import pytest
from benches import predictor_bench
from fuzzing.campaign import SEEDS, bounded, fuzz, refusal
from fuzzing.file_mutations import mutated_bytes, mutated_json, mutated_text
from hypothesis import given
from kept import kept

from fuzzycnc_ros.core.deformation.model import read_model, write_model
from fuzzycnc_ros.core.deformation.network import TSFuzzyNetwork
from fuzzycnc_ros.core.document import ModelFileError
from fuzzycnc_ros.core.thermal.fit import train_model
from fuzzycnc_ros.core.thermal.model import load_model
from fuzzycnc_ros.simulation.soft.foam_samples import foam_samples

pytestmark = pytest.mark.filterwarnings('ignore::RuntimeWarning')


@kept
def thermal_text() -> str:
    """Return a thermal model with a recursion of every kind that trains in a moment."""
    runs = [predictor_bench.recordings()[name] for name in ('D0', 'T1')]
    kinds = ('least_squares', 'stable_grey', 'lag_ridge')
    return train_model(runs, candidates=kinds).to_json()


@kept
def deformation_text() -> str:
    """Return a model of a foam sheet."""
    data = foam_samples(22)
    return write_model(TSFuzzyNetwork(ridge=0.03).fit(data.x, data.s).model_)


def damaged(text: str, seed: int) -> str:
    """Return a model file with damage of one kind."""
    rng = random.Random(seed)
    kind = rng.randrange(4)
    if kind == 0:
        return mutated_bytes(text.encode(), rng).decode('utf-8', 'surrogateescape')
    if kind == 1:
        return mutated_text(text, rng)
    return mutated_json(text, rng)


@fuzz(30, share=0.2)
@given(seed=SEEDS)
def test_thermal_models(seed):
    text = damaged(thermal_text(), seed)
    text = text if text.lstrip().startswith('{') else '{' + text
    if refusal(ModelFileError, lambda: load_model(text)):
        return
    with bounded():
        model = load_model(text)
        stream = model.start()
        sample = np.concatenate([model.domain.mean, model.domain.drive])
        for _ in range(5):
            assert np.isfinite(stream.step(sample)).all()
        assert np.isfinite(model.standard_deviation(sample)).all()
        assert load_model(model.to_json()).to_json() == model.to_json()


@fuzz(30, share=0.2)
@given(seed=SEEDS)
def test_thermal_models_in_a_predictor(seed):
    text = damaged(thermal_text(), seed)
    bench = predictor_bench.bench_with_model(thermal_text())
    with bounded():
        predictor_bench.predict(bench, predictor_bench.recordings()['T1'], range(6))
        answer = bench.request('use_model', model=text)
        assert answer.success or answer.message
        predictor_bench.predict(bench, predictor_bench.recordings()['T1'], range(6, 12))
    for item in bench.records('thermal_error'):
        assert not np.isinf(item.error).any()
        assert not np.isinf(item.standard_deviation).any()
        assert not item.valid or np.isfinite(item.error).all()
    if not answer.success:
        assert bench.records('thermal_error')[-1].valid


@fuzz(30, share=0.2)
@given(seed=SEEDS)
def test_deformation_models(seed):
    text = damaged(deformation_text(), seed)
    data = foam_samples(22)
    if refusal(ModelFileError, lambda: read_model(text)):
        return
    with bounded():
        model = read_model(text)
        accepted = model.accepts(data.x)
        assert np.isfinite(model.predict(data.x)[accepted]).all()
        json.loads(write_model(model))

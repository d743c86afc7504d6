# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
import copy
import hashlib
import json
from base64 import b64encode
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fuzzycnc_ros.core.document import ModelFileError
from fuzzycnc_ros.core.names import text_hash
from fuzzycnc_ros.core.thermal.fit import train_model
from fuzzycnc_ros.core.thermal.model import ModelMismatchError, ThermalModel, load_model
from fuzzycnc_ros.core.thermal.run import ThermalRun
from fuzzycnc_ros.papers.thermal import ALL_CONTENDERS


def in_base64(covariance):
    return b64encode(covariance[np.tril_indices(len(covariance))].tobytes()).decode()


NOT_POSITIVE = in_base64(np.eye(12) + np.eye(12, k=1) + np.eye(12, k=-1))
NOT_A_NUMBER = in_base64(np.full((12, 12), np.nan))


def machine_run(name, seed, samples=200):
    rng = np.random.default_rng(seed)
    rise = np.cumsum(rng.normal(0.02, 0.1, (samples, 3)), axis=0)
    return ThermalRun(
        name=name,
        time=60.0 * np.arange(samples),
        sensor=('T1', 'T2', 'T3'),
        temperature=20.0 + rise,
        channel=('Y', 'Z'),
        axis=('Y', 'Z'),
        displacement=rise @ np.array([[1e-6, 2e-6], [3e-6, -1e-6], [0.5e-6, 1e-6]])
        + 1e-8 * rng.normal(size=(samples, 2)),
    )


@pytest.fixture(scope='module')
def model():
    return train_model([machine_run('a', 0), machine_run('b', 1)])


@pytest.fixture(scope='module')
def document(model):
    return json.loads(model.to_json())


def test_a_model_survives_its_file(model):
    text = model.to_json()
    again = ThermalModel.from_json(text)
    assert again.to_json() == text
    assert again.hash == model.hash == hashlib.sha256(text.encode()).hexdigest()
    assert text_hash(text) == model.hash
    assert model.to_json() == text
    run = machine_run('c', 2)
    for name in (None, *model.candidates):
        # Sums over arrays of another memory layout may differ in the last digit.
        assert np.allclose(again.predict(run, name), model.predict(run, name), rtol=1e-12)
    one, other = again.predict(run), ThermalModel.from_json(text).predict(run)
    assert np.array_equal(one, other)
    assert np.array_equal(again.in_domain(run.rise()), model.in_domain(run.rise()))
    assert again.selection == model.selection or np.isnan(model.selection.xie_beni)
    assert again.candidates['lag_ridge'].settings == model.candidates['lag_ridge'].settings


def test_a_model_is_loaded_from_text_or_path(model, tmp_path):
    path = tmp_path / 'model.json'
    path.write_text(model.to_json())
    assert load_model(path).hash == load_model(str(path)).hash == model.hash
    assert load_model(model.to_json()).hash == model.hash
    with pytest.raises(ModelFileError, match=r'absent.json'):
        load_model(tmp_path / 'absent.json')
    path.write_text('[1, 2]')
    with pytest.raises(ModelFileError, match=r'model\.json: model file: expected an object'):
        load_model(path)
    path.write_bytes(b'\xff\xfe{')
    with pytest.raises(ModelFileError, match='UTF-16'):
        load_model(path)


@pytest.mark.parametrize('candidate', [None, 'lag_ridge', 'classical_grey', 'least_squares'])
def test_stream_and_batch_agree(model, candidate):
    rise = model.rises(machine_run('c', 2))
    batch = model.predict(rise, candidate)
    stream = model.start(candidate)
    steps = np.array([stream.step(sample) for sample in rise])
    assert np.abs(steps - batch).max() <= 1e-12 * np.abs(batch).max()


def test_channels_may_use_different_candidates(document):
    mixed = copy.deepcopy(document)
    mixed['channels'][0]['default'] = 'stable_grey'
    mixed['channels'][1]['default'] = 'lag_ridge'
    model = ThermalModel.from_json(json.dumps(mixed))
    rise = model.rises(machine_run('c', 2))
    predicted = model.predict(rise)
    assert np.allclose(predicted[:, 0], model.predict(rise, 'stable_grey')[:, 0], rtol=1e-12)
    assert np.allclose(predicted[:, 1], model.predict(rise, 'lag_ridge')[:, 1], rtol=1e-12)


def test_streams_that_do_not_fit_are_refused_with_the_difference(model):
    model.check_stream(['T3', 'T9', 'T2', 'T1'], 61.0)
    with pytest.raises(ModelMismatchError, match=r'found no T2, T3; the stream has T1, T9'):
        model.check_stream(['T1', 'T9'], 60.0)
    with pytest.raises(ModelMismatchError, match=r'expected 60 s .* found 600 s'):
        model.check_stream(['T1', 'T2', 'T3'], 600.0)
    with pytest.raises(ModelMismatchError, match=r'found nan s'):
        model.check_stream(['T1', 'T2', 'T3'], float('nan'))
    with pytest.raises(ModelMismatchError, match='3 columns'):
        model.predict(np.zeros((5, 2)))
    with pytest.raises(ValueError, match=r"nan of input 'T2' at sample 1.*substitute"):
        model.predict([[0.0, 0.0, 0.0], [0.0, np.nan, 0.0]])
    with pytest.raises(ValueError, match=r"candidate: expected one of .* found 'mlp'"):
        model.start('mlp')


def test_domain_covers_training_and_flags_what_is_far(model):
    run = machine_run('a', 0)
    assert model.in_domain(run.rise()).mean() > 0.9
    far = np.full(3, 50.0)
    assert not model.in_domain(far)
    near = model.domain.mean
    assert np.allclose(model.standard_deviation(near), model.band.deviation)
    wider = model.band.growth * model.distance(far)
    assert np.allclose(model.standard_deviation(far), wider * model.band.deviation)
    assert model.standard_deviation(run.rise()).shape == (200, 2)


@settings(deadline=None, max_examples=20)
@given(factor=st.floats(1.0, 50.0))
def test_distance_grows_away_from_the_mean(model, factor):
    step = np.array([1.0, -2.0, 0.5])
    near = model.domain.distance(model.domain.mean + step)
    assert model.domain.distance(model.domain.mean + factor * step) == pytest.approx(factor * near)


def test_what_is_only_compared_stays_out_of_the_file():
    runs = [machine_run('a', 0), machine_run('b', 1)]
    names = ('static_ridge', 'static_network')
    model = train_model(runs, candidates=names[:1], compared=names[1:], contenders=ALL_CONTENDERS)
    again = ThermalModel.from_json(model.to_json())
    assert set(model.candidates) == {'uncompensated', *names}
    assert set(again.candidates) == {'uncompensated', 'static_ridge'}
    assert 'only compared' in again.omitted['static_network']
    with pytest.raises(ValueError, match=r'only compared$'):
        replace(model, default=('static_network',) * 2).to_json()


def test_files_of_before_load_without_what_is_only_compared(model):
    document = json.loads(model.to_json())
    document['candidates']['mlp'] = document['candidates']['static_ridge']
    again = ThermalModel.from_json(json.dumps(document))
    assert 'mlp' not in again.candidates
    assert 'fuzzycnc compare' in again.omitted['mlp']
    document['channels'][0]['default'] = 'mlp'
    with pytest.raises(ModelFileError, match='since mlp is only compared; train anew'):
        ThermalModel.from_json(json.dumps(document))


def test_conversion_to_another_interval(model):
    slow = model.with_interval(300.0)
    assert slow.interval == 300.0
    constant = np.ones((600, 3))
    for name in ('lag_ridge', 'stable_grey', 'static_ridge'):
        assert np.allclose(
            slow.predict(constant, name)[-1], model.predict(constant, name)[-1], rtol=1e-3
        )
    assert 'holds for one interval' in slow.omitted['hybrid_network']
    assert slow.prior.basis.interval == 300.0
    assert slow.prior.known is model.prior.known
    with pytest.raises(ValueError, match='interval'):
        model.with_interval(0.0)


def changed(document, *path, value):
    other = copy.deepcopy(document)
    node = other
    for key in path[:-1]:
        node = node[key]
    node[path[-1]] = value
    return other


@pytest.mark.parametrize(
    ('path', 'value', 'message'),
    [
        (('schema',), 'something', "schema 'fuzzycnc/thermal-model'"),
        (('schema_version',), 4, 'schema version 3, but found 4'),
        (('units', 'displacement'), 'um', 'expected the units'),
        (('interval',), -60.0, 'interval'),
        (('interval',), True, 'interval: expected a number'),
        (('interval',), '60', "interval: expected a number, but found '60'"),
        (('interval',), 10**400, 'interval: expected a finite number'),
        (('inputs',), ['T1', 'T2'], 'expected 2 numbers'),
        (('inputs',), ['T1', 'T1', 'T3'], 'each sensor once'),
        (('inputs',), 'T1', 'inputs: expected a list'),
        (('inputs',), [], 'expected 0 numbers'),
        (('channels',), [], 'each channel once'),
        (('channels', 0, 'default'), 'anfis', 'default: expected one of'),
        (('channels', 0, 'residual_deviation'), -1.0, 'a number from 0 to 1'),
        (('candidates',), {}, 'default: expected'),
        (('candidates', 'anfis'), {}, 'anfis'),
        (('candidates', 'lag_ridge', 'recursion', 'pole', 0), 1.0, r'poles in \[0, 1\)'),
        (('candidates', 'lag_ridge', 'recursion', 'pole', 0), None, 'expected a number'),
        (('candidates', 'lag_ridge', 'recursion', 'drive', 0), [1.0], 'expected 3 numbers'),
        (('candidates', 'lag_ridge', 'recursion', 'offset'), [0.0], 'expected'),
        (('candidates', 'lag_ridge', 'recursion', 'form'), 'pickle', 'one of linear, grey'),
        (('candidates', 'lag_ridge', 'held_out_rms'), [0.0], 'expected 2 numbers'),
        (('candidates', 'classical_grey', 'recursion', 'exact'), 1, 'true or false'),
        (('selection', 'clusters', 0, 'gain'), [], 'expected'),
        (('selection', 'clusters', 0, 'chosen'), 'T9', 'chosen sensors'),
        (('domain', 'mean'), [0.0], 'directions'),
        (('domain', 'thickness'), {}, 'thickness: expected a number'),
        (('domain', 'thickness'), 0.0, 'thickness: expected numbers from 1e-09'),
        (('domain', 'directions'), [[1.0]], 'expected 3 numbers'),
        (('band_growth',), -1.0, 'a number from 0 to 100'),
        (('cold_start', 'tolerance'), [0.0, 1.0, 1.0], 'tolerance: expected numbers from 1e-09'),
        (('fingerprints', 0, 'complete'), 1, 'true or false'),
        (('prior', 'channels'), [], r'prior: expected one of each channel \(2\), but found 0'),
        (('prior', 'channels', 0, 'mean'), [0.0], 'mean: expected 12 numbers'),
        (('prior', 'channels', 0, 'covariance'), 'AAAA', 'expected 78 numbers in base64'),
        (('prior', 'channels', 0, 'covariance'), '?', 'covariance: expected numbers in base64'),
        (('prior', 'channels', 0, 'covariance'), NOT_POSITIVE, 'a positive definite matrix'),
        (('prior', 'channels', 0, 'covariance'), NOT_A_NUMBER, 'a positive definite matrix'),
        (('prior', 'channels', 0, 'scales', 'drift'), 0.0, 'drift: expected a number from 1e-09'),
        (('prior', 'channels', 0, 'fastest'), 0.0, 'fastest: expected a number from 200'),
        (('prior', 'lags'), [0.0], 'lags'),
        (('prior', 'lags'), [60.0] * 200, 'prior: sensors: expected'),
        (('prior', 'channels', 0, 'share'), 2.0, 'share: expected a number from 0 to 1'),
        (('prior', 'speed'), 0, 'speed: expected true or false'),
    ],
)
def test_damaged_files_are_refused(document, path, value, message):
    with pytest.raises(ModelFileError, match=message):
        load_model(json.dumps(changed(document, *path, value=value)))


def test_no_field_may_be_missing(document):
    for key in document.keys() - {'prior'}:
        short = {name: value for name, value in document.items() if name != key}
        with pytest.raises(ModelFileError, match=f"an object with '{key}'"):
            load_model(json.dumps(short))


def test_a_file_of_before_there_were_priors_keeps_its_hash(document):
    text = json.dumps({name: value for name, value in document.items() if name != 'prior'}) + '\n'
    model = load_model(text)
    assert model.prior is None
    assert model.hash == text_hash(text)
    assert model.with_interval(300.0).prior is None


@pytest.mark.parametrize(
    'text',
    ['{', '{}', '{"schema": NaN}', '{"schema": ' + '[' * 100000, '{"a": ' + '9' * 5000 + '}'],
)
def test_what_is_no_model_is_refused(text):
    with pytest.raises(ModelFileError):
        load_model(text)


def test_huge_files_are_refused():
    with pytest.raises(ModelFileError, match='at most 16777216'):
        load_model('{' + ' ' * (16 * 1024 * 1024))


def test_nan_in_a_file_is_refused(model):
    text = model.to_json().replace('"interval": 60.0', '"interval": NaN')
    with pytest.raises(ModelFileError, match='found NaN'):
        load_model(text)


@settings(deadline=None, max_examples=60)
@given(data=st.data())
def test_random_damage_never_gives_anything_but_a_clear_refusal(model, data):
    text = model.to_json()
    cut = data.draw(st.integers(0, len(text) - 1))
    junk = data.draw(st.text(max_size=5))
    damaged = '{' + text[1:cut] + junk + text[cut + data.draw(st.integers(0, 5)) :]
    try:
        loaded = load_model(damaged)
    except ModelFileError:
        return
    assert load_model(loaded.to_json()).hash == loaded.hash


def test_an_unreliable_default_is_refused(document):
    bad = changed(document, 'candidates', 'lag_ridge', 'problems', value=['diverges'])
    for channel in bad['channels']:
        channel['default'] = 'lag_ridge'
    with pytest.raises(ModelFileError, match=r'reliable candidate.*diverges'):
        load_model(json.dumps(bad))


def test_diverged_scores_survive_the_file(document):
    text = json.dumps(
        changed(document, 'candidates', 'classical_grey', 'held_out_rms', value=[None, 1e-6])
    )
    loaded = load_model(text)
    assert np.isinf(loaded.candidates['classical_grey'].held_out_rms[0])
    assert '"held_out_rms": [null, 1e-06]' in loaded.to_json()

# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fuzzycnc_ros.core.document import ModelFileError, Node
from fuzzycnc_ros.core.thermal.fit.anfis import Anfis, GreyAnfis, mahalanobis
from fuzzycnc_ros.core.thermal.fit.linear import ridge_solution
from fuzzycnc_ros.core.thermal.recursions.base import (
    LinearRecursion,
    ParallelRecursion,
    Stream,
    combine,
    read_recursion,
    write_recursion,
)
from fuzzycnc_ros.core.thermal.recursions.rules import CorrectedRecursion, RulesRecursion


def warm_up(samples=150, inputs=2, seed=0):
    """Return two runs of rises and a bent, lagging thermal error [m]."""
    rng = np.random.default_rng(seed)
    minute = np.arange(samples)[:, np.newaxis]
    rises, targets = [], []
    for end in (12.0, 8.0):
        shape = 1.0 - np.exp(-minute / np.linspace(20.0, 60.0, inputs))
        rise = end * shape + rng.normal(0.0, 0.05, (samples, inputs))
        rises.append(rise)
        targets.append(1e-6 * (rise.sum(axis=1) + 0.1 * rise[:, 0] ** 2))
    return np.concatenate(rises), np.concatenate(targets), np.repeat([0, 1], samples)


def rules(seed=0, channels=2, count=3, inputs=3):
    rng = np.random.default_rng(seed)
    shape = (channels, count, inputs)
    return RulesRecursion(
        center=rng.uniform(0.0, 10.0, shape),
        width=rng.uniform(0.5, 3.0, shape),
        slope=1e-6 * rng.normal(size=shape),
        offset=1e-6 * rng.normal(size=(channels, count)),
    )


def linear(seed=0, channels=2, inputs=3):
    rng = np.random.default_rng(seed)
    return LinearRecursion(
        pole=np.array([0.9]),
        drive=rng.normal(size=(1, inputs)),
        readout=1e-6 * rng.normal(size=(channels, 1)),
        direct=1e-6 * rng.normal(size=(channels, inputs)),
        offset=np.zeros(channels),
    )


def corrected(seed=0, channels=2, inputs=3):
    rng = np.random.default_rng(seed)
    return CorrectedRecursion(
        base=linear(seed, channels, inputs),
        corrector=rules(seed, channels, 3, inputs),
        mean=rng.uniform(2.0, 6.0, (channels, inputs)),
        whitening=0.3 * rng.normal(size=(channels, inputs, inputs)),
        inner=np.full(channels, 2.0),
        outer=np.full(channels, 3.0),
    )


def rises(samples=120, inputs=3, seed=1):
    return np.cumsum(np.random.default_rng(seed).normal(0.1, 0.3, (samples, inputs)), axis=0)


RECURSIONS = [
    rules(),
    rules(channels=1, count=8),
    corrected(),
    # A corrector with a memory of its own.
    replace(corrected(), corrector=linear(seed=5)),
]


def test_two_rules_of_two_inputs_are_the_equations():
    """[ding_zeng] eqs. (1) to (6), written out."""
    t1, t2 = 3.0, 5.0
    (c1, c2), (s1, s2) = ((2.0, 4.0), (6.0, 9.0)), ((1.0, 2.0), (3.0, 0.5))
    (p1, q1, r1), (p2, q2, r2) = (1.0, -2.0, 0.5), (0.3, 0.7, -1.0)

    def mu(value, center, width):
        return np.exp(-((value - center) ** 2) / (2.0 * width**2))

    w1 = mu(t1, c1[0], s1[0]) * mu(t2, c1[1], s1[1])
    w2 = mu(t1, c2[0], s2[0]) * mu(t2, c2[1], s2[1])
    f1, f2 = p1 * t1 + q1 * t2 + r1, p2 * t1 + q2 * t2 + r2
    expected = (w1 * f1 + w2 * f2) / (w1 + w2)
    model = RulesRecursion(
        center=np.array([[c1, c2]]),
        width=np.array([[s1, s2]]),
        slope=np.array([[[p1, q1], [p2, q2]]]),
        offset=np.array([[r1, r2]]),
    )
    assert model.run(np.array([[t1, t2]]))[0, 0] == pytest.approx(expected, rel=1e-14)


def test_far_rises_give_finite_errors():
    far = 1e4 * np.random.default_rng(0).normal(size=(50, 3))
    assert np.isfinite(rules().run(far)).all()


@given(seed=st.integers(0, 100), share=st.floats(0.0, 1.0))
def test_inference_lies_between_the_consequents(seed, share):
    model = rules(seed)
    rise = share * 12.0 * np.random.default_rng(seed).uniform(size=(20, 3))
    output = rise @ model.slope.transpose(0, 2, 1) + model.offset[:, np.newaxis]
    values = model.run(rise).T
    assert (values <= output.max(axis=2) + 1e-18).all()
    assert (values >= output.min(axis=2) - 1e-18).all()


@pytest.mark.parametrize('make', [Anfis, GreyAnfis])
def test_samples_without_a_target_only_drive(make):
    rise, target, runs = warm_up()
    hidden = np.where(runs == 0, target, np.nan)
    one = make().fit(rise, hidden, runs=runs)
    other = make().fit(rise[runs == 0], target[runs == 0])
    assert np.allclose(one.predict(rise, runs=runs), other.predict(rise, runs=runs), rtol=1e-9)


@pytest.mark.parametrize('make', [Anfis, GreyAnfis])
def test_units_do_not_matter(make):
    rise, target, runs = warm_up()
    one = make().fit(rise, target, runs=runs).predict(rise, runs=runs)
    other = make().fit(rise, 1e6 * target, runs=runs).predict(rise, runs=runs)
    assert np.allclose(1e6 * one, other, rtol=1e-6, atol=1e-6)


@pytest.mark.parametrize('make', [Anfis, GreyAnfis])
def test_equal_input_gives_equal_models(make):
    rise, target, runs = warm_up()
    one = make().fit(rise, target, runs=runs).recursion_.document()
    assert make().fit(rise, target, runs=runs).recursion_.document() == one


def test_bends_are_learnt_that_no_line_follows():
    rise, target, runs = warm_up()
    model = Anfis().fit(rise, target, runs=runs)
    line = rise @ ridge_solution(rise, target, 0.0)
    residual = np.abs(model.predict(rise, runs=runs) - target).max()
    assert residual < 0.3 * np.abs(line - target).max()
    assert model.problems_ == ()
    assert model.support_.sum() == pytest.approx(len(rise))


def test_a_grid_has_all_combinations_and_is_flagged_where_samples_are_few():
    rise, target, _ = warm_up(samples=11, inputs=4)
    model = Anfis(rules='grid', ridge=1e-9, epochs=0).fit(rise, target)
    assert model.recursion_.offset.shape == (1, 16)
    assert len(np.unique(model.recursion_.center[0], axis=0)) == 16
    # More consequents than samples: the fit goes through every one of them.
    assert np.abs(model.predict(rise) - target).max() < 0.01e-6
    assert 'rules rest on fewer samples than their 5 coefficients' in model.problems_[0]


@pytest.mark.parametrize('recursion', RECURSIONS)
def test_stream_and_batch_agree(recursion):
    rise = rises()
    batch = recursion.run(rise)
    stream = Stream(recursion)
    steps = np.array([stream.step(sample) for sample in rise])
    assert np.abs(steps - batch).max() <= 1e-12 * np.abs(batch).max()


@pytest.mark.parametrize('recursion', RECURSIONS)
def test_documents_come_back(recursion):
    again = read_recursion(Node(write_recursion(recursion), 'test'), recursion.inputs)
    assert np.array_equal(again.run(rises()), recursion.run(rises()))
    assert again.document() == recursion.document()


@pytest.mark.parametrize('make', [rules, corrected])
def test_channels_can_be_taken_apart_and_joined(make):
    recursion = make(channels=3)
    parts = [recursion.channel(channel) for channel in range(3)]
    joined = combine(parts)
    assert isinstance(joined, type(recursion))
    assert np.allclose(joined.run(rises()), recursion.run(rises()), rtol=1e-12, atol=1e-20)


def test_different_numbers_of_rules_run_side_by_side():
    one, two = rules(channels=1), rules(channels=1, count=5)
    joined = combine([one, two])
    assert isinstance(joined, ParallelRecursion)
    assert np.array_equal(joined.run(rises())[:, 1:], two.run(rises()))
    pair = [replace(corrected(channels=1), corrector=item) for item in (one, two)]
    assert np.array_equal(combine(pair).run(rises())[:, 1:], pair[1].run(rises()))


@pytest.mark.parametrize(
    ('path', 'value', 'message'),
    [
        (('channels',), [], 'at least one channel'),
        (('channels', 1, 'offset'), [0.0], 'offset: expected 3 numbers'),
        (('channels', 1, 'width', 0), [1.0, 2.0], '3 numbers'),
        (('channels', 0, 'width', 0, 0), -1.0, 'width: expected numbers from 1e-09'),
        (('channels', 0, 'slope'), None, 'a list'),
    ],
)
def test_documents_of_rules_are_not_believed(path, value, message):
    refused(rules(), path, value, message)


@pytest.mark.parametrize(
    ('path', 'value', 'message'),
    [
        (('corrector',), write_recursion(corrected()), 'a recursion without parts'),
        (('corrector',), write_recursion(rules(channels=1)), '2 channels and 3 inputs'),
        (('domain',), [], 'at least one channel'),
        (('domain', 0, 'outer'), 1.0, 'beyond the inner'),
        (('domain', 0, 'mean'), [1.0], 'mean: expected 3 numbers'),
    ],
)
def test_documents_of_corrected_models_are_not_believed(path, value, message):
    refused(corrected(), path, value, message)


def refused(recursion, path, value, message):
    document = write_recursion(recursion)
    node = document
    for key in path[:-1]:
        node = node[key]
    node[path[-1]] = value
    with pytest.raises((ModelFileError, ValueError), match=message):
        read_recursion(Node(document, 'test'), recursion.inputs)


@settings(deadline=None)
@given(seed=st.integers(0, 30), way=st.integers(0, 30))
def test_the_corrector_never_steps(seed, way):
    """Along any line the weight changes in proportion to the way gone."""
    recursion = corrected(seed)
    direction = np.random.default_rng(way).normal(size=3)
    line = recursion.mean[0] + np.linspace(0.0, 60.0, 2001)[:, np.newaxis] * direction
    weight = recursion.weight(line)
    steepest = np.linalg.norm(recursion.whitening, ord=2, axis=(1, 2))
    bound = steepest * np.linalg.norm(direction) * 0.03 / (recursion.outer - recursion.inner)
    assert ((weight >= 0.0) & (weight <= 1.0)).all()
    assert weight[0, 0] == 1.0
    assert (np.abs(np.diff(weight, axis=0)).max(axis=0) <= 1.001 * bound).all()
    far = np.linalg.norm((line - recursion.mean[0]) @ recursion.whitening[0].T, axis=1) >= 3.0
    assert (weight[far, 0] == 0.0).all()


def test_outside_its_domain_only_the_grey_model_speaks():
    rise, target, runs = warm_up()
    model = GreyAnfis().fit(rise, target, runs=runs)
    mean, whitening, limit = mahalanobis(rise)
    beyond = 5.0 * rise[runs == 0]
    distance = np.linalg.norm((beyond - mean) @ whitening.T, axis=1)
    far, near = distance > 1.5 * limit, distance <= limit
    assert far.any()
    assert near.any()
    grey = model.grey_.predict(beyond)
    anfis = model.anfis_.predict(beyond)
    assert np.array_equal(model.predict(beyond)[far], grey[far])
    assert np.allclose(model.predict(beyond)[near], (grey + anfis)[near], rtol=1e-12)
    assert (np.abs(anfis[far]) > 1e-6).any()


def test_the_corrector_takes_up_what_the_grey_model_leaves():
    rise, target, runs = warm_up()
    model = GreyAnfis().fit(rise, target, runs=runs)
    left = np.abs(model.grey_.predict(rise, runs=runs) - target)
    after = np.abs(model.predict(rise, runs=runs) - target)
    assert np.sqrt(np.mean(after**2)) < 0.5 * np.sqrt(np.mean(left**2))
    assert model.problems_ == ()


def test_problems_of_both_parts_are_told():
    rise, _, runs = warm_up()
    lagging = np.concatenate([np.cumsum(rise[runs == run, 0]) for run in (0, 1)]) * 1e-9
    model = GreyAnfis().fit(rise, lagging, runs=runs)
    assert model.grey_.problems_
    assert model.problems_ == model.grey_.problems_ + model.anfis_.problems_


def test_another_interval():
    rise, target, runs = warm_up()
    model = Anfis().fit(rise, target, runs=runs)
    assert np.array_equal(model.with_interval(10.0).predict(rise), model.predict(rise))
    series = GreyAnfis().fit(rise, target, runs=runs)
    faster = series.with_interval(30.0)
    expected = series.grey_.with_interval(30.0).recursion_.document()
    assert faster.recursion_.base.document() == expected
    assert faster.recursion_.corrector is series.recursion_.corrector


@pytest.mark.parametrize(
    ('make', 'parameter', 'value'),
    [
        (Anfis, 'rules', 'random'),
        (Anfis, 'n_rules', 0),
        (Anfis, 'n_rules', 1000),
        (Anfis, 'ridge', 0.0),
        (Anfis, 'epochs', -1),
        (Anfis, 'interval', 0.0),
        (GreyAnfis, 'fade', 1.0),
        (GreyAnfis, 'fade', np.nan),
        (GreyAnfis, 'corrector_ridge', -1.0),
    ],
)
def test_refusals(make, parameter, value):
    rise, target, runs = warm_up()
    word = {'n_rules': 'n_', 'corrector_ridge': 'ridge'}.get(parameter, parameter)
    with pytest.raises(ValueError, match=rf'{word}\w*: expected .*, but found'):
        make(**{parameter: value}).fit(rise, target, runs=runs)


def test_a_grid_of_many_inputs_is_refused():
    with pytest.raises(ValueError, match=r'2\^9 rules; use fcm'):
        Anfis(rules='grid').fit(np.ones((30, 9)), np.zeros(30))


def test_rules_run_without_the_estimators():
    """What a node loads to run a model leaves scikit-learn alone."""
    program = """
import sys
from fuzzycnc_ros.core.thermal.recursions.rules import CorrectedRecursion, RulesRecursion
print('sklearn' in sys.modules)
"""
    done = subprocess.run(
        [sys.executable, '-c', program], capture_output=True, text=True, check=True
    )
    assert done.stdout.strip() == 'False'

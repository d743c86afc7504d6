# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
import subprocess
import sys
import warnings

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from fuzzycnc_ros.core.estimator import NotFittedError
from fuzzycnc_ros.core.fuzzy.clustering import FuzzyCMeans

samples = arrays(
    np.float64,
    st.tuples(st.integers(6, 15), st.integers(1, 20)),
    elements=st.floats(-100.0, 100.0, allow_subnormal=False),
)


def blobs(seed=0, features=3):
    rng = np.random.default_rng(seed)
    centers = np.array([[-5.0], [0.0], [5.0]]) * np.ones(features)
    return np.concatenate([center + rng.normal(0, 0.3, (20, features)) for center in centers])


@settings(deadline=None, max_examples=60)
@given(data=samples, clusters=st.integers(2, 5), m=st.sampled_from([1.3, 2.0, 3.0]))
def test_memberships_sum_to_one_and_the_objective_never_rises(data, clusters, m):
    model = FuzzyCMeans(clusters, m=m, n_init=2, max_iter=40, random_state=0).fit(data)
    assert np.abs(model.membership_.sum(axis=1) - 1.0).max() <= 1e-12
    assert (model.membership_ >= 0.0).all()
    history = model.objective_history_
    # Equal samples have no objective but the rounding of their own coordinates.
    rounding = data.size * (np.finfo(float).eps * np.abs(data).max()) ** 2
    assert (np.diff(history) <= 1e-12 * (history[0] + np.ptp(data) ** 2) + rounding).all()
    assert 1.0 / clusters - 1e-12 <= model.partition_coefficient_ <= 1.0 + 1e-12


@pytest.mark.parametrize('features', [2, 200])
def test_fixed_point_satisfies_both_equations(features):
    data = blobs(features=features)
    model = FuzzyCMeans(3, m=1.8, tol=1e-12, max_iter=2000, random_state=1).fit(data)
    distance = ((data[:, None] - model.cluster_centers_) ** 2).sum(axis=2)
    nearness = distance ** (-1 / 0.8)
    membership = nearness / nearness.sum(axis=1, keepdims=True)
    assert np.allclose(model.membership_, membership, atol=1e-9)
    weight = membership**1.8
    centers = weight.T @ data / weight.sum(axis=0)[:, None]
    assert np.allclose(model.cluster_centers_, centers, atol=1e-8)
    assert model.objective_ == pytest.approx((weight * distance).sum(), rel=1e-9)


def test_separated_groups_are_found_whatever_the_order():
    data = blobs()
    order = np.random.default_rng(3).permutation(len(data))
    labels = FuzzyCMeans(3, random_state=0).fit_predict(data)
    shuffled = FuzzyCMeans(3, random_state=5).fit_predict(data[order])
    assert [len(set(labels[i : i + 20])) for i in (0, 20, 40)] == [1, 1, 1]
    together = labels[order][:, None] == labels[order]
    assert np.array_equal(together, shuffled[:, None] == shuffled)


def test_scale_and_offset_change_nothing():
    data = blobs()
    one = FuzzyCMeans(3, random_state=0).fit(data)
    other = FuzzyCMeans(3, random_state=0).fit(data * 1e-6 + 40.0)
    # Several starts find the same clusters; rounding chooses among them, and so the order.
    same = [np.argmax(other.membership_[place]) for place in one.membership_.argmax(axis=0)]
    assert sorted(same) == [0, 1, 2]
    assert np.allclose(one.membership_, other.membership_[:, same], atol=1e-6)
    assert one.xie_beni_ == pytest.approx(other.xie_beni_, rel=1e-6)


def test_a_sample_on_a_centre_belongs_to_it():
    model = FuzzyCMeans(2, random_state=0).fit([[0.0, 0.0]] * 5 + [[1.0, 0.0]] * 5)
    assert np.allclose(np.sort(model.membership_, axis=1), [0.0, 1.0], atol=1e-9)
    assert model.partition_coefficient_ == pytest.approx(1.0)


def test_identical_samples_are_shared_equally():
    model = FuzzyCMeans(2, random_state=0).fit(np.ones((6, 3)))
    assert np.allclose(model.membership_, 0.5)
    assert np.isnan(model.xie_beni_)


def test_predict_agrees_with_fit_and_membership():
    data = blobs()
    model = FuzzyCMeans(3, random_state=0).fit(data)
    assert np.array_equal(model.predict(data), model.labels_)
    assert np.allclose(model.predict_membership(data), model.membership_, atol=1e-5)


def test_same_seed_same_result_and_no_global_state():
    data = blobs()
    before = np.random.get_state()[1].copy()  # noqa: NPY002 the state that must not change
    one = FuzzyCMeans(3, random_state=7).fit(data)
    other = FuzzyCMeans(3, random_state=7).fit(data)
    assert np.array_equal(one.membership_, other.membership_)
    assert np.array_equal(before, np.random.get_state()[1])  # noqa: NPY002


@pytest.mark.parametrize(
    ('parameter', 'value'),
    [('m', 1.0), ('m', np.nan), ('m', 51.0), ('n_clusters', 0), ('n_clusters', 61), ('n_init', 0)],
)
def test_refusals_name_the_parameter(parameter, value):
    with pytest.raises(ValueError, match=rf'{parameter}: expected .*, but found'):
        FuzzyCMeans(**{'n_clusters': 3, parameter: value}).fit(blobs())


def test_unfitted_and_other_width_are_refused():
    with pytest.raises(NotFittedError, match='fit'):
        FuzzyCMeans(2).predict([[0.0]])
    model = FuzzyCMeans(2, random_state=0).fit([[0.0], [1.0], [2.0]])
    with pytest.raises(ValueError, match='features'):
        model.predict([[0.0, 1.0]])
    with pytest.raises(ValueError, match='NaN'):
        model.fit([[0.0], [np.nan], [1.0]])


def test_scikit_learn_accepts_the_estimator():
    checks = pytest.importorskip('sklearn.utils.estimator_checks')
    with warnings.catch_warnings():
        # Checks of other array libraries announce that they do not apply.
        warnings.simplefilter('ignore', pytest.importorskip('sklearn.exceptions').SkipTestWarning)
        checks.check_estimator(FuzzyCMeans(3, n_init=2, random_state=0))


def test_works_the_same_without_scikit_learn():
    program = """
import sys
sys.modules['sklearn'] = None
import numpy as np
from fuzzycnc_ros.core.fuzzy.clustering import FuzzyCMeans
data = np.concatenate([np.zeros((4, 2)), np.ones((4, 2))])
model = FuzzyCMeans(2, random_state=0)
labels = model.fit_predict(data)
assert len(set(labels[:4])) == len(set(labels[4:])) == 1 and labels[0] != labels[-1]
assert model.get_params()['n_clusters'] == 2
assert model.set_params(m=1.5).m == 1.5
for bad in ([[0.0]], [[np.nan, 0.0]], [0.0]):
    try:
        model.predict(bad)
    except ValueError:
        continue
    raise SystemExit(f'{bad} was accepted')
try:
    model.set_params(k=3)
except ValueError as error:
    assert "'k'" in str(error)
else:
    raise SystemExit('an unknown parameter was accepted')
print(repr(model))
"""
    done = subprocess.run(
        [sys.executable, '-c', program], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith('FuzzyCMeans(n_clusters=2, m=1.5')

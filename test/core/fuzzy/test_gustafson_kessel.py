# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
import warnings

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from fuzzycnc_ros.core.estimator import NotFittedError
from fuzzycnc_ros.core.fuzzy.clustering import GustafsonKessel, class_values, grow_clusters

samples = arrays(
    np.float64,
    st.tuples(st.integers(8, 15), st.integers(1, 5)),
    elements=st.floats(-100.0, 100.0, allow_subnormal=False),
    unique=True,
)


def sticks(seed=0):
    """Return three long thin groups, which round clusters would cut across."""
    rng = np.random.default_rng(seed)
    along = rng.uniform(-5, 5, (3, 30))
    across = rng.normal(0, 0.1, (3, 30)) + np.array([[0.0], [2.0], [4.0]])
    return np.stack([along, across], axis=-1).reshape(-1, 2)


def plain(z, membership, share, iterations):
    """Return memberships, centres, norms and J by the equations, sample by sample."""
    count, size = z.shape
    clusters = len(membership)
    whole = sum(np.outer(row, row) for row in z - z.mean(axis=0)) / count
    volume = np.linalg.det(whole) ** (1 / size)
    for _ in range(iterations):
        centers, norms, distance = [], [], np.empty((clusters, count))
        for i in range(clusters):
            weight = membership[i] ** 2
            center = sum(w * row for w, row in zip(weight, z, strict=True)) / weight.sum()
            spread = sum(
                w * np.outer(row - center, row - center) for w, row in zip(weight, z, strict=True)
            )
            spread = (1 - share) * spread / weight.sum() + share * volume * np.eye(size)
            norm = np.linalg.det(spread) ** (1 / size) * np.linalg.inv(spread)
            for k in range(count):
                distance[i, k] = (z[k] - center) @ norm @ (z[k] - center)
            centers.append(center)
            norms.append(norm)
        for i in range(clusters):
            for k in range(count):
                ratio = [np.sqrt(distance[i, k] / distance[j, k]) for j in range(clusters)]
                membership[i, k] = 1.0 / sum(value**2 for value in ratio)
    return membership, np.array(centers), np.array(norms), (membership**2 * distance).sum()


def test_agrees_with_a_plain_implementation():
    z = sticks()[::3]
    model = GustafsonKessel(3, max_iter=5, n_init=1, random_state=0).fit(z)
    # Both start from the same centres: those of the memberships before the sixth iteration.
    longer = GustafsonKessel(3, max_iter=12, tol=0.0, n_init=1, random_state=0).fit(z)
    found = plain(z, model.membership_.T.copy(), 0.02, 7)
    for ours, theirs in zip(
        (longer.membership_.T, longer.cluster_centers_, longer.norm_matrices_, longer.objective_),
        found,
        strict=True,
    ):
        assert ours == pytest.approx(theirs, rel=1e-9, abs=1e-10)


@settings(deadline=None, max_examples=60)
@given(data=samples, clusters=st.integers(1, 5), m=st.sampled_from([1.5, 2.0, 3.0]))
def test_memberships_sum_to_one_and_norms_keep_the_volume(data, clusters, m):
    model = GustafsonKessel(clusters, m=m, n_init=2, max_iter=20, random_state=0).fit(data)
    assert np.abs(model.membership_.sum(axis=1) - 1.0).max() <= 1e-12
    assert (model.membership_ >= 0.0).all()
    assert np.linalg.det(model.norm_matrices_) == pytest.approx(np.ones(clusters), rel=1e-6)
    assert np.allclose(model.predict_membership(data), model.membership_, atol=1e-6)


def test_long_groups_are_found_where_round_clusters_cut_them():
    truth = np.repeat([0, 1, 2], 30)
    labels = GustafsonKessel(3, n_init=10, random_state=0).fit_predict(sticks())
    pairs = {(int(a), int(b)) for a, b in zip(truth, labels, strict=True)}
    assert len(pairs) == 3


def test_same_seed_same_clusters_and_more_starts_are_no_worse():
    z = np.random.default_rng(1).normal(size=(80, 4))
    one, again = (GustafsonKessel(5, n_init=1, random_state=7).fit(z) for _ in range(2))
    assert np.array_equal(one.membership_, again.membership_)
    best = GustafsonKessel(5, n_init=6, random_state=7).fit(z)
    assert best.objective_ <= one.objective_ * (1.0 + 1e-9)


def test_it_says_whether_it_came_to_rest():
    z = np.random.default_rng(2).normal(size=(60, 3))
    assert GustafsonKessel(2, random_state=0).fit(z).converged_
    hasty = GustafsonKessel(2, max_iter=2, random_state=0).fit(z)
    assert not hasty.converged_
    assert hasty.n_iter_ == 2


@pytest.mark.parametrize('clusters', [2, 5, 10])
def test_constant_column_gives_numbers(clusters):
    z = np.column_stack([np.random.default_rng(3).normal(size=(60, 3)), np.full(60, 2.0)])
    model = GustafsonKessel(clusters, random_state=0).fit(z)
    for values in (model.membership_, model.cluster_centers_, model.norm_matrices_):
        assert np.isfinite(values).all()
    assert np.isfinite(model.objective_history_).all()


def test_without_regularisation_a_flat_group_still_gives_numbers():
    z = np.array([[t, 0.0] for t in range(9)] + [[t, 9.0] for t in range(9)])
    model = GustafsonKessel(2, regularisation=0.0, random_state=0).fit(z)
    assert np.isfinite(model.membership_).all()


def test_more_clusters_than_distinct_samples_is_refused():
    with pytest.raises(ValueError, match=r'expected 1 to 3 \(the number of distinct samples'):
        GustafsonKessel(4).fit([[0.0], [1.0], [2.0]] * 5)
    with pytest.raises(ValueError, match='expected 1 to 1 '):
        GustafsonKessel(2).fit(np.ones((10, 3)))
    model = GustafsonKessel(3, random_state=0).fit([[0.0], [1.0], [2.0]] * 5)
    assert sorted(model.cluster_centers_.ravel()) == pytest.approx([0.0, 1.0, 2.0], abs=1e-3)


@pytest.mark.parametrize(
    'params',
    [
        {'m': 1.0},
        {'m': 51.0},
        {'regularisation': -0.1},
        {'regularisation': 1.1},
        {'n_init': 0},
        {'max_iter': 0},
        {'tol': -1.0},
        {'n_clusters': 0},
    ],
)
def test_parameters_out_of_range_are_refused(params):
    with pytest.raises(ValueError, match=f'{next(iter(params))}: expected'):
        GustafsonKessel(**({'n_clusters': 2} | params)).fit(sticks())


def test_prediction_needs_a_fit():
    with pytest.raises(NotFittedError):
        GustafsonKessel().predict([[0.0]])


def test_class_values_are_weighted_means_and_variances():
    membership = np.array([[1.0, 0.0], [0.5, 0.5], [0.0, 1.0]])
    outputs = np.array([[0.0], [1.0], [4.0]])
    found = class_values(membership, outputs)
    assert found.center.ravel() == pytest.approx([0.25 / 1.25, (0.25 + 4.0) / 1.25])
    assert found.variance[0, 0] == pytest.approx(0.25 / 1.25 - 0.2**2)
    assert found.decision.ravel().tolist() == [0.0, 4.0]


def test_growth_stops_when_the_variance_is_small_enough_or_at_the_cap():
    z = np.concatenate([np.random.default_rng(4).normal(at, 0.1, (20, 2)) for at in (0, 5, 10)])
    output = np.repeat([0.0, 5.0, 10.0], 20)[:, None]
    model = GustafsonKessel(6, n_init=6, random_state=0)
    assert len(grow_clusters(z, output, 0.5, model).cluster_centers_) == 3
    assert len(grow_clusters(z, output, 0.0, model).cluster_centers_) == 6


def test_scikit_learn_accepts():
    checks = pytest.importorskip('sklearn.utils.estimator_checks')
    exceptions = pytest.importorskip('sklearn.exceptions')
    with warnings.catch_warnings():
        warnings.simplefilter('ignore', exceptions.SkipTestWarning)
        checks.check_estimator(GustafsonKessel(2, n_init=1, max_iter=30, random_state=0))

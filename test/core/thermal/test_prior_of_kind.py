# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""What machines of one kind teach of another one."""

from dataclasses import replace

import numpy as np
import pytest

from fuzzycnc_ros.core.thermal.learning import Basis, Knowledge, Scales
from fuzzycnc_ros.core.thermal.prior import LearningPrior, of_one_kind

BASIS = Basis(2, False, 60.0)


def machines(count, spread=2e-7, unknown=1e-8, seed=0):
    """Return what is known of machines whose weights differ about those of a kind."""
    random = np.random.default_rng(seed)
    kind = 1e-6 * np.arange(BASIS.features)
    found = []
    for _ in range(count):
        weights = kind + spread * random.normal(size=BASIS.features)
        covariance = np.eye(BASIS.features) * unknown * unknown
        known = Knowledge(Scales(2e-5, 1e-5, 1e-6, 0.2), 300.0, weights, covariance)
        found.append(LearningPrior(BASIS, (known,), (0.0,)))
    return found, kind


def test_the_kind_has_the_mean_and_the_spread_of_its_machines():
    priors, kind = machines(400)
    (known,) = of_one_kind(priors).known
    np.testing.assert_allclose(known.mean, kind, atol=4e-8)
    np.testing.assert_allclose(np.sqrt(known.covariance.diagonal()), 2e-7, rtol=0.15)
    assert known.scales == pytest.approx(Scales(2e-5, 1e-5, 1e-6, 0.2))


def test_what_no_machine_knows_stays_unknown():
    priors, _ = machines(3, spread=0.0, unknown=5e-7)
    (known,) = of_one_kind(priors).known
    np.testing.assert_allclose(np.sqrt(known.covariance.diagonal()), 5e-7)


def test_a_new_machine_lies_within_the_band_of_two():
    inside = []
    for seed in range(200):
        priors, _ = machines(3, seed=seed)
        (known,) = of_one_kind(priors[:2]).known
        apart = np.abs(priors[2].known[0].mean - known.mean)
        inside.append(apart <= 2.0 * np.sqrt(known.covariance.diagonal()))
    # Of two machines the spread is known badly: less than 95 %.
    assert 0.6 < np.mean(inside) < 0.95


def test_machines_that_differ_in_kind_are_refused():
    priors, _ = machines(2)
    with pytest.raises(ValueError, match='expected two of one kind or more, but found 1'):
        of_one_kind(priors[:1])
    other = replace(priors[1], basis=replace(BASIS, interval=30.0))
    with pytest.raises(ValueError, match='expected the same number of sensors'):
        of_one_kind([priors[0], other])

# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Regimes of the benchmark: their memberships, their share, and mixtures by score."""

import sys
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest

from fuzzycnc_ros.core.thermal.learning import Basis, Learner

BENCHMARKS = Path(__file__).parents[2] / 'benchmarks'
NAMES = ('thermal_regimes', 'thermal_learning', 'thermal_recordings')


@pytest.fixture(scope='module')
def regimes():
    """The benchmark's module."""
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(BENCHMARKS))
        yield import_module(NAMES[0])
    for name in NAMES:
        sys.modules.pop(name, None)


def predicted(learner):
    """Let a learner follow two short runs with a probe an hour, and return what it predicts."""
    random = np.random.default_rng(0)
    found = []
    for _ in range(2):
        for minute in range(240):
            rise = np.array([8.0, 3.0]) * (1.0 - np.exp(-minute / 90.0))
            learner.step(rise, 100.0 * (minute < 120), 60.0 * minute)
            found.append(np.concatenate(learner.predict()))
            if minute % 60 == 59:
                error = 1e-6 * (rise @ (3.0, -1.0) + random.normal(0.0, 0.3))
                learner.probe(np.array([error]), np.array([0.3e-6]))
        learner.begin_run()
    return np.array(found)


def test_regimes_without_a_share_are_the_learner_without_them(regimes):
    basis = Basis(2, True, 60.0)
    plain = predicted(Learner(basis, ['Z']))
    alike = predicted(regimes.regime_learner(regimes.heating, 0.0, basis, ['Z']))
    np.testing.assert_allclose(alike, plain, rtol=1e-6, atol=1e-12)
    other = predicted(regimes.regime_learner(regimes.heating, 0.7, basis, ['Z']))
    assert np.abs(other - plain).max() > 1e-7


def test_memberships_are_of_what_the_machine_does(regimes):
    slow = regimes.Slow()
    assert regimes.heating(slow) == 0.5
    assert regimes.running(slow) == regimes.warm(slow) == 0.0
    for minute in range(60):
        slow = slow.next(np.full(3, 0.2 * minute), 100.0, 60.0)
    assert min(regimes.heating(slow), regimes.running(slow), regimes.warm(slow)) > 0.5
    for _ in range(60):
        slow = slow.next(np.zeros(3), 0.0, 60.0)
    assert max(map(float, (regimes.running(slow), regimes.warm(slow)))) < 0.1
    assert regimes.heating(slow) < 0.5


def test_a_mixture_goes_over_to_the_member_that_predicts_the_probes(regimes):
    rows = 40
    probed = np.zeros((rows, 1), dtype=bool)
    probed[4::5] = True
    measured, deviation = np.full((rows, 1), 5e-6), np.full((rows, 1), 2e-6)
    wrong, right = (
        regimes.Judged(measured, np.full((rows, 1), value), deviation, probed)
        for value in (0.0, 5e-6)
    )
    (mixture,) = regimes.mixed([[wrong], [right]])
    assert mixture.predicted[0] == pytest.approx(0.6 * 5e-6)
    assert mixture.deviation[0] > deviation[0]
    assert mixture.predicted[-1] == pytest.approx(5e-6, rel=1e-6)
    (same,) = regimes.mixed([[wrong], [wrong]])
    np.testing.assert_allclose(same.predicted, wrong.predicted, atol=1e-18)
    np.testing.assert_allclose(same.deviation, deviation)

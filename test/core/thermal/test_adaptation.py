# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Adaptation: learns a lasting gain over runs, within its bound, and leaves a fitting model."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fuzzycnc_ros.core.thermal.probing import GainAdaptation

MICRON = 1e-6
NOISE = np.full(1, 1.5 * MICRON)


def run(adaptation, true_gain, offset=0.0, probes=8, seed=0):
    """Probe a warm-up to 30 um every half hour."""
    rng = np.random.default_rng(seed)
    adaptation.begin()
    for number in range(1, probes + 1):
        predicted = np.array([30e-6 * (1.0 - np.exp(-number / 3.0))])
        measured = (1.0 + true_gain) * predicted + offset + rng.normal(0.0, 0.5 * MICRON, 1)
        adaptation.elapse(1800.0)
        adaptation.update(predicted, measured, NOISE)


@pytest.mark.parametrize('bound', [0.0, 1.0, -0.1, np.nan])
def test_bound_is_a_fraction(bound):
    with pytest.raises(ValueError, match=r'bound: expected a fraction in \(0, 1\)'):
        GainAdaptation(1, bound)


def test_a_lasting_gain_is_learnt_over_runs():
    adaptation = GainAdaptation(1, 0.3)
    gains = []
    for seed in range(6):
        run(adaptation, 0.2, seed=seed)
        gains.append(adaptation.gain[0])
    assert 0.05 < gains[0] < 0.2  # a single run may err
    assert gains[-1] == pytest.approx(0.2, abs=0.03)


def test_a_machine_as_trained_stays_as_it_is():
    adaptation = GainAdaptation(1, 0.3)
    for seed in range(6):
        run(adaptation, 0.0, seed=seed)
        assert abs(adaptation.gain[0]) < 0.05


def test_an_offset_of_one_run_is_not_taken_for_a_gain():
    adaptation = GainAdaptation(1, 0.3)
    for seed in range(6):
        run(adaptation, 0.0, offset=(-1) ** seed * 3.0 * MICRON, seed=seed)
    assert abs(adaptation.gain[0]) < 0.06


@given(
    st.floats(0.01, 0.5),
    st.lists(st.tuples(st.floats(-40, 40), st.floats(-9.9, 9.9)), max_size=40),
)
def test_gain_never_leaves_its_bound(bound, probes):
    adaptation = GainAdaptation(1, bound)
    for predicted, apart in probes:
        adaptation.elapse(600.0)
        value = np.array([predicted * MICRON])
        adaptation.update(value, value + apart * MICRON, NOISE)
        assert abs(adaptation.gain[0]) <= bound


def test_state_resumes():
    one, other = GainAdaptation(1, 0.2), GainAdaptation(1, 0.2)
    run(one, 0.1)
    other.state = one.state
    run(one, 0.1, seed=1)
    run(other, 0.1, seed=1)
    assert one.state.tobytes() == other.state.tobytes()

# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Corrections by probes: what a probe changes, what it leaves, which probes are doubted."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fuzzycnc_ros.core.thermal.probing import (
    JUMP_MAX,
    OffsetGainFilter,
    OffsetReset,
    ProbeVariances,
    Verdict,
)

MICRON = 1e-6
NOISE = np.full(1, 0.7 * MICRON)
BOTH = pytest.mark.parametrize('kind', [OffsetGainFilter, OffsetReset])


def probe(known, predicted, measured, noise=NOISE):
    """Give one probe in um; return its verdicts."""
    channels = len(known.probed)
    return known.update(
        np.full(channels, predicted * MICRON),
        np.broadcast_to(np.array(measured) * MICRON, channels),
        np.broadcast_to(noise, channels),
    ).tolist()


def corrected(known, predicted):
    """Return a corrected prediction in um."""
    return (known.corrected(np.full(len(known.probed), predicted * MICRON)) / MICRON).tolist()


def test_refusals():
    with pytest.raises(ValueError, match='channels: expected 1 or more, but found 0'):
        OffsetGainFilter(0)
    with pytest.raises(ValueError, match='gain: expected a variance of 0 or more'):
        ProbeVariances(gain=-1.0)
    known = OffsetGainFilter(2)
    with pytest.raises(ValueError, match='time: expected 0 s or more, but found -1'):
        known.elapse(-1.0)
    with pytest.raises(ValueError, match='state: expected 16 finite numbers'):
        known.state = np.full(16, np.nan)


@BOTH
def test_nothing_is_changed_before_a_probe(kind):
    known = kind(2)
    known.elapse(86400.0)
    assert corrected(known, 12.0) == pytest.approx([12.0, 12.0])
    assert np.isnan(known.deviation(np.zeros(2))).all()
    assert probe(known, 5.0, np.nan) == [Verdict.ABSENT] * 2
    assert not known.probed.any()


def test_reset_makes_the_corrected_error_what_was_measured():
    known = OffsetReset(1)
    probe(known, 10.0, 13.0)
    assert corrected(known, 10.0) == pytest.approx([13.0])
    known.elapse(1800.0)
    probe(known, 20.0, 18.0)
    assert corrected(known, 20.0) == pytest.approx([18.0])
    assert corrected(known, 0.0) == pytest.approx([-2.0])


def test_filter_is_the_least_squares_of_prior_and_probes():
    """Without wandering its estimate solves the regularised normal equations."""
    rng = np.random.default_rng(3)
    variances = ProbeVariances(offset_rate=0.0, gain_rate=0.0)
    known = OffsetGainFilter(1, variances)
    predicted = rng.uniform(-30.0, 30.0, 12) * MICRON
    residual = 2.0 * MICRON + 0.1 * predicted + rng.normal(0.0, 0.3 * MICRON, 12)
    for value, apart in zip(predicted, residual, strict=True):
        known.update(np.array([value]), np.array([value + apart]), NOISE)
    rows = np.column_stack([np.ones(12), predicted])
    information = rows.T @ rows / NOISE[0] ** 2 + np.diag([1.0 / 4e-12, 1.0 / 0.02])
    solution = np.linalg.solve(information, rows.T @ residual / NOISE[0] ** 2)
    np.testing.assert_allclose(known.estimate[0], solution, rtol=1e-6)
    np.testing.assert_allclose(known.covariance[0], np.linalg.inv(information), rtol=1e-6)


@BOTH
def test_deviation_shrinks_with_a_probe_and_grows_with_time(kind):
    known = kind(1)
    probe(known, 20.0, 23.0)
    after = known.deviation(np.array([20e-6]))[0]
    assert after <= 0.71 * MICRON
    known.elapse(1800.0)
    later = known.deviation(np.array([20e-6]))[0]
    # 0.05 um^2 a minute for the offset alone
    assert later >= np.sqrt(after**2 + 1.5 * MICRON**2) * (1.0 - 1e-9)
    probe(known, 20.0, 23.0)
    assert known.deviation(np.array([20e-6]))[0] < later


@BOTH
def test_channels_are_apart(kind):
    known, alone = kind(2), kind(1)
    for step in range(5):
        verdicts = known.update(
            np.array([10.0, 20.0]) * MICRON,
            np.array([11.0 + step, np.nan]) * MICRON,
            np.full(2, NOISE[0]),
        )
        assert verdicts.tolist() == [Verdict.ACCEPTED, Verdict.ABSENT]
        probe(alone, 10.0, 11.0 + step)
        known.elapse(600.0)
        alone.elapse(600.0)
    np.testing.assert_array_equal(known.estimate[0], alone.estimate[0])
    assert not known.estimate[1].any()


@BOTH
def test_one_outlier_is_rejected_and_changes_nothing(kind):
    known = kind(1)
    probe(known, 10.0, 11.0)
    before = known.estimate.copy()
    assert probe(known, 10.0, 45.0) == [Verdict.REJECTED]
    np.testing.assert_array_equal(known.estimate, before)
    assert probe(known, 10.0, 11.2) == [Verdict.ACCEPTED]
    # The doubt is over: another single outlier is rejected again.
    assert probe(known, 10.0, 45.0) == [Verdict.REJECTED]


@BOTH
@pytest.mark.parametrize('second', [45.0, 40.0, 54.0])
def test_two_outliers_that_agree_are_a_jump_of_the_machine(kind, second):
    known = kind(1)
    probe(known, 10.0, 11.0)
    assert probe(known, 10.0, 45.0) == [Verdict.REJECTED]
    assert probe(known, 10.0, second) == [Verdict.ACCEPTED]
    assert corrected(known, 10.0)[0] == pytest.approx(second, abs=0.5)


@BOTH
def test_two_outliers_that_contradict_are_both_rejected(kind):
    known = kind(1)
    probe(known, 10.0, 11.0)
    assert probe(known, 10.0, 45.0) == [Verdict.REJECTED]
    assert probe(known, 10.0, -40.0) == [Verdict.REJECTED]
    assert corrected(known, 10.0)[0] == pytest.approx(11.0, abs=0.5)


@BOTH
@given(st.floats(-0.99, 0.99))
def test_less_than_the_jump_limit_is_never_doubted(kind, share):
    known = kind(1)
    assert probe(known, 0.0, share * JUMP_MAX / MICRON) == [Verdict.ACCEPTED]


@BOTH
def test_a_gain_taken_over_elsewhere_is_not_corrected_twice(kind):
    known = kind(1)
    probe(known, 20.0, 24.0)
    before = corrected(known, 20.0)[0]
    known.absorb(np.array([0.1]), np.array([20.0 * MICRON]))
    assert corrected(known, 20.0)[0] == pytest.approx(before - 2.0)


@BOTH
def test_reference_forgets_all_but_a_gain_that_is_kept(kind):
    known = kind(1)
    probe(known, 20.0, 24.0)
    gain = known.estimate[0, 1]
    known.forget(keep_gain=True)
    assert known.estimate[0].tolist() == [0.0, gain]
    assert not known.probed.any()
    known.forget()
    np.testing.assert_array_equal(known.state, kind(1).state)


@BOTH
def test_state_resumes_even_a_doubt(kind):
    known, other = kind(2), kind(2)
    probe(known, 10.0, [11.0, 9.0])
    known.elapse(900.0)
    probe(known, 10.0, [50.0, 9.5])
    state = known.state
    assert np.isfinite(state).all()
    other.state = state
    for item in (known, other):
        item.elapse(300.0)
        assert probe(item, 12.0, [52.0, 11.0]) == [Verdict.ACCEPTED, Verdict.ACCEPTED]
    assert known.state.tobytes() == other.state.tobytes()


@given(st.lists(st.tuples(st.floats(-40, 40), st.floats(-9, 9), st.floats(0, 7200)), max_size=60))
def test_covariance_stays_sound(probes):
    known = OffsetGainFilter(1)
    for predicted, apart, time in probes:
        probe(known, predicted, predicted + apart)
        known.elapse(time)
        assert np.linalg.eigvalsh(known.covariance[0] / np.diag([1e-12, 1.0])[0, 0])[0] >= -1e-9
        assert np.isfinite(known.state).all()

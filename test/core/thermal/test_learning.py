# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Learning from probes, held to the dense Gaussian process that it is."""

from copy import deepcopy
from pathlib import Path

import learnt_machine
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from processors import SETTINGS, result_under
from scipy.stats import multivariate_normal, norm

from fuzzycnc_ros.core.thermal import learning
from fuzzycnc_ros.core.thermal.fit.linear import lag_features, poles_of_lags
from fuzzycnc_ros.core.thermal.learning import (
    BREADTH,
    DRIFT_TIME,
    EXPECTED,
    RISE_LAGS,
    SPINDLE_LAGS,
    TRUST,
    WINDOW,
    Basis,
    Learner,
    Posterior,
    Probe,
    Scales,
    Verdict,
)

BASIS = Basis(2, True, 60.0)
SCALES = Scales(20e-6, 8e-6, 2e-6, 0.4)


def prior(scales=SCALES, fastest=200.0):
    """Return the variances of the weights, written out anew."""
    rise = scales.rise / 10.0 / np.sqrt(8)
    speed = scales.speed / np.sqrt(8)
    return np.array([rise] * 8 + [speed / fastest] * 4 + [speed / fastest**2] * 4) ** 2


def covariance(probes, others, scales=SCALES):
    """Return the covariances of errors at probes (run, time, features)."""
    found = np.empty((len(probes), len(others)))
    rho = 1.0 / np.sqrt(1.0 + scales.change**2)
    for i, (run, time, features) in enumerate(probes):
        for j, (other, at, row) in enumerate(others):
            found[i, j] = rho ** abs(run - other) * (features * prior(scales) * row).sum()
            if run == other:
                found[i, j] += scales.drift**2 * np.exp(-abs(time - at) / DRIFT_TIME)
    return found


def machine(seed, runs, probes):
    """Return run, time, features and error of the probes of a random machine that is like SCALES.

    Three things happen to it, such as a warm spindle, each with features of its own.
    """
    random = np.random.default_rng(seed)
    happening = np.abs(random.normal(size=(3, 16)))
    happening[:, 8:12] *= 25.0
    happening[:, 12:] = happening[:, 8:12] ** 2
    places = [
        (run, 3600.0 * (number + 1), random.uniform(0.0, 2.0, 3) @ happening)
        for run in range(runs)
        for number in range(probes)
    ]
    whole = covariance(places, places) + 1e-12 * np.eye(len(places))
    values = random.multivariate_normal(np.zeros(len(places)), whole)
    return [(*place, float(error)) for place, error in zip(places, values, strict=True)]


def follow(posterior, probes, noise=1e-6):
    """Let a posterior see probes at their times, and return the verdicts."""
    verdicts = []
    for run, time, features, error in probes:
        reach(posterior, run)
        verdicts.append(posterior.update(features, time, error, noise))
    return verdicts


def reach(posterior, run):
    while posterior._run < run:
        posterior.begin_run()


def test_it_is_the_gaussian_process_of_its_scales(monkeypatch):
    monkeypatch.setattr(learning, 'GATE', 1e9)
    probes = machine(0, 3, 4)
    known = Posterior(BASIS, SCALES)
    follow(known, probes)
    asked = (2, 5.5 * 3600.0, probes[5][2])
    places = [probe[:3] for probe in probes]
    errors = np.array([probe[3] for probe in probes])
    whole = covariance(places, places) + 1e-12 * np.eye(len(places))
    row = covariance([asked], places)[0]
    variance = covariance([asked], [asked])[0, 0] - row @ np.linalg.solve(whole, row)
    expected, deviation = known.predict(asked[2], asked[1])
    assert expected == pytest.approx(row @ np.linalg.solve(whole, errors), rel=1e-6)
    # The band follows the squares that the probes missed by as well.
    ratio = known._square / known._squares
    assert deviation == pytest.approx(np.sqrt(ratio * variance), rel=1e-6)
    assert known._squares == TRUST + len(probes)


@pytest.mark.parametrize('based', [False, True])
def test_likelihood_is_that_of_a_normal_distribution(based):
    probes = machine(1, 3, 5)
    known = Posterior(BASIS, SCALES)
    follow(known, probes)
    base, taken = None, known._probes
    if based:  # what the first run left of the weights, at the begin of the second
        random = np.random.default_rng(2)
        root = np.sqrt(prior())[:, np.newaxis] * random.normal(size=(16, 16))
        base, taken = (1, root @ random.normal(size=16), root @ root.T), known._probes[5:]
    evidence = learning._Evidence(taken, base, BASIS.of_rises, known._units())

    def wanted(scales):
        places = [(probe.run, probe.time, probe.features) for probe in taken]
        whole = covariance(places, places, scales)
        mean = np.zeros(len(places))
        if base is not None:
            rho = scales.kept
            for i, (run, _, features) in enumerate(places):
                mean[i] = rho ** (run - 1) * features @ base[1]
                for j, (other, _, row) in enumerate(places):
                    both = rho ** (run - 1 + other - 1)
                    whole[i, j] += both * features @ (base[2] - np.diag(prior(scales))) @ row
        whole += 1e-12 * np.eye(len(places))
        errors = [probe.error for probe in taken]
        total = -multivariate_normal.logpdf(errors, mean, whole, allow_singular=True)
        for value, median, breadth in zip(scales, EXPECTED, BREADTH, strict=True):
            total -= norm.logpdf(np.log(value / median), 0.0, breadth)
        return total

    other = Scales(30e-6, 4e-6, 1e-6, 0.2)
    assert evidence.surprise(SCALES) - evidence.surprise(other) == pytest.approx(
        wanted(SCALES) - wanted(other), rel=1e-6
    )


def test_scales_are_learnt_and_the_weights_anew_with_them():
    probes = machine(3, 4, 8)
    known = Posterior(BASIS)
    follow(known, probes)
    evidence = learning._Evidence(known._probes, None, BASIS.of_rises, known._units())
    before = evidence.surprise(known.scales)
    known.tune()
    assert evidence.surprise(known.scales) < before
    fresh = Posterior(BASIS, known.scales)
    follow(fresh, probes)
    np.testing.assert_allclose(known._mean, fresh._mean, rtol=1e-9, atol=1e-18)
    np.testing.assert_allclose(known._covariance, fresh._covariance, rtol=1e-9, atol=1e-22)


def test_a_false_probe_moves_no_further_than_the_band_and_is_forgotten():
    probes = machine(4, 2, 8)
    known = Posterior(BASIS, SCALES)
    follow(known, probes[:-2])
    spoilt = deepcopy(known)
    run, time, features, error = probes[-2]
    reach(spoilt, run)
    expected, deviation = spoilt.predict(features, time)
    for false in (error + 60e-6, error + 200e-6, -error - 80e-6, 1e3 * error):
        judged = deepcopy(spoilt)
        assert judged.update(features, time, false, 1e-6) == Verdict.REJECTED
        moved = abs(judged.predict(features, time)[0] - expected)
        assert moved <= 2.0 * deviation * (1.0 + 1e-9)
        # The next true probe undoes it, to the last digits of the filter.
        assert follow(judged, probes[-1:]) == [Verdict.ACCEPTED]
        clean = deepcopy(known)
        follow(clean, probes[-1:])
        np.testing.assert_allclose(judged._mean, clean._mean, rtol=1e-6, atol=1e-12)


def test_a_jump_is_believed_when_the_next_probe_agrees():
    probes = machine(5, 2, 8)
    known = Posterior(BASIS, SCALES)
    follow(known, probes[:-2])
    jumped = [(*probe[:3], probe[3] + 50e-6) for probe in probes[-2:]]
    assert follow(known, jumped) == [Verdict.REJECTED, Verdict.ACCEPTED]
    assert known.due
    known.tune()
    assert known.predict(jumped[-1][2], jumped[-1][1])[0] == pytest.approx(jumped[-1][3], abs=2e-6)


def test_two_false_probes_that_differ_teach_nothing():
    probes = machine(5, 2, 8)
    known = Posterior(BASIS, SCALES)
    follow(known, probes[:-3])
    false = [
        (*probe[:3], probe[3] + off)
        for probe, off in zip(probes[-3:-1], (60e-6, -60e-6), strict=True)
    ]
    assert follow(known, false) == [Verdict.REJECTED, Verdict.REJECTED]
    assert follow(known, probes[-1:]) == [Verdict.ACCEPTED]
    clean = Posterior(BASIS, SCALES)
    follow(clean, [*probes[:-3], probes[-1]])
    np.testing.assert_allclose(known._mean, clean._mean, rtol=1e-9, atol=1e-15)


def test_first_probes_of_a_machine_that_moves_a_lot_are_believed():
    known = Posterior(BASIS)
    features = np.array([4.0] * 8 + [0.0] * 8)
    assert known.update(features, 3600.0, 90e-6, 0.5e-6) == Verdict.ACCEPTED
    assert known.scales.rise > 1.5 * EXPECTED.rise


def test_old_probes_are_condensed_without_being_forgotten():
    probes = machine(6, 14, 6)
    known, whole = Posterior(BASIS, SCALES), Posterior(BASIS, SCALES)
    follow(known, probes)
    follow(whole, probes)
    assert len(known._probes) > WINDOW
    known._condense()
    assert 0 < len(known._probes) < WINDOW
    known._rebuild()
    np.testing.assert_allclose(known._mean, whole._mean, rtol=1e-5, atol=1e-10)
    np.testing.assert_allclose(known._covariance, whole._covariance, rtol=1e-5, atol=1e-16)


def test_a_run_of_many_probes_is_condensed_within():
    probes = machine(7, 1, WINDOW + 4)
    known, whole = Posterior(BASIS, SCALES), Posterior(BASIS, SCALES)
    follow(known, probes)
    follow(whole, probes)
    known._condense()
    known._rebuild()
    assert len(known._probes) == WINDOW // 2 + 2
    asked = [(probe[2], probes[-1][1]) for probe in probes]
    expected, deviation = np.array([whole.predict(*item) for item in asked]).T
    found = np.array([known.predict(*item) for item in asked])
    # The drift of then is forgotten: not all digits, but what is known.
    assert (np.abs(found[:, 0] - expected) < 0.3 * deviation).all()
    np.testing.assert_allclose(found[:, 1], deviation, rtol=0.1)


@given(st.lists(st.tuples(st.integers(0, 4), st.floats(-1e-3, 1e-3)), max_size=60))
@settings(max_examples=30, deadline=None)
def test_covariance_stays_symmetric_and_positive(steps):
    known, random = Posterior(BASIS), np.random.default_rng(0)
    now = 0.0
    for what, value in steps:
        if what == 0:
            known.begin_run()
            now = 0.0
        elif what == 1:
            known.tune()
        elif what == 2:
            now += 1e7 * abs(value)
        else:
            known.update(random.normal(size=16) * 30.0, now, value, 0.5e-6)
    whole = known._covariance
    np.testing.assert_allclose(whole, whole.T, rtol=1e-9, atol=1e-26)
    # In units in which every weight is about 1.
    scale = np.sqrt(np.append(known._prior(known.scales), known.scales.drift**2))
    assert np.linalg.eigvalsh(whole / np.outer(scale, scale)).min() > -1e-9
    assert all(np.isfinite(known.predict(random.normal(size=16), now)))


def test_runs_that_are_studied_teach_as_the_gaussian_process_says(monkeypatch):
    probes = machine(8, 3, 5)
    places, errors = [probe[:3] for probe in probes], np.array([probe[3] for probe in probes])
    monkeypatch.setattr(Posterior, '_likeliest', lambda self, evidence: (SCALES, 0.0))
    seen = [Probe(run, time, features, error, 1e-6) for run, time, features, error in probes]
    studied = Posterior.studied(BASIS, seen, EXPECTED)
    assert studied.scales == SCALES
    assert Posterior.studied(BASIS, seen, SCALES, tuned=False).scales == SCALES
    # What the next run is expected to have, one feature at a time and without its drift.
    scale = np.sqrt(prior())
    whole = covariance(places, places) + 1e-12 * np.eye(len(places))
    across = covariance([(3, 0.0, row) for row in np.eye(16)], places)
    gain = np.linalg.solve(whole, across.T).T
    np.testing.assert_allclose(studied.mean / scale, gain @ errors / scale, atol=1e-6)
    expected = np.diag(scale**2) - gain @ across.T
    unit = np.outer(scale, scale)
    np.testing.assert_allclose(studied.covariance / unit, expected / unit, atol=1e-6)


def test_a_posterior_begins_with_knowledge_and_keeps_near_its_scales():
    probes = machine(9, 4, 6)
    seen = [Probe(run, time, features, error, 1e-6) for run, time, features, error in probes]
    studied = Posterior.studied(BASIS, seen[:18], EXPECTED)
    known = Posterior.of(BASIS, studied)
    features = probes[18][2]
    variance = features @ studied.covariance @ features + studied.scales.drift**2
    expected, deviation = known.predict(features, 0.0)
    assert expected == pytest.approx(features @ studied.mean)
    assert deviation == pytest.approx(np.sqrt(variance))
    # Probes that say nothing of the scales leave them where runs before have put them.
    known.update(np.zeros(16), 0.0, 0.0, 1e-3)
    known.tune()
    assert known.scales == studied.scales
    # What is learnt beyond it is of the run; the next one begins with less of it.
    known.update(features, 0.0, probes[18][3], 1e-6)
    within = known.predict(features, 0.0)[1]
    known.begin_run()
    assert within < known.predict(features, 0.0)[1] < 2.0 * deviation


def test_features_are_rises_speeds_and_their_lags():
    random = np.random.default_rng(0)
    rise, speed = random.normal(size=(30, 2)), 100.0 * random.normal(size=30)
    rows, size = [slice(0, 30)], np.abs(speed)[:, np.newaxis]
    lags, of_speed = (poles_of_lags(item, 60.0) for item in (RISE_LAGS, SPINDLE_LAGS))
    speeds = [lag_features(drive, rows, of_speed, direct=False) for drive in (size, size**2)]
    whole = np.hstack([lag_features(rise, rows, lags), *speeds])
    assert whole.shape == (30, BASIS.features)
    state = BASIS.initial_state()
    for row in range(30):
        features, state = BASIS.step(rise[row], float(speed[row]), state)
        np.testing.assert_allclose(features, whole[row], rtol=1e-12, atol=1e-12)
    lag = 0.0
    for value in rise[:, 1]:
        lag += (1.0 - np.exp(-60.0 / 1800.0)) * (value - lag)
    assert features[5] == pytest.approx(lag)


@pytest.mark.parametrize('sensors', [0, 90])
def test_no_sensor_or_too_many_are_refused(sensors):
    with pytest.raises(ValueError, match=f'sensors: expected 1 to 85 .* found {sensors}'):
        Basis(sensors, True, 60.0)


def stepped(learner, rise, speed=0.0):
    time = learner._time + learner.basis.interval
    learner.step(np.full(learner.basis.sensors, rise), speed, time)
    return learner.predict()


def test_channels_are_learnt_apart_and_what_was_not_probed_stays():
    learner = Learner(Basis(1, False, 60.0), ['Y', 'Z'])
    for _ in range(30):
        error, before = stepped(learner, 10.0)
    verdicts = learner.probe(np.array([30e-6, np.nan]), np.full(2, 0.5e-6))
    assert verdicts.tolist() == [Verdict.ACCEPTED, Verdict.ABSENT]
    assert not error.any()
    error, after = stepped(learner, 10.0)
    assert error[0] == pytest.approx(30e-6, rel=0.05)
    assert after[0] < 0.2 * before[0]
    assert error[1] == 0.0
    assert after[1] == pytest.approx(before[1], rel=0.1)
    learner.begin_run()
    cold, _ = stepped(learner, 0.0)
    assert not cold.any()


def test_a_probe_between_samples_has_the_features_between():
    learner = Learner(Basis(1, False, 60.0), ['Z'])
    stepped(learner, 0.0)
    before = learner.predict()[0]
    stepped(learner, 10.0)
    learner.probe(np.array([20e-6]), np.array([0.5e-6]), ago=30.0)
    whole = learner.predict()[0] - before
    # It was warm by half of it then, and the error is as large again now.
    assert 30e-6 < whole[0] < 45e-6


@given(st.lists(st.tuples(st.integers(0, 6), st.floats(-4e-5, 4e-5)), max_size=90))
@settings(max_examples=40, deadline=None)
def test_memory_goes_on_with_the_same_digits(steps):
    one, other = (Learner(Basis(2, True, 60.0), ['Y', 'Z']) for _ in range(2))
    for what, value in steps:
        if what == 0:
            for item in (one, other):
                item.begin_run()
        elif what < 4:
            for item in (one, other):
                stepped(item, 1e6 * value, 1e7 * value)
        else:
            error = np.array([value, np.nan if what == 4 else 3.0 * value])
            if what == 6:
                error[0] = 3e-4
            for item in (one, other):
                item.probe(error, np.full(2, 0.5e-6), ago=15.0)
        other.memory = other.memory.copy()
        np.testing.assert_array_equal(one.predict(), other.predict())
        np.testing.assert_array_equal(one.memory, other.memory)


def test_memory_of_many_probes_goes_on_with_the_same_digits():
    learner, _ = learnt_machine.follow(4000, 5)
    again = deepcopy(learner)
    again.memory = learner.memory
    assert learner.posteriors[0]._base is not None
    for item in (learner, again):
        item.begin_run()
        stepped(item, 4.0, 100.0)
        item.probe(np.full(2, 5e-6), np.full(2, 0.5e-6))
    np.testing.assert_array_equal(learner.memory, again.memory)


@pytest.mark.parametrize('part', ['cut', 'nan', 'scale', 'run', 'count', 'length', 'noise'])
def test_damaged_memory_is_refused_and_nothing_is_lost(part):
    learner, _ = learnt_machine.follow(2000, 6, channels=1)
    before, spoilt = learner.memory, learner.memory
    at = {'scale': 6, 'run': 1, 'count': -1, 'length': 0, 'nan': 40}
    if part == 'cut':
        spoilt = spoilt[:-1]
    elif part == 'noise':
        spoilt[-learner.basis.features - 1] = 0.0
    elif part == 'count':
        spoilt[11] += 1.0
    else:
        spoilt[at[part]] = np.nan if part == 'nan' else -1.0
    with pytest.raises(ValueError, match='expected'):
        learner.memory = spoilt
    np.testing.assert_array_equal(learner.memory, before)


def check_sound(learner):
    """Check that all that is known is symmetric, positive and finite."""
    for known in learner.posteriors:
        whole = known._covariance
        np.testing.assert_allclose(whole, whole.T, rtol=1e-9, atol=1e-26)
        scale = np.sqrt(np.append(known._prior(known.scales), known.scales.drift**2))
        assert np.linalg.eigvalsh(whole / np.outer(scale, scale)).min() > -1e-9
        assert np.isfinite(known._mean).all()
        assert len(known._probes) <= WINDOW + 1


def test_many_steps_with_false_probes_leave_it_sound():
    learner, said = learnt_machine.follow(4000, 1)
    check_sound(learner)
    assert said == learnt_machine.follow(4000, 1)[1]


@pytest.mark.slow
@pytest.mark.timeout(1800)
@pytest.mark.parametrize('steps', [200_000, pytest.param(1_000_000, marks=pytest.mark.qualify)])
def test_very_many_steps_leave_it_sound(steps):
    check_sound(learnt_machine.follow(steps, 2, channels=1)[0])


@pytest.mark.parametrize(
    'settings',
    [
        'oldest',
        *(pytest.param(name, marks=pytest.mark.slow) for name in SETTINGS if name != 'oldest'),
    ],
)
def test_digits_are_the_same_on_every_processor(settings):
    script = Path(learnt_machine.__file__)
    _, usual = learnt_machine.follow(3000, 3)
    assert result_under(SETTINGS[settings], script, '3000', '3') == usual

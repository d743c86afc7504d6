# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""What calibration runs of a made-up machine teach, to learn on from."""

import json
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import calibrated_machine
import numpy as np
import pytest
from calibrated_machine import SENSORS, learnt, made_run
from processors import OLDEST, result_under

from fuzzycnc_ros.core.document import Node
from fuzzycnc_ros.core.thermal.fit import learning_prior as module
from fuzzycnc_ros.core.thermal.fit import train_model
from fuzzycnc_ros.core.thermal.fit.learning_prior import (
    EVERY,
    EVIDENCE_MAX,
    NOISE,
)
from fuzzycnc_ros.core.thermal.learning import Posterior, Verdict
from fuzzycnc_ros.core.thermal.prior import MODEL_SHARE, LearningPrior


@pytest.fixture(scope='module')
def runs():
    return [made_run(name, seed) for seed, name in enumerate('pqr')]


@pytest.fixture(scope='module')
def prior(runs):
    return learnt(runs)


def evidence(monkeypatch, runs):
    """Return the probes of each channel that runs are taken for."""
    seen, studied = [], Posterior.studied

    def noted(basis, probes, expected, *, tuned=True):
        if tuned:
            seen.append(probes)
        return studied(basis, probes, expected, tuned=tuned)

    monkeypatch.setattr(module.Posterior, 'studied', noted)
    learnt(runs, speed=False)
    return seen


def step(learner, rise, speed, time):
    """Go on to a sample; return what is expected of it, and the deviation."""
    learner.step(rise, speed, float(time))
    return learner.predict()


def follow(learner, share, run, default):
    """Return expected errors of a run and their deviation, (n, c) each."""
    speeds = run.spindle_speed.tolist()
    found = [step(learner, *sample) for sample in zip(run.rise(), speeds, run.time, strict=True)]
    error, deviation = (np.array(values) for values in zip(*found, strict=True))
    return np.array(share) * default + error, deviation


def test_a_machine_is_known_before_the_first_probe(runs):
    model = train_model(runs)
    run = made_run('new', 9)
    assert model.prior.share == (MODEL_SHARE, MODEL_SHARE)
    learner = model.prior.learner(model.channel)
    error, deviation = follow(learner, model.prior.share, run, model.predict(run))
    left = run.displacement - error
    size, rms = (np.sqrt(np.mean(np.square(v), axis=0)) for v in (run.displacement, left))
    assert (rms < 0.05 * size).all()
    assert (np.abs(left) < 2.0 * deviation).mean() > 0.9
    assert (np.sqrt(np.mean(np.square(deviation), axis=0)) < 4.0 * rms).all()


@pytest.mark.parametrize(('missed', 'share'), [(1e-4, 1.0), (0.1, MODEL_SHARE)])
def test_a_model_that_is_better_beyond_chance_is_the_mean_alone(runs, missed, share):
    prior = learnt(runs, missed=missed)
    assert prior.share == (share, share)
    learner, run = prior.learner(('Y', 'Z')), made_run('new', 9)
    error, deviation = follow(learner, prior.share, run, run.displacement)
    left = run.displacement - error
    assert left.any() == (share < 1.0)
    assert (np.abs(left) < 2.0 * deviation).mean() > 0.9


def test_a_probe_is_learnt_beside_what_is_known(runs):
    prior = learnt(runs)
    run = made_run('new', 9)
    learner = prior.learner(('Y', 'Z'))
    nothing = np.zeros_like(run.displacement)
    _, before = follow(learner, prior.share, run, nothing)
    last = run.rise()[-1], float(run.spindle_speed[-1])
    expected, _ = step(learner, *last, run.time[-1] + 60.0)
    learner.probe(expected + 1e-6, np.full(2, 0.3e-6))
    error, after = step(learner, *last, run.time[-1] + 120.0)
    assert (expected < error).all()
    assert (error < expected + 1e-6).all()
    assert (after < before[-1]).all()
    fresh = prior.learner(('Y', 'Z'))
    one, other = (item.posteriors[0].predict(np.ones(16), 1e5) for item in (fresh, learner))
    assert one != other


def test_a_false_probe_is_doubted_from_the_first_on(prior):
    run, learner = made_run('new', 9), prior.learner(('Y', 'Z'))
    for sample in zip(run.rise()[:120], run.spindle_speed.tolist(), run.time, strict=False):
        expected, deviation = step(learner, *sample)
    verdicts = learner.probe(expected + np.array([100e-6, 0.0]), np.full(2, 0.3e-6))
    assert verdicts.tolist() == [Verdict.REJECTED, Verdict.ACCEPTED]
    error, _ = step(learner, *sample[:2], sample[2] + 60.0)
    assert abs(error[0] - expected[0]) < 2.5 * deviation[0]


def test_displacements_that_count_are_even_and_few(monkeypatch, runs):
    found = evidence(monkeypatch, runs)
    assert found[1][4].error == runs[0].displacement[80:100, 1].mean()
    for probes in found:
        assert [probe.run for probe in probes] == sorted(probe.run for probe in probes)
        assert len(probes) == 3 * 6 * 3600.0 // EVERY
        for first, second in pairwise(probes):
            assert first.run != second.run or second.time - first.time >= EVERY - 60.0
        assert probes[0].noise == pytest.approx(0.2e-6, rel=0.2)
        assert np.allclose(probes[4].features[:2], runs[0].rise()[80:100].mean(axis=0))
    long = [made_run(str(day), day, hours=20.0) for day in range(6)]
    for probes in evidence(monkeypatch, long):
        assert EVIDENCE_MAX - 6 <= len(probes) <= EVIDENCE_MAX
        assert np.bincount([probe.run for probe in probes]).min() > 30


def test_what_a_touch_probe_measured_counts_as_it_is(monkeypatch, runs):
    sparse = []
    for run in runs:
        displacement = np.full_like(run.displacement, np.nan)
        for channel, every in enumerate((45, 90)):
            displacement[15::every, channel] = run.displacement[15::every, channel]
        sparse.append(replace(run, displacement=displacement))
    for channel, probes in enumerate(evidence(monkeypatch, sparse)):
        measured = np.concatenate([run.displacement[:, channel] for run in sparse])
        assert [probe.error for probe in probes] == measured[np.isfinite(measured)].tolist()
        assert {probe.noise for probe in probes} == {NOISE}


def test_cycles_of_a_single_run_count_as_runs(monkeypatch):
    run = made_run('cycles', 3, hours=12.0, speeds=(0.0, 300.0))
    on = np.arange(len(run.time)) // 120 % 2 == 0
    probes = evidence(monkeypatch, [replace(run, spindle_speed=np.where(on, 300.0, 0.0))])[0]
    assert np.bincount([probe.run for probe in probes]).tolist() == [12, 12, 12]
    assert all(probe.time < 4 * 3600.0 for probe in probes)


def test_too_many_inputs_leave_no_prior(runs):
    names = tuple(f's{number}' for number in range(90))
    temperature = np.tile(runs[0].temperature, (1, 45))
    wide = replace(runs[0], sensor=names, temperature=temperature)
    assert learnt([wide], names) is None


def test_it_survives_its_document(prior):
    text = json.dumps(prior.document())
    again = LearningPrior.read(Node(json.loads(text), 'prior'), len(SENSORS), 60.0)
    assert json.dumps(again.document()) == text
    assert again.basis == prior.basis
    for one, other in zip(again.known, prior.known, strict=True):
        assert (one.scales, one.fastest) == (other.scales, other.fastest)
        assert np.array_equal(one.mean, other.mean)
        assert np.array_equal(one.covariance, other.covariance)


def test_digits_are_the_same_on_an_old_processor():
    found = result_under(OLDEST, Path(calibrated_machine.__file__))
    assert found == calibrated_machine.hash_of_prior()

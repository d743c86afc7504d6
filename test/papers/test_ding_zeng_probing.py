# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Occasional probing, drift alarm, deviation.

Residuals in um, Y then Z; T2 and T3 are never seen; medians over noise seeds.
"""

import numpy as np
import pytest
from tiers import rest_slow

from fuzzycnc_ros.core.thermal.fit import GreyModel, select_sensors, train_model
from fuzzycnc_ros.core.thermal.probing import (
    DriftAlarm,
    OffsetGainFilter,
    OffsetReset,
    drift_deviation,
)
from fuzzycnc_ros.simulation.thermal.duties import record_runs

SEEDS = range(12)
MICRON = 1e-6
NOISE = np.full(2, np.sqrt(0.5) * MICRON)
"""Standard deviation of a probe, the model's own scatter included."""

KINDS = {'offset': OffsetReset, 'kalman': OffsetGainFilter}


def corrected(kind, predicted, measured, every):
    """Return the corrected prediction; a probe acts from the sample after it on, a minute later.

    `every` is the number of samples, one a minute, between two probes; 0 is never.
    """
    known, found = KINDS[kind](2), np.empty_like(predicted)
    for row, value in enumerate(predicted):
        found[row] = known.corrected(value)
        known.elapse(60.0)
        if every and row and row % every == 0:
            known.update(value, measured[row], NOISE)
    return found


@pytest.fixture(scope='module')
def from_one_run():
    """Prediction and measurement of T3 by a stable grey model of D0 alone, per seed."""
    found = []
    for seed in SEEDS:
        runs = record_runs(seed=seed)
        training, judged = runs['D0'], runs['T3']
        chosen = select_sensors([training]).chosen
        rise = training.rise()[:, training.columns(chosen)]
        models = [GreyModel().fit(rise, target) for target in training.displacement.T]
        unseen = judged.rise()[:, judged.columns(chosen)]
        predicted = np.column_stack([model.predict(unseen) for model in models])
        found.append((predicted, judged.displacement))
    return found


def medians(from_one_run, kind, every):
    """Return the largest and the root mean square residual, medians over the seeds."""
    figures = []
    for predicted, measured in from_one_run:
        residual = (corrected(kind, predicted, measured, every) - measured) / MICRON
        figures.append((np.abs(residual).max(axis=0), np.sqrt((residual**2).mean(axis=0))))
    return np.median(figures, axis=0)


@pytest.mark.paper
@pytest.mark.parametrize('kind', KINDS)
@pytest.mark.parametrize(
    ('every', 'limit'), [(30, (3.6, 2.3)), (60, (4.8, 2.6)), (120, (5.7, 3.3))]
)
def test_probing_bounds_the_residual(from_one_run, kind, every, limit):
    """Printed: 3.6/2.3, 4.8/2.3 and 5.7/2.8; unprobed our Z is worse, 6.5 where 5.0 is printed."""
    largest, _ = medians(from_one_run, kind, every)
    assert (largest <= limit).all()


@pytest.mark.paper
@pytest.mark.parametrize('kind', KINDS)
def test_half_hourly_probing_as_root_mean_square(from_one_run, kind):
    """Printed: 1.02/0.70 after, 4.74/2.27 before."""
    _, before = medians(from_one_run, kind, 0)
    _, after = medians(from_one_run, kind, 30)
    assert (after <= (1.1, 0.8)).all()
    assert (after < 0.7 * before).all()


@pytest.mark.paper
@pytest.mark.parametrize('every', [30, 60, 120])
def test_filter_equals_the_plain_reset(from_one_run, every):
    plain, filtered = (medians(from_one_run, kind, every)[0] for kind in ('offset', 'kalman'))
    np.testing.assert_allclose(filtered, plain, atol=0.5)


@pytest.fixture(scope='module', params=rest_slow([SEEDS[:6], SEEDS], 0), ids=len)
def fitting(request):
    """Models of three runs with the runs that they have not seen, per seed."""
    found = []
    for seed in request.param:
        runs = record_runs(seed=seed)
        model = train_model(
            [runs[name] for name in ('D0', 'D0b', 'T1')],
            candidates=('stable_grey', 'lag_ridge'),
            spindle_speed=False,
        )
        found += [(model, runs[name]) for name in ('T2', 'T3')]
    return found


@pytest.mark.slow
@pytest.mark.paper
@pytest.mark.parametrize('kind', KINDS)
def test_two_deviations_cover_the_residual(fitting, kind):
    """At least 86 % on unseen duties; the filter alone would cover all and more."""
    inside = []
    for model, run in fitting:
        known, predicted = KINDS[kind](2), model.predict(run)
        of_model = model.standard_deviation(model.rises(run))
        for row, value in enumerate(predicted):
            if known.probed.all():
                deviation = np.fmin(of_model[row], known.deviation(value))
                apart = np.abs(known.corrected(value) - run.displacement[row])
                inside.append(apart <= 2.0 * deviation)
            known.elapse(60.0)
            if row and row % 30 == 0:
                known.update(value, run.displacement[row], NOISE)
    share = np.mean(inside, axis=0)
    assert ((share >= 0.86) & (share < 1.0)).all()


def raised_after(model, run, changed=None):
    """Return the number of half-hourly probes until the alarm, None if it is not raised."""
    rises = model.rises(run)
    predicted = model.predict(run)
    measured = run.displacement if changed is None else changed(run.displacement)
    alarm = DriftAlarm(len(model.channel))
    rows = range(30, len(predicted), 30)
    for number, row in enumerate(rows, start=1):
        distance = float(model.distance(rises[row]))
        allowed = drift_deviation(model.held_out_rms, distance, NOISE)
        if alarm.update((measured[row] - predicted[row]) / allowed).any():
            return number
    return None


def test_healthy_machines_raise_no_alarm(fitting):
    false = [raised_after(model, run) is not None for model, run in fitting]
    assert np.mean(false) <= 0.05


def more(displacement):
    return 1.3 * displacement


def less(displacement):
    return 0.7 * displacement


def wandering(displacement):
    return displacement + np.linspace(0.0, 10e-6, len(displacement))[:, np.newaxis]


@pytest.mark.parametrize(('changed', 'probes'), [(more, 4), (less, 4), (wandering, 5)])
def test_a_machine_that_has_changed_raises_it_within_hours(fitting, changed, probes):
    """30 % more or less of its error, or 10 um in addition over the run."""
    found = [raised_after(model, run, changed) for model, run in fitting]
    raised = [number for number in found if number is not None]
    assert len(raised) >= 0.9 * len(found)
    assert np.median(raised) <= probes

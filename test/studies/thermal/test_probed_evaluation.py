# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Probing now and then, judged on a recorded run: the live correction, and no leak."""

from dataclasses import replace

import numpy as np
import pytest
from benches.predictor_bench import (
    MICRON,
    bench_with_model,
    errors_of,
    model_text,
    predict,
    probe_of,
    recordings,
    trained,
)

from fuzzycnc_ros.core.thermal.fit import evaluate
from fuzzycnc_ros.core.thermal.run import ThermalDataError
from fuzzycnc_ros.studies.thermal.probed import evaluate_probed

HOUR = 3600.0
ROWS = ('uncompensated', 'unprobed', 'held', 'learnt')
FIRST = 3
"""Row of the first probe of a whole run: the first after the thermal reference."""


def probed(run=None, every=HOUR, **window):
    """Return T3, or another run, under hourly probes with the model of D0 alone."""
    model, run = trained('D0'), run or recordings()['T3']
    return evaluate_probed(model, run, evaluate(model, run, **window), every)


def measured(values, run=None):
    """Return a run with other displacements."""
    return replace(run or recordings()['T3'], displacement=values)


def test_what_is_learnt_is_that_of_the_live_predictor():
    run = recordings()['T3']
    bench = bench_with_model(model_text('D0'), learn=True, probe_interval_min=HOUR)
    every = range(len(run.time))
    found = predict(bench, run, every, probes=[probe_of(run, row) for row in every])
    live = run.displacement / MICRON - errors_of(found)
    ours = probed().residual['learnt'] / MICRON
    np.testing.assert_allclose(ours[FIRST + 1 :], live[FIRST + 1 :], atol=1e-6)
    assert np.isnan(ours[: FIRST + 1]).all()


def test_probe_changes_nothing_up_to_its_own_sample():
    run, row = recordings()['T3'], FIRST + 60
    values = run.displacement.copy()
    values[row] += 3.0 * MICRON
    before, after = probed(), probed(measured(values))
    for name in ROWS:
        change = after.residual[name] - before.residual[name]
        np.testing.assert_allclose(change[FIRST + 1 : row], 0.0, atol=1e-15)
        np.testing.assert_allclose(change[row], 3.0 * MICRON)
    for name in ROWS[2:]:
        change = after.residual[name] - before.residual[name]
        assert (np.abs(change[row + 1 : row + 60]) > 0.1 * MICRON).all()


def test_last_probe_is_held_until_the_sample_after_the_next():
    run = recordings()['T3']
    left = probed().residual['held']
    for first in range(FIRST, len(run.time) - 60, 60):
        rows = slice(first + 1, first + 61)
        np.testing.assert_allclose(left[rows], run.displacement[rows] - run.displacement[first])


def test_all_rows_are_judged_on_the_same_samples_and_agree_with_an_evaluation():
    run, found = recordings()['T3'], probed()
    assert set(found.residual) == set(found.rms) == set(found.largest) == set(ROWS)
    counted = {
        name: np.isfinite(values).sum(axis=0).tolist() for name, values in found.residual.items()
    }
    assert set(map(tuple, counted.values())) == {tuple(found.samples)}
    assert (found.samples == len(run.time) - FIRST - 1).all()
    for name, values in found.residual.items():
        np.testing.assert_allclose(found.rms[name], np.sqrt(np.nanmean(values**2, axis=0)))
        np.testing.assert_allclose(found.largest[name], np.nanmax(np.abs(values), axis=0))
    alone = evaluate(trained('D0'), run, start=run.time[FIRST + 1])
    np.testing.assert_allclose(found.rms['unprobed'], alone.rms['default'])
    np.testing.assert_allclose(found.rms['uncompensated'], alone.rms['uncompensated'])


def test_model_of_one_run_is_better_with_probes_and_they_better_with_it():
    rms = probed().rms
    assert (rms['learnt'] < 0.8 * rms['unprobed']).all()
    assert (rms['learnt'] < 0.8 * rms['held']).all()


def test_probing_begins_with_what_is_judged():
    run = recordings()['T3']
    row = 150
    values = run.displacement.copy()
    values[:row] = 0.0
    window = {'start': run.time[row]}
    whole, cut = probed(**window), probed(measured(values), **window)
    assert (whole.time[0], len(whole.time)) == (run.time[row], len(run.time) - row)
    assert (whole.samples == len(run.time) - row - 1).all()
    for name in ROWS:
        np.testing.assert_array_equal(whole.residual[name], cut.residual[name])


def test_next_displacement_is_taken_where_none_was_measured_channel_by_channel():
    run = recordings()['T3']
    values = np.full_like(run.displacement, np.nan)
    first, second = np.arange(10, 400, 50), np.arange(25, 400, 100)
    values[first, 0] = run.displacement[first, 0]
    values[second, 1] = run.displacement[second, 1]
    found = probed(measured(values))
    # Due after 60 min, the first channel has a value every 50 min: every second one is used.
    assert found.probes.tolist() == [len(first[::2]), len(second)]
    assert found.samples.tolist() == [len(first) - 1, len(second) - 1]
    held = np.flatnonzero(np.isfinite(found.residual['held'][:, 0]))
    assert held.tolist() == first[1:].tolist()
    used = [first[(number // 2) * 2] for number in range(len(first) - 1)]
    np.testing.assert_allclose(
        found.residual['held'][held, 0], run.displacement[held, 0] - run.displacement[used, 0]
    )


def test_doubted_probe_is_counted():
    run = recordings()['T3']
    values = run.displacement.copy()
    values[FIRST + 120, 0] += 60.0 * MICRON
    found = probed(measured(values))
    assert found.doubted.tolist() == [1, 0]
    assert found.largest['learnt'][0] == pytest.approx(60.0 * MICRON, rel=0.2)


@pytest.mark.parametrize(
    ('every', 'text'),
    [
        (30.0, 'expected at least 60 s between two probes, .* but found 30 s'),
        (500.0 * 60.0, "run 'T3': expected at most .* s between two probes, .* found 30000 s"),
    ],
)
def test_interval_that_no_probing_can_keep_is_refused(every, text):
    with pytest.raises(ThermalDataError, match=text):
        probed(every=every)


def test_run_that_was_measured_once_is_refused():
    run = recordings()['T3']
    values = np.full_like(run.displacement, np.nan)
    values[100] = run.displacement[100]
    with pytest.raises(ThermalDataError, match=r"run 'T3': .* after the first probe"):
        probed(measured(values))

# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
from copy import deepcopy
from dataclasses import replace

import numpy as np
import pytest

from fuzzycnc_ros.core.thermal.learning import Basis, Learner
from fuzzycnc_ros.core.thermal.run import ThermalDataError
from fuzzycnc_ros.simulation.thermal.duties import record_runs
from fuzzycnc_ros.studies.page.html import render_page
from fuzzycnc_ros.studies.thermal import learnt

HOUR = 3600.0


@pytest.fixture(scope='module')
def runs():
    """Return three days of the simulated mill, with twelve of its sensors."""
    return [few(run) for run in list(record_runs(seed=4).values())[:3]]


def few(run):
    return replace(run, sensor=run.sensor[::7], temperature=run.temperature[:, ::7])


@pytest.fixture(scope='module')
def found(runs):
    return list(learnt.learn_runs(runs, HOUR))


def rms(found, name):
    return np.array([item.rms[name] for item in found])


def test_what_a_machine_is_taught_by_probes_stays_from_run_to_run(found):
    assert (rms(found, 'learnt')[1:] < 2.5e-6).all()
    assert (rms(found, 'learnt')[1:] < 0.5 * rms(found, 'held')[1:]).all()
    assert (rms(found, 'carried')[1:] < 0.3 * rms(found, 'uncompensated')[1:]).all()
    np.testing.assert_array_equal(rms(found, 'carried')[0], rms(found, 'uncompensated')[0])


def test_bands_hold_what_is_left(found):
    for phase in ('unprobed', 'later'):
        shares = np.array([item.covered[phase] for item in found[1:]])
        assert np.isnan(shares).all() or np.nanmean(shares) > 0.9
    widths = np.array([np.median(item.deviation, axis=0) for item in found])
    assert (widths[2] < widths[0]).all()


def test_without_carrying_each_run_begins_with_nothing(runs, found):
    alone = list(learnt.learn_runs(runs, HOUR, carry=False))
    np.testing.assert_array_equal(rms(alone, 'carried'), rms(alone, 'uncompensated'))
    np.testing.assert_array_equal(rms(alone, 'learnt')[0], rms(found, 'learnt')[0])
    assert (rms(alone, 'learnt')[1:] > rms(found, 'learnt')[1:]).all()


def test_a_probe_acts_from_the_next_sample_on(found):
    item = found[0]
    first = int(np.flatnonzero(item.probed[:, 0])[0])
    assert item.time[first] - item.time[0] == pytest.approx(HOUR)
    assert not item.predicted[: first + 1].any()
    assert item.predicted[first + 1, 0] == pytest.approx(item.measured[first, 0], abs=2e-6)
    assert item.probes.tolist() == item.probed.sum(axis=0).tolist()


def test_where_nothing_was_measured_the_next_displacement_is_the_probe(runs):
    holed = runs[0].displacement.copy()
    holed[50:80, 0] = np.nan
    (item,) = learnt.learn_runs([replace(runs[0], displacement=holed)], HOUR)
    assert np.flatnonzero(item.probed[:, 0])[0] == 80
    assert np.flatnonzero(item.probed[:, 1])[0] == 60


def test_noise_of_probes_is_drawn_by_seed(runs, found):
    one, same, other = (
        next(learnt.learn_runs(runs[:1], HOUR, seed=seed)).rms['learnt'] for seed in (1, 1, 2)
    )
    np.testing.assert_array_equal(one, same)
    assert (one != other).any()
    assert (one != found[0].rms['learnt']).any()


def test_probes_faster_than_samples_are_refused(runs):
    with pytest.raises(ThermalDataError, match=r'at least 60 s between two probes.* found 10 s'):
        next(learnt.learn_runs(runs, 10.0))


def test_figures_and_table(found):
    document = learnt.learnt_document(found)
    run = found[1].run
    assert document['runs'][run]['learnt']['Y']['rms_um'] == pytest.approx(
        1e6 * found[1].rms['learnt'][0]
    )
    assert 0.0 <= document['band'][run]['unprobed']['Y']['covered'] <= 1.0
    table = learnt.learnt_table(found)
    assert [row[0] for row in table.rows] == [item.run for item in found]


def test_page_shows_every_run(found):
    pytest.importorskip('jinja2', reason='jinja2 is not installed')
    page = render_page(learnt.learnt_page(found, {'Machine': 'mill'}))
    assert all(f'{item.run}: error, prediction and probes' in page for item in found)


def test_lines_name_where_the_last_probe_does_better(found):
    worse = replace(found[1], rms={**found[1].rms, 'held': np.zeros(2)}, doubted=np.array([1, 0]))
    lines = learnt.learnt_lines([worse])
    assert any('1 of 6 probes doubted' in line for line in lines)
    assert any('on Y, Z the last probe, held, does better' in line for line in lines)
    assert not any('does better' in line for line in learnt.learnt_lines(found[1:]))


def test_a_band_that_holds_too_little_is_named_first(found):
    assert not learnt.narrow_bands([found[1]])
    narrow = replace(found[1], deviation=found[1].deviation * [0.01, 1.0])
    (line,) = learnt.narrow_bands([narrow])
    assert line.warning
    assert f'{narrow.run}: the learnt band covers' in line.text
    assert ' % of Y; it should cover 95 %' in line.text
    assert learnt.learnt_page([narrow], {}).sections[0].remarks[0] == line.text


FALSE = {
    'chip of 10 um': lambda error, last: error + 10e-6,
    'chip of 20 um': lambda error, last: error + 20e-6,
    'chip of 50 um': lambda error, last: error + 50e-6,
    'chip of 200 um': lambda error, last: error + 200e-6,
    'chip below': lambda error, last: error - 20e-6,
    'edge missed': lambda error, last: error - 100e-6,
    'other sign': lambda error, last: -error,
    'not measured': lambda error, last: 0.0 * error,
    'radius for diameter': lambda error, last: 0.5 * error,
    'diameter for radius': lambda error, last: 2.0 * error,
    'mm read as inches': lambda error, last: 25.4 * error,
    'inches read as mm': lambda error, last: error / 25.4,
    'um read as mm': lambda error, last: 1e3 * error,
    'mm read as um': lambda error, last: 1e-3 * error,
    'a digit too many': lambda error, last: 10.0 * error,
    'a digit too few': lambda error, last: 0.1 * error,
    'the last value again': lambda error, last: last,
    'one channel': lambda error, last: error + np.array([np.nan, 30e-6]),
    'the other channel': lambda error, last: error + np.array([30e-6, np.nan]),
    'both apart': lambda error, last: error + np.array([40e-6, -40e-6]),
}


@pytest.fixture(scope='module')
def taught():
    """Return a learner an hour into its fourth run, that run, and how it goes on."""
    days = [few(run) for run in record_runs(seed=4).values()]
    learner = Learner(Basis(len(days[0].sensor), True, days[0].interval), ['Y', 'Z'])
    for run in days[:3]:
        walk(learner, run, range(len(run.time)))
        learner.begin_run()
    walk(learner, days[3], range(61))
    return learner, days[3]


def walk(learner, run, rows, every=60):
    """Let a learner follow rows of a run, probed in every one of so many after the first."""
    rise, noise = run.rise(), np.full(2, 0.5e-6)
    for row in rows:
        learner.step(rise[row], float(run.spindle_speed[row]), run.time[row])
        if row > rows[0] and row % every == 0 and row < rows[-1]:
            learner.probe(run.displacement[row], noise)


@pytest.mark.parametrize('kind', FALSE)
def test_a_false_probe_moves_no_further_than_the_band_and_is_gone_two_probes_later(taught, kind):
    learner, run = taught
    expected, deviation = learner.predict()
    false = FALSE[kind](run.displacement[60], run.displacement[0])
    spoilt, spared = deepcopy(learner), deepcopy(learner)
    spoilt.probe(np.asarray(false), np.full(2, 0.5e-6))
    assert (np.abs(spoilt.predict()[0] - expected) <= 2.0 * deviation * (1.0 + 1e-9)).all()
    for item in (spoilt, spared):
        walk(item, run, range(61, 122), every=30)
    np.testing.assert_allclose(spoilt.predict()[0], spared.predict()[0], rtol=0.0, atol=1e-9)

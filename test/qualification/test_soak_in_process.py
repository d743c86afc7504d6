# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""A soak: equal runs are equal, what grows or gets lost is found."""

import os
import subprocess
import sys
import threading

import numpy as np
import pytest
from soak.growth import GROWTH_MAX, growths, held_by
from soak.run import (
    CYCLE,
    HELD,
    SEGMENT,
    SOAK_DUTIES,
    TICK,
    TICKS_MIN,
    run_soak,
    soak_duties,
)

from fuzzycnc_ros.components.thermal.compensator import Compensator
from fuzzycnc_ros.components.thermal.thermal_predictor import ThermalPredictor
from fuzzycnc_ros.core.thermal.fit import train_model
from fuzzycnc_ros.studies.shift.thermal_shift import record_calibration

pytestmark = pytest.mark.qualify


@pytest.fixture(scope='module')
def model_text():
    """A plain model."""
    runs = record_calibration(('D0', 'T1')).runs
    return train_model(runs, candidates=('lag_ridge',)).to_json()


@pytest.fixture(scope='module')
def soaked(model_text):
    """The shortest soak."""
    told = []
    run = run_soak(model_text, TICKS_MIN, progress=lambda *news: told.append(news))
    return run, told


class Growing(Compensator):
    """Forgets nothing."""

    def on_thermal_error(self, error):
        self.kept = [*getattr(self, 'kept', ()), [[] for _ in range(1000)]]
        return super().on_thermal_error(error)


class Silent(ThermalPredictor):
    """Does not answer now and then."""

    def on_temperatures(self, sample):
        answer = list(super().on_temperatures(sample))
        return [] if sample.stamp // 60_000_000_000 % 100 == 0 else answer


def test_nothing_grows_and_nothing_is_missed(soaked):
    run, told = soaked
    assert run.ticks == TICKS_MIN
    assert told == [(done, TICKS_MIN) for done in range(SEGMENT, TICKS_MIN + 1, SEGMENT)]
    assert run.samples.shape == (TICKS_MIN // SEGMENT, len(run.figures))
    assert (run.samples[:, : len(HELD)] > 0.0).all()
    assert run.settled == CYCLE // SEGMENT
    assert run.missed == {}
    held = [item for item in run.growths if item.name in HELD]
    assert [item.name for item in held] == list(HELD)
    assert [item.name for item in held if item.grows] == []
    times = run.figures[len(HELD) :]
    assert times[0] == 'simulated_machine [us]'
    assert len(times) == 5


def test_a_second_run_has_the_same_hash_and_another_seed_has_not(soaked, model_text):
    run, _ = soaked
    again = run_soak(model_text, TICKS_MIN)
    assert again.hash == run.hash
    assert run.parts_at(again) is None
    other = run_soak(model_text, TICKS_MIN, seed=1)
    assert other.hash != run.hash
    assert run.parts_at(other) == 0.0
    longer = run_soak(model_text, TICKS_MIN + 1)
    assert longer.ticks == TICKS_MIN + SEGMENT
    assert (longer.hashes[:-1] == run.hashes).all()
    with pytest.raises(ValueError, match='expected a run of 1200 ticks but found 1300'):
        run.parts_at(longer)


def test_a_component_that_forgets_nothing_is_found(model_text, soaked):
    run = run_soak(model_text, TICKS_MIN, replaced={'compensator': Growing})
    assert run.hash == soaked[0].hash  # nobody sees it on the topics
    assert any(text.startswith('Python blocks grew by') for text in run.problems)


def test_a_component_that_does_not_answer_is_found(model_text):
    run = run_soak(model_text, TICKS_MIN, replaced={'thermal_predictor': Silent})
    assert run.missed['thermal_error'] == TICKS_MIN // 100
    assert f'thermal_error: {TICKS_MIN // 100} missed' in run.problems


def test_too_short(model_text):
    with pytest.raises(ValueError, match=f'ticks: expected {TICKS_MIN} or more but found 10'):
        run_soak(model_text, 10)
    with pytest.raises(ValueError, match='JSON'):
        run_soak('{', TICKS_MIN)


@pytest.mark.parametrize(
    ('ticks', 'count'), [(1, 1), (200, 1), (201, 2), (600, 2), (601, 3), (60_000, 200)]
)
def test_duties_last_long_enough(ticks, count):
    duties = soak_duties(ticks)
    assert len(duties) == count
    assert duties == (SOAK_DUTIES * count)[:count]
    assert TICK == 60.0


def test_what_this_process_holds(tmp_path):
    before = held_by()
    kept = np.ones(8 * 2**20)
    stop = threading.Event()
    thread = threading.Thread(target=stop.wait)
    thread.start()
    with (tmp_path / 'file').open('w'):
        now = held_by()
    stop.set()
    thread.join()
    assert now.memory - before.memory > 0.9 * kept.nbytes
    assert (now.threads, now.files) == (before.threads + 1, before.files + 1)


def test_a_process_that_is_gone():
    with pytest.raises(FileNotFoundError):
        held_by(2**22 + 1)


def test_a_process_that_has_given_its_memory_back():
    with subprocess.Popen([sys.executable, '-c', '']) as process:
        os.waitid(os.P_PID, process.pid, os.WEXITED | os.WNOWAIT)
        with pytest.raises(ProcessLookupError, match='is ending'):
            held_by(process.pid)


def test_growth_is_from_the_first_to_the_last_quarter():
    time = np.arange(40.0)
    samples = np.column_stack([np.full(40, 7.0), 100.0 + time, 100.0 - time, 0.0 * time])
    samples[20] *= 3.0  # a peak in between is no growth
    flat, rising, falling, nothing = growths('abcd', samples, [GROWTH_MAX] * 4)
    assert (flat.growth, flat.grows, flat.largest) == (0.0, False, 21.0)
    assert (rising.before, rising.after) == (104.5, 134.5)
    assert rising.growth == pytest.approx(30.0 / 104.5)
    assert rising.grows
    assert falling.growth < 0.0
    assert not falling.grows
    assert nothing.growth == 0.0
    grown = growths('a', np.repeat([[0.0], [1.0]], 4, axis=0), [GROWTH_MAX])[0]
    assert grown.grows
    with pytest.raises(ValueError, match='expected 4 or more after the warm-up but found 3'):
        growths('a', np.zeros((3, 1)), [0.0])

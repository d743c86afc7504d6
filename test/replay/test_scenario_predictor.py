# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Probing and a change of models in the whole graph, and that their bags give the same again."""

import numpy as np
import pytest

from fuzzycnc_ros.components.machine.simulated_machine import (
    SimulatedMachine,
    SimulatedMachineConfig,
)
from fuzzycnc_ros.components.thermal.compensator import Compensator, CompensatorConfig
from fuzzycnc_ros.components.thermal.temperature_acquisition import TemperatureAcquisition
from fuzzycnc_ros.components.thermal.thermal_predictor import (
    ThermalPredictor,
    ThermalPredictorConfig,
)
from fuzzycnc_ros.core.thermal.fit import train_model
from fuzzycnc_ros.replay.replay import replay
from fuzzycnc_ros.runtime.graph import InProcessGraph
from fuzzycnc_ros.studies.published_bag import PublishedBag
from fuzzycnc_ros.studies.shift.thermal_shift import record_calibration, run_shift

CANDIDATES = ('stable_grey', 'lag_ridge')
"""Candidates that train in a moment."""


@pytest.fixture(scope='module')
def calibration():
    """Recorded calibration runs."""
    return record_calibration(('D0', 'D0b', 'T1'))


@pytest.fixture(scope='module')
def one_run(calibration):
    """A model of one run."""
    return train_model(calibration.runs[:1], candidates=CANDIDATES).to_json()


@pytest.fixture(scope='module')
def three_runs(calibration):
    """A model of three runs."""
    return train_model(calibration.runs, candidates=CANDIDATES).to_json()


@pytest.mark.slow
def test_half_hourly_probes_correct_a_model_of_one_run(one_run):
    probing = {'learn': True, 'probe_interval_min': 1800.0}
    (plain,), (probed,) = (
        run_shift(one_run, duties=('T3',), parameters={'thermal_predictor': parameters})
        for parameters in ({}, probing)
    )
    before, after = plain.scores(), probed.scores()
    rms = [[score.rms for score in scores['default']] for scores in (before, after)]
    assert max(rms[1]) < 0.7 * max(rms[0])
    largest = [[score.max for score in scores['applied']] for scores in (before, after)]
    assert max(largest[1]) < max(largest[0])


@pytest.mark.replay
def test_bag_of_a_probed_shift_replays(one_run, tmp_path):
    parameters = {
        'thermal_predictor': {
            'learn': True,
            'probe_interval_min': 1800.0,
        }
    }
    with PublishedBag(tmp_path / 'bag') as bag:
        run_shift(one_run, duties=('T2',), parameters=parameters, sink=bag)
    report = replay(tmp_path / 'bag')
    assert report.identical, [item for item in report.topics if not item.equal]


def run_with_swap(first, second, sink, *, swap_time=600.0, ticks=1000, swap_at=500):
    """Run T2 with one model and ask for another in the middle; return the offsets [um]."""
    machine = SimulatedMachine(SimulatedMachineConfig(duties=('T2',)))
    predictor = ThermalPredictor(ThermalPredictorConfig(swap_time=swap_time))
    applied = []

    def watch(topic, record):
        sink(topic, record)
        if topic == 'compensation_applied':
            applied.append(1e6 * record.offset)

    graph = InProcessGraph(
        machine,
        [TemperatureAcquisition(), predictor, Compensator()],
        sink=watch,
        provenance=True,
    )
    assert graph.request('thermal_predictor', 'use_model', model=first).success
    assert graph.request('compensator', 'activate').success
    for tick in range(ticks):
        if tick == swap_at:
            answer = graph.request('thermal_predictor', 'use_model', model=second)
            assert answer.message.startswith('fading from ')
        graph.step()
    return np.array(applied)


@pytest.mark.slow
@pytest.mark.replay
def test_models_change_in_the_middle_of_a_shift_without_a_step(one_run, three_runs, tmp_path):
    errors = []
    with PublishedBag(tmp_path / 'bag') as bag:

        def sink(topic, record):
            bag(topic, record)
            if topic == 'thermal_error' and record.valid:
                errors.append((record.stamp, 1e6 * record.error, record.model))

        applied = run_with_swap(one_run, three_runs, sink)
    values = np.array([error for _, error, _ in errors])
    fading = np.array([' to ' in model for _, _, model in errors])
    assert 8 <= fading.sum() <= 10
    moved = np.abs(np.diff(values, axis=0))
    during = moved[np.flatnonzero(fading)].max()
    usual = moved[5:][~fading[6:]].max()
    assert during < usual + 0.5
    assert np.isfinite(applied).all()
    # 12 s between two ticks at the compensator's slew limit
    assert np.abs(np.diff(applied, axis=0)).max() <= 12e6 * CompensatorConfig().slew_max + 1e-6
    report = replay(tmp_path / 'bag')
    assert report.identical, [item for item in report.topics if not item.equal]

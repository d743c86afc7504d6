# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Thermal predictor: models that read the spindle speed beside the temperatures."""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fuzzycnc_ros.components.codes import Reason
from fuzzycnc_ros.core.machine.duties import DUTIES
from fuzzycnc_ros.core.thermal import ThermalRun, train_model

sys.path.insert(0, str(Path(__file__).parent))
from component_bench import Bench
from predictor_bench import (
    MICRON,
    bench_with_model,
    errors_of,
    predict,
    recordings,
    reference_of,
    state_of,
)


def with_speed(name: str) -> ThermalRun:
    """Return a run with the spindle speed of its duty."""
    run = recordings()[name]
    return replace(run, spindle_speed=[DUTIES[name].spindle_speed(time) for time in run.time])


@pytest.fixture(scope='module')
def speed_model():
    """A model that reads the spindle speed."""
    runs = [with_speed(name) for name in ('D0', 'D0b', 'T1')]
    return train_model(runs, model='lag_ridge_speed', candidates=('lag_ridge_speed',))


def drive(bench: Bench, run: ThermalRun, rows, sign: float = 1.0) -> list:
    """Give states of the machine and samples; return the errors that came of them."""
    found = []
    for row in rows:
        bench.push('machine_state', state_of(run, row, sign * run.spindle_speed[row]))
        found += predict(bench, run, [row])
    return found


@pytest.mark.parametrize('sign', [1.0, -1.0])
def test_model_with_spindle_speed_takes_it_from_the_machine(speed_model, sign):
    run, bench = with_speed('T2'), bench_with_model(speed_model.to_json())
    found = errors_of(drive(bench, run, range(120), sign)[2:])
    wanted = speed_model.predict(run)[2:120] / MICRON
    np.testing.assert_allclose(found, wanted, rtol=1e-9)


def test_last_spindle_speed_is_held_for_a_while(speed_model):
    run, bench = with_speed('T2'), bench_with_model(speed_model.to_json(), gap_max=600.0)
    drive(bench, run, range(30))
    bench.push('machine_state', state_of(run, 30, np.nan))
    held = predict(bench, run, range(30, 50))
    assert [item.valid for item in held] == [True] * 10 + [False] * 10
    assert held[-1].reason == Reason.SENSOR_LOST
    assert 'machine_state has told none for more than gap_max = 600 s' in bench.health()
    np.testing.assert_allclose(
        errors_of(held[:10]), speed_model.predict(run)[30:40] / MICRON, rtol=1e-9
    )
    assert drive(bench, run, [50])[0].valid


def test_model_with_spindle_speed_comes_back_from_its_checkpoint(speed_model):
    run, first = with_speed('T2'), bench_with_model(speed_model.to_json())
    wanted = errors_of(drive(first, run, range(110))[100:])
    second = bench_with_model(speed_model.to_json())
    second.component.restore('predictor_state', first.records('predictor_state')[97])
    second.push('thermal_reference', reference_of(run))
    np.testing.assert_allclose(errors_of(drive(second, run, range(100, 110))), wanted, rtol=1e-12)
    assert first.records('predictor_state')[97].last_rise.shape == (len(speed_model.inputs),)


def test_model_without_spindle_speed_needs_no_state_of_the_machine():
    run = recordings()['T2']
    known, unknown = bench_with_model(), bench_with_model()
    drive(known, with_speed('T2'), range(40))
    predict(unknown, run, range(40))
    for one, other in zip(
        known.records('predictor_state'), unknown.records('predictor_state'), strict=True
    ):
        assert one.state.tobytes() == other.state.tobytes()

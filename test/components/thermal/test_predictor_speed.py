# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Thermal predictor: models that read the spindle speed beside the temperatures."""

from dataclasses import replace

import numpy as np
import pytest
from benches.component_bench import Bench
from benches.predictor_bench import (
    MICRON,
    bench_with_model,
    errors_of,
    predict,
    recordings,
    reference_of,
    state_of,
)

from fuzzycnc_ros.core.thermal.fit import train_model
from fuzzycnc_ros.core.thermal.run import ThermalRun
from fuzzycnc_ros.runtime.enums import Reason, SpeedStatus
from fuzzycnc_ros.runtime.records import SpindleSpeed, ThermalError
from fuzzycnc_ros.simulation.thermal.duties import DUTIES


def with_speed(name: str) -> ThermalRun:
    """Return a run with the spindle speed of its duty."""
    run = recordings()[name]
    return replace(run, spindle_speed=[DUTIES[name].spindle_speed(time) for time in run.time])


@pytest.fixture(scope='module')
def speed_model():
    """A model that reads the spindle speed."""
    runs = [with_speed(name) for name in ('D0', 'D0b', 'T1')]
    return train_model(runs, model='lag_ridge_speed', candidates=('lag_ridge_speed',))


def drive(bench: Bench, run: ThermalRun, rows, sign: float = 1.0) -> list[ThermalError]:
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
    assert 'nor spindle_speed has told one for more than gap_max = 600 s' in bench.health()
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


def own_speed(run: ThermalRun, row: int, speed: float, status=SpeedStatus.OK) -> SpindleSpeed:
    """Return what a source of its own tells at a sample of a run."""
    stamp = state_of(run, row, np.nan).stamp
    return SpindleSpeed(stamp=stamp, frame_id='mill/machine', speed=speed, status=int(status))


def test_speed_of_its_own_source_stands_in_for_a_controller_that_knows_none(speed_model):
    run, bench = with_speed('T2'), bench_with_model(speed_model.to_json())
    found = []
    for row in range(120):
        bench.push('machine_state', state_of(run, row, np.nan))
        bench.push('spindle_speed', own_speed(run, row, -run.spindle_speed[row]))
        found += predict(bench, run, [row])
    wanted = speed_model.predict(run)[2:120] / MICRON
    np.testing.assert_allclose(errors_of(found[2:]), wanted, rtol=1e-9)
    assert 'OK speed source: -52.36 rad/s (-500 rpm) from spindle_speed' in bench.health()


def test_no_controller_is_needed_to_predict(speed_model):
    run, bench = with_speed('T2'), bench_with_model(speed_model.to_json(), gap_max=120.0)
    for row in range(40):
        bench.push('spindle_speed', own_speed(run, row, run.spindle_speed[row]))
        predict(bench, run, [row])
    assert bench.records('thermal_error')[-1].valid
    for row in range(40, 44):
        bench.push('spindle_speed', own_speed(run, row, 1e9, SpeedStatus.OUT_OF_RANGE))
        predict(bench, run, [row])
    assert [item.valid for item in bench.records('thermal_error')[-5:]] == [True] * 3 + [False] * 2


def test_controller_has_precedence_and_a_contradiction_is_told(speed_model):
    """The source of its own gives rpm for rad/s."""
    run, bench = with_speed('T2'), bench_with_model(speed_model.to_json())
    found = []
    for row in range(60):
        bench.push('spindle_speed', own_speed(run, row, run.spindle_speed[row] * 30.0 / np.pi))
        found += drive(bench, run, [row])
    wanted = speed_model.predict(run)[2:60] / MICRON
    np.testing.assert_allclose(errors_of(found[2:]), wanted, rtol=1e-9)
    assert 'WARN speed source: 157.1 rad/s (1500 rpm) from machine_state, but' in bench.health()


def falsely_driven(
    bench: Bench, run: ThermalRun, factor: float, rows: range
) -> list[ThermalError]:
    """Drive along a run; in some rows the speed is a factor of the largest trained."""
    largest = float(np.max(run.spindle_speed))
    found = []
    for row in range(100):
        speed = factor * largest if row in rows else run.spindle_speed[row]
        bench.push('machine_state', state_of(run, row, speed))
        found += predict(bench, run, [row])
    return found


def test_speed_far_beyond_the_training_is_out_of_domain(speed_model):
    """Temperatures do not tell: those of the bearings follow within minutes, not at once."""
    run = with_speed('T2')
    assert speed_model.speed_max == pytest.approx(np.max(run.spindle_speed))
    for factor, inside in ((1.35, True), (1.5, False)):
        bench = bench_with_model(speed_model.to_json())
        found = falsely_driven(bench, run, factor, range(60, 63))
        assert [item.in_domain for item in found[60:63]] == [inside] * 3
        assert all(item.in_domain and item.valid for item in (*found[2:60], *found[63:]))
        assert all(item.valid for item in found[60:63])


def test_health_tells_why_it_is_out_of_domain(speed_model):
    run, bench = with_speed('T2'), bench_with_model(speed_model.to_json())
    falsely_driven(bench, run, 1.5, range(99, 100))
    assert 'WARN domain: spindle speed 314.2 rad/s is beyond 1.4 times' in (bench.health())
    healthy = bench_with_model(speed_model.to_json())
    drive(healthy, run, range(30))
    assert 'domain' not in healthy.health()


def test_false_speed_leaves_no_more_than_the_margin_behind(speed_model):
    """A counter that reads 1000 rad/s too much for ten minutes: 5.8 times the largest trained."""
    run = with_speed('T2')
    good = errors_of(drive(bench_with_model(speed_model.to_json()), run, range(100)))
    bad = falsely_driven(bench_with_model(speed_model.to_json()), run, 5.8, range(60, 70))
    edge = falsely_driven(bench_with_model(speed_model.to_json()), run, 1.4, range(60, 70))
    assert all(not item.in_domain for item in bad[60:70])
    assert all(item.in_domain for item in bad[70:])
    np.testing.assert_allclose(errors_of(bad[2:]), errors_of(edge[2:]), rtol=1e-9)
    assert np.abs(errors_of(bad[70:]) - good[70:]).max() < 10.0

# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Motion, load and coolant that a control tells: means, gaps, and what a model makes of them."""

from dataclasses import replace

import numpy as np
import pytest
from benches.predictor_bench import (
    MICRON,
    bench_with_model,
    errors_of,
    predict,
    recordings,
    state_of,
)

from fuzzycnc_ros.components.thermal.control_drives import ControlDrives, drives_at, drives_told
from fuzzycnc_ros.core.thermal.fit import train_model
from fuzzycnc_ros.core.thermal.run import GAP_MAX
from fuzzycnc_ros.runtime.enums import Coolant, Reason
from fuzzycnc_ros.runtime.records import SECOND, MachineState

SILENT = MachineState(
    stamp=0,
    frame_id='',
    state=2,
    homed=True,
    offsets_allowed=True,
    cold_since=0,
    spindle_speed=0.0,
    axis=('X', 'Y'),
    position=np.zeros(2),
)


def told(second, travel, coolant=Coolant.OFF):
    """Return what a state tells whose X axis has travelled so far [m], and Y is unknown."""
    state = replace(
        SILENT,
        travel=np.array([travel, np.nan]),
        square_speed=np.array([2.0 * travel, np.nan]),
        spindle_load=-0.5,
        coolant=int(coolant),
    )
    found = drives_told(state)
    assert found is not None
    return (second * SECOND, *found)


def test_a_control_that_tells_none_has_no_drives():
    assert drives_told(SILENT) is None
    assert drives_at(np.array([0, SECOND]), []) == {}


def test_means_since_the_sample_before():
    drives = ControlDrives()
    drives.note(*told(0, 7.0, Coolant.ON))
    first = {'axis_speed/X': 0.0, 'axis_square_speed/X': 0.0, 'spindle_load': 0.5, 'coolant': 1.0}
    assert drives.take(0) == first
    drives.note(*told(30, 8.0))
    drives.note(*told(60, 13.0))
    assert drives.take(60 * SECOND) == pytest.approx(
        {'axis_speed/X': 0.1, 'axis_square_speed/X': 0.2, 'spindle_load': 0.5, 'coolant': 0.5}
    )
    # a control that begins anew, and a message that says nothing new
    drives.note(*told(90, 1.0))
    drives.note(*told(120, 4.0))
    drives.note(*told(120, 4.0))
    assert drives.take(120 * SECOND)['axis_speed/X'] == pytest.approx(0.1)
    # held, but for no longer than readings are bridged
    last = 120 + int(GAP_MAX)
    assert drives.take(last * SECOND)['axis_speed/X'] == pytest.approx(0.1)
    assert drives.take((last + 1) * SECOND) == {}
    drives.note(*told(last + 1, 1e6))
    assert drives.take((last + 1) * SECOND) == {}
    drives.note(*told(last + 2, 2e6))
    assert drives.take((last + 2) * SECOND) == {'spindle_load': 0.5, 'coolant': 0.0}, 'absurd'


def test_moments_go_on_as_long_as_the_travel_does():
    def moved(second, travel, moment):
        return second * SECOND, {'axis_speed/X': travel, 'axis_moment/X': moment}, {}

    drives = ControlDrives()
    for second, travel, moment in ((0, 0.0, 0.0), (30, 3.0, -1.2), (60, 6.0, -1.8)):
        drives.note(*moved(second, travel, moment))
    found = drives.take(60 * SECOND)
    assert found == pytest.approx({'axis_speed/X': 0.1, 'axis_moment/X': -0.03})
    drives.note(*moved(90, 1.0, 0.5))  # it has begun anew
    drives.note(*moved(120, 4.0, 2.0))
    assert drives.take(120 * SECOND) == pytest.approx({'axis_speed/X': 0.1, 'axis_moment/X': 0.05})


def test_a_recording_has_what_a_predictor_would_have_known():
    states = [told(second, 0.2 * second) for second in range(5, 600, 10)]
    stamps = SECOND * np.arange(0, 600, 60)
    found = drives_at(stamps, reversed(states))
    assert sorted(found) == ['axis_speed/X', 'axis_square_speed/X', 'coolant', 'spindle_load']
    assert found['axis_speed/X'][0] == 0.0
    np.testing.assert_allclose(found['axis_speed/X'][2:], 0.2, rtol=1e-12)
    assert np.isfinite(found['axis_speed/X']).all()


def moving(name):
    """Return a run whose Y axis moves in every second half hour."""
    run = recordings()[name]
    square = 0.1 * ((run.time // 1800.0) % 2.0)
    return replace(run, drives={'axis_square_speed/Y': square, 'coolant': (square == 0.0) * 1.0})


@pytest.fixture(scope='module')
def model():
    runs = [moving(name) for name in ('D0', 'D0b', 'T1')]
    name = 'lag_ridge_drives'
    return train_model(runs, model=name, candidates=(name,), sensors='clusters', n_clusters=3)


def drive(bench, run, rows, factor=1.0):
    """Give states of the machine and samples; return the errors that came of them."""
    square = 60.0 * np.cumsum(run.drives['axis_square_speed/Y'])
    found = []
    for row in rows:
        told = np.where(np.array(run.axis) == 'Y', factor * square[row], np.nan)
        # What holds until the next message.
        on = run.drives['coolant'][min(row + 1, len(run.time) - 1)]
        state = replace(
            state_of(run, row, np.nan), square_speed=told, coolant=int(1 + on), travel=np.zeros(0)
        )
        bench.push('machine_state', state)
        found += predict(bench, run, [row])
    return found


def test_a_model_takes_them_from_the_machine(model):
    run, bench = moving('T2'), bench_with_model(model.to_json())
    found = errors_of(drive(bench, run, range(120))[2:])
    np.testing.assert_allclose(found, model.predict(run)[2:120] / MICRON, rtol=1e-6, atol=1e-6)
    assert 'ERROR' not in bench.health()


def test_without_them_it_says_so_and_far_more_of_them_is_out_of_domain(model):
    run, bench = moving('T2'), bench_with_model(model.to_json())
    predict(bench, run, range(3))
    assert bench.records('thermal_error')[-1].reason == Reason.SENSOR_LOST
    assert 'axis_square_speed/Y, coolant, which machine_state has not told' in bench.health()
    bench = bench_with_model(model.to_json())
    assert all(item.in_domain for item in drive(bench, run, range(32))[3:])
    far = drive(bench, run, range(32, 60), factor=3.0)
    assert not any(item.in_domain for item in far[1:])
    assert 'axis_square_speed/Y beyond 2 times the largest trained' in bench.health()

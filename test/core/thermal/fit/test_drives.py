# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""What a control tells beside the spindle speed takes part where it helps on unseen runs."""

from dataclasses import replace

import numpy as np
import pytest

from fuzzycnc_ros.core.thermal.fit import evaluate, train_model
from fuzzycnc_ros.core.thermal.model import ModelMismatchError, ThermalModel
from fuzzycnc_ros.core.thermal.recursions.base import first_order_lags
from fuzzycnc_ros.core.thermal.run import ThermalDataError, ThermalRun, counted, drivers_of

MINUTES = 480
MOVED = 'axis_square_speed/X'
FORMS = ('static_ridge', 'lag_ridge', 'lag_ridge_speed')


def lag(values, time):
    return first_order_lags(np.exp(-60.0 / time), (1.0 - np.exp(-60.0 / time)) * values)


def duty(seed, ball_screw=30e-6):
    """Return a run: its spindle warms a sensor, its X screw grows where no sensor sees it."""
    random = np.random.default_rng(seed)
    speed, square = (
        np.repeat(random.uniform(0.0, top, MINUTES // 60) * random.integers(0, 2, 8), 60)
        for top in (300.0, 0.2)
    )
    spindle = lag((speed / 200.0) ** 2.0, 3000.0)
    rise = np.stack([8.0 * spindle, 3.0 * lag(spindle, 2000.0)], axis=1)
    error = 10e-6 * spindle + ball_screw * lag(square / 0.1, 3600.0)
    coolant = np.repeat(random.integers(0, 2, MINUTES // 30), 30).astype(float)
    return ThermalRun(
        name=f'day {seed}',
        time=60.0 * np.arange(MINUTES),
        sensor=('head', 'column'),
        temperature=20.0 + rise + 0.05 * random.standard_normal(rise.shape),
        channel=('X',),
        axis=('X',),
        displacement=(error + 0.3e-6 * random.standard_normal(MINUTES))[:, np.newaxis],
        spindle_speed=speed,
        drives={MOVED: square, 'coolant': coolant},
    )


@pytest.fixture(scope='module')
def runs():
    return [duty(seed) for seed in range(4)]


@pytest.fixture(scope='module')
def model(runs):
    return train_model(runs, candidates=FORMS)


def test_motion_is_used_where_it_helps_on_a_duty_that_was_never_seen(runs, model):
    assert model.drivers == ('spindle_speed', MOVED, 'coolant')
    assert model.default == ('lag_ridge_drives',)
    assert list(model.drives_max) == [MOVED, 'coolant']
    judged = evaluate(model, duty(9))
    assert judged.rms['default'] < 1e-6 < 5e-6 < judged.rms['lag_ridge_speed']


def test_it_is_left_out_where_it_does_not(runs):
    idle = [replace(duty(seed, ball_screw=0.0)) for seed in range(4)]
    model = train_model(idle, candidates=FORMS)
    assert 'lag_ridge_drives' in model.candidates
    assert model.default != ('lag_ridge_drives',)
    # and costs nothing there: the others are, to the digit, what they are without it
    plain = train_model([replace(run, drives={}) for run in idle], candidates=FORMS)
    assert plain.default == model.default
    for name in FORMS:
        one, other = plain.candidates[name], model.candidates[name]
        assert one.held_out_rms.tolist() == other.held_out_rms.tolist()
        assert evaluate(plain, idle[0]).rms[name] == evaluate(model, idle[0]).rms[name]


def test_a_model_file_keeps_them_and_its_stream_needs_them(model):
    again = ThermalModel.from_json(model.to_json())
    run, stream = duty(9), again.start()
    rises, found = run.rise(), []
    for row in range(MINUTES):
        drives = {name: values[row] for name, values in run.drives.items()}
        vector = np.concatenate([rises[row], again.drive(run.spindle_speed[row], drives)])
        found.append(stream.step(vector))
    np.testing.assert_allclose(found, again.predict(run), rtol=1e-9, atol=1e-15)
    with pytest.raises(ThermalDataError, match=f'expected {MOVED} in every sample'):
        again.predict(replace(run, drives={}))
    with pytest.raises(ModelMismatchError, match=r'axis_square_speed/X, coolant'):
        again.predict(np.zeros((9, 2)))
    text = model.to_json().replace(f'"{MOVED}"', '"axis_heat/X"')
    with pytest.raises(ValueError, match='drivers: expected spindle_speed before axis_speed/X'):
        ThermalModel.from_json(text)


def test_forms_of_all_kinds_ignore_them_in_a_model_file(runs):
    names = ('lag_ridge', 'classical_grey', 'stable_grey', 'hybrid_network_speed')
    few = [replace(run.resample(240.0)) for run in runs[:2]]
    model = train_model(few, candidates=('lag_ridge',), compared=names)
    again = ThermalModel.from_json(model.to_json())
    assert set(names) < set(again.candidates), again.omitted
    told = few[1].drives[MOVED]
    other = replace(few[1], drives={MOVED: told + 1.0, 'coolant': 0.0 * told})
    for name in names:
        alike = again.predict(few[1], name), again.predict(other, name)
        np.testing.assert_array_equal(*alike)


def test_a_run_keeps_them_in_step(runs):
    run = runs[0]
    slow = run.resample(120.0)
    np.testing.assert_allclose(slow.drives[MOVED][0], run.drives[MOVED][:2].mean())
    part = run.window(stop=6000.0)
    assert len(part.drives['coolant']) == len(part.time) == 101
    assert len(counted(run, stop=6000.0).drives[MOVED]) == 101
    gap = np.where(np.arange(MINUTES) == 5, np.nan, run.drives[MOVED])
    assert drivers_of([replace(run, drives={MOVED: gap})]) == ('spindle_speed',)
    assert drivers_of([run, replace(runs[1], drives={})]) == ('spindle_speed',)
    for name, values, naming in (
        ('heat', run.time, 'expected drives named axis_speed/X'),
        (MOVED, -1.0 + 0.0 * run.time, 'from 0 to 1000'),
        (MOVED, run.time[1:], f'expected {MOVED} of shape'),
    ):
        with pytest.raises(ThermalDataError, match=naming):
            replace(run, drives={name: values})


def test_a_model_that_needs_them_is_refused_where_none_were_told(runs):
    plain = [replace(run, drives={}) for run in runs]
    with pytest.raises(ThermalDataError, match='expected motion, load or coolant that changes'):
        train_model(plain, model='lag_ridge_drives', candidates=FORMS)

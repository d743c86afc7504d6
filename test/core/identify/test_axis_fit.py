# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Axes found from what was recorded of them: known truth, a real one, data that cannot tell."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.io import loadmat
from tiers import rest_slow
from two_mass_axis import TwoMassAxis, TwoMassConfig, operated

from fuzzycnc_ros.core.identify.axis_data import identify_axis, reading_noise, sensor_count
from fuzzycnc_ros.core.identify.axis_fit import (
    AxisModel,
    AxisRecording,
    fit_axis,
    friction_by_recording,
    late,
)
from fuzzycnc_ros.core.identify.loop_fit import fit_loop, following
from fuzzycnc_ros.core.machine.axis_models import BallscrewAxisConfig
from fuzzycnc_ros.core.servo.axis_control import make_axis_controller
from fuzzycnc_ros.simulation.servo.axes import BallscrewAxis, simulated_axis

PERIOD = 1e-3


@pytest.fixture(scope='module')
def one_friction():
    config = BallscrewAxisConfig(offset=0.0, count=1e-6, delay=1e-3)
    return config, fit_axis([late(operated(BallscrewAxis(config), 3.7, 3.0), config.delay)])


def test_a_simulated_axis_is_found(one_friction):
    config, fit = one_friction
    assert fit.structure.startswith('one friction')
    assert fit.model.gain == pytest.approx(config.force_max / config.mass, rel=0.03)
    assert fit.model.coulomb == pytest.approx(config.coulomb_forward / config.mass, rel=0.1)
    assert fit.held_out_rms < 0.04 * fit.held_out_span


@pytest.mark.slow
def test_friction_by_direction_is_told():
    config = replace(BallscrewAxisConfig.by_direction(), viscous_backward=400.0, count=1e-6)
    fit = fit_axis([operated(BallscrewAxis(config), 3.7, seed=seed) for seed in (1, 2)])
    assert fit.structure.startswith('friction by direction')
    assert fit.model.viscous_backward > 1.5 * fit.model.viscous_forward


def test_machine_data_of_an_axis(one_friction):
    config, _ = one_friction
    recording = operated(BallscrewAxis(config), 3.7)
    found = identify_axis([recording], force=config.force_max)
    data = found.data
    assert data.plant.mass == pytest.approx(config.mass, rel=0.03)
    assert data.plant.count == pytest.approx(1e-6)
    # the safe end of the interval, which holds the truth
    assert config.delay <= data.plant.delay <= 1.6 * config.delay
    assert data.limits.travel_high > recording.position.max()
    assert data.limits.resonance == 0.0
    assert data.knowledge.mode_high == 0.0
    assert not data.knowledge.not_fit_for_control
    simulated_axis(data).drive(0.1)


class Sprung(TwoMassAxis):
    """An axis that a spring pulls back."""

    def drive(self, duty):
        super().drive(duty - 3000.0 * self.position / self.config.force)


@pytest.mark.parametrize('digits', [9, 12])
@pytest.mark.parametrize('slowest', [1.0, 2.0, 5.0])
def test_the_count_of_a_sensor_that_is_never_read_slowly(slowest, digits):
    """The least step is two counts, or five; at run time steps of one are no fault then."""
    draw = np.random.default_rng(3)
    counts = np.cumsum(draw.choice([slowest, slowest + 1.0, slowest + 3.0, 90.0], 2000))
    place = np.round(1.806e-7 * counts, digits)
    recording = AxisRecording(np.zeros(len(place)), place, PERIOD)
    assert sensor_count([recording]) == pytest.approx(1.806e-7, rel=1e-3)


def test_readings_without_counts_have_noise_instead():
    draw = np.random.default_rng(4)
    time = PERIOD * np.arange(5000)
    place = 0.05 * np.sin(3.0 * time) + 3e-7 * draw.standard_normal(len(time))
    recording = AxisRecording(np.zeros(len(place)), place, PERIOD)
    assert sensor_count([recording]) == 0.0
    assert reading_noise([recording]) == pytest.approx(3e-7, rel=0.05)


def test_an_axis_on_a_spring_is_not_fit_for_control():
    found = identify_axis([operated(Sprung(TwoMassConfig()), 4.0, 5.0, seed=1)])
    why = found.data.knowledge.not_fit_for_control
    assert 'grows with the position' in why
    with pytest.raises(ValueError, match='fit for control but found one that is not'):
        make_axis_controller(found.data)


@pytest.mark.parametrize(
    ('change', 'said'),
    [
        (lambda r: replace(r, command=0.0 * r.command), 'command: expected a course'),
        (lambda r: replace(r, position=0.0 * r.position), 'position: expected motion'),
        (lambda r: replace(r, command=-r.command), 'turn the sign'),
        (lambda r: r.part(0, 500), 'expected 1000 samples'),
    ],
)
def test_data_that_tell_nothing(change, said):
    recording = operated(BallscrewAxis(), 3.7, 2.0)
    with pytest.raises(ValueError, match=said):
        fit_axis([change(recording)])


@pytest.mark.slow
def test_the_emps_recording_open_loop(data):
    """A plain output-error fit leaves 2.37 mm, the published parameters 5.15 mm."""
    path = data / 'emps-ballscrew' / 'DATA_EMPS.mat'
    if not path.is_file():
        pytest.skip(f'expected the EMPS recording at {path} but found none')
    raw = loadmat(path)
    fit = fit_axis([AxisRecording(raw['vir'].ravel() / 10.0, raw['qm'].ravel(), PERIOD)])
    assert 1e3 * fit.rms < 2.3
    assert fit.structure == 'friction by direction'
    assert 0.9 < fit.model.gain * 95.1 / 351.5 < 1.1


@pytest.mark.parametrize(
    'truth', rest_slow([((40.0, 250.0, 0.0, 3e-3),), ((60.0, 400.0, 0.7, 1e-3),)], 1)
)
def test_loops_of_an_axis_that_follows_a_path(truth):
    time = PERIOD * np.arange(4000)
    phase = 2.0 * np.pi * np.cumsum(np.interp(time, [0.0, 1.0, 4.0], [0.2, 1.0, 3.0])) * PERIOD
    path = 0.02 * np.sin(phase)
    noise = 1e-7 * np.random.default_rng(0).standard_normal(len(time))
    found = fit_loop(path, following(path, PERIOD, truth) + noise, PERIOD)
    gain, bandwidth, forward, _ = truth
    constant = 0.5 * (1.0 - forward**2) / gain**2 - 1.0 / (gain * bandwidth)
    assert found.contour_constant == pytest.approx(constant, rel=0.02)
    assert found.held_out_rms < 3e-7
    for one, value in zip(found.parameters, truth, strict=True):
        assert one.low - 1e-4 <= value <= one.high + 1e-4


def test_a_path_in_another_unit_is_no_following():
    path = 0.02 * np.sin(6.0 * PERIOD * np.arange(2000))
    with pytest.raises(ValueError, match='is the unit the same'):
        fit_loop(path, 1e-3 * path, PERIOD)


def test_friction_that_changes_from_day_to_day_is_learnt_from_the_day_before():
    """Four days of an axis whose friction rises by a half after the first one and stays."""
    model = AxisModel(gain=3.7, viscous_forward=2.0, viscous_backward=2.0, coulomb=0.2, offset=0.0)
    days = []
    for number, factor in enumerate((1.0, 1.5, 1.5, 1.5)):
        duty = 0.4 * np.sin(2e-3 * np.arange(1500) + number) + 0.1
        rubs = replace(
            model, viscous_forward=2.0 * factor, viscous_backward=2.0 * factor,
            coulomb=0.2 * factor,
        )  # fmt: skip
        days.append(AxisRecording(duty, np.round(rubs.simulate(duty, 1e-3), 6), 1e-3))
    found = friction_by_recording(days, model)
    assert found.factors == pytest.approx((1.0, 1.5, 1.5, 1.5), rel=0.05)
    assert found.learnt < 0.8 * found.plain
    assert found.latest == found.factors[-1]
    # what comes and goes is not learnt
    assert friction_by_recording([days[0], days[1], days[0]], model).latest == 1.0

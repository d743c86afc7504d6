# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Resonance and dead time: stated where coherence and excitation allow it, else unknown."""

from pathlib import Path

import numpy as np
import pytest
from scipy.io import loadmat
from tiers import rest_slow
from two_mass_axis import UNSEEN, TwoMassAxis, operated

from fuzzycnc_ros.core.identify.axis_fit import AxisRecording
from fuzzycnc_ros.core.identify.frequency import FrequencyResponse, frequency_response
from fuzzycnc_ros.core.identify.response_fit import LinearResponse, fit_response
from fuzzycnc_ros.core.machine.axis_models import BallscrewAxisConfig
from fuzzycnc_ros.simulation.servo.axes import BallscrewAxis

RECORDED = Path(__file__).parents[2] / 'support' / 'axes'


def recorded(name, *, reference):
    _, commanded, actual, duty = np.loadtxt(
        RECORDED / f'{name}.csv.gz', delimiter=',', skiprows=1
    ).T
    return AxisRecording(duty, 1e-3 * actual, 1e-3, commanded if reference else None)


def fitted(recordings, gain, viscous=2.0):
    return fit_response(frequency_response(recordings, gain), gain, viscous)


@pytest.mark.parametrize('reference', rest_slow([True, False], 0))
def test_a_loop_that_swings_by_itself_tells_no_resonance(reference):
    """Its coherence is 1 up to half the sampling rate: that is the controller turned round."""
    found = fitted([recorded('gantry', reference=reference)], 5.0)
    assert not found.resonance_known
    assert found.known_to < 12.0
    # the true mode and dead time are not excluded
    assert found.mode.low < 25.0
    assert 2e-3 in found.delay
    assert found.delay.high > 4e-3


def test_parts_of_a_recording_that_agree_prove_nothing():
    whole = recorded('gantry', reference=False)
    for part in np.array_split(np.arange(len(whole.position)), 2):
        found = fitted([whole.part(part[0], part[-1])], 5.0)
        assert found is None or not found.resonance_known


def test_a_light_axis_is_known_far_up():
    found = fitted([recorded('light', reference=True)], 100.0)
    assert not found.resonance_known
    assert found.known_to > 150.0
    assert found.mode.low > found.known_to
    assert found.delay.high < 1e-3
    assert found.gain.high < 1.1 * found.gain.low


def test_positions_rounded_or_not_tell_the_same_of_a_real_axis(data):
    path = data / 'emps-ballscrew' / 'DATA_EMPS.mat'
    if not path.is_file():
        pytest.skip(f'expected the EMPS recording at {path} but found none')
    raw = loadmat(path)
    duty, place = raw['vir'].ravel() / 10.0, raw['qm'].ravel()
    for position in (place, np.round(place, 7)):
        found = fitted([AxisRecording(duty, position, 1e-3)], 3.7)
        assert not found.resonance_known
        assert 50.0 < found.known_to < 90.0
        assert found.mode.low > 90.0
        assert found.delay.high < 1e-3


def test_the_mode_and_dead_time_of_a_belt_are_told():
    config = UNSEEN['belt, 60 Hz, 2 ms']
    gain = config.force / (config.motor + config.slide)
    found = fitted([operated(TwoMassAxis(config), gain, 12.0, seed=1)], gain)
    assert found.resonance_known
    assert config.resonance in found.mode
    assert found.mode.high < 1.3 * found.mode.low
    assert config.delay in found.delay
    # a sensor at the motor: far above the mode the motor's mass is all that is left
    mass = (config.motor + config.slide) / config.motor
    assert found.model.ratio == pytest.approx(mass, rel=0.15)


@pytest.mark.parametrize(('damping', 'told'), [(0.1, True), (0.45, False)])
def test_a_broad_bend_of_the_response_is_no_mode(damping, told):
    """As backlash makes one: to call it a mode would hide the one further up."""
    frequency = np.asarray(np.geomspace(1.0, 80.0, 110), np.float64)
    known = LinearResponse(
        gain=9.0, viscous=4.0, delay=2e-3, mode=28.0, damping=damping, ratio=1.46
    )
    size = len(frequency)
    response = FrequencyResponse(
        frequency, known.at(frequency), np.full(size, 0.02), np.ones(size, bool),
        np.zeros(size, bool), np.ones(size), by_reference=False,
    )  # fmt: skip
    found = fit_response(response, 9.0, 4.0)
    assert found.resonance_known == told
    assert 2e-3 in found.delay


def test_what_answers_by_its_speed_is_known_in_level_not_in_gain():
    """As a valve: gain and friction alone are anything, and what they give together is not."""
    frequency = np.asarray(np.geomspace(1.0, 15.0, 70), np.float64)
    axis = LinearResponse(gain=280.0, viscous=600.0, delay=5e-3)
    draw = np.random.default_rng(5).standard_normal((2, len(frequency)))
    size = len(frequency)
    response = FrequencyResponse(
        frequency, axis.at(frequency) * np.exp(0.05 * (draw[0] + 1j * draw[1])),
        np.full(size, 0.05), np.ones(size, bool), np.zeros(size, bool), np.ones(size),
        by_reference=False,
    )  # fmt: skip
    found = fit_response(response, 280.0, 300.0)
    assert found.gain.high > 2.0 * found.gain.low
    assert found.level.high < 1.2 * found.level.low
    assert 1.0 in found.level


def test_a_dead_time_that_no_response_fits_is_excluded():
    """Friction, damping and dead time delay alike: their covariance alone leaves 45 ms open."""
    frequency = np.asarray(np.geomspace(1.1, 38.0, 87), np.float64)
    axis = LinearResponse(
        gain=33.0, viscous=360.0, delay=2.4e-3, mode=29.0, damping=0.33, ratio=0.0
    )
    size = len(frequency)
    response = FrequencyResponse(
        frequency, axis.at(frequency), np.full(size, 0.1), np.ones(size, bool),
        np.zeros(size, bool), np.full(size, 0.5), by_reference=False,
    )  # fmt: skip
    found = fit_response(response, 3.6, 30.0)
    assert found.resonance_known
    assert 2.4e-3 in found.delay
    assert found.delay.high < 8e-3


def test_a_stiff_axis_leaves_room_for_modes_only_above():
    recording = operated(BallscrewAxis(BallscrewAxisConfig(count=1e-7)), 3.7)
    found = fitted([recording], 3.7)
    assert not found.resonance_known
    assert found.mode.low > 30.0


def test_an_axis_that_hardly_moves_is_not_known():
    draw = np.random.default_rng(1)
    duty = 1e-4 * draw.standard_normal(4000)
    place = 1e-6 * np.round(draw.standard_normal(4000))
    assert fitted([AxisRecording(duty, place, 1e-3)], 3.7) is None


@pytest.mark.parametrize('ratio', [0.0, 2.5])
def test_a_simulated_mode_answers_as_the_response_says(ratio):
    """Both ways to the same response: the simulation in time, the formula in frequency."""
    config = BallscrewAxisConfig(
        count=0.0, coulomb_forward=0.0, coulomb_backward=0.0, offset=0.0, mode=40.0,
        mode_damping=0.08, mode_ratio=ratio,
    )  # fmt: skip
    plant = BallscrewAxis(config)
    duty = 0.1 * np.random.default_rng(2).standard_normal(20000)
    rows = []
    for one in duty:
        rows.append(plant.measure())
        plant.drive(float(one))
    found = frequency_response([AxisRecording(duty, np.array(rows), 1e-3)], 3.7)
    model = LinearResponse(
        gain=config.force_max / config.mass, viscous=config.viscous_forward / config.mass,
        mode=40.0, damping=0.08, ratio=ratio,
    )  # fmt: skip
    told = (found.frequency > 5.0) & (found.frequency < 100.0)
    off = np.abs(found.response[told] / model.at(found.frequency[told]) - 1.0)
    assert np.median(off) < 0.06

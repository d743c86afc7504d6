# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The lathe's axis and its sensors against the prototype's figures [long2014]."""

import numpy as np
import pytest
from scipy.linalg import block_diag

from fuzzycnc_ros.core.machine.axis_models import LatheAxisConfig
from fuzzycnc_ros.simulation.servo.axes import LatheAxis, PositionSensor

pytestmark = pytest.mark.paper

OBSERVER_GAIN = [3.4118e-5, 5.0544e-4, 89.6186, 0.730339, 0.365172, -0.558585]
"""On xa, xt, v [mm/s], y [mm], ysens [mm], d, per millimetre that the prediction is off."""

POSITION_GAIN, VELOCITY_GAIN = 0.2846, 0.00738
"""Local gains of the production controller [duty/mm, duty s/mm]."""


@pytest.mark.parametrize(('substeps', 'printed_mm'), [(20, 3.5e-5), (5, 5.6e-4), (1, 0.014)])
def test_substeps_agree_with_the_exact_model(substeps, printed_mm):
    axis = LatheAxis(LatheAxisConfig(coulomb=0.0, breakaway=0.0, substeps=substeps))
    model = axis.config.linear()
    dynamics, duty, _ = model.discrete()
    state, place = np.zeros(5), model.states.index('position')
    difference = []
    for _ in range(1000):
        axis.drive(0.3)
        state = dynamics @ state + 0.3 * duty
        difference.append(abs(axis.position - state[place]))
    # printed to two digits
    assert 1e3 * max(difference) == pytest.approx(printed_mm, rel=0.015)


@pytest.mark.parametrize(
    ('factor', 'printed'),
    [(0.5, 0.9692), (0.75, 0.9653), (1.0, 0.9682), (1.25, 0.9727), (1.5, 0.9970), (1.75, 1.014)],
)
def test_spectral_radius_of_the_production_loop(factor, printed):
    nominal = LatheAxisConfig().linear()
    changed = LatheAxisConfig(gain=0.286 * factor).linear()
    dynamics, duty, _ = changed.discrete()
    model, entry, disturbance = nominal.discrete()
    # the observer: prediction with the last duty, corrected by what the prediction was off
    believed = block_diag(model, [[1.0]])
    believed[:5, 5] = disturbance
    driven, read = np.append(entry, 0.0), np.append(nominal.c, 0.0)
    # millimetres to metres; velocity and both positions stay, as both sides are lengths
    correct = np.array(OBSERVER_GAIN) * [1e3, 1e3, 1.0, 1.0, 1.0, 1e3]
    feedback = -1e3 * np.array([0.0, 0.0, VELOCITY_GAIN, POSITION_GAIN, 0.0, -1e-3])
    loop = np.block(
        [
            [dynamics, np.outer(duty, feedback)],
            [
                np.outer(correct, nominal.c),
                believed - np.outer(correct, read) + np.outer(driven, feedback),
            ],
        ]
    )
    assert np.abs(np.linalg.eigvals(loop)).max() == pytest.approx(printed, abs=6e-4)


def test_what_the_encoder_is_wrong_by():
    # 41 targets, median 7.9 um, largest 19.3 um; where they lie the sheet does not say
    config = LatheAxisConfig(sensor='encoder', noise=0.0)
    sensor = PositionSensor(config, config.period)
    targets = np.random.default_rng(0).uniform(-0.19, 0.19, (500, 41))
    read = [sensor.read(position) for position in targets.ravel()]
    error = 1e6 * np.abs(targets.ravel() - read).reshape(targets.shape)
    for printed, found in ((7.9, np.median(error, axis=1)), (19.3, error.max(axis=1))):
        low, high = np.quantile(found, [0.01, 0.99])
        assert low < printed < high
    assert error.max() < 6.0 + 0.08 * 190.0 + 0.3126
    # and the grating by half a count
    grating = PositionSensor(LatheAxisConfig(noise=0.0), config.period)
    errors = [position - grating.read(position) for position in targets[0]]
    assert np.abs(errors).max() <= 0.3126e-6


def test_the_friction_case_is_the_default():
    config = LatheAxisConfig()
    assert (config.coulomb, config.breakaway, config.stribeck_velocity) == (0.02, 0.03, 2e-3)
    assert (config.gain, config.count, config.noise) == (0.286, 0.625e-6, 0.1e-6)

# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Check values of the simulated grinder."""

import numpy as np
import pytest

from fuzzycnc_ros.core.thermal.fit import GreyModel, LagRidge, StaticRidge
from fuzzycnc_ros.simulation.thermal.grinder import GRINDER_NODES, SENSORS
from fuzzycnc_ros.simulation.thermal.grinder_runs import (
    FLUX_CASES,
    GRINDER_EXPERIMENTS,
    record_flux_case,
    record_grinder,
    simulate_grinder,
)

pytestmark = pytest.mark.paper


def truth_um(name):
    return 1e6 * simulate_grinder(GRINDER_EXPERIMENTS[name]).displacement


@pytest.mark.parametrize(
    ('minutes', 'y', 'z'),
    [(60, -5.307, -1.149), (240, -9.834, -0.408), (480, -4.836, 10.726)],
)
def test_experiment_1_at_the_printed_minutes(minutes, y, z):
    assert truth_um('E1')[minutes] == pytest.approx([y, z], abs=0.0005)


@pytest.mark.parametrize(
    ('name', 'y', 'z'),
    [
        ('E1', (-10.1, 0.0), (-2.5, 10.7)),
        ('E2', (-13.8, 0.0), (-10.3, 0.1)),
        ('E3', (-5.3, 0.0), (-0.7, 3.5)),
    ],
)
def test_range_of_each_experiment(name, y, z):
    displacement = truth_um(name)
    found = np.stack([displacement.min(axis=0), displacement.max(axis=0)])
    assert found == pytest.approx(np.array([y, z]).T, abs=0.0501)  # printed to one decimal


@pytest.mark.parametrize(('name', 'largest'), [('constant2', 20.7), ('random', 19.2)])
def test_largest_error_of_the_flux_tests_in_y(name, largest):
    assert 1e6 * np.abs(record_flux_case(name).displacement[:, 0]).max() == pytest.approx(
        largest, abs=0.0501
    )


def test_rows_are_a_minute_apart_and_include_both_ends():
    lengths = {name: len(run.time) for name, run in record_grinder().items()}
    assert lengths == {'E1': 481, 'E2': 451, 'E3': 301}
    assert {len(record_flux_case(name).time) for name in FLUX_CASES} == {481}
    assert np.all(np.diff(record_grinder(['E3'])['E3'].time) == 60.0)


def test_noise_is_drawn_in_the_sheets_order():
    rng = np.random.default_rng(300 + 4)
    for name, run in record_grinder(seed=4).items():
        truth = simulate_grinder(GRINDER_EXPERIMENTS[name])
        temperature = truth.temperature + rng.normal(
            0.0, 0.1 / np.sqrt(5.0), run.temperature.shape
        )
        y = truth.displacement[:, 0] + rng.normal(0.0, 0.1e-6, len(truth.time))
        z = truth.displacement[:, 1] + rng.normal(0.0, 0.1e-6, len(truth.time))
        np.testing.assert_array_equal(run.temperature, temperature)
        np.testing.assert_array_equal(run.displacement, np.column_stack([y, z]))


def test_sensors_sit_where_they_belong():
    listed = (
        'sp sp wh wh sh sh c0 c0 c1 c1 c2 c2 c3 c3 y0 y1 y1 y2 z0 z1 z1 z2 x0 x1 b0 b2 oil oil'
    )
    share = SENSORS.weights[:28] / SENSORS.weights[:28].sum(axis=1, keepdims=True)
    assert [GRINDER_NODES[i] for i in share.argmax(axis=1)] == listed.split()
    np.testing.assert_allclose(share.max(axis=1), 0.9)
    np.testing.assert_allclose(np.sort(share, axis=1)[:, -2], 0.1)
    np.testing.assert_allclose(SENSORS.weights.sum(axis=1) + SENSORS.air, 1.0)
    np.testing.assert_array_equal(SENSORS.weights[28:], 0.0)
    assert np.all((SENSORS.air[:28] >= 0.0) & (SENSORS.air[:28] <= 0.3))
    lag = -10.0 / np.log(SENSORS.memory)
    assert np.all((lag[:28] >= 60.0) & (lag[:28] <= 200.0))
    assert np.all((lag[28:] >= 600.0) & (lag[28:] <= 2400.0))


@pytest.mark.parametrize(
    ('model', 'y', 'z'),
    [
        (StaticRidge(ridge=1e-2), 1.23, 0.96),
        (GreyModel('stable'), 0.55, 0.99),
        (LagRidge(ridge=1e-2), 1.54, 0.64),
    ],
    ids=['LR', 'SGM', 'LagRidge'],
)
def test_linear_models_from_experiment_1_are_as_wrong_on_2_as_printed(model, y, z):
    """These residuals follow from every draw of the sensors: they check them together."""
    rms = []
    for seed in range(3):
        train, test = record_grinder(['E1', 'E2'], seed).values()
        rise, unseen = (run.rise(run.temperature[0]) for run in (train, test))
        residual = [
            model.fit(rise, train.displacement[:, axis]).predict(unseen)
            - test.displacement[:, axis]
            for axis in range(2)
        ]
        rms.append(1e6 * np.sqrt(np.square(residual).mean(axis=1)))
    assert np.median(rms, axis=0) == pytest.approx([y, z], abs=0.02)

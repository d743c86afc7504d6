# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""A real spindle: train on 24 h with three speeds, judge on a fourth, never seen.

The recording is the first 32 h of the public repository CAIVIAC/FL_THERMAL.  Every setting is
chosen inside the training rows.
"""

from itertools import pairwise

import numpy as np
import pytest

from fuzzycnc_ros.core.thermal import ThermalRun, evaluate, train_model

TRAINING_ROWS = 5791
CYCLES = (0, 991, 1951, 2911, 3871, 4831, 5791)
RIDGES = 10.0 ** np.arange(-6.0, 7.0)


@pytest.fixture(scope='module')
def recording(data):
    table = np.genfromtxt(
        data / 'spindle-thermal' / 'spindle_thermal.csv', delimiter=',', names=True
    )
    sensors = [f't{number}' for number in range(1, 17)]
    channels = [f'ch{number}' for number in range(1, 6)]
    return ThermalRun(
        name='spindle',
        time=table['t'],
        sensor=sensors,
        temperature=np.column_stack([table[name] for name in sensors]),
        channel=channels,
        axis=('X', 'X', 'Y', 'Y', 'Z'),
        displacement=1e-6 * np.column_stack([table[name] for name in channels]),
    )


@pytest.fixture(scope='module')
def model(recording):
    return train_model([recording.window(stop=recording.time[TRAINING_ROWS - 1])])


@pytest.fixture(scope='module')
def evaluation(model, recording):
    return evaluate(model, recording, start=recording.time[TRAINING_ROWS])


def fit_ridge(temperature, displacement, ridge, standardise):
    """Return a static ridge regression with intercept as a function of temperatures."""
    center, level = temperature.mean(axis=0), displacement.mean(axis=0)
    scale = temperature.std(axis=0) if standardise else np.ones(temperature.shape[1])
    columns = (temperature - center) / scale
    normal = columns.T @ columns + ridge * np.eye(len(scale))
    weight = np.linalg.solve(normal, columns.T @ (displacement - level))
    return lambda rows: (rows - center) / scale @ weight + level


@pytest.fixture(scope='module', params=[False, True], ids=['raw', 'standardised'])
def static_ridge_rms(request, recording):
    """Static ridge on the absolute temperatures, penalty by leaving one cycle out."""
    x, y = recording.temperature, recording.displacement
    error = np.zeros((len(RIDGES), y.shape[1]))
    for first, last in pairwise(CYCLES):
        inside = np.zeros(len(x), dtype=bool)
        inside[first:last] = True
        rest = ~inside & (np.arange(len(x)) < TRAINING_ROWS)
        for number, ridge in enumerate(RIDGES):
            predict = fit_ridge(x[rest], y[rest], ridge, request.param)
            error[number] += ((predict(x[inside]) - y[inside]) ** 2).mean(axis=0)
    rms = []
    for channel, ridge in enumerate(RIDGES[error.argmin(axis=0)]):
        target = y[:TRAINING_ROWS, channel]
        predict = fit_ridge(x[:TRAINING_ROWS], target, ridge, request.param)
        residual = predict(x[TRAINING_ROWS:]) - y[TRAINING_ROWS:, channel]
        rms.append(np.sqrt((residual**2).mean()))
    return np.array(rms)


@pytest.mark.paper
def test_default_beats_static_ridge_on_a_speed_never_seen(evaluation, static_ridge_rms):
    ratio = evaluation.rms['default'] / static_ridge_rms
    assert (ratio < 1.0).sum() >= 4
    assert ratio.max() <= 1.2


@pytest.mark.paper
def test_default_beats_the_other_baselines(evaluation):
    for baseline in ('uncompensated', 'least_squares', 'static_ridge'):
        ratio = evaluation.rms['default'] / evaluation.rms[baseline]
        assert (ratio < 1.0).sum() >= 4
        assert ratio.max() <= 1.2


@pytest.mark.paper
def test_the_unseen_cycle_is_where_the_model_was_not_trained(model, evaluation):
    assert evaluation.samples == 480
    assert evaluation.in_domain < 0.5
    assert model.runs == ('spindle',)


@pytest.mark.paper
def test_the_classical_grey_model_is_refused_on_a_real_machine(model):
    assert 'not positive' in model.candidates['classical_grey'].problems[0]
    assert 'classical_grey' not in model.default

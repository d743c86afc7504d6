# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Reports on thermal runs with stand-ins for what a model predicts."""

import numpy as np

from fuzzycnc_ros.simulation.thermal.duties import DUTIES, record_run
from fuzzycnc_ros.studies.thermal.report_data import (
    CompensationRun,
    Latency,
    ReportData,
    SensorCountCurve,
)


def mill_run(name='T2', **changes):
    """Build a run of the simulated mill with a stand-in for its predictions."""
    recorded = record_run(name, 1)
    measured = recorded.displacement
    prediction = 0.9 * measured
    rows = len(recorded.time)
    fields = {
        'name': name,
        'time': recorded.time,
        'sensor': recorded.sensor,
        'temperature': recorded.temperature,
        'cluster': [0] * 32 + [1] * 29 + [2] * 12 + [-1] * 3,
        'chosen': ['T18', 'T55', 'T63'],
        'channel': recorded.channel,
        'measured': measured,
        'predicted': {'classical_grey': 1.4 * measured, 'lag_ridge': prediction},
        'default': 'lag_ridge',
        'standard_deviation': np.full((rows, 2), 1e-6),
        'in_domain': np.arange(rows) != 100,
        'offset': -prediction,
        'applied': -prediction,
        'offset_limit': 50e-6,
        'spindle_speed': [DUTIES[name].spindle_speed(t) for t in recorded.time],
        **changes,
    }
    return CompensationRun(**fields)


def report(**changes):
    fields = {
        'title': 'A shift of <mill_1>',
        'runs': [mill_run()],
        'summary': 'One run & its figures.',
        'sensor_count_curve': SensorCountCurve(
            (1, 5), ('Y', 'Z'), 1e-6 * np.ones((2, 2)), 'T2', 'LagRidge', 5
        ),
        'latency': Latency(1e-3 * np.linspace(1.0, 3.0, 101)),
        'facts': {'Model hash': 'sha256:abc'},
        'notes': ['No safety function.'],
        **changes,
    }
    return ReportData(**fields)


def day_run(interval=10.0, seed=4):
    """Build a run of 24 h with 76 noisy sensors and five channels, one of them with a spike."""
    rng = np.random.default_rng(seed)
    time = np.arange(0.0, 86_400.0, interval)
    slow = 12.0 * np.sin(time / 9e3)[:, np.newaxis]
    channel = ('X', 'Y', 'Z', 'Y2', 'Z2')
    measured = 1e-6 * (slow * np.arange(1, 6) + rng.normal(size=(len(time), 5)))
    measured[5_000, 1] = 200e-6
    predicted = 0.9 * measured
    noise = 0.1 * rng.normal(size=(len(time), 76))
    return mill_run(
        time=time,
        temperature=20.0 + slow * np.linspace(0.2, 1.0, 76) + noise,
        channel=channel,
        measured=measured,
        predicted={
            'classical_grey': 1.2 * measured,
            'static_ridge': 0.8 * measured,
            'lag_ridge': predicted,
        },
        standard_deviation=np.full(measured.shape, 1e-6),
        in_domain=time > 3e3,
        offset=-predicted,
        applied=-predicted,
        offset_limit=250e-6,
        spindle_speed=200.0 * (time // 3600.0 % 2),
    )

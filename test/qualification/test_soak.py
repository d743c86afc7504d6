# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""A soak over DDS: nothing is missed, and every node is watched."""

import pytest
from soak.run import TICKS_MIN

from fuzzycnc_ros.core.thermal.fit import train_model
from fuzzycnc_ros.studies.shift.thermal_shift import record_calibration

NODES = (
    'temperature_acquisition',
    'sensor_selector',
    'thermal_predictor',
    'compensator',
    'recorder',
    'simulated_machine',
)


@pytest.mark.ros
@pytest.mark.realtime
@pytest.mark.qualify
def test_a_live_soak_misses_nothing_and_watches_every_node(monkeypatch):
    soak_live = pytest.importorskip('soak.live', reason='run `make test`')
    monkeypatch.setenv('ROS_DOMAIN_ID', '0')  # soak_live takes a domain of its own
    monkeypatch.setattr(soak_live, 'WARM_UP_LIVE', TICKS_MIN // 2)
    monkeypatch.setattr(soak_live, 'PERIOD', 0.1)
    runs = record_calibration(('D0', 'T1')).runs
    model = train_model(runs, candidates=('lag_ridge',)).to_json()
    told = []
    run = soak_live.soak_live(model, TICKS_MIN, 0, lambda text, done, total: told.append(text))
    assert run.ticks == TICKS_MIN
    assert run.missed == {}
    assert {name.split()[0] for name in run.figures} == set(NODES)
    held = [c for c, name in enumerate(run.figures) if 'latency' not in name]
    assert (run.samples[:, held] > 0.0).all()
    assert 0 < run.settled < len(run.samples)
    assert len(run.hash) == 64
    assert told[0].startswith('soaking over DDS')

# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Watch over slow sensor faults: models, documents and states that are refused."""

from dataclasses import replace

import numpy as np
import pytest
from benches.watch_rig import STEP, recordings

from fuzzycnc_ros.core.document import ModelFileError, Node
from fuzzycnc_ros.core.thermal.fit.selection import all_sensors
from fuzzycnc_ros.core.thermal.fit.training import learn_watch
from fuzzycnc_ros.core.thermal.sensor_watch import SensorWatch, SensorWatchModel


@pytest.fixture(scope='module')
def model():
    runs = recordings()
    return learn_watch(runs, all_sensors(runs), STEP)


@pytest.mark.parametrize(
    ('changes', 'message'),
    [
        ({'sensor': ('s0',) * 8}, 'sensor: expected each sensor once'),
        ({'input': ('s0', 'x')}, 'input: expected inputs among .* but found x'),
        ({'moment': np.eye(3)}, 'moment: expected finite numbers of shape'),
        ({'moment': np.triu(np.ones((8, 8)))}, 'moment: expected mean products'),
        ({'moment': -np.eye(8)}, 'moment: expected mean products'),
        ({'moment': 5e-324 * np.eye(8)}, 'moment: expected mean products'),
        ({'moment': 3.0 - 2.0 * np.eye(8)}, 'moment: expected mean products'),
        ({'missed': np.full(8, np.nan)}, 'missed: expected finite numbers'),
        ({'missed': np.full(8, -0.1)}, 'missed: expected numbers from 0'),
        ({'leverage': np.full(8, -1.0)}, 'leverage: expected numbers from 0'),
    ],
)
def test_parts_that_do_not_belong_together_are_refused(model, changes, message):
    with pytest.raises(ValueError, match=message):
        replace(model, **changes)


def test_a_damaged_document_is_refused(model):
    document = model.document()
    for key in document:
        with pytest.raises(ModelFileError, match=f"an object with '{key}'"):
            SensorWatchModel.read(Node({k: v for k, v in document.items() if k != key}, 'watch'))
    short = document | {'moment': document['moment'][1:]}
    with pytest.raises(ModelFileError, match='watch, moment: expected 36 numbers'):
        SensorWatchModel.read(Node(short, 'watch'))


@pytest.mark.parametrize('state', [np.zeros(3), np.full(32, np.nan)])
def test_a_state_of_another_model_is_refused(model, state):
    watch = SensorWatch(model)
    with pytest.raises(ValueError, match='state: expected 32 finite numbers'):
        watch.state = state
    assert not watch.state.any()

# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""What diagnostics say of records that mean nothing."""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fuzzycnc_ros.components.component import Level
from fuzzycnc_ros.components.merge import Merger
from fuzzycnc_ros.components.records import SECOND, ThermalReference
from fuzzycnc_ros.components.thermal_predictor import ThermalPredictor
from fuzzycnc_ros.nodes.diagnostics import input_health

sys.path.insert(0, str(Path(__file__).parents[1] / 'core'))
from component_bench import readings

pytestmark = pytest.mark.ros


def test_refused_records_show_until_a_good_one_comes():
    merger = Merger(ThermalPredictor())
    good = readings(1.0, [20.0, 21.0])
    merger.push('temperatures', replace(good, status=np.zeros(1, np.uint8)))
    (item,) = (item for item in input_health(merger, SECOND) if item.name == 'temperatures')
    assert item.level is Level.ERROR
    assert item.message == 'refused: status: expected 2 values, parallel to sensor, but found 1'
    assert item.values['refused'] == '1'
    merger.push('temperatures', good)
    (item,) = (item for item in input_health(merger, SECOND) if item.name == 'temperatures')
    assert item.level is Level.OK


def test_latched_inputs_show_only_what_was_refused():
    merger = Merger(ThermalPredictor())
    assert 'thermal_reference' not in [item.name for item in input_health(merger, 0)]
    reference = ThermalReference(
        stamp=1, cold_since=0, set_by='test', sensor=('T1',), temperature=np.zeros(2), samples=3
    )
    merger.push('thermal_reference', reference)
    (item,) = (item for item in input_health(merger, 0) if item.name == 'thermal_reference')
    assert item.message.startswith('refused: temperature: expected 1 values')

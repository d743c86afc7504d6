# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The simulated machine: thermal mill, its duties and sensor faults, the offset input."""

from fuzzycnc_ros.core.machine.duties import (
    DUTIES,
    Duty,
    DutyBlock,
    record_run,
    record_runs,
    simulate_duty,
)
from fuzzycnc_ros.core.machine.mill import MILL_AXES, MILL_SENSORS, ThermalMill
from fuzzycnc_ros.core.machine.offset_input import OffsetInput, OffsetInputConfig, OffsetStatus
from fuzzycnc_ros.core.machine.sensor_faults import FaultInjector, SensorFault, parse_sensor_fault

__all__ = [
    'DUTIES',
    'MILL_AXES',
    'MILL_SENSORS',
    'Duty',
    'DutyBlock',
    'FaultInjector',
    'OffsetInput',
    'OffsetInputConfig',
    'OffsetStatus',
    'SensorFault',
    'ThermalMill',
    'parse_sensor_fault',
    'record_run',
    'record_runs',
    'simulate_duty',
]

# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The simulated machines: thermal mill and grinder, duties, sensor faults, the offset input."""

from fuzzycnc_ros.core.machine.duties import (
    DUTIES,
    Duty,
    DutyBlock,
    record_run,
    record_runs,
    simulate_duty,
)
from fuzzycnc_ros.core.machine.grinder import GRINDER_AXES, AmbientCourse, Grinder
from fuzzycnc_ros.core.machine.grinder_network import GRINDER_SENSORS
from fuzzycnc_ros.core.machine.grinder_runs import (
    FLUX_CASES,
    GRINDER_EXPERIMENTS,
    GrinderCase,
    record_flux_case,
    record_grinder,
    simulate_grinder,
)
from fuzzycnc_ros.core.machine.mill import MILL_AXES, MILL_SENSORS, ThermalMill
from fuzzycnc_ros.core.machine.offset_input import OffsetInput, OffsetInputConfig, OffsetStatus
from fuzzycnc_ros.core.machine.sensor_faults import FaultInjector, SensorFault, parse_sensor_fault

__all__ = [
    'DUTIES',
    'FLUX_CASES',
    'GRINDER_AXES',
    'GRINDER_EXPERIMENTS',
    'GRINDER_SENSORS',
    'MILL_AXES',
    'MILL_SENSORS',
    'AmbientCourse',
    'Duty',
    'DutyBlock',
    'FaultInjector',
    'Grinder',
    'GrinderCase',
    'OffsetInput',
    'OffsetInputConfig',
    'OffsetStatus',
    'SensorFault',
    'ThermalMill',
    'parse_sensor_fault',
    'record_flux_case',
    'record_grinder',
    'record_run',
    'record_runs',
    'simulate_duty',
    'simulate_grinder',
]

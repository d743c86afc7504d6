# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The simulated machines: thermal mill and grinder, duties, axes, faults, the offset input.

The names below are loaded when they are first used.
"""

from typing import TYPE_CHECKING

from fuzzycnc_ros.core.lazy_names import lazy_names

if TYPE_CHECKING:
    from fuzzycnc_ros.core.machine.axis_batch import LatheAxes, LatheMove, random_moves
    from fuzzycnc_ros.core.machine.axis_plant import AxisPlant, LinearAxis
    from fuzzycnc_ros.core.machine.ballscrew_axis import BallscrewAxis, BallscrewAxisConfig
    from fuzzycnc_ros.core.machine.duties import (
        DUTIES,
        Duty,
        DutyBlock,
        record_run,
        record_runs,
        simulate_duty,
    )
    from fuzzycnc_ros.core.machine.foam_samples import FoamSamples, true_compensation
    from fuzzycnc_ros.core.machine.foam_sheet import FoamSheet, FoamStitching
    from fuzzycnc_ros.core.machine.foam_tracks import FoamTrack, TrackQuality
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
    from fuzzycnc_ros.core.machine.lathe_axis import LatheAxis, LatheAxisConfig
    from fuzzycnc_ros.core.machine.mill import MILL_AXES, MILL_SENSORS, ThermalMill
    from fuzzycnc_ros.core.machine.offset_input import OffsetInput, OffsetInputConfig, OffsetStatus
    from fuzzycnc_ros.core.machine.position_sensor import PositionSensorConfig
    from fuzzycnc_ros.core.machine.sensor_faults import (
        FaultInjector,
        SensorFault,
        parse_sensor_fault,
    )

__all__ = [
    'DUTIES',
    'FLUX_CASES',
    'GRINDER_AXES',
    'GRINDER_EXPERIMENTS',
    'GRINDER_SENSORS',
    'MILL_AXES',
    'MILL_SENSORS',
    'AmbientCourse',
    'AxisPlant',
    'BallscrewAxis',
    'BallscrewAxisConfig',
    'Duty',
    'DutyBlock',
    'FaultInjector',
    'FoamSamples',
    'FoamSheet',
    'FoamStitching',
    'FoamTrack',
    'Grinder',
    'GrinderCase',
    'LatheAxes',
    'LatheAxis',
    'LatheAxisConfig',
    'LatheMove',
    'LinearAxis',
    'OffsetInput',
    'OffsetInputConfig',
    'OffsetStatus',
    'PositionSensorConfig',
    'SensorFault',
    'ThermalMill',
    'TrackQuality',
    'parse_sensor_fault',
    'random_moves',
    'record_flux_case',
    'record_grinder',
    'record_run',
    'record_runs',
    'simulate_duty',
    'simulate_grinder',
    'true_compensation',
]

__getattr__ = lazy_names(
    __name__,
    {
        'axis_batch': (
            'LatheAxes',
            'LatheMove',
            'random_moves',
        ),
        'axis_plant': (
            'AxisPlant',
            'LinearAxis',
        ),
        'ballscrew_axis': (
            'BallscrewAxis',
            'BallscrewAxisConfig',
        ),
        'duties': (
            'DUTIES',
            'Duty',
            'DutyBlock',
            'record_run',
            'record_runs',
            'simulate_duty',
        ),
        'foam_samples': (
            'FoamSamples',
            'true_compensation',
        ),
        'foam_sheet': (
            'FoamSheet',
            'FoamStitching',
        ),
        'foam_tracks': (
            'FoamTrack',
            'TrackQuality',
        ),
        'grinder': (
            'GRINDER_AXES',
            'AmbientCourse',
            'Grinder',
        ),
        'grinder_network': ('GRINDER_SENSORS',),
        'grinder_runs': (
            'FLUX_CASES',
            'GRINDER_EXPERIMENTS',
            'GrinderCase',
            'record_flux_case',
            'record_grinder',
            'simulate_grinder',
        ),
        'lathe_axis': (
            'LatheAxis',
            'LatheAxisConfig',
        ),
        'mill': (
            'MILL_AXES',
            'MILL_SENSORS',
            'ThermalMill',
        ),
        'offset_input': (
            'OffsetInput',
            'OffsetInputConfig',
            'OffsetStatus',
        ),
        'position_sensor': ('PositionSensorConfig',),
        'sensor_faults': (
            'FaultInjector',
            'SensorFault',
            'parse_sensor_fault',
        ),
    },
)

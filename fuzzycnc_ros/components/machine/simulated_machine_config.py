# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Parameters of `simulated_machine`."""

from collections.abc import Mapping
from dataclasses import dataclass, fields
from types import MappingProxyType

from fuzzycnc_ros.core.config import Config, param, same_param
from fuzzycnc_ros.core.inputs.offset_input import OffsetInputConfig
from fuzzycnc_ros.core.machine.path_loop import ContouringConfig
from fuzzycnc_ros.simulation.thermal.duties import AXIS_DUTIES, DUTIES, Duty, DutyBlock
from fuzzycnc_ros.simulation.thermal.mill import DISPLACEMENT_NOISE, RPM

WHOLE_SHIFT = Duty(
    'shift',
    tuple(
        DutyBlock(rpm * RPM, 60.0 * minutes)
        for rpm, minutes in (
            (1000, 60),
            (0, 15),
            (1500, 75),
            (0, 30),
            (2000, 60),
            (500, 40),
            (1500, 80),
            (0, 120),
        )
    ),
    base=21.0,
    amplitude=2.0,
    phase_hours=6.0,
)
"""Eight hours from a cold machine: work, pauses, and two hours in which it cools down."""

MACHINE_DUTIES: Mapping[str, Duty] = MappingProxyType(
    {**DUTIES, WHOLE_SHIFT.name: WHOLE_SHIFT, **AXIS_DUTIES}
)
"""All duties by name."""

DAY_START = 6 * 3600.0
"""Machine time at which the first duty starts [s]: six in the morning of day one."""


_PREFIX = 'axis_'


@dataclass(frozen=True, kw_only=True)
class SimulatedMachineConfig(Config):
    """Parameters of `simulated_machine`."""

    duties: tuple[str, ...] = param(
        ('T2',),
        '-',
        'Duties to run, one a day, each from cold, without the nights between them: D0, D0b, T1, '
        'T2, T3, shift; with axis motion axis_Y, axis_A, axis_B, axis_work, axis_short',
    )
    paths: tuple[str, ...] = param(
        (), '-', 'Paths to load after the duties, one by one: infinity, trident, butterfly'
    )
    jobs: tuple[str, ...] = param(
        (),
        '-',
        'Jobs of the one duty, each s after it began, which must rise: 3600:path:butterfly, '
        '7200:program, 10800:move:X:-0.05; built-in axes make no moves',
    )
    part_program: str = param(
        '', '-', 'Text of the part program of a job, in mm; empty is a plate of its own'
    )
    path_feed: float = param(
        0.2, 'm/s', 'Programmed feed of these paths, in jobs too', low=1e-6, high=10.0
    )
    path_timeout: float = param(
        60.0,
        's',
        'Machine time without a trajectory for a path after which the run ends',
        low=0.1,
        high=86400.0,
    )
    patterns: tuple[str, ...] = param(
        (),
        '-',
        'Patterns to stitch on soft sheets after the duties, one by one, instead of paths: '
        'parallelogram:45, with lengths in m as parallelogram:30:thickness=0.02:depth=0.008, or '
        'calibration:40, so many single primitives',
    )
    pattern_feed: float = param(
        0.021, 'm/s', 'Programmed feed of these patterns', low=1e-6, high=10.0
    )
    sheet_thickness: float = param(
        15e-3, 'm', 'Thickness of the sheet that lies in the machine', low=1e-4, high=1.0
    )
    sheet_size: tuple[float, ...] = param(
        (0.15, 0.1), 'm', 'Its clamped area along X and Y', low=1e-3, high=10.0
    )
    sheet_friction: float = param(
        0.35, '-', 'Friction between its foot and any sheet', low=0.0, high=10.0
    )
    sheet_seed: int = param(
        0,
        '-',
        "Seed of each sheet's scatter and of the noise of its stitches, counted up path by path; "
        '-1 for none of both',
        low=-1,
        high=2**31 - 1,
    )
    duty_duration: float = param(
        0.0, 's', 'Time after which each duty is cut off; 0 runs it whole', low=0.0, high=864000.0
    )
    seed: int = param(0, '-', 'Seed of all measuring noise', low=0, high=2**31 - 1)
    tick_period: float = param(
        12.0, 's', 'Machine time between two sets of readings', low=0.1, high=60.0
    )
    rate: float = param(
        1.0, '-', 'Speed of machine time without lock-step; 1 is real time', low=0.01, high=1e4
    )
    displacement_interval: float = param(
        60.0, 's', 'Machine time between two displacement measurements', low=0.1, high=3600.0
    )
    displacement_noise: float = param(
        DISPLACEMENT_NOISE, 'm', 'Standard deviation of their noise', low=1e-9, high=1e-4
    )
    displacement_compensated: bool = param(
        False,
        '-',
        'Measure the machine as it is, offsets in force included; else without its offsets',
    )
    sensor_faults: tuple[str, ...] = param(
        (), '-', 'Sensor faults as sensor:kind:start[:value], start in s after a duty began'
    )
    displacement_positions: tuple[float, ...] = param(
        (0.0,),
        'm',
        'Positions of the machine at which axes with a ball screw are measured',
        low=-100.0,
        high=100.0,
    )
    screws: tuple[str, ...] = param(
        (),
        '-',
        'Axes whose ball screw warms up by their motion, as Y:fixed_free; mountings: fixed_free, '
        'fixed_fixed, linear_scale',
    )
    screw_data: tuple[str, ...] = param(
        (),
        '-',
        'What differs from the defaults of their screws, as Y:length:0.9; fields of '
        'BallScrewConfig',
    )
    screw_faults: tuple[str, ...] = param(
        (),
        '-',
        'Faults of their screws as axis:fault:start, start in s after a duty began; faults: '
        'nut_sensor_off, stretch_lost',
    )
    offset_max: float = param(
        60e-6, 'm', "The machine's own limit of an offset", low=1e-6, high=1e-3
    )
    slew_max: float = param(
        0.5e-6, 'm/s', "The machine's own limit of an offset's change", low=1e-9, high=1e-3
    )
    slope_max: float = same_param(OffsetInputConfig, 'slope_max')
    validity_max: float = param(
        180.0,
        's',
        'How long after its stamp an offset acts at most, whatever it says itself',
        low=0.01,
        high=7200.0,
    )
    axis_interpolation_period: float = same_param(ContouringConfig, 'interpolation_period')
    axis_control_steps: int = same_param(ContouringConfig, 'control_steps')
    axis_filter_samples: int = same_param(ContouringConfig, 'filter_samples')
    axis_position_gain: float = same_param(ContouringConfig, 'position_gain')
    axis_velocity_bandwidth: float = same_param(ContouringConfig, 'velocity_bandwidth')
    axis_velocity_max: float = same_param(ContouringConfig, 'velocity_max')
    axis_acceleration_max: float = same_param(ContouringConfig, 'acceleration_max')
    axis_run_out: float = same_param(ContouringConfig, 'run_out')
    servo_axes: tuple[str, ...] = param(
        (),
        '-',
        'Axes that axis_command drives instead of the built-in loops, as X:lathe; models: lathe, '
        'ballscrew, machine_file',
    )
    axis_data: tuple[str, ...] = param(
        (),
        '-',
        'Axes of a machine file, as X:plant.gain:0.31; a machine file gives them',
    )
    servo_plant: tuple[str, ...] = param(
        (),
        '-',
        'What differs from the defaults of their models, faults too, as X:gain_factor:1.5; fields '
        'of LatheAxisConfig and BallscrewAxisConfig',
    )
    servo_travel_low: float = param(
        -0.3,
        'm',
        'Low end of their travel; an axis of a machine file has its own',
        low=-100.0,
        high=100.0,
    )
    servo_travel_high: float = param(
        0.3,
        'm',
        'High end of their travel; an axis of a machine file has its own',
        low=-100.0,
        high=100.0,
    )
    servo_silence: float = param(
        0.0, 's', 'Time from which axis_state is missing; 0 for never', low=0.0, high=1e6
    )
    moves: tuple[str, ...] = param(
        (), '-', 'Positions to command one after the other, in m, as X:-0.05 or X:-0.05,Y:0.01'
    )
    move_time: float = param(1.2, 's', 'Time that each gets', low=0.01, high=3600.0)
    move_tolerance: float = param(
        1e-5, 'm', 'Distance from its target that may be left then', low=1e-9, high=1.0
    )
    lockstep_nodes: tuple[str, ...] = param(
        ('temperature_acquisition', 'sensor_selector', 'thermal_predictor', 'compensator'),
        '-',
        'Nodes of the run: in lock-step they get turns in this order, else the start awaits them',
    )
    start_timeout: float = param(
        10.0,
        's',
        'Wall time after which a run without lock-step starts without nodes that are missing',
        low=0.0,
        high=600.0,
    )
    lockstep_recorder: bool = param(
        False, '-', 'Whether the run starts with a recorder, and in lock-step waits for it'
    )
    answer_timeout: float = param(
        1.0,
        's',
        'Wall time after which a silent node of a lock-step run is lost',
        low=0.05,
        high=60.0,
    )


def contouring_config(config: SimulatedMachineConfig) -> ContouringConfig:
    """Return the axes that the fields `axis_<name>` of a configuration describe.

    Raises
    ------
    ValueError
        If their loops would not settle.
    """
    names = {item.name for item in fields(config)}
    given = {
        item.name: getattr(config, _PREFIX + item.name)
        for item in fields(ContouringConfig)
        if _PREFIX + item.name in names
    }
    return ContouringConfig(**given)

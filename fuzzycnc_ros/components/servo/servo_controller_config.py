# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Parameters of `servo_controller`, and the controllers that they mean."""

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace

from fuzzycnc_ros.components.servo.servo_axes import (
    FROM_FILE,
    check_period,
    file_axes,
    parse_axes,
)
from fuzzycnc_ros.components.servo.servo_plausibility import MotionDoubt
from fuzzycnc_ros.core.config import Config, param
from fuzzycnc_ros.core.inputs.trajectory_input import TrajectoryInputConfig
from fuzzycnc_ros.core.machine.machine_data import AxisData, AxisLimits
from fuzzycnc_ros.core.servo.axis_control import (
    AXIS_CONTROLLERS,
    FOR_USE,
    make_axis_controller,
)
from fuzzycnc_ros.core.servo.built_in import BALLSCREW_SETTINGS, BUILT_IN_AXES, built_in_controller
from fuzzycnc_ros.core.servo.controller import AxisController
from fuzzycnc_ros.core.servo.feedback_watch import FeedbackLimits
from fuzzycnc_ros.core.servo.profile import ProfileLimits

_FREE = {item.name: item.metadata['high'] for item in fields(AxisLimits)}
"""Limits that limit nothing."""

SUITED = 'suited'
"""Stands for the controller that won on an axis after tuning with equal effort."""


@dataclass(frozen=True, kw_only=True)
class ServoControllerConfig(Config):
    """Parameters of `servo_controller`."""

    autostart: bool = param(
        False, '-', 'Configure and activate at start; otherwise a lifecycle manager does'
    )
    realtime_priority: int = param(
        0,
        '-',
        'Priority of the process in real time (SCHED_FIFO), if it is allowed one; 0 for none',
        low=0,
        high=99,
    )
    axes: tuple[str, ...] = param(
        ('X:lathe',),
        '-',
        'Axes with their models, as X:lathe; models: lathe, ballscrew, machine_file',
    )
    axis_data: tuple[str, ...] = param(
        (),
        '-',
        'Axes of a machine file, as X:plant.gain:0.31; a machine file gives them',
    )
    axis_controller: str = param(
        FROM_FILE,
        '-',
        'Controller of the axes of a machine file: the one that it names, with its settings, or '
        'another, untuned',
        choices=(FROM_FILE, *AXIS_CONTROLLERS),
    )
    reversed_axes: tuple[str, ...] = param(
        (), '-', 'Axes that a positive duty drives to negative positions'
    )
    controller: str = param(
        SUITED,
        '-',
        'Controller of every axis that is of no machine file: what won on it after tuning, '
        f'{FOR_USE[0]} on a lathe, {BUILT_IN_AXES["ballscrew"].controller} on a ballscrew, or '
        'another; a ballscrew has these two only',
        choices=(SUITED, *FOR_USE),
    )
    period: float = param(1e-3, 's', 'Control period, that of the axis states', low=1e-4, high=0.1)
    velocity_max: float = param(
        0.2, 'm/s', 'Largest velocity on the way to a position', low=1e-6, high=10.0, live=True
    )
    acceleration_max: float = param(
        1.5, 'm/s^2', 'Largest acceleration on the way', low=1e-6, high=1000.0, live=True
    )
    jerk_max: float = param(
        30.0, 'm/s^3', 'Largest jerk on the way', low=1e-6, high=1e6, live=True
    )
    travel_low: float = param(
        -0.25,
        'm',
        'Lowest position that an axis is sent to; one of a machine file has its own',
        low=-100.0,
        high=100.0,
    )
    travel_high: float = param(
        0.25,
        'm',
        'Highest position that an axis is sent to; one of a machine file has its own',
        low=-100.0,
        high=100.0,
    )
    trajectory_velocity_max: float = param(
        0.25, 'm/s', 'Largest velocity of a trajectory that is followed', low=1e-4, high=10.0
    )
    trajectory_acceleration_max: float = param(
        4.0, 'm/s^2', 'Largest acceleration of such a trajectory', low=1e-3, high=1000.0
    )
    duty_max: float = param(1.0, '-', 'Largest magnitude of duty', low=1e-3, high=1.0)
    command_validity: float = param(
        0.02, 's', 'Time after which the drives take a command as out of date', low=1e-3, high=1.0
    )
    silence_max: float = param(
        0.02,
        's',
        'Time without axis states that is bridged; a longer one is a fault',
        low=1e-3,
        high=1.0,
    )
    missed_max: int = param(
        5, '-', 'Readings in a row that may be missing or unusable', low=1, high=1000
    )
    friction_max: float = param(
        0.12,
        '-',
        'Largest friction that is believed, as duty; an axis of a machine file has its own',
        low=0.0,
        high=1.0,
    )
    load_max: float = param(
        0.12,
        '-',
        'Largest load either way that is believed, as duty; an axis of a machine file has its own',
        low=0.0,
        high=1.0,
    )

    def __post_init__(self) -> None:
        """Check the fields and how they fit together.

        Raises
        ------
        ValueError
            If a field is out of its bounds, an axis is unknown, or there is no travel.
        """
        super().__post_init__()
        axes = parse_axes('axes', self.axes)
        if not axes:
            raise ValueError('axes: expected one or more but found none')
        known = self._file_axes
        check_period('period', self.period, known)
        for axis, data in known.items():
            if self.axis_controller == FROM_FILE and not data.controller:
                raise ValueError(
                    f'axes: expected a tuned controller of {axis} in the machine file but found '
                    f'none; `fuzzycnc servo tune --machine-file FILE --axis {axis}` finds one, or '
                    'name one by axis_controller'
                )
        unknown = [name for name in self.reversed_axes if name not in axes]
        if unknown:
            raise ValueError(
                f'reversed_axes: expected axes among {", ".join(axes)} but found '
                f'{", ".join(unknown)}'
            )
        if not self.travel_low < self.travel_high:
            raise ValueError(
                f'travel_high: expected more than travel_low = {self.travel_low} m but found '
                f'{self.travel_high} m'
            )
        if self.silence_max > self.command_validity:
            raise ValueError(
                f'silence_max: expected at most command_validity = {self.command_validity} s, for '
                f'which the drives hold a command, but found {self.silence_max} s'
            )
        theirs = (SUITED, *BALLSCREW_SETTINGS)
        if self.controller not in theirs and 'ballscrew' in axes.values():
            raise ValueError(
                f'controller: expected {", ".join(theirs)} for a ballscrew axis but found '
                f'{self.controller}'
            )

    @property
    def _file_axes(self) -> dict[str, AxisData]:
        return file_axes('axes', parse_axes('axes', self.axes), self.axis_data)

    @property
    def driven(self) -> dict[str, AxisData]:
        """All axes by name; those that are built in have the limits of these parameters alone."""
        limits = AxisLimits(
            velocity=_FREE['velocity'],
            acceleration=_FREE['acceleration'],
            travel_low=self.travel_low,
            travel_high=self.travel_high,
            positioning_jerk=_FREE['positioning_jerk'],
            load=self.load_max,
            friction=self.friction_max,
        )
        known = self._file_axes
        return {
            name: known.get(name) or replace(BUILT_IN_AXES[model], limits=limits)
            for name, model in parse_axes('axes', self.axes).items()
        }


def make_controllers(config: ServoControllerConfig) -> dict[str, AxisController]:
    """Return one controller per axis.

    Raises
    ------
    ValueError
        If parameters do not fit each other.
    """
    found: dict[str, AxisController] = {}
    for (name, data), model in zip(
        config.driven.items(), parse_axes('axes', config.axes).values(), strict=True
    ):
        direction = -1.0 if name in config.reversed_axes else 1.0
        if model == FROM_FILE:
            asked = '' if config.axis_controller == FROM_FILE else config.axis_controller
            found[name] = file_controller(config, name, data, asked)
        else:
            found[name] = built_in_controller(
                model,
                '' if config.controller == SUITED else config.controller,
                direction=direction,
                period=config.period,
                duty_max=config.duty_max,
            )
            found[name].watch.limits = _believed(config, found[name].watch.limits)
    return found


def profile_limits(
    config: ServoControllerConfig, velocity: float, data: AxisData
) -> ProfileLimits:
    """Return the limits of a motion that is at most so fast [m/s]; NaN asks for no less."""
    given = config.velocity_max, config.acceleration_max, config.jerk_max
    top, acceleration, jerk = map(min, given, data.limits.positioning)
    return ProfileLimits(
        velocity=min(velocity, top) if velocity == velocity else top,
        acceleration=acceleration,
        jerk=jerk,
    )


def trajectory_limits(config: ServoControllerConfig) -> TrajectoryInputConfig:
    """Return what trajectories have to keep: what all axes keep, too."""
    limits = [data.limits for data in config.driven.values()]
    return TrajectoryInputConfig(
        period=config.period,
        velocity_max=min([config.trajectory_velocity_max, *(one.velocity for one in limits)]),
        acceleration_max=min(
            [config.trajectory_acceleration_max, *(one.acceleration for one in limits)]
        ),
    )


def motion_doubt(data: AxisData) -> MotionDoubt:
    """Return what is believed possible of the motion of an axis."""
    return MotionDoubt(friction=data.limits.friction, load=data.limits.load)


def file_controller(
    config: ServoControllerConfig,
    name: str,
    data: AxisData,
    controller: str,
    settings: Mapping[str, float] | None = None,
) -> AxisController:
    """Return a controller of an axis of a machine file.

    Parameters
    ----------
    config : ServoControllerConfig
        Parameters of the servo controller.
    name, data
        The axis.
    controller : str
        Its controller; empty for that of the file.
    settings : mapping of str to float, optional
        Its settings; by default those of the file, if the controller is that of the file.

    Raises
    ------
    ValueError
        If they do not fit each other.
    """
    assert data.plant is not None
    direction = -1.0 if name in config.reversed_axes else data.plant.direction
    duty = min(config.duty_max, data.plant.duty_max)
    known = replace(data, plant=replace(data.plant, direction=direction, duty_max=duty))
    try:
        made = make_axis_controller(known, controller, settings)
    except ValueError as error:
        raise ValueError(f'axis_data: {name}: {error}') from error
    made.watch.limits = replace(made.watch.limits, bad_max=config.missed_max)
    return made


def _believed(config: ServoControllerConfig, limits: FeedbackLimits) -> FeedbackLimits:
    """Return what to believe of the feedback of an axis with this travel."""
    travel = config.travel_high - config.travel_low
    load = max(limits.load, min(config.load_max + config.friction_max, 1.0))
    return replace(limits, error_max=travel, bad_max=config.missed_max, load=load)

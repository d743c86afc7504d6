# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Parameters of `joint_trajectory_bridge`."""

from dataclasses import dataclass

from fuzzycnc_ros.core.config import Config, param
from fuzzycnc_ros.core.inputs.trajectory_input import TrajectoryInputConfig
from fuzzycnc_ros.runtime.records import nanoseconds


@dataclass(frozen=True, kw_only=True)
class JointTrajectoryBridgeConfig(Config):
    """Parameters of `joint_trajectory_bridge`."""

    autostart: bool = param(
        False, '-', 'Configure and activate at start; otherwise a lifecycle manager does'
    )
    axes: tuple[str, ...] = param(('X', 'Y', 'Z'), '-', 'Axes that goals may move, ISO 841 names')
    joints: tuple[str, ...] = param(
        (), '-', 'Names of their joints, in the same order; empty: the names of the axes'
    )
    velocity_max: float = param(
        0.25,
        'm/s',
        'Velocity of an axis above which a goal is refused',
        low=1e-6,
        high=10.0,
    )
    acceleration_max: float = param(
        4.0,
        'm/s^2',
        'Acceleration above which a goal is refused, and of a stop',
        low=1e-6,
        high=1000.0,
    )
    duration_max: float = param(
        600.0, 's', 'Longest trajectory that is taken', low=1e-3, high=3600.0
    )
    age_max: float = param(
        0.5, 's', 'How old the start of a trajectory may be, if it names one', low=0.0, high=60.0
    )
    start_tolerance: float = param(
        1e-4,
        'm',
        'How far from the axes a trajectory may begin, if it has a point at time 0',
        low=0.0,
        high=0.1,
    )
    path_tolerance: float = param(
        0.0,
        'm',
        'Distance of an axis from the trajectory at which a goal ends; 0 is none. Goals may name '
        'their own',
        low=0.0,
        high=1.0,
        live=True,
    )
    goal_tolerance: float = param(
        1e-4,
        'm',
        'Distance from its end within which each axis must come to rest; 0 is none. Goals may '
        'name their own',
        low=0.0,
        high=1.0,
        live=True,
    )
    goal_time: float = param(
        2.0,
        's',
        'Time after the end of a trajectory in which the axes must be there. Goals may name '
        'their own',
        low=1e-3,
        high=60.0,
        live=True,
    )
    period: float = param(
        1e-3, 's', 'Time between two samples of the trajectory', low=1e-4, high=0.1
    )
    chunk: float = param(
        0.1, 's', 'Motion that each part of the trajectory commits to', low=1e-3, high=10.0
    )
    lead: float = param(0.2, 's', 'How long before its start a part is sent', low=1e-3, high=10.0)
    joint_state_period: float = param(
        0.02, 's', 'Time between two joint states while axes move', low=1e-3, high=60.0
    )
    rest_period: float = param(
        1.0,
        's',
        'Time between two joint states while axes rest',
        low=0.1,
        high=60.0,
    )
    workpiece_offset: tuple[float, ...] = param(
        (0.0, 0.0, 0.0),
        'm',
        'Place of the frame <machine>/workpiece in <machine>/machine, for viewers alone',
        low=-1000.0,
        high=1000.0,
    )

    def __post_init__(self) -> None:
        """Check every field, and that they fit each other.

        Raises
        ------
        ValueError
            If they do not; the message names the parameter.
        """
        super().__post_init__()
        for name in ('axes', 'joints'):
            found: tuple[str, ...] = getattr(self, name)
            if len(set(found)) != len(found) or not all(found):
                raise ValueError(
                    f'{name}: expected names, each once, but found {", ".join(found)}'
                )
        if not self.axes:
            raise ValueError('axes: expected names such as X but found none')
        if self.joints and len(self.joints) != len(self.axes):
            raise ValueError(
                f'joints: expected one name for each of {", ".join(self.axes)} but found '
                f'{", ".join(self.joints)}'
            )
        if len(self.workpiece_offset) != 3:
            raise ValueError(
                f'workpiece_offset: expected X, Y and Z but found {len(self.workpiece_offset)} '
                'numbers'
            )
        if nanoseconds(self.chunk) % nanoseconds(self.period):
            raise ValueError(
                f'chunk = {self.chunk} s must be a whole number of periods of {self.period} s'
            )

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Names of the joints, in the order of the axes."""
        return self.joints or self.axes

    @property
    def limits(self) -> TrajectoryInputConfig:
        """Limits of a whole trajectory, for the guard that machines have too."""
        return TrajectoryInputConfig(
            period=self.period,
            velocity_max=self.velocity_max,
            acceleration_max=self.acceleration_max,
            samples_max=int(self.duration_max / self.period) + 2,
        )

# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Goals of the action `FollowJointTrajectory`: what is asked for, and what is wrong with it."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import IntEnum
from typing import Any

import numpy as np

from fuzzycnc_ros.components.motion.joint_trajectory_config import JointTrajectoryBridgeConfig
from fuzzycnc_ros.runtime.convert import stamp_of
from fuzzycnc_ros.runtime.records import SECOND, Floats, nanoseconds

STANDING = 1e-6
"""Velocity below which an end of a trajectory is at rest [m/s]; senders round to floats."""
_FIELDS = ('position', 'velocity', 'acceleration')


class GoalCode(IntEnum):
    """Results of a goal; the numbers are those of `control_msgs/action/FollowJointTrajectory`."""

    SUCCESSFUL = 0
    INVALID_GOAL = -1
    INVALID_JOINTS = -2
    OLD_HEADER_TIMESTAMP = -3
    PATH_TOLERANCE_VIOLATED = -4
    GOAL_TOLERANCE_VIOLATED = -5


class GoalError(ValueError):
    """A goal that is not taken, and by which code its sender is told."""

    def __init__(self, code: GoalCode, text: str) -> None:
        super().__init__(text)
        self.code = code


def goal_arguments(
    name: str,
    trajectory: Any,
    path_tolerance: Sequence[Any] = (),
    goal_tolerance: Sequence[Any] = (),
    goal_time: Any = None,
) -> dict[str, Any]:
    """Return the arguments of the request `follow` for messages of ROS.

    Parameters
    ----------
    name : str
        Name of the goal.
    trajectory : object
        A `trajectory_msgs/msg/JointTrajectory`.
    path_tolerance, goal_tolerance : sequence of object
        Messages `control_msgs/msg/JointTolerance`.
    goal_time : object, optional
        A `builtin_interfaces/msg/Duration`.
    """
    points = trajectory.points
    return {
        'goal': name,
        'joint': list(trajectory.joint_names),
        'start': stamp_of(trajectory.header.stamp),
        'time': [stamp_of(point.time_from_start) for point in points],
        'position': [list(point.positions) for point in points],
        'velocity': [list(point.velocities) for point in points],
        'acceleration': [list(point.accelerations) for point in points],
        'effort': any(len(point.effort) for point in points),
        'path_tolerance': _tolerances(path_tolerance),
        'goal_tolerance': _tolerances(goal_tolerance),
        'goal_time': 0 if goal_time is None else stamp_of(goal_time),
    }


def _tolerances(items: Sequence[Any]) -> list[list[Any]]:
    return [[item.name, item.position, item.velocity, item.acceleration] for item in items]


@dataclass(frozen=True, eq=False)
class Tolerance:
    """Largest distances [m] and differences of velocity [m/s] of joints; infinite where none."""

    position: Floats
    velocity: Floats

    def breach(self, joints: Sequence[str], position: Floats, velocity: Floats) -> str:
        """Say which joint is off by more, and by how much; empty if none is."""
        for what, unit, found, most in (
            ('position', 'mm', position, self.position),
            ('velocity', 'mm/s', velocity, self.velocity),
        ):
            over = (most < np.inf) & ~(np.abs(found) <= most)  # also where nobody measures
            if over.any():
                first = int(np.flatnonzero(over)[0])
                return (
                    f'{what} of {joints[first]}: expected within {1e3 * most[first]:g} {unit} of '
                    f'the trajectory but found it {1e3 * abs(found[first]):.4g} {unit} off'
                )
        return ''


@dataclass(frozen=True, eq=False)
class Goal:
    """A trajectory that joints shall follow.

    Attributes
    ----------
    name : str
        Name of the goal.
    start : int
        When it shall begin [ns]; 0 is at once.
    column : tuple of int
        Places of its joints among all joints.
    time : ndarray, shape (n,)
        When its points are passed, from its start [s].
    position : ndarray, shape (n, joints)
        Its points [m].
    velocity, acceleration : ndarray, shape (n, joints), or None
        Those at its points [m/s, m/s^2].
    path_tolerance, goal_tolerance : Tolerance
        What is allowed on the way and at the end.
    goal_time : int
        Time after the end in which the joints must be there [ns].
    """

    name: str
    start: int
    column: tuple[int, ...]
    time: Floats
    position: Floats
    velocity: Floats | None
    acceleration: Floats | None
    path_tolerance: Tolerance
    goal_tolerance: Tolerance
    goal_time: int

    @classmethod
    def of(cls, arguments: Mapping[str, Any], config: JointTrajectoryBridgeConfig) -> 'Goal':
        """Return the goal that the arguments of a request mean.

        Raises
        ------
        GoalError
            If they mean none.
        """
        joints = _joints(arguments['joint'], config.joint_names)
        column = tuple(config.joint_names.index(name) for name in joints)
        time = _time(arguments['time'], config.duration_max)
        if arguments.get('effort'):
            raise _invalid('effort: expected none, since axes are led by position, but found some')
        known = {name: _values(name, arguments[name], len(time), joints) for name in _FIELDS}
        position, velocity = known['position'], known['velocity']
        if position is None:
            raise _invalid('positions: expected those of all points but found none')
        if known['acceleration'] is not None and velocity is None:
            raise _invalid('velocities: expected them beside accelerations but found none')
        if velocity is not None and np.abs(velocity[-1]).max() > STANDING:
            at = int(np.abs(velocity[-1]).argmax())
            raise _invalid(
                f'velocities: expected {joints[at]} at rest at the last point but found '
                f'{1e3 * velocity[-1, at]:g} mm/s'
            )
        goal_time = int(arguments['goal_time'])
        if goal_time < 0:
            raise _invalid(
                f'goal_time_tolerance: expected 0 or more but found {goal_time / SECOND:g} s'
            )
        return cls(
            name=str(arguments['goal']),
            start=int(arguments['start']),
            column=column,
            time=time,
            position=position,
            velocity=velocity,
            acceleration=known['acceleration'],
            path_tolerance=_tolerance('path_tolerance', arguments, joints, config.path_tolerance),
            goal_tolerance=_tolerance('goal_tolerance', arguments, joints, config.goal_tolerance),
            goal_time=goal_time or nanoseconds(config.goal_time),
        )


def _invalid(text: str) -> GoalError:
    return GoalError(GoalCode.INVALID_GOAL, text)


def _joints(found: Sequence[str], known: Sequence[str]) -> tuple[str, ...]:
    """Return the joints of a goal, which must be among those known, each once."""
    text = ''
    unknown = [name for name in found if name not in known]
    if not found:
        text = 'none'
    elif unknown:
        text = ', '.join(unknown)
    elif len(set(found)) != len(found):
        text = f'one twice: {", ".join(found)}'
    if text:
        raise GoalError(
            GoalCode.INVALID_JOINTS,
            f'joint_names: expected names among {", ".join(known)} but found {text}',
        )
    return tuple(found)


def _time(found: Sequence[int], most: float) -> Floats:
    """Return when points are passed [s], rising from 0 or later."""
    if not found:
        raise _invalid('points: expected at least one but found none')
    for number, (before, after) in enumerate(zip([-1, *found[:-1]], found, strict=True)):
        if after <= before:
            expected = '0 s or later' if not number else f'more than {before / SECOND:.9g} s'
            raise _invalid(
                f'time_from_start of point {number}: expected {expected} but found '
                f'{after / SECOND:.9g} s'
            )
    if not 0 < found[-1] <= nanoseconds(most):
        raise _invalid(
            f'time_from_start of the last point: expected more than 0 s, at most {most:g} s '
            f'(parameter duration_max), but found {found[-1] / SECOND:.9g} s'
        )
    return np.array(found, np.float64) / SECOND


def _values(
    name: str, found: Sequence[Sequence[float]], points: int, joints: Sequence[str]
) -> Floats | None:
    """Return what points say of their joints, shape (points, joints); None if none says it."""
    plural = {'position': 'positions', 'velocity': 'velocities'}.get(name, 'accelerations')
    if not any(len(values) for values in found):
        return None
    for number, values in enumerate(found):
        if len(values) != len(joints):
            raise _invalid(
                f'{plural} of point {number}: expected one for each of {", ".join(joints)} but '
                f'found {len(values)}; give them at all points or at none'
            )
    array = np.array(found, np.float64).reshape(points, len(joints))
    plain = (
        np.abs(array) < 1e6
    )  # false for NaN; anything larger is a mix-up, and keeps sums finite
    if not plain.all():
        row, column = np.argwhere(~plain)[0]
        raise _invalid(
            f'{plural} of point {row}: expected a finite number (SI units) for {joints[column]} '
            f'but found {array[row, column]}'
        )
    return array


def _tolerance(
    name: str,
    arguments: Mapping[str, Any],
    joints: Sequence[str],
    default: float,
) -> Tolerance:
    """Return a tolerance of the joints: 0 takes the default, -1 is none."""
    position = np.full(len(joints), default or np.inf)
    velocity = np.full(len(joints), np.inf)
    for joint, *values in arguments[name]:
        if joint not in joints:
            raise GoalError(
                GoalCode.INVALID_JOINTS,
                f'{name}: expected joints of the trajectory, {", ".join(joints)}, but found '
                f'{joint or "one without a name"}',
            )
        for value in values:
            if not (value >= 0.0 or value == -1.0):  # also NaN
                raise _invalid(
                    f'{name} of {joint}: expected more than 0, 0 for the default or -1 for none '
                    f'but found {value}'
                )
        if values[2] > 0.0:
            raise _invalid(
                f'{name} of {joint}: expected none of the acceleration, which is not measured, '
                f'but found {values[2]} m/s^2'
            )
        at = joints.index(joint)
        for array, value in ((position, values[0]), (velocity, values[1])):
            if value:
                array[at] = np.inf if value == -1.0 else value
    return Tolerance(position, velocity)

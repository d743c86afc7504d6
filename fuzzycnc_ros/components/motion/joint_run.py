# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""One trajectory of joints on its way to the machine, part by part, each with a way to rest."""

from dataclasses import dataclass

import numpy as np

from fuzzycnc_ros.components.motion.joint_goal import STANDING, Goal, GoalCode, GoalError
from fuzzycnc_ros.components.motion.joint_trajectory_config import JointTrajectoryBridgeConfig
from fuzzycnc_ros.components.motion.parts import PartsRun, PathHeader
from fuzzycnc_ros.core.feedrate.motion.waypoints import Sampled, SampledCurve, WaypointCurve
from fuzzycnc_ros.core.inputs.trajectory_input import TrajectoryInput, TrajectoryPart
from fuzzycnc_ros.runtime.component import Emission
from fuzzycnc_ros.runtime.records import SECOND, Floats, nanoseconds


@dataclass(frozen=True, eq=False)
class Wanted:
    """Reference of a goal's joints [m], their velocities [m/s], and the next point."""

    position: Floats
    velocity: Floats
    point: int


class JointPath:
    """Path of a goal for axes that rest at a place.

    Parameters
    ----------
    goal : Goal
        The goal.
    place : ndarray, shape (axes,)
        Where the axes are told to be [m].
    config : JointTrajectoryBridgeConfig
        Axes, limits and periods.

    Raises
    ------
    GoalError
        If it begins elsewhere, or passes a limit on its way.
    """

    def __init__(self, goal: Goal, place: Floats, config: JointTrajectoryBridgeConfig) -> None:
        self.goal = goal
        self.axes = tuple(config.axes[column] for column in goal.column)
        self._before = 0 if goal.time[0] == 0.0 else 1  # points that the goal does not have
        origin = place[list(goal.column)]
        self._curve = _curve(goal, origin, self.axes, config.start_tolerance)
        self.sampled = SampledCurve(self._curve, config.period)
        guard = TrajectoryInput(self.axes, origin, config.limits)
        every = self.sampled.samples
        answer = guard.command(
            TrajectoryPart(
                path_id=goal.name or 'goal',
                epoch=1,
                part=0,
                last=True,
                start=nanoseconds(config.period),
                period=config.period,
                committed=len(self.sampled),
                axis=self.axes,
                position=every.position.ravel(),
                velocity=every.velocity.ravel(),
                arc_length=every.arc_length,
            )
        )
        if not answer.accepted:
            found = answer.reason.partition(';')[0]
            raise GoalError(
                GoalCode.INVALID_GOAL, f'{found}; give the trajectory more time, or more points'
            )

    def wanted(self, sample: float) -> Wanted:
        """Return what the goal wants at a sample, which need not be whole."""
        time = np.array([self.sampled.time(sample)])
        position, velocity, _ = self._curve.at(time)
        point = int(self._curve.piece(time)[0]) + 1 - self._before
        return Wanted(position[0], velocity[0], point)


def _curve(goal: Goal, origin: Floats, axes: tuple[str, ...], most: float) -> WaypointCurve:
    """Return the curve from where the axes of a goal rest [m] through its points."""
    time, position = goal.time, goal.position.copy()
    velocity = None if goal.velocity is None else goal.velocity.copy()
    acceleration = goal.acceleration
    if time[0] == 0.0:
        away = np.abs(position[0] - origin)
        if away.max() > most:
            at = int(away.argmax())
            raise GoalError(
                GoalCode.INVALID_GOAL,
                f'point 0 at 0 s: expected {axes[at]} where it is, at {1e3 * origin[at]:.4f} mm, '
                f'but found {1e3 * position[0, at]:.4f} mm; start from joint_states',
            )
        if velocity is not None and np.abs(velocity[0]).max() > STANDING:
            at = int(np.abs(velocity[0]).argmax())
            raise GoalError(
                GoalCode.INVALID_GOAL,
                f'velocities of point 0 at 0 s: expected {axes[at]} at rest but found '
                f'{1e3 * velocity[0, at]:g} mm/s; a trajectory begins at rest',
            )
        position[0] = origin
    else:
        still = np.zeros((1, len(axes)))
        time, position = np.append(0.0, time), np.vstack([origin, position])
        velocity = None if velocity is None else np.vstack([still, velocity])
        acceleration = None if acceleration is None else np.vstack([still, acceleration])
    if velocity is not None:
        velocity[[0, -1]] = 0.0
    return WaypointCurve(time, position, velocity, acceleration)


class JointRun(PartsRun):
    """A goal that is being sent.

    Parameters
    ----------
    path : JointPath
        What is to be followed.
    header : PathHeader
        What its parts say of it.
    config : JointTrajectoryBridgeConfig
        How much is sent how early.
    start : int
        Machine time of the first sample [ns].
    """

    def __init__(
        self, path: JointPath, header: PathHeader, config: JointTrajectoryBridgeConfig, start: int
    ) -> None:
        super().__init__(header, path.axes, config, start)
        self.path = path
        self._acceleration_max = config.acceleration_max
        self._tail: Sampled | None = None
        self.stopped = False
        """True if the last part ends the way before its end."""

    @property
    def goal(self) -> Goal:
        """The goal."""
        return self.path.goal

    def wanted(self, stamp: int) -> Wanted | None:
        """Return what the goal wants at machine time `stamp` [ns]; None if it is not followed."""
        if self.stopped or stamp < self.start:
            return None
        return self.path.wanted((stamp - self.start) / self._period)

    def send(self, stamp: int) -> Emission:
        """Return the next part."""
        sampled = self.path.sampled
        low, high = self._taken, min(self._taken + self._chunk, len(sampled))
        self.complete = high == len(sampled)
        tail = None
        if not self.complete:
            tail = self._tail = sampled.rest_after(high - 1, self._acceleration_max)
        return self._emit(stamp, sampled.part(low, high), tail)

    def stop(self, stamp: int) -> list[Emission]:
        """Return what brings the axes to rest on the way; nothing if all of it is sent."""
        if self.complete:
            return []
        self.complete = self.stopped = True
        return [self._emit(stamp, self._tail, None)] if self._tail is not None else []

    def rest_place(self) -> Floats:
        """Return where the axes of the goal come to rest if it is stopped now [m]."""
        if self.complete or self._tail is None:
            return np.asarray(self.path.sampled.samples.position[-1 if self.part else 0])
        return np.asarray(self._tail.position[-1])

    @property
    def progress(self) -> float:
        """Part of the way that has been sent, 0 to 1."""
        return min(1.0, self._taken / len(self.path.sampled))

    @property
    def length(self) -> float:
        """Duration of the goal [s]."""
        return (len(self.path.sampled) - 1) * self._period / SECOND

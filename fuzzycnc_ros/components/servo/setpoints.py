# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""A trajectory as the axes of a controller follow it, period by period."""

from collections.abc import Sequence

import numpy as np

from fuzzycnc_ros.core.inputs.trajectory_input import (
    TrajectoryInput,
    TrajectoryInputConfig,
    TrajectoryPart,
)
from fuzzycnc_ros.runtime.records import Trajectory


def trajectory_part(part: Trajectory) -> TrajectoryPart:
    """Return a part as a trajectory input takes it."""
    return TrajectoryPart(
        path_id=part.path_id,
        epoch=part.epoch,
        part=part.part,
        last=part.last,
        start=part.start,
        period=part.period,
        committed=part.committed,
        axis=part.axis,
        position=part.position,
        velocity=part.velocity,
        arc_length=part.arc_length,
    )


class TrajectoryFollower:
    """Takes trajectories, which begin where the axes are told to be, and says where to be.

    Parameters
    ----------
    axes : sequence of str
        Names of the axes.
    limits : TrajectoryInputConfig
        What trajectories have to keep.
    """

    def __init__(self, axes: Sequence[str], limits: TrajectoryInputConfig) -> None:
        self._names, self._limits = tuple(axes), limits
        self._epoch = 0
        self._input = TrajectoryInput(self._names, np.zeros(len(self._names)), limits)

    @property
    def input(self) -> TrajectoryInput:
        """The guard that judges every part."""
        return self._input

    @property
    def following(self) -> bool:
        """True while a trajectory is being followed, or is to begin."""
        return self._input.next_time is not None

    def command(self, part: Trajectory, places: Sequence[float], now: int) -> str:
        """Take a part; return why it is refused, or nothing.

        Parameters
        ----------
        part : Trajectory
            The part.
        places : sequence of float
            Where the axes are told to be [m]; a path begins there.
        now : int
            Machine time [ns].
        """
        if part.epoch < self._epoch:
            return f'expected epoch {self._epoch} or higher but found {part.epoch}'
        if not self.following:
            if self._input.sample.position.tolist() != list(places):
                self._input = TrajectoryInput(self._names, np.array(places), self._limits)
            self._input.advance(max(now, self._input.time))
        answer = self._input.command(trajectory_part(part))
        self._epoch = max(self._epoch, self._input.epoch)
        return '' if answer.accepted else answer.reason

    def at(self, stamp: int) -> tuple[list[float], list[float], list[float]]:
        """Return where the axes are to be at a time [ns], how fast, and how they go on from there.

        Returns
        -------
        position, velocity, acceleration : list of float
            Of each axis [m, m/s, m/s^2]; the acceleration is that of the period that begins, in
            which the duty is held.  That of the period before came late by as much: where a path
            starts or turns by an edge of acceleration, an axis was 15 um behind.
        """
        guard = self._input
        while guard.next_time is not None and guard.next_time <= stamp:
            guard.take()
        if stamp > guard.time:
            guard.advance(stamp)
        sample = guard.sample
        return sample.position.tolist(), sample.velocity.tolist(), guard.acceleration.tolist()

    def stop(self) -> None:
        """Give the trajectory up; its parts that are still to come are refused."""
        if self.following:
            self._input.allow(False, 'it was given up')
            self._input.allow(True)

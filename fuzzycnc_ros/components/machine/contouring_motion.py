# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The axes of the simulated machine: they follow a trajectory, period by period, and are judged.

It is a part of `simulated_machine`, which makes the time: it ticks at `next_time` and hands on
what is emitted.
"""

from collections.abc import Iterator
from dataclasses import field, fields
from typing import Any

import numpy as np

from fuzzycnc_ros.components.servo.setpoints import trajectory_part
from fuzzycnc_ros.core.config import Config
from fuzzycnc_ros.core.feedrate.path.contour import PathError
from fuzzycnc_ros.core.inputs.trajectory_input import TrajectoryInput, TrajectoryInputConfig
from fuzzycnc_ros.core.machine.path_loop import ContouringConfig
from fuzzycnc_ros.runtime.component import Emission, Health, Level
from fuzzycnc_ros.runtime.enums import TrajectoryStatus
from fuzzycnc_ros.runtime.records import (
    AxisState,
    ContourError,
    Floats,
    Trajectory,
    TrajectoryState,
    nanoseconds,
)
from fuzzycnc_ros.simulation.motion.contouring_axes import ContouringAxes

MOTION_AXES = ('X', 'Y', 'Z')
"""Axes of the machine that move along paths."""

ERROR_BATCH = 0.1
"""Time of motion that one `contour_error` covers [s]."""

_SETTLED = (1e-7, 1e-6)
"""Distance [m] and velocity [m/s] below which an axis rests."""

_PREFIX = 'axis_'


def axis_param(name: str) -> Any:
    """Make a field `axis_<name>` with default, unit, bounds and text of the contouring machine."""
    item = {item.name: item for item in fields(ContouringConfig)}[name]
    return field(default=item.default, metadata=item.metadata)


def contouring_config(config: Config) -> ContouringConfig:
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


class ContouringMotion:
    """Follow trajectories with the axes of a machine and measure the contour error.

    Parameters
    ----------
    config : ContouringConfig
        Gains, limits and periods of the axes, which rest at 0 at the beginning.
    """

    axes = MOTION_AXES
    """Axes, in the order of all arrays."""
    failure = ''
    """Why a programme of the axes' own failed; they have none."""
    periods = 0
    """Periods of such a programme that are over."""

    def __init__(self, config: ContouringConfig) -> None:
        self._config = config
        self._period = nanoseconds(config.interpolation_period)
        self._input = TrajectoryInput(
            MOTION_AXES,
            np.zeros(len(MOTION_AXES)),
            TrajectoryInputConfig(
                period=config.interpolation_period,
                velocity_max=config.velocity_max,
                acceleration_max=config.acceleration_max,
            ),
        )
        self._axes = ContouringAxes(self._input.sample.position, config)
        self._error = PathError(config.interpolation_period, config.delay)
        self._batch = max(1, round(ERROR_BATCH / config.interpolation_period))
        self._moved: int | None = None  # tick up to which the axes were moved; None at rest
        self._commanded = 0  # when the commanded position last changed
        self._begins = False
        self._path_id = ''  # what is measured
        self._finished = ''
        self._reported: tuple[object, ...] = self._state()

    @property
    def reference(self) -> Floats:
        """Where the axes are told to be, shape (3,) [m]."""
        return self._input.sample.position

    @property
    def busy(self) -> bool:
        """Whether a trajectory is to be followed or the axes do not rest yet."""
        return self._moved is not None or self._input.next_time is not None

    @property
    def following(self) -> bool:
        """Whether a trajectory goes on; these axes always arrive."""
        return self.busy

    @property
    def moving(self) -> bool:
        """Whether the axes move, from the first sample of a trajectory until they rest again."""
        return self._moved is not None

    def place(self, path_id: str) -> float:
        """Return how far along a path the axes were commanded [m]; 0 if it is not followed."""
        place = self._place
        return place if self._input.path_id == path_id and place > 0.0 else 0.0

    def finished(self, path_id: str) -> bool:
        """Whether that path was the last to be followed, to its end, and the axes rest."""
        return not self.busy and self._finished == path_id != ''

    def next_time(self, now: int) -> int | None:
        """Return when the axes want their next tick [ns]; None if they rest and all is told."""
        known = [self._input.next_time]
        if self._moved is not None:
            known.append(self._moved + self._period)
        elif self._state() != self._reported:
            known.append(now + self._period)
        return min((time for time in known if time is not None), default=None)

    def command(self, part: Trajectory) -> None:
        """Take a part of a trajectory; the trajectory input decides whether it is followed."""
        before = self._input.next_time
        answer = self._input.command(trajectory_part(part))
        if answer.accepted and before is None and part.part == 0:
            self._begins = self._input.next_time is not None

    def allow(self, allowed: bool, why: str, now: int) -> None:
        """Say whether the machine may move; if not, the commanded position stands still."""
        if not allowed:
            self._commanded = now
            self._begins = False
        self._input.allow(allowed, why)

    def check(self, move: str) -> None:
        """Refuse a move: the axes have loops of their own.

        Raises
        ------
        ValueError
            Always.
        """
        raise ValueError(f'jobs: expected servo_axes for the move {move!r} but found none')

    def clamp(self) -> None:
        """Do nothing: axes that rest have no periods."""

    def advance(self, time: int) -> None:
        """Move machine time on to `time` [ns] in a tick that is not for the axes."""
        if time > self._input.time:
            self._input.advance(time)

    def tick(self, stamp: int, frame_id: str) -> Iterator[Emission]:
        """Move the axes on by a period, or let them begin; say where they are and what is new.

        Axes that are still on their way to rest when another path begins between two of their
        periods start a new row of periods there.
        """
        if self._moved is not None and stamp == self._moved + self._period:
            self._axes.step(self.reference)
        if self._input.next_time == stamp:
            if self._begins:
                yield from self._flush(self._moved or stamp, frame_id)
                self._error.begin()
                self._begins, self._path_id = False, self._input.path_id
                self._finished = ''
            self._input.take()
            if self._input.status.name == TrajectoryStatus.FINISHED.name:
                self._finished = self._path_id
            self._commanded = self._moved = stamp
        else:
            self.advance(stamp)
        if self._moved is not None:
            self._moved = stamp
            sample = self._input.sample
            self._error.add(sample.position, sample.arc_length, self._axes.position)
            if self._at_rest(stamp):
                self._moved = None
        yield self.state(stamp, frame_id)
        if self._error.pending >= self._batch or self._moved is None:
            yield from self._flush(stamp, frame_id)
        if self._state() != self._reported:
            yield self.report(stamp, frame_id)

    def state(self, stamp: int, frame_id: str) -> Emission:
        """Return where the axes are."""
        return Emission(
            'axis_state',
            AxisState(
                stamp=stamp,
                frame_id=frame_id,
                axis=MOTION_AXES,
                reference=self.reference,
                position=self._axes.position,
                velocity=self._axes.velocity,
            ),
        )

    def report(self, stamp: int, frame_id: str) -> Emission:
        """Return what is made of the trajectory."""
        self._reported = self._state()
        return Emission(
            'trajectory_state',
            TrajectoryState(
                stamp=stamp,
                frame_id=frame_id,
                path_id=self._input.path_id,
                epoch=self._input.epoch,
                part=self._input.part,
                status=int(self._input.status),
                reason=self._input.reason,
                arc_length=self._place,
            ),
        )

    def health(self) -> Health:
        """Report what the axes do and why a part was refused."""
        status, reason = self._input.status, self._input.reason
        poor = status.name in (TrajectoryStatus.STARVED.name, TrajectoryStatus.REFUSED.name)
        position = zip(MOTION_AXES, self._axes.position, strict=True)
        values = {f'position {axis} [mm]': f'{1e3 * place:.4f}' for axis, place in position}
        text = reason or f'{status.name.lower()} {self._input.path_id}'.strip()
        return Health('axes', Level.WARN if poor else Level.OK, text, values)

    @property
    def _place(self) -> float:
        """Commanded place on the newest path [m]; NaN before it begins."""
        return np.nan if self._begins else self._input.sample.arc_length

    def _at_rest(self, stamp: int) -> bool:
        """Whether all that was commanded is over and the axes have arrived."""
        run_out = nanoseconds(self._config.run_out)
        if self._input.next_time is not None or stamp < self._commanded + run_out:
            return False
        distance, velocity = _SETTLED
        away = np.abs(self._axes.position - self.reference).max()
        return bool(away <= distance and np.abs(self._axes.velocity).max() <= velocity)

    def _flush(self, stamp: int, frame_id: str) -> Iterator[Emission]:
        """Yield the contour error of the samples since the last time."""
        found = self._error.take()
        if len(found.distance):
            yield Emission(
                'contour_error',
                ContourError(
                    stamp=stamp,
                    frame_id=frame_id,
                    path_id=self._path_id,
                    period=self._config.interpolation_period,
                    arc_length=found.arc_length,
                    error=found.distance,
                ),
            )

    def _state(self) -> tuple[object, ...]:
        """Return what a change of is reported."""
        read = self._input
        return (read.path_id, read.epoch, read.part, read.status, read.reason)

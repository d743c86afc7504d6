# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The axes of the simulated machine: they follow a trajectory, period by period, and are judged.

Whatever moves them, they are a part of `simulated_machine`, which makes the time: it ticks at
`next_time` and hands on what is emitted.
"""

from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence

import numpy as np

from fuzzycnc_ros.components.servo.setpoints import trajectory_part
from fuzzycnc_ros.core.inputs.trajectory_input import (
    TrajectoryInput,
    TrajectoryInputConfig,
    TrajectoryStatus,
)
from fuzzycnc_ros.core.machine.path_loop import ContouringConfig
from fuzzycnc_ros.runtime.component import Emission, Health, Level
from fuzzycnc_ros.runtime.records import (
    AxisCommand,
    AxisState,
    ContourError,
    Floats,
    Trajectory,
    TrajectoryState,
    nanoseconds,
)
from fuzzycnc_ros.simulation.motion.contour import PathError
from fuzzycnc_ros.simulation.motion.contouring_axes import ContouringAxes

MOTION_AXES = ('X', 'Y', 'Z')
"""Axes of the machine that move along paths."""

ERROR_BATCH = 0.1
"""Time of motion that one `contour_error` covers [s]."""

_SETTLED = (1e-7, 1e-6)
"""Distance [m] and velocity [m/s] below which an axis rests."""


class Axes(ABC):
    """Axes that follow trajectories and have the error of their contour measured.

    Parameters
    ----------
    axes : sequence of str
        Axes, in the order of all arrays.
    period : float
        Time between two ticks of motion [s].
    delay : float
        Time by which the axes lag behind what they are told [s].
    """

    def __init__(self, axes: Sequence[str], period: float, delay: float) -> None:
        self.axes = tuple(axes)
        self._interval, self._period = period, nanoseconds(period)
        self._error = PathError(period, delay)
        self._batch = max(1, round(ERROR_BATCH / period))
        self._path_id = ''  # what is measured
        self._reported: tuple[object, ...] = ()

    @property
    @abstractmethod
    def guard(self) -> TrajectoryInput:
        """The input that judges every part of a trajectory."""

    @property
    @abstractmethod
    def reference(self) -> Floats:
        """Commanded positions of the axes, shape (axes,) [m]; NaN where unknown."""

    @property
    @abstractmethod
    def busy(self) -> bool:
        """True if a motion is to be followed to its end, or the axes do not rest yet."""

    @property
    def following(self) -> bool:
        """True if the motion of the axes goes on; without it, they may never arrive."""
        return self.busy

    @property
    @abstractmethod
    def moving(self) -> bool:
        """True if the axes move or are held by their control."""

    @property
    def tripped(self) -> bool:
        """True if drives keep at zero until a new owner commands them."""
        return False

    @property
    def failure(self) -> str:
        """Why a programme of the axes' own failed; empty if it did not, or they have none."""
        return ''

    @property
    def periods(self) -> int:
        """Periods of such a programme that are over."""
        return 0

    @property
    def arc_length(self) -> float:
        """Commanded place on the newest path [m]; NaN before it begins."""
        return self.guard.sample.arc_length

    def place(self, path_id: str) -> float:
        """Return how far along a path the axes were commanded [m]; 0 if it is not followed."""
        place = self.arc_length
        return place if self.guard.path_id == path_id and place > 0.0 else 0.0

    @abstractmethod
    def finished(self, path_id: str) -> bool:
        """Return True if that path was the last to be followed, to its end, and the axes rest."""

    @abstractmethod
    def next_time(self, now: int) -> int | None:
        """Return when the axes want their next tick [ns]; None if nothing is to be done."""

    @abstractmethod
    def command(self, part: Trajectory) -> None:
        """Take a part of a trajectory; the trajectory input decides whether it is followed."""

    @abstractmethod
    def drive(self, command: AxisCommand) -> None:
        """Take a command of the drives, if they take any."""

    def go(self, move: str) -> None:
        """Have the axes make one more move, given as `X:-0.05`.

        Raises
        ------
        ValueError
            If they cannot make it.
        """
        self.check(move)

    def check(self, move: str) -> None:
        """Look at a move that is to be made later.

        Raises
        ------
        ValueError
            If the axes cannot make it.
        """
        raise ValueError(f'jobs: expected servo_axes for the move {move!r} but found none')

    @abstractmethod
    def clamp(self) -> None:
        """Clamp the axes where they are until they are needed again."""

    def allow(self, allowed: bool, why: str, now: int) -> None:
        """Say whether the machine may move; if not, the commanded position stands still."""
        self.guard.allow(allowed, why)

    @abstractmethod
    def advance(self, time: int) -> None:
        """Move machine time on to `time` [ns] in a tick that is not for the axes."""

    @abstractmethod
    def tick(self, stamp: int, frame_id: str) -> Iterator[Emission]:
        """Move the axes on by a period; say where they are and what is new."""

    @abstractmethod
    def state(self, stamp: int, frame_id: str) -> Emission:
        """Return where the axes are."""

    @abstractmethod
    def health(self) -> Health:
        """Report what the axes do and why something was refused."""

    def report(self, stamp: int, frame_id: str) -> Emission:
        """Return what is made of the trajectory."""
        guard = self.guard
        self._reported = self._judged()
        return Emission(
            'trajectory_state',
            TrajectoryState(
                stamp=stamp,
                frame_id=frame_id,
                path_id=guard.path_id,
                epoch=guard.epoch,
                part=guard.part,
                status=int(guard.status),
                reason=guard.reason,
                arc_length=self.arc_length,
            ),
        )

    def _judged(self) -> tuple[object, ...]:
        """Return what a change of is reported."""
        guard = self.guard
        return (guard.path_id, guard.epoch, guard.part, guard.status, guard.reason)

    def _begin_path(self, stamp: int, frame_id: str) -> Iterator[Emission]:
        """Measure another path from now on; yield what is left of the one before."""
        yield from self._flush(stamp, frame_id)
        self._error.begin()
        self._path_id = self.guard.path_id

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
                    period=self._interval,
                    arc_length=found.arc_length,
                    error=found.distance,
                ),
            )


class ContouringMotion(Axes):
    """Follow trajectories with the position loops of the machine.

    Parameters
    ----------
    config : ContouringConfig
        Gains, limits and periods of the axes, which rest at 0 at the beginning.
    """

    def __init__(self, config: ContouringConfig) -> None:
        super().__init__(MOTION_AXES, config.interpolation_period, config.delay)
        self._config = config
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
        self._moved: int | None = None  # tick up to which the axes were moved; None at rest
        self._commanded = 0  # when the commanded position last changed
        self._begins = False
        self._finished = ''
        self._reported = self._judged()

    @property
    def guard(self) -> TrajectoryInput:
        """The input that judges every part of a trajectory."""
        return self._input

    @property
    def reference(self) -> Floats:
        """Commanded positions of the axes, shape (3,) [m]."""
        return self._input.sample.position

    @property
    def busy(self) -> bool:
        """True if a trajectory is to be followed or the axes do not rest yet."""
        return self._moved is not None or self._input.next_time is not None

    @property
    def moving(self) -> bool:
        """True while the axes move, from the first sample until they rest again."""
        return self._moved is not None

    @property
    def arc_length(self) -> float:
        """Commanded place on the newest path [m]; NaN before it begins."""
        return np.nan if self._begins else super().arc_length

    def finished(self, path_id: str) -> bool:
        """Return True if that path was the last to be followed, to its end, and the axes rest."""
        return not self.busy and self._finished == path_id != ''

    def next_time(self, now: int) -> int | None:
        """Return when the axes want their next tick [ns]; None if they rest and all is told."""
        known = [self._input.next_time]
        if self._moved is not None:
            known.append(self._moved + self._period)
        elif self._judged() != self._reported:
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
        super().allow(allowed, why, now)

    def drive(self, command: AxisCommand) -> None:
        """Take no notice: the axes have loops of their own."""

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
                yield from self._begin_path(self._moved or stamp, frame_id)
                self._begins, self._finished = False, ''
            self._input.take()
            if self._input.status is TrajectoryStatus.FINISHED:
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
        if self._judged() != self._reported:
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

    def health(self) -> Health:
        """Report what the axes do and why a part was refused."""
        status, reason = self._input.status, self._input.reason
        poor = status in (TrajectoryStatus.STARVED, TrajectoryStatus.REFUSED)
        position = zip(MOTION_AXES, self._axes.position, strict=True)
        values = {f'position {axis} [mm]': f'{1e3 * place:.4f}' for axis, place in position}
        text = reason or f'{status.name.lower()} {self._input.path_id}'.strip()
        return Health('axes', Level.WARN if poor else Level.OK, text, values)

    def _at_rest(self, stamp: int) -> bool:
        """Return True if all that was commanded is over and the axes have arrived."""
        run_out = nanoseconds(self._config.run_out)
        if self._input.next_time is not None or stamp < self._commanded + run_out:
            return False
        distance, velocity = _SETTLED
        away = np.abs(self._axes.position - self.reference).max()
        return bool(away <= distance and np.abs(self._axes.velocity).max() <= velocity)

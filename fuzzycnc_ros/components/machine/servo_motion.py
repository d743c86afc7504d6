# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Driven axes of the simulated machine: read and driven once per control period.

It takes the place of `contouring_motion`: a part of `simulated_machine`, which makes the time.
Where the axes are to be is not known here, but trajectories are judged here too: it is the
machine that says what it lets the axes follow.
"""

from collections.abc import Callable, Iterator, Mapping
from math import isfinite

import numpy as np

from fuzzycnc_ros.components.machine.contouring_motion import ERROR_BATCH
from fuzzycnc_ros.components.machine.servo_drives import ServoDrives
from fuzzycnc_ros.components.machine.servo_moves import ServoMoves
from fuzzycnc_ros.components.machine.simulated_machine_config import SimulatedMachineConfig
from fuzzycnc_ros.components.servo.servo_axes import (
    check_period,
    file_axes,
    parse_axes,
    parse_plants,
)
from fuzzycnc_ros.components.servo.setpoints import ServoLead
from fuzzycnc_ros.core.feedrate.path.contour import PathError
from fuzzycnc_ros.core.inputs.trajectory_input import TrajectoryInputConfig
from fuzzycnc_ros.core.machine.machine_data import AxisData
from fuzzycnc_ros.runtime.component import Emission, Health, Level
from fuzzycnc_ros.runtime.enums import TrajectoryStatus
from fuzzycnc_ros.runtime.records import (
    AxisCommand,
    AxisState,
    ContourError,
    Floats,
    Trajectory,
    TrajectoryState,
    nanoseconds,
)
from fuzzycnc_ros.simulation.servo.axes import AxisPlant

_ARRIVED = 1e-5
"""Distance from the end of a trajectory within which an axis has arrived [m]."""

_END_ROOM = 0.1
"""How far beyond the travel of an axis of a machine file its limit switches are, over it [-]."""


def servo_motion(config: SimulatedMachineConfig, on: Callable[[], bool]) -> 'ServoMotion':
    """Return the driven axes that a configuration describes.

    Parameters
    ----------
    config : SimulatedMachineConfig
        Parameters of the machine.
    on : callable
        Whether the axes are needed when all moves are over; else they are clamped.

    Raises
    ------
    ValueError
        If they do not fit each other.
    """
    if config.duties and not config.jobs:
        raise ValueError(
            'duties: expected none on a machine with servo_axes but no jobs, which say when to '
            f'drive them every {config.axis_interpolation_period:g} s, but found '
            f'{", ".join(config.duties)}'
        )
    travel = (config.servo_travel_low, config.servo_travel_high)
    if not travel[0] < travel[1]:
        raise ValueError(
            f'servo_travel_high: expected more than servo_travel_low = {travel[0]} m but found '
            f'{travel[1]} m'
        )
    axes = parse_axes('servo_axes', config.servo_axes)
    period = config.axis_interpolation_period
    data = file_axes('servo_axes', axes, config.axis_data)
    check_period('axis_interpolation_period', period, data)
    return ServoMotion(
        parse_plants('servo_plant', axes, config.servo_plant, data, period=period),
        ServoMoves(
            tuple(axes),
            config.moves,
            duration=config.move_time,
            tolerance=config.move_tolerance,
        ),
        TrajectoryInputConfig(
            period=period,
            velocity_max=config.axis_velocity_max,
            acceleration_max=config.axis_acceleration_max,
        ),
        travel={axis: _ends(data[axis]) if axis in data else travel for axis in axes},
        silence=config.servo_silence,
        on=on,
    )


def _ends(data: AxisData) -> tuple[float, float]:
    """Return where the limit switches of an axis are [m]."""
    low, high = data.limits.travel_low, data.limits.travel_high
    room = _END_ROOM * (high - low)
    return low - room, high + room


class ServoMotion:
    """Drive axes as commanded and say where they are.

    Parameters
    ----------
    plants : mapping of str to AxisPlant
        Axes by name, of one control period.
    moves : ServoMoves
        What the machine itself asks for.
    limits : TrajectoryInputConfig
        What trajectories have to keep.
    travel : mapping of str to tuple of float
        Ends of the travel of each axis [m].
    silence : float
        Time after the first period from which the feedback is missing [s]; 0 for never.
    on : callable
        Whether the axes are needed when all moves are over.
    """

    def __init__(
        self,
        plants: Mapping[str, AxisPlant],
        moves: ServoMoves,
        limits: TrajectoryInputConfig,
        *,
        travel: Mapping[str, tuple[float, float]],
        silence: float,
        on: Callable[[], bool],
    ) -> None:
        self.axes = tuple(plants)
        self._plants = list(plants.values())
        self._moves, self._on = moves, on
        self._drives = ServoDrives(plants, travel)
        self._lead = ServoLead(self.axes, limits)
        self._period = nanoseconds(limits.period)
        self._per_period = 1.0 / limits.period
        self._silence = round(silence / limits.period)
        self._place = [plant.position for plant in self._plants]  # told for trajectories
        self._error = PathError(limits.period, 0.0)  # the velocity is fed forward
        self._batch = max(1, round(ERROR_BATCH / limits.period))
        self._path_id = ''  # what is measured
        self._reading = [plant.measure() for plant in self._plants]
        self._speed = [0.0] * len(self._plants)
        self._last: int | None = None  # newest period; None while clamped
        self._clamping = False
        self._count = 0
        self._reported = self._state()

    @property
    def reference(self) -> Floats:
        """Where the axes are told to be, shape (axes,) [m]; NaN during a move."""
        if not self._moves.over:
            return np.full(len(self.axes), np.nan)
        return np.array(self._place)

    @property
    def busy(self) -> bool:
        """Whether moves are being made or a trajectory is to be followed to its end."""
        return self.following or not self._arrived()

    @property
    def following(self) -> bool:
        """Whether moves are being made or a trajectory goes on."""
        return not self._moves.over or self._lead.following

    @property
    def moving(self) -> bool:
        """Whether the axes are under control."""
        return not self._moves.over or self._on()

    @property
    def tripped(self) -> bool:
        """Whether the drives keep at zero until a new owner commands them."""
        return bool(self._drives.tripped)

    @property
    def periods(self) -> int:
        """Control periods of the moves that are over."""
        return min(self._count, self._moves.duration // self._period)

    @property
    def failure(self) -> str:
        """Which move did not arrive; empty if none."""
        return self._moves.failure

    def place(self, path_id: str) -> float:
        """Return how far along a path the axes were commanded [m]; 0 if it is not followed."""
        guard = self._lead.input
        way = guard.sample.arc_length
        return way if guard.path_id == path_id and way > 0.0 else 0.0

    def finished(self, path_id: str) -> bool:
        """Whether that path was the last to be followed, to its end, and the axes rest."""
        guard = self._lead.input
        done = guard.status.name == TrajectoryStatus.FINISHED.name
        return not self.busy and done and guard.path_id == path_id != ''

    def next_time(self, now: int) -> int | None:
        """Return when the axes want their next tick [ns]; None if nobody needs them."""
        if not (self.moving or self._clamping):
            return None
        return (now if self._last is None else self._last) + self._period

    def drive(self, command: AxisCommand) -> None:
        """Take a command of the drives; they decide whether it is followed."""
        self._drives.command(command)

    def go(self, move: str) -> None:
        """Have the axes make one more move, given as `X:-0.05`."""
        self._moves.add(move)

    def check(self, move: str) -> None:
        """Look at a move that is to be made later.

        Raises
        ------
        ValueError
            If it does not name axes and numbers.
        """
        self._moves.parsed(move)

    def clamp(self) -> None:
        """Clamp the axes where they are, a period from now, until they are needed again.

        An `axis_state` without axes says so; silence alone would be a fault of the feedback.
        """
        self._clamping = True

    def command(self, part: Trajectory) -> None:
        """Take a part of a trajectory; the trajectory input decides whether it is followed."""
        if self._moves.over and self._last is not None:
            self._lead.command(part, self._place, self._last)

    def allow(self, allowed: bool, why: str, now: int) -> None:
        """Say whether the machine may move; if not, its drives are at zero."""
        self._drives.allow(allowed, why)
        self._lead.input.allow(allowed, why)

    def advance(self, time: int) -> None:
        """Do nothing in a tick that is not for the axes."""

    def tick(self, stamp: int, frame_id: str) -> Iterator[Emission]:
        """Hold the duties over the period that ends now; read the axes and tell."""
        if self._last is not None:
            for plant, duty in zip(
                self._plants, self._drives.duties(self._last, stamp), strict=True
            ):
                plant.drive(duty)
        if self._clamping:
            self._clamping, self._last = False, None
            yield from self._flush(stamp, frame_id)
            yield self.state(stamp, frame_id)
            return
        resumed = self._last is None and self._count > 0
        self._last = stamp
        self._count += 1
        for index, plant in enumerate(self._plants):
            before, reading = self._reading[index], plant.measure()
            self._reading[index] = reading
            self._speed[index] = (reading - before) * self._per_period
        if resumed:  # they are taken over where they are found
            self._place = list(self._reading)
            self._speed = [0.0] * len(self._plants)
        move = self._moves.next(stamp, frame_id, dict(zip(self.axes, self._reading, strict=True)))
        if move is not None:
            yield Emission('position_command', move)
            goals = dict(zip(move.axis, move.position.tolist(), strict=True))
            self._place = [
                goals.get(name, old) for name, old in zip(self.axes, self._place, strict=True)
            ]
        if self._lead.following:
            if self._drives.reason:
                self._lead.input.allow(False, self._drives.reason)
                self._lead.input.allow(True)
            self._place = self._lead.at(stamp)[0]
        yield from self._judge_path(stamp, frame_id)
        if not self._silence or self._count <= self._silence:
            yield self.state(stamp, frame_id)
        if self._state() != self._reported:
            yield self.report(stamp, frame_id)

    def _judge_path(self, stamp: int, frame_id: str) -> Iterator[Emission]:
        """Measure how far the slides are off the path, from its first sample until they rest."""
        guard = self._lead.input
        begun = guard.sample.arc_length == guard.sample.arc_length
        if guard.path_id != self._path_id and begun:
            yield from self._flush(stamp, frame_id)
            self._error.begin()
            self._path_id = guard.path_id
        off = not self._moves.over or not self.busy
        if not self._path_id or off:
            yield from self._flush(stamp, frame_id)
            return
        if begun:
            places = [plant.position for plant in self._plants]
            self._error.add(self._place, guard.sample.arc_length, places)
        if self._error.pending >= self._batch:
            yield from self._flush(stamp, frame_id)

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
                    period=1.0 / self._per_period,
                    arc_length=found.arc_length,
                    error=found.distance,
                ),
            )

    def state(self, stamp: int, frame_id: str) -> Emission:
        """Return where the axes are; what the sensor of an axis does not give is NaN.

        Clamped axes are none that could be driven.
        """
        driven = slice(None) if self._last is not None else slice(0)
        return Emission(
            'axis_state',
            AxisState(
                stamp=stamp,
                frame_id=frame_id,
                axis=self.axes[driven],
                reference=self.reference[driven],
                position=np.array(self._reading)[driven],
                velocity=np.array(self._speed)[driven],
            ),
        )

    def report(self, stamp: int, frame_id: str) -> Emission:
        """Return what is made of the trajectory."""
        guard = self._lead.input
        self._reported = self._state()
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
                arc_length=guard.sample.arc_length,
            ),
        )

    def health(self) -> Health:
        """Report where the axes are and why the drives are at zero."""
        values = {
            f'position {name} [mm]': f'{1e3 * place:.4f}'
            for name, place in zip(self.axes, self._reading, strict=True)
        }
        values['late commands'] = str(self._drives.late)
        poor = self._drives.reason or self._lead.input.reason
        return Health('axes', Level.WARN if poor else Level.OK, poor or 'driven', values)

    def _arrived(self) -> bool:
        """Whether the axes read where a trajectory has left them."""
        if not self._lead.input.path_id:
            return True
        return all(
            isfinite(reading) and abs(reading - place) <= _ARRIVED
            for reading, place in zip(self._reading, self._place, strict=True)
        )

    def _state(self) -> tuple[object, ...]:
        """Return what a change of is reported."""
        guard = self._lead.input
        return (guard.path_id, guard.epoch, guard.part, guard.status, guard.reason)

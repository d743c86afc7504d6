# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Driven axes of the simulated machine: read and driven once per control period.

Where the axes are to be is not known here, but trajectories are judged here too: it is the
machine that says what it lets the axes follow, and its drives do, whatever they are told.
"""

from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from math import isfinite

import numpy as np

from fuzzycnc_ros.components.machine.machine_axes import Axes
from fuzzycnc_ros.components.machine.simulated_machine_config import SimulatedMachineConfig
from fuzzycnc_ros.components.servo.servo_axes import (
    check_period,
    file_axes,
    parse_axes,
    parse_plants,
)
from fuzzycnc_ros.components.servo.setpoints import TrajectoryFollower
from fuzzycnc_ros.core.inputs.trajectory_input import (
    TrajectoryInput,
    TrajectoryInputConfig,
    TrajectoryStatus,
)
from fuzzycnc_ros.core.machine.machine_data import AxisData
from fuzzycnc_ros.core.servo.axis import velocity_lag
from fuzzycnc_ros.runtime.component import Emission, Health, Level
from fuzzycnc_ros.runtime.records import (
    AxisCommand,
    AxisState,
    Floats,
    PositionCommand,
    Trajectory,
    nanoseconds,
)
from fuzzycnc_ros.simulation.servo.axes import SimulatedAxis

_ARRIVED = 1e-5
"""Distance from the end of a trajectory within which an axis has arrived [m]."""

_END_ROOM = 0.1
"""Distance of the limit switches beyond the travel of an axis of a machine file, over it [-]."""


class ServoMoves:
    """Positions of axes, commanded one after the other, each with its time.

    Parameters
    ----------
    axes : sequence of str
        Axes that there are.
    config : SimulatedMachineConfig
        Targets [m] as `X:-0.05`, of several axes as `X:-0.05,Y:0.01`; time of each, and how near
        an axis has to read at its end.

    Attributes
    ----------
    failure : str
        Which move did not arrive; empty if none.

    Raises
    ------
    ValueError
        If a move does not name axes and numbers.
    """

    def __init__(self, axes: Sequence[str], config: SimulatedMachineConfig) -> None:
        self._axes = tuple(axes)
        self._waiting = deque(self.parsed(text) for text in config.moves)
        self._duration = nanoseconds(config.move_time)
        self._given = len(self._waiting) * self._duration
        self._tolerance = config.move_tolerance
        self._number = 0
        self._move: dict[str, float] = {}  # the one that is being made
        self._until = 0
        self.failure = ''

    @property
    def duration(self) -> int:
        """Time of all moves that were given at the beginning [ns]."""
        return self._given

    @property
    def over(self) -> bool:
        """True if the time of the last one is over."""
        return not (self._move or self._waiting)

    def add(self, text: str) -> None:
        """Have one more move follow.

        Raises
        ------
        ValueError
            If it does not name axes and numbers.
        """
        self._waiting.append(self.parsed(text))

    def next(
        self, stamp: int, frame_id: str, readings: Mapping[str, float]
    ) -> PositionCommand | None:
        """Return the next move if its time has come at a period [ns], and judge the last."""
        if self._move:
            if stamp < self._until:
                return None
            self._judge(self._move, readings)
        self._move = self._waiting.popleft() if self._waiting else {}
        if not self._move:
            return None
        self._number += 1
        self._until = stamp + self._duration
        return PositionCommand(
            stamp=stamp,
            frame_id=frame_id,
            axis=tuple(self._move),
            position=np.array(list(self._move.values())),
            velocity=np.full(len(self._move), np.nan),
        )

    def _judge(self, move: Mapping[str, float], readings: Mapping[str, float]) -> None:
        for name, target in move.items():
            if self.failure or abs(readings[name] - target) <= self._tolerance:
                continue
            self.failure = (
                f'move {self._number}: expected {name} within '
                f'{1e6 * self._tolerance:g} µm of {1e3 * target:g} mm but it reads '
                f'{1e3 * readings[name]:.4f} mm; is servo_controller active?'
            )

    def parsed(self, text: str) -> dict[str, float]:
        """Return the targets [m] of a move by axis.

        Raises
        ------
        ValueError
            If it does not name axes and numbers.
        """
        found: dict[str, float] = {}
        for item in text.split(','):
            name, _, value = item.partition(':')
            try:
                place = float(value)
            except ValueError:
                place = np.nan
            if name not in self._axes or name in found or not np.isfinite(place):
                raise ValueError(
                    f'moves: expected targets in m as X:-0.05 of axes among '
                    f'{", ".join(self._axes) or "none (servo_axes)"} but found {text!r}'
                )
            found[name] = place
        return found


class ServoDrives:
    """Holds the newest command while it is valid, and takes the drives to zero otherwise.

    Parameters
    ----------
    plants : mapping of str to simulated axis
        Axes by name.
    travel : mapping of str to tuple of float
        Ends of the travel of each axis [m].

    Attributes
    ----------
    epoch : int
        Owner of the newest command that was followed; 0 before the first.
    tripped : str
        Why an axis that would have left its travel keeps the drives at zero; empty if none did.
    reason : str
        Why the drives are at zero, or a command was refused; empty if all is well.
    late : int
        Periods that were driven by a command for an earlier one.

    Notes
    -----
    A command is refused if the machine does not allow motion, its epoch is lower than one that
    was followed, its axes are not those of the machine or a duty is not finite.  An axis that
    could not come to rest within its travel with its drive at zero trips the drives: they stay
    at zero until a higher epoch takes over.
    """

    def __init__(
        self, plants: Mapping[str, SimulatedAxis], travel: Mapping[str, tuple[float, float]]
    ) -> None:
        self._names = tuple(plants)
        self._axes = [_Stopping(name, plant, travel[name]) for name, plant in plants.items()]
        self._zero = [0.0] * len(plants)
        self._forbidden = self.tripped = ''
        self._duties: list[float] = self._zero
        self._stamp = self._until = -1
        self.epoch = 0
        self.reason = 'no axis_command yet'
        self.late = 0

    def allow(self, allowed: bool, why: str) -> None:
        """Say whether the machine may move; if not, the drives are at zero at once."""
        self._forbidden = '' if allowed else f'the machine does not allow motion: {why}'
        if not allowed:
            self._stop(self._forbidden)

    def command(self, command: AxisCommand) -> None:
        """Take a command, or refuse it and keep to the last as long as that is valid."""
        refusal = self._forbidden or self._refused(command.epoch, command.axis)
        duties = command.duty.tolist()
        if not refusal and not (len(duties) == len(command.axis) and all(map(_is_duty, duties))):
            refusal = f'duty: expected one within -1 to 1 per axis but found {duties}'
        if refusal:
            self.reason = refusal
            return
        self.epoch, self.tripped, self.reason = command.epoch, '', ''
        given = dict(zip(command.axis, duties, strict=True))
        self._duties = [given.get(name, 0.0) for name in self._names]
        self._stamp, self._until = command.stamp, command.valid_until

    def duties(self, begin: int, end: int) -> Sequence[float]:
        """Return the duties [-] over a period between two times [ns]."""
        rests = [axis.rest() for axis in self._axes]
        if self._until < 0 or self.tripped:
            return self._zero
        for axis, rest in zip(self._axes, rests, strict=True):
            if not axis.low <= rest <= axis.high:
                self.tripped = (
                    f'{axis.name} would leave its travel of {1e3 * axis.low:g} to '
                    f'{1e3 * axis.high:g} mm; drives at zero until a new owner commands'
                )
                self._stop(self.tripped)
                return self._zero
        if end > self._until:
            self._stop(f'axis_command of epoch {self.epoch} is out of date; drives at zero')
            return self._zero
        if self._stamp < begin:
            self.late += 1
        return self._duties

    def _stop(self, reason: str) -> None:
        self.reason = reason
        self._duties, self._until = self._zero, -1

    def _refused(self, epoch: int, axes: Sequence[str]) -> str:
        if epoch < max(self.epoch, 1):
            return f'expected epoch {max(self.epoch, 1)} or higher but found {epoch}'
        if self.tripped and epoch == self.epoch:
            return self.tripped
        if len(set(axes)) != len(axes) or not set(axes) <= set(self._names):
            return f'axis: expected {", ".join(self._names)} but found {", ".join(axes)}'
        return ''


class _Stopping:
    """Stopping place of an axis whose drive goes to zero now: limit switches know no sensor."""

    def __init__(self, name: str, plant: SimulatedAxis, travel: tuple[float, float]) -> None:
        model = plant.config.linear()
        self.name = name
        self.low, self.high = travel
        self._plant = plant
        self._coasting = model.lag + model.period
        # what the drive has in store accelerates the axis on
        self._growth = (model.lag - velocity_lag(model)) / model.period + 2.0
        self._speed = 0.0

    def rest(self) -> float:
        """Return the position [m]; to be asked once per period."""
        speed = self._plant.velocity
        gain, self._speed = speed - self._speed, speed
        if gain * speed > 0.0:
            speed += gain * self._growth
        return self._plant.position + speed * self._coasting


def _is_duty(value: float) -> bool:
    return -1.0 <= value <= 1.0  # false for NaN


class ServoMotion(Axes):
    """Drive axes as commanded and say where they are.

    Parameters
    ----------
    config : SimulatedMachineConfig
        Parameters of the machine.
    on : callable
        Whether the axes are needed when all moves are over; else they are clamped.

    Raises
    ------
    ValueError
        If the parameters do not fit each other.
    """

    def __init__(self, config: SimulatedMachineConfig, on: Callable[[], bool]) -> None:
        if config.duties and not config.jobs:
            raise ValueError(
                'duties: expected none on a machine with servo_axes but no jobs, which say when '
                f'to drive them every {config.axis_interpolation_period:g} s, but found '
                f'{", ".join(config.duties)}'
            )
        ends = (config.servo_travel_low, config.servo_travel_high)
        if not ends[0] < ends[1]:
            raise ValueError(
                f'servo_travel_high: expected more than servo_travel_low = {ends[0]} m but found '
                f'{ends[1]} m'
            )
        axes = parse_axes('servo_axes', config.servo_axes)
        period = config.axis_interpolation_period
        super().__init__(tuple(axes), period, 0.0)  # the velocity is fed forward
        data = file_axes('servo_axes', axes, config.axis_data)
        check_period('axis_interpolation_period', period, data)
        plants = parse_plants('servo_plant', axes, config.servo_plant, data, period=period)
        travel = {axis: _ends(data[axis]) if axis in data else ends for axis in axes}
        limits = TrajectoryInputConfig(
            period=period,
            velocity_max=config.axis_velocity_max,
            acceleration_max=config.axis_acceleration_max,
        )
        self._plants = list(plants.values())
        self._moves, self._on = ServoMoves(self.axes, config), on
        self._drives = ServoDrives(plants, travel)
        self._lead = TrajectoryFollower(self.axes, limits)
        self._per_period = 1.0 / period
        self._silence = round(config.servo_silence / period)
        self._place = [plant.position for plant in self._plants]  # told for trajectories
        self._reading = [plant.measure() for plant in self._plants]
        self._speed = [0.0] * len(self._plants)
        self._last: int | None = None  # newest period; None while clamped
        self._clamping = False
        self._count = 0
        self._reported = self._judged()

    @property
    def guard(self) -> TrajectoryInput:
        """The input that judges every part of a trajectory."""
        return self._lead.input

    @property
    def reference(self) -> Floats:
        """Commanded positions of the axes, shape (axes,) [m]; NaN during a move."""
        if not self._moves.over:
            return np.full(len(self.axes), np.nan)
        return np.array(self._place)

    @property
    def busy(self) -> bool:
        """True if moves are being made or a trajectory is to be followed to its end."""
        return self.following or not self._arrived()

    @property
    def following(self) -> bool:
        """True if moves are being made or a trajectory goes on."""
        return not self._moves.over or self._lead.following

    @property
    def moving(self) -> bool:
        """True if the axes are under control."""
        return not self._moves.over or self._on()

    @property
    def tripped(self) -> bool:
        """True if the drives keep at zero until a new owner commands them."""
        return bool(self._drives.tripped)

    @property
    def periods(self) -> int:
        """Control periods of the moves that are over."""
        return min(self._count, self._moves.duration // self._period)

    @property
    def failure(self) -> str:
        """Which move did not arrive; empty if none."""
        return self._moves.failure

    def finished(self, path_id: str) -> bool:
        """Return True if that path was the last to be followed, to its end, and the axes rest."""
        done = self.guard.status is TrajectoryStatus.FINISHED
        return not self.busy and done and self.guard.path_id == path_id != ''

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
        super().allow(allowed, why, now)

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
                self.guard.allow(False, self._drives.reason)
                self.guard.allow(True)
            self._place = self._lead.at(stamp)[0]
        yield from self._judge_path(stamp, frame_id)
        if not self._silence or self._count <= self._silence:
            yield self.state(stamp, frame_id)
        if self._judged() != self._reported:
            yield self.report(stamp, frame_id)

    def _judge_path(self, stamp: int, frame_id: str) -> Iterator[Emission]:
        """Measure how far the slides are off the path, from its first sample until they rest."""
        begun = self.arc_length == self.arc_length
        if self.guard.path_id != self._path_id and begun:
            yield from self._begin_path(stamp, frame_id)
        off = not self._moves.over or not self.busy
        if not self._path_id or off:
            yield from self._flush(stamp, frame_id)
            return
        if begun:
            places = [plant.position for plant in self._plants]
            self._error.add(self._place, self.arc_length, places)
        if self._error.pending >= self._batch:
            yield from self._flush(stamp, frame_id)

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

    def health(self) -> Health:
        """Report where the axes are and why the drives are at zero."""
        values = {
            f'position {name} [mm]': f'{1e3 * place:.4f}'
            for name, place in zip(self.axes, self._reading, strict=True)
        }
        values['late commands'] = str(self._drives.late)
        poor = self._drives.reason or self.guard.reason
        return Health('axes', Level.WARN if poor else Level.OK, poor or 'driven', values)

    def _arrived(self) -> bool:
        """Return True if the axes read where a trajectory has left them."""
        if not self.guard.path_id:
            return True
        return all(
            isfinite(reading) and abs(reading - place) <= _ARRIVED
            for reading, place in zip(self._reading, self._place, strict=True)
        )


def _ends(data: AxisData) -> tuple[float, float]:
    """Return where the limit switches of an axis are [m]."""
    low, high = data.limits.travel_low, data.limits.travel_high
    room = _END_ROOM * (high - low)
    return low - room, high + room

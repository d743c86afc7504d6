# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Component `servo_controller`: where the axes are in, what their drives shall do out.

Every axis state is a control period and is answered by a command.  A state that does not come in
time is bridged by what the controllers expect while the drives hold the last command; too long a
silence, feedback that cannot be right, motion that does not fit the duties or a fault of the
machine are a fault: all duties stay zero until the component is activated anew.  Axes hold where
they are found, go to commanded positions, or follow a trajectory.  An axis state without axes says
that the machine has clamped them: no period is missed until it drives them again.
"""

from collections.abc import Iterator, Mapping
from math import nan
from typing import Any

import numpy as np

from fuzzycnc_ros.components.servo.servo_axis import ServoAxis
from fuzzycnc_ros.components.servo.servo_controller_config import (
    ServoControllerConfig,
    make_controllers,
    motion_doubt,
    profile_limits,
    trajectory_limits,
)
from fuzzycnc_ros.components.servo.servo_trial import ServoTrials
from fuzzycnc_ros.components.servo.setpoints import TrajectoryFollower
from fuzzycnc_ros.runtime.component import (
    Answer,
    Component,
    Emission,
    Health,
    Input,
    Level,
    Output,
)
from fuzzycnc_ros.runtime.enums import MachineMode, ServoStatus
from fuzzycnc_ros.runtime.records import (
    AxisCommand,
    AxisState,
    MachineState,
    PositionCommand,
    ServoState,
    ServoTrial,
    ServoTrialState,
    Trajectory,
    nanoseconds,
)

TELL_EVERY = 0.05
"""Time between two `servo_state` while nothing happens [s]."""
LATENESS = 0.5
"""Share of a period by which an axis state may be late."""
_MOVING = (MachineMode.ON, MachineMode.RUNNING)


class ServoController(Component[ServoControllerConfig]):
    """Control the positions of the axes of a machine."""

    NAME = 'servo_controller'
    SUMMARY = 'Positions the axes by variable-universe fuzzy control. Managed lifecycle.'
    CONFIG = ServoControllerConfig
    MACHINE = Input('machine_state', MachineState, quiet=True)
    INPUTS = (
        MACHINE,
        Input('position_command', PositionCommand, quiet=True, paced=False),
        Input('trajectory', Trajectory, quiet=True),
        Input('servo_trial', ServoTrial, quiet=True, sole=True, paced=False),
        Input('axis_state', AxisState, driving=True),
    )
    OUTPUTS = (
        Output('axis_command', AxisCommand),
        Output('servo_state', ServoState),
        Output('servo_trial_state', ServoTrialState),
    )
    MANAGED = True

    def __init__(self, config: ServoControllerConfig | None = None) -> None:
        super().__init__(config)
        self._known = self._config.driven
        self._axes = [
            ServoAxis(
                name,
                controller,
                (self._known[name].limits.travel_low, self._known[name].limits.travel_high),
                motion_doubt(self._known[name]),
            )
            for name, controller in make_controllers(self._config).items()
        ]
        self._names = tuple(axis.name for axis in self._axes)
        self._lead = TrajectoryFollower(self._names, trajectory_limits(self._config))
        self._trials = ServoTrials(self._config)
        self._led = False
        self._period = nanoseconds(self._config.period)
        self._tolerance = round(LATENESS * self._period)
        self._validity = nanoseconds(self._config.command_validity)
        self._silence = round(self._config.silence_max / self._config.period)  # periods
        self._active = False
        self._epoch = 0
        self._at: int | None = None  # control period that was worked last
        self._said = 0  # stamp of the newest command
        self._missing = 0  # in a row
        self._missed = 0
        self._fault = ''
        self._forbidden = ''
        self._wanted: PositionCommand | None = None
        self._refusal = ''
        self._told: tuple[object, ...] = ()
        self._told_at = 0

    @property
    def next_deadline(self) -> int | None:
        """Time at which the next axis state is overdue."""
        if self._at is None or not self._active or self._fault:
            return None
        return self._at + self._period + self._tolerance

    def on_machine_state(self, state: MachineState) -> None:
        """Note whether the machine may move; if not, its drives are at zero anyway.

        A fault of the machine that comes up while the axes are driven is one here too.
        """
        modes = {int(mode): mode.name.lower() for mode in MachineMode}
        allowed = state.state in _MOVING
        driven = self._active and self._at is not None and not self._forbidden
        self._forbidden = '' if allowed else f'the machine is {modes.get(state.state, "unknown")}'
        if state.state == MachineMode.FAULT and driven and not self._fault:
            self._give_up('the machine reports a fault and keeps its drives at zero')

    def on_position_command(self, command: PositionCommand) -> None:
        """Take a command for the next period; one that cannot be carried out is not kept."""
        self._refusal = self._refused(command)
        if not self._refusal:
            self._wanted = command

    def on_trajectory(self, part: Trajectory) -> None:
        """Take a part of a trajectory; axes on the way to a position refuse it."""
        if not self._active or self._fault or self._forbidden or self._at is None:
            return  # the machine side says the same
        if self._trials.running and not self._trials.led:
            self._refusal = f'trajectory {part.path_id}: a controller is being tried'
            return
        if any(axis.moving for axis in self._axes) or self._wanted is not None:
            self._refusal = f'trajectory {part.path_id}: the axes are on the way to a position'
            return
        if any(axis.reference != axis.reference for axis in self._axes):
            self._refusal = f'trajectory {part.path_id}: no axis_state since the drives were off'
            return
        places = [axis.reference for axis in self._axes]
        self._refusal = self._lead.command(part, places, self._at)

    def on_servo_trial(self, asked: ServoTrial) -> None:
        """Take a trial of a controller, or its operator's sign of life, for the next period."""
        self._trials.take(asked)

    def renewed(self, step: int) -> 'tuple[ServoController, list[Emission]]':
        """Forget all but the epoch: the machine side believes no lower one."""
        fresh = self._afresh()
        fresh._epoch = self._epoch
        return fresh, []

    def on_axis_state(self, state: AxisState) -> Iterator[Emission]:
        """Answer a control period."""
        yield from self._answer(state)
        if not self._trials.pending:
            return
        readings = dict(zip(state.axis, state.position.tolist(), strict=False))
        machine = self.last(self.MACHINE)
        self._trials.begin(self._axes, readings, machine, self._busy, state.stamp)
        for told in self._trials.told(self.frame('workpiece')):
            yield Emission('servo_trial_state', told)

    def _answer(self, state: AxisState) -> Iterator[Emission]:
        stamp = state.stamp
        if not self._active:
            yield from self._tell(stamp)
            return
        if not state.axis and not self._fault:
            self._begin()
            yield from self._tell(stamp)
            return
        found = dict(zip(state.axis, state.position.tolist(), strict=False))
        readings = [found.get(name, nan) for name in self._names]
        if self._at is None:
            self._epoch = max(stamp, self._epoch + 1)  # stamps may have gone back
        else:
            periods = round((stamp - self._at) / self._period)
            if periods < 1:
                return  # bridged already
            # more than what makes a fault need not be made up for
            for _ in range(min(periods - 1, self._silence + 1)):
                self._at += self._period
                self._miss()
                self._step(None)
        self._at, self._missing = stamp, 0
        yield self._command(stamp, self._step(readings))
        yield from self._tell(stamp)

    def on_deadline(self, stamp: int) -> Iterator[Emission]:
        """Bridge a period whose axis state has not come; the drives hold the last command."""
        if self._at is None:
            return
        self._at += self._period
        self._miss()
        duties = self._step(None)
        if self._fault:
            yield self._command(stamp, duties)
        elif self._forbidden and self._missing > self._silence:
            self._at = None  # drives that are off need no bridging; they are taken over anew
        yield from self._tell(stamp)

    def on_request(self, name: str, arguments: Mapping[str, Any], stamp: int) -> Answer:
        """`activate` (takes the axes over where they are) and `deactivate` (duty zero)."""
        if name == 'activate':
            if self._active:
                return Answer(False, 'already active')
            self._begin()
            self._trials.forget()
            self._missed = 0
            self._active = True
            return Answer(True, 'active: the axes are held where they are found')
        if name == 'deactivate':
            if not self._active:
                return Answer(False, 'not active')
            self._active = False
            self._begin()
            told = self._said > 0
            # one that is not newer than the last would not be heard
            stop = self._command(max(stamp, self._said + 1), [0.0] * len(self._axes))
            return Answer(True, 'inactive: duties are zero', (stop,) if told else ())
        return super().on_request(name, arguments, stamp)

    def health(self) -> list[Health]:
        """Report what the axes do, why they do not, and deadlines that were missed."""
        values = {}
        for axis in self._axes:
            status = axis.controller.status
            values[f'error {axis.name} [um]'] = f'{1e6 * status.error:.2f}'
            values[f'duty {axis.name} [-]'] = f'{status.duty:.4f}'
        if not self._active:
            items = [Health('state', Level.OK, 'inactive')]
        elif self._fault:
            text = f'{self._fault}; activate again when it is mended'
            items = [Health('state', Level.ERROR, text, values)]
        elif self._forbidden:
            items = [Health('state', Level.WARN, f'duties are zero: {self._forbidden}')]
        else:
            text = ServoStatus(self._status).name.lower()
            items = [Health('state', Level.OK, text, values)]
        for axis in self._axes:
            if axis.controller.taken_back:
                why = 'its loop was unstable and has gain taken back: tune it, or identify it anew'
                items.append(Health(f'gain {axis.name}', Level.WARN, why))
        level = Level.WARN if self._missed else Level.OK
        items.append(Health('deadlines', level, f'{self._missed} missed since activation'))
        if self._refusal:
            items.append(Health('command', Level.WARN, self._refusal))
        return items

    @property
    def _status(self) -> ServoStatus:
        if self._fault:
            return ServoStatus.FAULT
        if not self._active or self._forbidden or self._at is None:
            return ServoStatus.INACTIVE
        if self._lead.following:
            return ServoStatus.FOLLOWING
        moving = any(axis.moving for axis in self._axes)
        return ServoStatus.MOVING if moving else ServoStatus.RESTING

    @property
    def _busy(self) -> str:
        """Why no controller may be tried now, as far as it is known here; empty if one may."""
        if not self._active:
            return 'servo_controller: expected an active node but found one that is not'
        if self._fault:
            return f'servo_controller: expected no alarm but found: {self._fault}'
        resting = self._status == ServoStatus.RESTING and self._wanted is None
        known = all(axis.reference == axis.reference for axis in self._axes)
        return '' if resting and known else 'axes: expected all at rest but found them moving'

    def _begin(self) -> None:
        """Start over: nothing is known of where the axes are, and nothing is wrong."""
        self._at = self._wanted = None
        self._fault = self._refusal = ''
        self._missing = 0
        self._release()

    def _release(self) -> None:
        """Let go of the axes; the next reading takes them over anew."""
        self._lead.stop()
        self._trials.give_up('the axes were released', self._at or 0)
        for axis in self._axes:
            axis.release()

    def _miss(self) -> None:
        self._missed += 1
        self._missing += 1

    def _step(self, readings: list[float] | None) -> list[float]:
        """Work one control period, which nothing was heard of without readings [m].

        Returns
        -------
        list of float
            Duties [-].
        """
        zero = [0.0] * len(self._axes)
        if self._fault:
            return zero
        if self._forbidden:
            self._wanted = None
            self._release()
            return zero
        if self._missing > self._silence:
            silent = 1e3 * self._missing * self._config.period
            self._give_up(f'feedback has stopped: no axis_state for {silent:g} ms')
            return zero
        if readings is not None:
            for axis, reading in zip(self._axes, readings, strict=True):
                if axis.reference != axis.reference:
                    axis.hold(reading)
        if self._wanted is not None:
            self._go(self._wanted)
        self._follow()
        if readings is None:
            for axis in self._axes:
                axis.bridge()
        else:
            for axis, reading in zip(self._axes, readings, strict=True):
                axis.step(reading)
        if self._trials.running:
            assert self._at is not None
            found = readings or [nan] * len(self._axes)
            self._trials.judge(self._axes, found, self.last(self.MACHINE), self._at)
        if readings is None:
            return [axis.duty for axis in self._axes]
        for axis in self._axes:
            if axis.fault:
                self._give_up(f'{axis.name}: {axis.fault}')
                return zero
        return [axis.duty for axis in self._axes]

    def _follow(self) -> None:
        """Lead the axes along the trajectory, if there is one."""
        if self._lead.following:
            assert self._at is not None
            for axis, *motion in zip(self._axes, *self._lead.at(self._at), strict=True):
                axis.lead(*motion)
            self._led = True
        elif self._led:
            self._led = False
            for axis in self._axes:
                axis.stop()

    def _give_up(self, why: str) -> None:
        """Take all axes to zero."""
        self._fault = why
        self._wanted = None
        self._lead.stop()
        self._trials.give_up(why, self._at or 0)
        for each in self._axes:
            each.stop()

    def _refused(self, command: PositionCommand) -> str:
        """Say why a position command cannot be carried out; empty if it can."""
        if not self._active or self._fault:
            return 'position_command: expected an active component without fault'
        if self._forbidden:
            return f'position_command: {self._forbidden}'
        if self._lead.following:
            return 'position_command: a trajectory is being followed'
        if self._trials.running:
            return 'position_command: a controller is being tried'
        sizes = {len(command.axis), len(command.position), len(command.velocity)}
        if len(sizes) != 1 or not command.axis:
            return 'position_command: expected one position and velocity per axis'
        if len(set(command.axis)) != len(command.axis):
            return f'axis: expected each name once but found {", ".join(command.axis)}'
        known = {axis.name: axis for axis in self._axes}
        for name, place, speed in _rows(command):
            if name not in known:
                return f'axis: expected {", ".join(known)} but found {name}'
            refusal = known[name].refusal(place, speed)
            if refusal:
                return refusal
        return ''

    def _go(self, command: PositionCommand) -> None:
        """Send the axes off, all of them or none."""
        if any(axis.reference != axis.reference for axis in self._axes):
            return  # no reading has said yet where the axes are
        self._wanted = None
        known = {axis.name: axis for axis in self._axes}
        try:
            ways = {
                name: known[name].way(
                    place, profile_limits(self._config, speed, self._known[name])
                )
                for name, place, speed in _rows(command)
            }
        except ValueError as error:
            self._refusal = str(error)
            return
        for name, way in ways.items():
            known[name].go(way)

    def _command(self, stamp: int, duties: list[float]) -> Emission:
        self._said = stamp
        return Emission(
            'axis_command',
            AxisCommand(
                stamp=stamp,
                frame_id=self.frame('machine'),
                epoch=self._epoch,
                axis=self._names,
                duty=np.array(duties),
                valid_until=stamp + self._validity,
            ),
        )

    def _tell(self, stamp: int) -> Iterator[Emission]:
        """Yield what the controllers do, on a change and now and then."""
        state = (self._status, self._fault, self._forbidden)
        if state == self._told and stamp - self._told_at < nanoseconds(TELL_EVERY):
            return
        self._told, self._told_at = state, stamp
        statuses = [axis.controller.status for axis in self._axes]
        known = self._active and self._at is not None
        yield Emission(
            'servo_state',
            ServoState(
                stamp=stamp,
                frame_id=self.frame('workpiece'),
                epoch=self._epoch,
                status=int(self._status),
                reason=self._fault or (self._forbidden if self._active else ''),
                axis=self._names,
                reference=np.array([axis.reference for axis in self._axes]),
                error=np.array([item.error if known else nan for item in statuses]),
                disturbance=np.array([item.disturbance if known else nan for item in statuses]),
                saturated=np.array([item.saturated for item in statuses]),
                missed=self._missed,
            ),
        )


def _rows(command: PositionCommand) -> Iterator[tuple[str, float, float]]:
    """Yield axis, position [m] and velocity [m/s] of a command."""
    return zip(command.axis, command.position.tolist(), command.velocity.tolist(), strict=True)

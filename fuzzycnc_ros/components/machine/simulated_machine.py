# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Component `simulated_machine`: a mill that heats up, as a machine on topics.

It is the only component that makes time: `tick` moves the machine on.  Whoever hosts it decides
when that happens, a lock-step sequencer or a clock.  Ticks of warmth are long; while the axes
follow a trajectory there are short ones in between, one per interpolation period.
"""

from collections.abc import Iterator, Mapping
from typing import Any

from fuzzycnc_ros.components.machine.machine_axes import Axes, ContouringMotion
from fuzzycnc_ros.components.machine.machine_operator import (
    duty_length,
    machine_operator,
    machine_sheet,
)
from fuzzycnc_ros.components.machine.mill_instruments import Warmth
from fuzzycnc_ros.components.machine.servo_motion import ServoMotion
from fuzzycnc_ros.components.machine.simulated_machine_config import (
    DAY_START,
    MACHINE_DUTIES,
    SimulatedMachineConfig,
    contouring_config,
)
from fuzzycnc_ros.components.machine.stitching import Stitching
from fuzzycnc_ros.runtime.component import (
    LATCHED,
    REQUEST,
    Answer,
    Emission,
    Health,
    Input,
    Level,
    Output,
    TickingComponent,
)
from fuzzycnc_ros.runtime.enums import MachineMode
from fuzzycnc_ros.runtime.records import (
    AxisCommand,
    AxisState,
    CompensatedPath,
    Compensation,
    CompensationApplied,
    ContourError,
    Displacement,
    MachineState,
    Material,
    PositionCommand,
    StitchedPath,
    StitchPattern,
    Temperatures,
    ToolPath,
    Trajectory,
    TrajectoryState,
    nanoseconds,
)
from fuzzycnc_ros.simulation.thermal.duties import Duty, DutyBlock

__all__ = ['DAY', 'WAIT', 'SimulatedMachine', 'SimulatedMachineConfig']

DAY = 24 * 3600.0
"""Time between the starts of two duties [s]: every duty starts from a cold machine."""
TOLD_AGAIN = 30.0
"""Time after which axes that rest during a duty are told again [s]; few need to know."""
WAIT = 0.01
"""Time between two ticks that wait for the trajectory of a path [s]."""

_NO_DUTY = Duty('none', (DutyBlock(0.0, DAY),), base=20.0, amplitude=2.0, phase_hours=0.0)
"""A machine that only follows paths stands in its shop with the spindle at rest."""


class SimulatedMachine(TickingComponent[SimulatedMachineConfig]):
    """Run duties on the simulated mill, apply compensation, follow trajectories, drive axes."""

    NAME = 'simulated_machine'
    SUMMARY = (
        'The simulated mill: temperatures, displacement, state; applies compensation, follows '
        'trajectories, drives axes, stitches soft sheets.'
    )
    CONFIG = SimulatedMachineConfig
    MACHINE_SIDE = True
    INPUTS = (
        Input('compensation', Compensation, sole=True),
        Input('trajectory', Trajectory),
        Input('axis_command', AxisCommand, sole=True),
        Input('compensated_path', CompensatedPath, LATCHED),
    )
    OUTPUTS = (
        Output('machine_state', MachineState),
        Output('compensation_applied', CompensationApplied),
        Output('displacement', Displacement),
        Output('sensor_readings', Temperatures),
        Output('axis_state', AxisState),
        Output('contour_error', ContourError),
        Output('trajectory_state', TrajectoryState),
        Output('tool_path', ToolPath, LATCHED),
        Output('position_command', PositionCommand),
        Output('material', Material, LATCHED),
        Output('stitch_pattern', StitchPattern, LATCHED),
        Output('stitched_path', StitchedPath),
    )

    def __init__(self, config: SimulatedMachineConfig | None = None) -> None:
        super().__init__(config)
        duties = self._config.duties
        self._has_paths = bool(self._config.paths or self._config.patterns or self._config.jobs)
        unknown = [name for name in duties if name not in MACHINE_DUTIES]
        if unknown or not (duties or self._has_paths or self._config.moves):
            raise ValueError(
                f'duties: expected names among {", ".join(MACHINE_DUTIES)} but found '
                f'{", ".join(unknown) or "none, and no paths either"}'
            )
        self._warmth = Warmth(self._config)
        self._stitching = Stitching(machine_sheet(self._config), self._config.sheet_seed)
        self._operator = machine_operator(self._config)
        self._motion: Axes = (
            ServoMotion(self._config, self._axes_needed)
            if self._config.servo_axes or self._config.moves
            else ContouringMotion(contouring_config(self._config))
        )
        for move in self._operator.moves:
            self._motion.check(move)
        self._tick_period = nanoseconds(self._config.tick_period)
        self._run = 0
        self._ticks = 0
        self._time = 0
        self._duty_over = False
        self._duty: Duty = _NO_DUTY
        self._mode = MachineMode.ON
        self._told_mode: MachineMode | None = None
        self._told_again = 0
        self._enter(0)

    @property
    def next_tick(self) -> int | None:
        """Machine time of the next tick [ns]; None when the programme is over."""
        known = (self._slow_tick(), self._fast_tick(), self._job_tick())
        return min((time for time in known if time is not None), default=None)

    @property
    def total_ticks(self) -> int:
        """Number of ticks of the whole programme; where it has paths an estimate."""
        duties = sum(self._duty_ticks(name) for name in self._config.duties)
        period = self._config.axis_interpolation_period
        moves = round(len(self._config.moves) * self._config.move_time / period)
        return duties + moves + self._operator.ticks(period)

    @property
    def ticks_done(self) -> int:
        """Number of `total_ticks` that are over."""
        done = sum(self._duty_ticks(name) for name in self._config.duties[: self._run])
        if not self._duties_done:
            done += self._ticks
            if not self._operator.timed:
                return done
        place = self._motion.place(self._operator.path_id)
        done += self._motion.periods
        return done + self._operator.ticks_done(self._config.axis_interpolation_period, place)

    @property
    def failure(self) -> str:
        """Why the programme was given up; empty if it was not."""
        return self._operator.failure or self._motion.failure or self._stitching.failure

    def on_compensation(self, command: Compensation) -> None:
        """Take an offset command; the offset input decides whether it is followed."""
        self._warmth.command(command)

    def on_trajectory(self, part: Trajectory) -> None:
        """Take a part of a trajectory; the trajectory input decides whether it is followed."""
        self._motion.command(part)

    def on_axis_command(self, command: AxisCommand) -> None:
        """Take a command of the drives; where the machine has its own loops it means nothing."""
        self._motion.drive(command)

    def on_compensated_path(self, path: CompensatedPath) -> None:
        """Take the stitches of a pattern; they are made when the axes follow its tool path."""
        self._stitching.load(path)

    def set_mode(self, mode: MachineMode) -> None:
        """Switch the machine; only in ON it moves, applies offsets and turns its spindle.

        An emergency stop holds the commanded position at once; the path is not taken up again.
        """
        self._mode = mode
        self._permit()

    def on_request(self, name: str, arguments: Mapping[str, Any], stamp: int) -> Answer:
        """Note by `sources` that several nodes command the machine, or one alone again."""
        answer = super().on_request(name, arguments, stamp)
        if name == REQUEST:
            self._permit()
        return answer

    def tick(self) -> Iterator[Emission]:
        """Move on to the next tick and report everything that is measured there.

        Raises
        ------
        RuntimeError
            If the programme is over.
        """
        stamp = self.next_tick
        if stamp is None:
            raise RuntimeError('all duties are done; there is no next tick')
        slow, fast = stamp == self._slow_tick(), stamp == self._fast_tick()
        begins = stamp == self._job_tick()
        self._time = stamp
        if begins:
            self._operator.begin(stamp)
        if slow:
            self._warm(stamp)
        workpiece = self.frame('workpiece')
        moved = list(self._motion.tick(stamp, workpiece)) if fast else []
        if not fast:
            self._motion.advance(stamp)
        mode = self._present_mode()
        if slow or mode is not self._told_mode:
            self._told_mode = mode
            yield Emission('machine_state', self._state(stamp, mode))
        if slow:
            machine, since = self.frame('machine'), stamp - self._start
            yield self._warmth.applied(stamp, machine, self.sources.refusal('compensation'))
            measured = self._config.displacement_compensated
            offset = self._warmth.offsets.at if measured else None
            yield from self._warmth.readings(stamp, since, machine, workpiece, offset)
        yield from moved
        yield from self._stitching.tick(moved, self._motion, workpiece)
        told = {item.output for item in moved}
        if slow and (self._duties_done or stamp >= self._told_again):
            self._told_again = stamp + nanoseconds(TOLD_AGAIN)
            if not self._motion.moving and 'axis_state' not in told:
                yield self._motion.state(stamp, workpiece)
            if 'trajectory_state' not in told:
                yield self._motion.report(stamp, workpiece)
        yield from self._go_on(stamp, slow)

    def health(self) -> list[Health]:
        """Report duty and path, the offsets in force and why a command was refused."""
        duty = 'all duties done' if self._duties_done else f'duty {self._duty.name}'
        found = [
            Health('duty', Level.OK, duty),
            self._warmth.health(),
            self._motion.health(),
            self._stitching.health(),
        ]
        if self.failure:
            found.append(Health('path', Level.ERROR, self.failure))
        elif self._has_paths:
            found.append(Health('path', Level.OK, self._operator.path_id or 'none'))
        return found

    @property
    def _duties_done(self) -> bool:
        return self._run >= len(self._config.duties)

    def _slow_tick(self) -> int | None:
        """Return when warmth is next moved on [ns]; None where nothing warms up any more."""
        if self._duty_over or (self._duties_done and (self._operator.over or not self._has_paths)):
            return None
        return self._start + (self._ticks + 1) * self._tick_period

    def _fast_tick(self) -> int | None:
        """Return when the axes are next moved on, or a trajectory is waited for [ns]."""
        due = self._motion.next_time(self._time)
        if self._operator.waiting and not self._motion.busy:
            wait = self._time + nanoseconds(WAIT)
            return wait if due is None else min(due, wait)
        if due is None and self._told_mode not in (None, self._present_mode()):
            return self._time + nanoseconds(self._config.axis_interpolation_period)
        return due

    def _job_tick(self) -> int | None:
        """Return when the next job of the duty begins [ns]; None if one is under way."""
        due = self._operator.due
        if due is None:
            return None
        soon = self._time + nanoseconds(self._config.axis_interpolation_period)
        return max(self._start + due, soon)

    def _axes_needed(self) -> bool:
        """Return True if driven axes are to be controlled."""
        if self._operator.timed:
            return self._operator.begun
        return self._has_paths and not self._operator.over

    def _warm(self, stamp: int) -> None:
        """Move temperatures and offsets on by a tick period."""
        period = self._config.tick_period
        allowed = self._mode is MachineMode.ON
        begin = self._ticks * period
        speed = self._duty.spindle_speed(begin) if allowed else 0.0
        strokes, since = self._duty.motion(begin) if allowed else ({}, 0.0)
        self._warmth.move(period, strokes, since)
        self._warmth.advance(period, speed)
        self._warmth.follow(stamp, self._motion.axes, self._motion.reference)
        self._ticks += 1

    def _go_on(self, stamp: int, slow: bool) -> Iterator[Emission]:
        """Go on to the next duty or path where the present one is over and the axes rest."""
        if slow and not self._duties_done:
            following = (self._ticks + 1) * self._tick_period
            self._duty_over = following > nanoseconds(duty_length(self._config, self._duty.name))
        if self._motion.busy and not self._operator.failure:
            what = 'the axes do not arrive'
            self._operator.wait(stamp, what, busy=self._motion.following)
        elif self._operator.begun:
            yield from self._work(stamp)
        elif self._duty_over:
            self._enter(self._run + 1)
        elif self._duties_done and self._has_paths and not self._operator.timed:
            done = self._motion.finished(self._operator.path_id)
            if done or (slow and not self._operator.path_id):
                for item in self._operator.load(stamp, self.frame('workpiece')):
                    if isinstance(item.record, Material):
                        self._stitching.clamp(item.record)
                    yield item
            else:
                self._operator.wait(stamp, self._motion.health().message, busy=False)

    def _work(self, stamp: int) -> Iterator[Emission]:
        """Load the job that was begun, or clamp the axes when it is done and they have settled."""
        operator = self._operator
        if not operator.loaded:
            yield from operator.load(stamp, self.frame('workpiece'))
            if operator.move:
                self._motion.go(operator.move)
            return
        done = bool(operator.move) or self._motion.finished(operator.path_id)
        if not done:
            operator.wait(stamp, self._motion.health().message, busy=False)
        if operator.settled(stamp, done=done):
            operator.end()
            self._motion.clamp()

    def _present_mode(self) -> MachineMode:
        """Return the operating state; a program runs where the spindle or the axes do."""
        if self._mode is not MachineMode.ON:
            return self._mode
        if self._motion.tripped or self.sources.refusal('axis_command'):
            return MachineMode.FAULT
        running = self._warmth.working or self._motion.moving
        return MachineMode.RUNNING if running else MachineMode.ON

    def _permit(self) -> None:
        """Follow commands in ON alone, and only where they have one source."""
        off = '' if self._mode is MachineMode.ON else self._mode.name.lower()
        offsets = off or self.sources.refusal('compensation')
        axes = off or self.sources.refusal('axis_command')
        self._warmth.offsets.allow(not offsets, offsets)
        self._motion.allow(not axes, axes, self._time)
        if axes:
            self._stitching.drop(axes)

    def _state(self, stamp: int, mode: MachineMode) -> MachineState:
        return MachineState(
            stamp=stamp,
            frame_id=self.frame('machine'),
            state=int(mode),
            homed=True,
            offsets_allowed=self._mode is MachineMode.ON
            and not self.sources.refusal('compensation'),
            cold_since=self._start,
            spindle_speed=self._warmth.spindle_speed,
            **self._warmth.where(self._motion.axes, self._motion.reference),
        )

    def _duty_ticks(self, duty: str) -> int:
        """Return the number of ticks of a duty."""
        return nanoseconds(duty_length(self._config, duty)) // self._tick_period

    def _enter(self, run: int) -> None:
        """Set the machine up, cold, for one duty of the programme; paths follow on the last."""
        self._run, self._duty_over = run, False
        self._duty = _NO_DUTY if self._duties_done else MACHINE_DUTIES[self._config.duties[run]]
        if run and self._duties_done:
            return
        self._ticks = 0
        self._start = self._time = nanoseconds(DAY_START + run * DAY)
        self._warmth.begin(self._duty, run)

# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Component `simulated_machine`: the thermal mill of method sheet 001 as a machine on topics.

It is the only component that makes time: `tick` moves the machine on.  Whoever hosts it decides
when that happens, a lock-step sequencer or a clock.  Ticks of warmth are long; while the axes
follow a trajectory there are short ones in between, one per interpolation period.
"""

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from fuzzycnc_ros.components.codes import MachineMode
from fuzzycnc_ros.components.command_sources import REQUEST, CommandSources
from fuzzycnc_ros.components.component import (
    LATCHED,
    Answer,
    Component,
    Emission,
    Health,
    Input,
    Level,
    Output,
)
from fuzzycnc_ros.components.contouring_motion import (
    ContouringMotion,
    contouring_config,
)
from fuzzycnc_ros.components.machine_programme import machine_programme, machine_sheet
from fuzzycnc_ros.components.records import (
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
from fuzzycnc_ros.components.servo_motion import ServoMotion, servo_motion
from fuzzycnc_ros.components.simulated_machine_config import SimulatedMachineConfig
from fuzzycnc_ros.components.stitching import Stitching
from fuzzycnc_ros.core.machine.duties import DUTIES, Duty, DutyBlock
from fuzzycnc_ros.core.machine.mill import DISPLACEMENT_NOISE, MILL_AXES, MILL_SENSORS, ThermalMill
from fuzzycnc_ros.core.machine.offset_input import OffsetInput, OffsetInputConfig
from fuzzycnc_ros.core.machine.sensor_faults import parse_sensor_fault

__all__ = ['DAY', 'DAY_START', 'WAIT', 'SimulatedMachine', 'SimulatedMachineConfig']

DAY_START = 6 * 3600.0
"""Machine time at which the first duty starts [s]: six in the morning of day one."""
DAY = 24 * 3600.0
"""Time between the starts of two duties [s]: every duty starts from a cold machine."""
TOLD_AGAIN = 30.0
"""Time after which axes that rest during a duty are told again [s]; few need to know."""
WAIT = 0.01
"""Time between two ticks that wait for the trajectory of a path [s]."""

_NO_DUTY = Duty('none', (DutyBlock(0.0, DAY),), base=20.0, amplitude=2.0, phase_hours=0.0)
"""A machine that only follows paths stands in its shop with the spindle at rest."""


class SimulatedMachine(Component):
    """Run duties on the simulated mill, apply compensation, follow trajectories, drive axes."""

    NAME = 'simulated_machine'
    SUMMARY = (
        'The simulated mill: temperatures, displacement, state; applies compensation, follows '
        'trajectories, drives axes, stitches soft sheets.'
    )
    CONFIG = SimulatedMachineConfig
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
    _config: SimulatedMachineConfig

    def __init__(self, config: SimulatedMachineConfig | None = None) -> None:
        super().__init__(config)
        duties = self._config.duties
        self._has_paths = bool(self._config.paths or self._config.patterns)
        unknown = [name for name in duties if name not in DUTIES]
        if unknown or not (duties or self._has_paths or self._config.moves):
            raise ValueError(
                f'duties: expected names among {", ".join(DUTIES)} but found '
                f'{", ".join(unknown) or "none, and no paths either"}'
            )
        self._faults = tuple(parse_sensor_fault(text) for text in self._config.sensor_faults)
        self._offsets = OffsetInput(
            MILL_AXES,
            OffsetInputConfig(offset_max=self._config.offset_max, slew_max=self._config.slew_max),
        )
        self._stitching = Stitching(machine_sheet(self._config), self._config.sheet_seed)
        self._paths = machine_programme(self._config)
        self._motion: ContouringMotion | ServoMotion = (
            servo_motion(self._config, lambda: self._has_paths and not self._paths.over)
            if self._config.servo_axes or self._config.moves
            else ContouringMotion(contouring_config(self._config))
        )
        self._tick_period = nanoseconds(self._config.tick_period)
        self._run = 0
        self._ticks = 0
        self._time = 0
        self._duty_over = False
        self._duty: Duty = _NO_DUTY
        self._mill: ThermalMill
        self._speed = 0.0
        self._mode = MachineMode.ON
        self._sources = CommandSources(type(self))
        self._told_mode: MachineMode | None = None
        self._told_again = 0
        self._enter(0)

    @property
    def next_tick(self) -> int | None:
        """Machine time of the next tick [ns]; None when the programme is over."""
        slow, fast = self._slow_tick(), self._fast_tick()
        return slow if fast is None or (slow is not None and slow < fast) else fast

    @property
    def total_ticks(self) -> int:
        """Number of ticks of the whole programme; where it has paths an estimate."""
        duties = sum(self._duty_ticks(name) for name in self._config.duties)
        period = self._config.axis_interpolation_period
        moves = round(len(self._config.moves) * self._config.move_time / period)
        return duties + moves + self._paths.ticks(period)

    @property
    def ticks_done(self) -> int:
        """How many of `total_ticks` are over."""
        done = sum(self._duty_ticks(name) for name in self._config.duties[: self._run])
        if not self._duties_done:
            return done + self._ticks
        place = self._motion.place(self._paths.path_id)
        done += self._motion.periods
        return done + self._paths.ticks_done(self._config.axis_interpolation_period, place)

    @property
    def failure(self) -> str:
        """Why the programme was given up; empty if it was not."""
        return self._paths.failure or self._motion.failure or self._stitching.failure

    def on_compensation(self, command: Compensation) -> None:
        """Take an offset command; the offset input decides whether it is followed."""
        self._offsets.command(
            command.epoch,
            command.axis,
            command.offset,
            command.slope,
            command.reference_position,
            stamp=command.stamp,
            valid_until=command.valid_until,
        )

    def on_trajectory(self, part: Trajectory) -> None:
        """Take a part of a trajectory; the trajectory input decides whether it is followed."""
        self._motion.command(part)

    def on_axis_command(self, command: AxisCommand) -> None:
        """Take a command of the drives; where the machine has its own loops it means nothing."""
        if isinstance(self._motion, ServoMotion):
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
        if name != REQUEST:
            return super().on_request(name, arguments, stamp)
        answer = self._sources.note(arguments)
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
        self._time = stamp
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
            yield from self._readings(stamp)
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
        values = {
            f'offset {axis} [um]': f'{1e6 * offset:.2f}'
            for axis, offset in zip(MILL_AXES, self._offsets.applied, strict=True)
        }
        level = Level.WARN if self._offsets.reason else Level.OK
        text = self._offsets.reason or self._offsets.status.name.lower()
        duty = 'all duties done' if self._duties_done else f'duty {self._duty.name}'
        found = [
            Health('duty', Level.OK, duty),
            Health('compensation', level, text, values),
            self._motion.health(),
            *self._sources.health(),
            self._stitching.health(),
        ]
        if self.failure:
            found.append(Health('path', Level.ERROR, self.failure))
        elif self._has_paths:
            found.append(Health('path', Level.OK, self._paths.path_id or 'none'))
        return found

    @property
    def _duties_done(self) -> bool:
        return self._run >= len(self._config.duties)

    def _slow_tick(self) -> int | None:
        """Return when warmth is next moved on [ns]; None where nothing warms up any more."""
        if self._duty_over or (self._duties_done and (self._paths.over or not self._has_paths)):
            return None
        return self._start + (self._ticks + 1) * self._tick_period

    def _fast_tick(self) -> int | None:
        """Return when the axes are next moved on, or a trajectory is waited for [ns]."""
        due = self._motion.next_time(self._time)
        if self._paths.waiting and not self._motion.busy:
            wait = self._time + nanoseconds(WAIT)
            return wait if due is None else min(due, wait)
        if due is None and self._told_mode not in (None, self._present_mode()):
            return self._time + nanoseconds(self._config.axis_interpolation_period)
        return due

    def _warm(self, stamp: int) -> None:
        """Move temperatures and offsets on by a tick period."""
        period = self._config.tick_period
        allowed = self._mode is MachineMode.ON
        self._speed = self._duty.spindle_speed(self._ticks * period) if allowed else 0.0
        self._mill.advance(period, self._speed)
        self._offsets.advance(stamp)
        self._ticks += 1

    def _readings(self, stamp: int) -> Iterator[Emission]:
        """Yield what is measured of the warm machine."""
        yield Emission('compensation_applied', self._applied(stamp))
        interval = nanoseconds(self._config.displacement_interval)
        if (stamp - self._start) % interval < self._tick_period:
            yield Emission(
                'displacement',
                Displacement(
                    stamp=stamp,
                    frame_id=self.frame('workpiece'),
                    axis=MILL_AXES,
                    channel=MILL_AXES,
                    displacement=self._mill.measure_displacement(),
                    standard_deviation=np.full(len(MILL_AXES), DISPLACEMENT_NOISE),
                    includes_compensation=False,
                ),
            )
        reading = self._mill.read()
        yield Emission(
            'sensor_readings',
            Temperatures(
                stamp=stamp,
                frame_id=self.frame('machine'),
                sensor=MILL_SENSORS,
                temperature=reading,
                status=np.where(np.isfinite(reading), 0, 1).astype(np.uint8),
                readings=1,
            ),
        )

    def _go_on(self, stamp: int, slow: bool) -> Iterator[Emission]:
        """Go on to the next duty or path where the present one is over and the axes rest."""
        if slow and not self._duties_done:
            following = (self._ticks + 1) * self._tick_period
            self._duty_over = following > nanoseconds(self._length(self._duty.name))
        if self._motion.busy:
            self._paths.wait(stamp, 'following one', busy=True)
        elif self._duty_over:
            self._enter(self._run + 1)
        elif self._duties_done and self._has_paths:
            done = self._motion.finished(self._paths.path_id)
            if done or (slow and not self._paths.path_id):
                loaded = self._paths.load_next(stamp, self.frame('workpiece'))
                for item in loaded:
                    if isinstance(item.record, Material):
                        self._stitching.clamp(item.record)
                yield from loaded
            else:
                self._paths.wait(stamp, self._motion.health().message, busy=False)

    def _present_mode(self) -> MachineMode:
        """Return the operating state; a program runs where the spindle or the axes do."""
        if self._mode is not MachineMode.ON:
            return self._mode
        tripped = isinstance(self._motion, ServoMotion) and self._motion.tripped
        if tripped or self._sources.refusal('axis_command'):
            return MachineMode.FAULT
        running = self._speed or self._motion.moving
        return MachineMode.RUNNING if running else MachineMode.ON

    def _permit(self) -> None:
        """Follow commands in ON alone, and only where they have one source."""
        off = '' if self._mode is MachineMode.ON else self._mode.name.lower()
        offsets = off or self._sources.refusal('compensation')
        axes = off or self._sources.refusal('axis_command')
        self._offsets.allow(not offsets, offsets)
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
            and not self._sources.refusal('compensation'),
            cold_since=self._start,
            spindle_speed=self._speed,
            axis=self._motion.axes,
            position=self._motion.reference,
        )

    def _length(self, duty: str) -> float:
        """Return for how long a duty is run [s]; at least one tick."""
        whole = DUTIES[duty].duration
        wanted = min(whole, self._config.duty_duration or whole)
        return max(wanted, self._config.tick_period)

    def _duty_ticks(self, duty: str) -> int:
        """Return the number of ticks of a duty."""
        return nanoseconds(self._length(duty)) // self._tick_period

    def _enter(self, run: int) -> None:
        """Set the machine up, cold, for one duty of the programme; paths follow on the last."""
        self._run, self._duty_over = run, False
        self._duty = _NO_DUTY if self._duties_done else DUTIES[self._config.duties[run]]
        if run and self._duties_done:
            return
        self._ticks = 0
        self._start = self._time = nanoseconds(DAY_START + run * DAY)
        self._mill = self._duty.mill(seed=self._config.seed + 1000 * run, faults=self._faults)

    def _applied(self, stamp: int) -> CompensationApplied:
        return CompensationApplied(
            stamp=stamp,
            frame_id=self.frame('machine'),
            epoch=self._offsets.epoch,
            status=int(self._offsets.status),
            reason=self._sources.refusal('compensation') or self._offsets.reason,
            axis=MILL_AXES,
            offset=self._offsets.applied,
            at_limit=self._offsets.at_limit,
        )

# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Base of components that move axes: one motion at a time, and its owner."""

from abc import ABC, abstractmethod
from collections.abc import Iterator
from typing import ClassVar, Generic, TypeVar

from fuzzycnc_ros.components.motion.parts import PartsRun, PathHeader
from fuzzycnc_ros.core.config import Config
from fuzzycnc_ros.core.inputs.trajectory_input import TrajectoryStatus
from fuzzycnc_ros.runtime.component import Component, Emission, Input, Level
from fuzzycnc_ros.runtime.enums import MachineMode
from fuzzycnc_ros.runtime.records import MachineState, Record, TrajectoryState

ConfigT = TypeVar('ConfigT', bound=Config)
RunT = TypeVar('RunT', bound=PartsRun)

GRACE = 2.0
"""Time after the end of a motion in which the machine should say that it has finished [s]."""
BAD_ENDS = (TrajectoryStatus.STARVED, TrajectoryStatus.REFUSED)
"""States of the machine after motion that did not come to its own end."""
_MOVING = (MachineMode.ON, MachineMode.RUNNING)


def motion_refusal(state: MachineState) -> str:
    """Say why a machine must not be moved; empty if it may."""
    if state.state not in _MOVING:
        modes = {int(mode): mode.name.lower() for mode in MachineMode}
        return f'the machine is not on but {modes.get(state.state, state.state)}'
    return '' if state.homed else 'the machine is not homed'


class MotionSender(Component[ConfigT], ABC, Generic[ConfigT, RunT]):
    """Send one motion at a time; hear from the machine how each comes to its end."""

    MACHINE: ClassVar[Input[MachineState]]
    FOLLOWED: ClassVar[Input[TrajectoryState]]

    def __init__(self, config: ConfigT | None = None) -> None:
        super().__init__(config)
        self._active = False
        self._epoch = 0
        self._time = 0  # newest stamp of anything
        self._run: RunT | None = None
        self._sent_at = 0  # when the first part of the run was sent
        self._moved_until = 0  # end of all motion that was sent
        self._told: tuple[object, ...] = ()  # by the newest trajectory_state
        self._told_since = 0
        self._told_before: tuple[object, ...] | None = None  # the run, until something else is
        self._level, self._text = Level.OK, 'inactive'

    def receive(self, name: str, record: Record) -> Iterator[Emission]:
        """Take one record of input `name`; yield what it causes."""
        self._time = max(self._time, record.stamp)
        yield from super().receive(name, record)

    def on_trajectory_state(self, state: TrajectoryState) -> None:
        """Note how the machine's motion came to its end."""
        told = (state.epoch, state.path_id, state.part, state.status, state.reason)
        if told != self._told:
            self._told, self._told_since = told, state.stamp
        run = self._run
        if run is None or state.stamp <= self._sent_at or told == self._told_before:
            return  # it may tell again what became of an earlier path
        self._told_before = None
        if state.epoch > self._epoch:
            self._give_up(f'another owner, epoch {state.epoch}, moves the machine')
        elif state.status == TrajectoryStatus.FINISHED:
            if (state.epoch, state.path_id) == (self._epoch, run.header.path_id) and run.complete:
                self._finish(run, state.stamp)
        elif state.status in BAD_ENDS:
            what = TrajectoryStatus(state.status).name.lower()
            self._give_up(f'{what} by the machine: {state.reason or "no part in time"}')

    @abstractmethod
    def _finish(self, run: RunT, stamp: int) -> None:
        """Take the machine's word that it has followed all of the run."""

    @abstractmethod
    def _give_up(self, why: str) -> None:
        """Send no more of the run."""

    def _unready(self, stamp: int) -> str:
        """Say why nobody may move the machine now; empty if somebody may."""
        machine = self.newest(self.MACHINE, stamp)
        if machine is None:
            return 'no fresh machine_state'
        refusal = motion_refusal(machine)
        if not refusal and self.last(self.FOLLOWED) is None:
            return 'no trajectory_state: what the machine follows is unknown'
        return refusal

    def _header(self, name: str) -> PathHeader:
        """Return what the parts of a new run say, as the owner of the machine's motion."""
        state = self.last(self.FOLLOWED)
        epoch = 0 if state is None else state.epoch
        if self._epoch == 0 or epoch > self._epoch:
            self._epoch = epoch + 1
        return PathHeader(name, self._epoch, self.frame('workpiece'))

    def _begin_run(self, run: RunT, stamp: int) -> None:
        """Note that the first part of a run is about to be sent."""
        self._run, self._sent_at, self._told_before = run, stamp, self._told

    def _say(self, level: Level, text: str) -> None:
        self._level, self._text = level, text

# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Component `feedrate_scheduler`: a tool path in, the motion of the axes out, part by part.

A path starts from rest, after a rapid to its beginning if the axes stand elsewhere.  Each part of
the trajectory ends with a way to rest on the path, which the machine takes if the next part does
not come in time.  What the machine refuses or gives up is never sent again by itself: the path is
dropped, and whoever wants it sends it anew.  While one path is run another one is refused.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from fuzzycnc_ros.components.motion.feedrate_run import PathRun, rehearse
from fuzzycnc_ros.components.motion.feedrate_scheduler_config import FeedrateSchedulerConfig
from fuzzycnc_ros.components.motion.motion_allowed import motion_refusal
from fuzzycnc_ros.components.motion.parts import PathHeader
from fuzzycnc_ros.components.motion.program_request import ScheduledProgram, schedule_text
from fuzzycnc_ros.components.motion.tool_paths import (
    PATH_AXES,
    ToolPathSegments,
    tool_path_segments,
)
from fuzzycnc_ros.runtime.component import (
    LATCHED,
    Answer,
    Component,
    Emission,
    Health,
    Input,
    Level,
    Output,
)
from fuzzycnc_ros.runtime.enums import TrajectoryStatus
from fuzzycnc_ros.runtime.records import (
    AxisState,
    FeedSchedule,
    Floats,
    MachineState,
    Record,
    ToolPath,
    Trajectory,
    TrajectoryState,
    nanoseconds,
)

GRACE = 2.0
"""Time after the end of a path in which the machine should say that it has finished [s]."""
SETTLED = 1.0
"""Time after which axes whose trajectory was given up are at rest [s]."""
LINES_WHILE_RUNNING = 300
"""Longest program that is scheduled while a path is run: its parts must leave in time."""
_BAD_ENDS = (TrajectoryStatus.STARVED, TrajectoryStatus.REFUSED)


@dataclass(frozen=True)
class Waiting:
    """A path that waits for its start."""

    path: ToolPath
    segments: ToolPathSegments
    fresh: bool
    """Whether it was made just now, so that nobody can have run it."""


class FeedrateScheduler(Component[FeedrateSchedulerConfig]):
    """Run the tool paths that arrive, one at a time."""

    NAME = 'feedrate_scheduler'
    SUMMARY = 'Chooses the feed along tool paths and streams their trajectory. Managed lifecycle.'
    CONFIG = FeedrateSchedulerConfig
    AXES = Input('axis_state', AxisState, max_age=60.0, quiet=True)
    MACHINE = Input('machine_state', MachineState, max_age=600.0)
    FOLLOWED = Input('trajectory_state', TrajectoryState, quiet=True)
    INPUTS = (AXES, MACHINE, FOLLOWED, Input('tool_path', ToolPath, LATCHED, driving=True))
    OUTPUTS = (Output('trajectory', Trajectory), Output('feed_schedule', FeedSchedule))
    MANAGED = True

    def __init__(self, config: FeedrateSchedulerConfig | None = None) -> None:
        super().__init__(config)
        self.scheduled: ScheduledProgram | None = None
        """What became of the newest program that was scheduled."""
        self._active = False
        self._epoch = 0
        self._time = 0  # newest stamp of anything
        self._kept: tuple[ToolPath, bool] | None = None  # newest that came while inactive
        self._waiting: Waiting | None = None
        self._wake_at: int | None = None
        self._run: PathRun | None = None
        self._sent_at = 0  # when the first part of the run was sent
        self._moved_until = 0  # end of all motion that was sent
        self._told: tuple[object, ...] = ()  # by the newest trajectory_state
        self._told_since = 0
        self._told_before: tuple[object, ...] | None = None  # the run, until something else is
        self._handled = (-1, '')  # stamp and name of the newest path that was taken
        self._level, self._text = Level.OK, 'inactive'
        self._lost: str = ''

    @property
    def next_deadline(self) -> int | None:
        """When the next part is to be sent, a path may start, or its end should be known."""
        run = self._run
        if run is None:
            return self._wake_at
        return run.end + nanoseconds(GRACE) if run.complete else run.next_send

    def receive(self, name: str, record: Record) -> Iterator[Emission]:
        """Take one record of input `name`; yield what it causes."""
        self._time = max(self._time, record.stamp)
        yield from super().receive(name, record)

    def reconfigure(self, config: FeedrateSchedulerConfig) -> None:
        """Take new live parameters; they act from the next part on that is sent."""
        if self._run is not None and not self._run.complete:
            self._run.change(config)
        super().reconfigure(config)

    def on_tool_path(self, path: ToolPath) -> Iterator[Emission]:
        """Run a path, or keep it until the component is active."""
        if (path.stamp, path.path_id) == self._handled:
            return  # a latched topic says it again
        fresh = self._is_fresh(path)
        if not self._active:
            if self._kept is not None and self._kept[0].path_id != path.path_id:
                self._lost = f'{self._kept[0].path_id} replaced by {path.path_id} while inactive'
            self._kept = (path, fresh)
        elif self._take(path, fresh=fresh) and fresh:
            yield from self._start(self._time)

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
            self._drop(f'another owner, epoch {state.epoch}, moves the machine')
        elif state.status == TrajectoryStatus.FINISHED:
            if (state.epoch, state.path_id) == (self._epoch, run.header.path_id) and run.complete:
                self._run = None
                self._moved_until = state.stamp
                self._say(Level.OK, f'{run.header.path_id} finished')
        elif state.status in _BAD_ENDS:
            what = TrajectoryStatus(state.status).name.lower()
            self._drop(f'{what} by the machine: {state.reason or "no part in time"}')

    def on_machine_state(self, state: MachineState) -> None:
        """Give up when the machine must not move; start a path that waits when it may again."""
        refusal = motion_refusal(state)
        if refusal and self._run is not None:
            self._drop(refusal)
        elif self._waiting is not None:
            self._wake_at = state.stamp

    def on_deadline(self, stamp: int) -> Iterator[Emission]:
        """Send the next part, start a path that waits, or miss the machine's word of the end."""
        self._time = max(self._time, stamp)
        self._wake_at = None
        run = self._run
        if run is None:
            yield from self._start(stamp)
        elif run.complete:
            state = self.last(self.FOLLOWED)
            known = {int(status): status.name for status in TrajectoryStatus}
            heard = 'silent'
            if state is not None:
                heard = known.get(state.status, f'status {state.status}')
            self._drop(f'the machine did not say that it has finished: {heard}')
        else:
            yield from self._send(run, stamp)

    def on_request(self, name: str, arguments: Mapping[str, Any], stamp: int) -> Answer:
        """`activate`, `deactivate` (comes to rest on the path) and `schedule_program`."""
        self._time = max(self._time, stamp)
        if name == 'activate':
            return self._activate()
        if name == 'deactivate':
            return self._deactivate()
        if name == 'schedule_program':
            return self._schedule_program(arguments)
        return super().on_request(name, arguments, stamp)

    def health(self) -> list[Health]:
        """Report what is run or waited for, and what became of paths that were not."""
        run = self._run
        values = {}
        if run is not None:
            values = {'path': run.header.path_id, 'parts sent': str(run.part)}
            values['planned [%]'] = f'{100.0 * run.progress:.0f}'
        items = [Health('state', self._level, self._text, values)]
        if self._lost:
            items.append(Health('lost path', Level.WARN, self._lost))
        if self._active and self._config.feed_override == 0.0:
            items.append(Health('feed hold', Level.WARN, 'feed_override is 0'))
        return items

    def _activate(self) -> Answer:
        if self._active:
            return Answer(False, 'already active')
        try:
            rehearse(self._config)
        except ValueError as error:
            return Answer(False, str(error))
        self._active = True
        self._epoch = 0
        self._lost = ''
        self._say(Level.OK, 'waiting for a tool path')
        kept, self._kept = self._kept, None
        if kept is not None and self._take(kept[0], fresh=kept[1]):
            self._say(Level.WARN, f'{kept[0].path_id} waits for machine_state')
        return Answer(True, 'active: tool paths are run')

    def _deactivate(self) -> Answer:
        if not self._active:
            return Answer(False, 'not active')
        run, emissions = self._run, tuple[Emission, ...]()
        if run is not None and not run.complete:
            emissions = tuple(run.stop(self._time))
        if run is not None:
            self._moved_until = max(self._moved_until, run.at_rest)
        self._active = False
        self._run = self._waiting = self._wake_at = None
        self._say(Level.OK, 'inactive')
        text = 'inactive' if run is None else f'inactive; {run.header.path_id} ends at rest'
        return Answer(True, text, emissions)

    def _is_fresh(self, path: ToolPath) -> bool:
        """Whether a path was made no earlier than what the machine has said of itself.

        A latched path may be old: it outlives the node that ran it.
        """
        heard = [item.stamp for name, item in self._newest.items() if name != 'tool_path']
        return bool(heard) and path.stamp >= max(heard) - nanoseconds(self._config.lead)

    def _take(self, path: ToolPath, *, fresh: bool) -> bool:
        """Have a path wait for its start; say why if it is not to be run."""
        if self._run is not None:
            running = self._run.header.path_id
            self._lost = (
                f'{path.path_id} refused: {running} is being run; send it again afterwards'
            )
            return False
        self._handled = (path.stamp, path.path_id)
        try:
            segments = tool_path_segments(path)
        except ValueError as error:
            self._say(Level.ERROR, f'{path.path_id or "tool path"} refused: {error}')
            return False
        self._lost = ''
        if self._waiting is not None:
            name = self._waiting.path.path_id
            self._lost = f'{name} replaced by {path.path_id} before it could start'
        self._waiting = Waiting(path, segments, fresh)
        # Nobody knows how late it is when an old path arrives: the next state will tell.
        self._say(Level.WARN, f'{path.path_id} waits for machine_state')
        return True

    def _start(self, stamp: int) -> Iterator[Emission]:
        """Start the path that waits if the machine is ready."""
        waiting = self._waiting
        if waiting is None:
            return
        name = waiting.path.path_id
        place, obstacle = self._place(waiting.segments, stamp)
        if obstacle:
            self._say(Level.WARN, f'{name} waits: {obstacle}')
            return
        self._waiting = None
        state = self.last(self.FOLLOWED)
        epoch = 0 if state is None else state.epoch
        if not waiting.fresh and state is not None and state.path_id == name:
            self._say(Level.WARN, f'{name} was begun before; send it anew to run it again')
            return
        if self._epoch == 0 or epoch > self._epoch:
            self._epoch = epoch + 1
        header = PathHeader(name, self._epoch, self.frame('workpiece'))
        try:
            run = PathRun(
                header,
                waiting.segments,
                place,
                self._config,
                stamp + nanoseconds(self._config.lead),
            )
        except ValueError as error:
            self._say(Level.ERROR, f'{name} refused: {error}')
            return
        self._run, self._sent_at, self._told_before = run, stamp, self._told
        self._say(Level.OK, f'running {name}')
        yield from self._send(run, stamp)

    def _send(self, run: PathRun, stamp: int) -> Iterator[Emission]:
        """Send the next part; where the path turns out to be impossible, come to rest on it."""
        try:
            emissions = run.send(stamp)
        except ValueError as error:
            emissions = run.stop(stamp) if run.part else []
            self._drop(str(error))
        self._moved_until = max(self._moved_until, run.at_rest)
        yield from emissions

    def _place(self, segments: ToolPathSegments, stamp: int) -> tuple[Floats, str]:
        """Return where the axes rest, X, Y and Z [m], and what a start has to wait for."""
        place = np.zeros(3)
        machine = self.newest(self.MACHINE, stamp)
        if machine is None:
            return place, 'no fresh machine_state'
        refusal = motion_refusal(machine)
        if refusal:
            return place, refusal
        state = self.last(self.FOLLOWED)
        if state is None:
            return place, 'no trajectory_state: what the machine follows is unknown'
        if state.status == TrajectoryStatus.FOLLOWING:
            return place, f'the machine still follows {state.path_id}'
        rest_since = self._moved_until
        if state.status in _BAD_ENDS and state.epoch:
            rest_since = max(rest_since, self._told_since + nanoseconds(SETTLED))
        axes = self.newest(self.AXES, stamp)
        if axes is None:
            return place, 'no fresh axis_state: where the axes are is unknown'
        if axes.stamp < rest_since:
            return place, 'no axis_state since the end of the last motion'
        told = dict(zip(axes.axis, axes.reference.tolist(), strict=False))
        for name, column in zip(segments.axis, segments.columns, strict=True):
            place[column] = told.get(name, np.nan)
        if not np.isfinite(place).all():
            lost = ', '.join(PATH_AXES[k] for k in np.flatnonzero(~np.isfinite(place)))
            return place, f'axis_state does not tell where {lost} is commanded to be'
        return place, ''

    def _drop(self, why: str) -> None:
        """Send no more of the path."""
        run, self._run = self._run, None
        if run is not None:
            self._say(Level.ERROR, f'{run.header.path_id} given up: {why}; send it anew')

    def _say(self, level: Level, text: str) -> None:
        self._level, self._text = level, text

    def _schedule_program(self, arguments: Mapping[str, Any]) -> Answer:
        """Choose the feeds of a program, and run it if that is asked for."""
        text, wanted = str(arguments['program']), bool(arguments.get('run', False))
        obstacle = ''
        if wanted and not self._active:
            obstacle = 'run: expected an active node but it is inactive; activate it first'
        elif wanted and self._run is not None:
            obstacle = f'run: {self._run.header.path_id} is being run; ask again afterwards'
        elif wanted and self._waiting is not None:
            obstacle = f'run: {self._waiting.path.path_id} waits for its start'
        elif self._run is not None and text.count('\n') > LINES_WHILE_RUNNING:
            obstacle = (
                f'program: expected up to {LINES_WHILE_RUNNING} lines while a path is being run; '
                'ask again afterwards, or use `fuzzycnc schedule`'
            )
        if obstacle:
            return Answer(False, obstacle)
        try:
            found = schedule_text(
                self._config,
                text,
                units=str(arguments.get('units', '')),
                path_id=str(arguments.get('path_id', '')),
                stamp=self._time,
                frame_id=self.frame('workpiece'),
                run=wanted,
            )
        except ValueError as error:
            return Answer(False, str(error))
        self.scheduled = found
        emissions: tuple[Emission, ...] = ()
        if found.path is not None and self._take(found.path, fresh=True):
            emissions = tuple(self._start(self._time))
        return Answer(True, found.message, emissions)

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
from fuzzycnc_ros.components.motion.program_request import ScheduledProgram, schedule_text
from fuzzycnc_ros.components.motion.sender import BAD_ENDS, GRACE, MotionSender, motion_refusal
from fuzzycnc_ros.components.motion.tool_paths import (
    PATH_AXES,
    ToolPathSegments,
    tool_path_segments,
)
from fuzzycnc_ros.core.inputs.trajectory_input import TrajectoryStatus
from fuzzycnc_ros.runtime.component import (
    LATCHED,
    Answer,
    Emission,
    Health,
    Input,
    Level,
    Output,
)
from fuzzycnc_ros.runtime.records import (
    AxisState,
    FeedSchedule,
    Floats,
    MachineState,
    ToolPath,
    Trajectory,
    TrajectoryState,
    nanoseconds,
)

SETTLED = 1.0
"""Time after which axes whose trajectory was given up are at rest [s]."""
LINES_WHILE_RUNNING = 300
"""Longest program that is scheduled while a path is run: its parts must leave in time."""


@dataclass(frozen=True)
class Waiting:
    """A path that waits for its start."""

    path: ToolPath
    segments: ToolPathSegments
    fresh: bool
    """True if it was made just now, so that it cannot have been run yet."""


class FeedrateScheduler(MotionSender[FeedrateSchedulerConfig, PathRun]):
    """Run the tool paths that arrive, one at a time."""

    NAME = 'feedrate_scheduler'
    SUMMARY = 'Chooses the feed along tool paths and streams their trajectory. Managed lifecycle.'
    CONFIG = FeedrateSchedulerConfig
    AXES = Input('axis_state', AxisState, max_age=60.0, quiet=True)
    MACHINE = Input('machine_state', MachineState, max_age=600.0)
    FOLLOWED = Input('trajectory_state', TrajectoryState, quiet=True, paced=False)
    INPUTS = (AXES, MACHINE, FOLLOWED, Input('tool_path', ToolPath, LATCHED, driving=True))
    OUTPUTS = (Output('trajectory', Trajectory), Output('feed_schedule', FeedSchedule))
    MANAGED = True

    def __init__(self, config: FeedrateSchedulerConfig | None = None) -> None:
        super().__init__(config)
        self.scheduled: ScheduledProgram | None = None
        """Result of the newest program that was scheduled."""
        self._kept: tuple[ToolPath, bool] | None = None  # newest that came while inactive
        self._waiting: Waiting | None = None
        self._wake_at: int | None = None
        self._handled = (-1, '')  # stamp and name of the newest path that was taken
        self._lost: str = ''

    @property
    def next_deadline(self) -> int | None:
        """Time at which the next part is due, a path may start, or its end should be known."""
        run = self._run
        if run is None:
            return self._wake_at
        return run.end + nanoseconds(GRACE) if run.complete else run.next_send

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

    def on_machine_state(self, state: MachineState) -> None:
        """Give up when the machine must not move; start a path that waits when it may again."""
        refusal = motion_refusal(state)
        if refusal and self._run is not None:
            self._give_up(refusal)
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
            self._give_up(f'the machine did not say that it has finished: {heard}')
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
        """Return True if a path was made no earlier than the newest state of the machine.

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
        if not waiting.fresh and state is not None and state.path_id == name:
            self._say(Level.WARN, f'{name} was begun before; send it anew to run it again')
            return
        header = self._header(name)
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
        self._begin_run(run, stamp)
        self._say(Level.OK, f'running {name}')
        yield from self._send(run, stamp)

    def _send(self, run: PathRun, stamp: int) -> Iterator[Emission]:
        """Send the next part; where the path turns out to be impossible, come to rest on it."""
        try:
            emissions = run.send(stamp)
        except ValueError as error:
            emissions = run.stop(stamp) if run.part else []
            self._give_up(str(error))
        self._moved_until = max(self._moved_until, run.at_rest)
        yield from emissions

    def _place(self, segments: ToolPathSegments, stamp: int) -> tuple[Floats, str]:
        """Return where the axes rest, X, Y and Z [m], and what a start has to wait for."""
        place = np.zeros(3)
        unready, state = self._unready(stamp), self.last(self.FOLLOWED)
        if unready or state is None:
            return place, unready
        if state.status == TrajectoryStatus.FOLLOWING:
            return place, f'the machine still follows {state.path_id}'
        rest_since = self._moved_until
        if state.status in BAD_ENDS and state.epoch:
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

    def _finish(self, run: PathRun, stamp: int) -> None:
        self._run = None
        self._moved_until = stamp
        self._say(Level.OK, f'{run.header.path_id} finished')

    def _give_up(self, why: str) -> None:
        """Send no more of the path."""
        run, self._run = self._run, None
        if run is not None:
            self._say(Level.ERROR, f'{run.header.path_id} given up: {why}; send it anew')

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

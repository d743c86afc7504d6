# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Component `joint_trajectory_bridge`: goals of ROS's joint trajectories in, motion of axes out.

A goal starts from rest and is sent in parts, each with a way to rest on the trajectory, so that it
can be stopped: by its sender, by a newer goal, or because an axis is too far off.  The machine
keeps its own limits; what it refuses or gives up ends the goal and is never sent again by itself.
Goals are refused while somebody else moves the axes.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from fuzzycnc_ros.components.motion.joint_goal import Goal, GoalCode, GoalError
from fuzzycnc_ros.components.motion.joint_run import JointPath, JointRun
from fuzzycnc_ros.components.motion.joint_trajectory_config import JointTrajectoryBridgeConfig
from fuzzycnc_ros.components.motion.sender import GRACE, MotionSender, motion_refusal
from fuzzycnc_ros.core.inputs.trajectory_input import TrajectoryStatus
from fuzzycnc_ros.runtime.component import (
    Answer,
    Emission,
    Health,
    Input,
    Level,
    Output,
)
from fuzzycnc_ros.runtime.records import (
    SECOND,
    AxisState,
    Floats,
    MachineState,
    Names,
    Record,
    Trajectory,
    TrajectoryState,
    nanoseconds,
)

SETTLED = 1.0
"""Time after the end of a motion in which axes may still swing [s]."""
WATCH = 0.1
"""Time between two looks at what the machine says, while there is a goal [s]."""
SWAYING = 1e-3
"""Velocity below which axes that nobody moves count as resting [m/s]."""


@dataclass(frozen=True, kw_only=True, eq=False)
class JointStates(Record):
    """Positions [m] and velocities of joints [m/s], as ROS's viewers read them."""

    TYPE: ClassVar[str] = 'sensor_msgs/msg/JointState'

    name: Names
    position: Floats
    velocity: Floats
    effort: Floats


@dataclass(frozen=True)
class GoalResult:
    """Result of a goal: its name, the code and the text for its sender."""

    goal: str
    code: GoalCode
    text: str
    cancelled: bool = False
    """True if its sender wanted it to end."""


@dataclass(frozen=True, eq=False)
class GoalFeedback:
    """Desired and actual positions of the joints of a goal [m, m/s] at time `stamp` [ns]."""

    goal: str
    stamp: int
    joints: Names
    desired: tuple[Floats, Floats]
    actual: tuple[Floats, Floats]
    point: int


class JointTrajectoryBridge(MotionSender[JointTrajectoryBridgeConfig, JointRun]):
    """Follow goals, one at a time, and tell where the joints are."""

    NAME = 'joint_trajectory_bridge'
    SUMMARY = 'Follows joint trajectories of ROS, publishes joint states. Managed lifecycle.'
    CONFIG = JointTrajectoryBridgeConfig
    MACHINE = Input('machine_state', MachineState, max_age=600.0, quiet=True)
    FOLLOWED = Input('trajectory_state', TrajectoryState, quiet=True, paced=False)
    AXES = Input('axis_state', AxisState, driving=True, max_age=60.0)
    INPUTS = (MACHINE, FOLLOWED, AXES)
    OUTPUTS = (Output('trajectory', Trajectory), Output('joint_states', JointStates))
    MANAGED = True

    def __init__(self, config: JointTrajectoryBridgeConfig | None = None) -> None:
        super().__init__(config)
        self._goals = 0
        self._ending: GoalResult | None = None  # of the run, once its axes rest
        self._finished: int | None = None  # when the machine said that the run is over
        self._waiting: Goal | None = None
        self._outcomes: list[GoalResult] = []
        self._looked_at = 0
        self._joints_at: int | None = None  # newest joint states

    @property
    def next_deadline(self) -> int | None:
        """Time at which the next part is to be sent, or something is to be checked or repeated."""
        due = []
        if self._joints_at is not None and self._axes_known(self._joints_at):
            due.append(self._joints_at + nanoseconds(self._config.rest_period))
        run = self._run
        if run is not None and not run.complete:
            due.append(run.next_send)
        goal = self._waiting
        if run is not None or goal is not None:
            due.append(self._looked_at + nanoseconds(WATCH))
        if goal is not None:
            begin = goal.start - nanoseconds(self._config.lead)
            due += [begin] if begin > self._looked_at else []
        return min(due, default=None)

    def take_outcomes(self) -> list[GoalResult]:
        """Return the goals that have ended since the last call."""
        found, self._outcomes = self._outcomes, []
        return found

    @property
    def progress(self) -> GoalFeedback | None:
        """Progress of the goal that is being followed; None if there is none."""
        run, state = self._run, self.last(self.AXES)
        if run is None or state is None:
            return None
        wanted = run.wanted(state.stamp)
        if wanted is None:
            return None
        names = tuple(self._config.joint_names[column] for column in run.goal.column)
        return GoalFeedback(
            run.goal.name,
            state.stamp,
            names,
            (wanted.position, wanted.velocity),
            self._measured(run, state),
            wanted.point,
        )

    def tool(self, joints: JointStates) -> Floats:
        """Return the place of the tool in the workpiece's frame, X, Y and Z [m]."""
        known = dict(zip(self._config.joint_names, self._config.axes, strict=True))
        places = zip(joints.name, joints.position.tolist(), strict=True)
        told = {known[name]: place for name, place in places}
        return np.array([told.get(axis, 0.0) for axis in 'XYZ'])

    def renewed(self, step: int) -> tuple['JointTrajectoryBridge', list[Emission]]:
        """Go on after the clock has stepped: what was under way is over, and its sender told."""
        self._give_up('the clock was set')
        if self._waiting is not None:
            self._end(self._waiting.name, GoalCode.INVALID_GOAL, 'the clock was set')
        fresh, emissions = super().renewed(step)
        assert isinstance(fresh, JointTrajectoryBridge)
        fresh._outcomes, fresh._goals = self._outcomes, self._goals
        return fresh, emissions

    def on_axis_state(self, state: AxisState) -> Iterator[Emission]:
        """Tell where the joints are, and judge how the goal is followed."""
        due = self._joints_at is None or (
            state.stamp >= self._joints_at + nanoseconds(self._config.joint_state_period)
        )
        if due:
            yield from self._joint_states(state, state.stamp)
        run = self._run
        if run is not None:
            yield from self._judge(run, state)
        yield from self._begin(state.stamp)

    def on_machine_state(self, state: MachineState) -> None:
        """Give up when the machine must not move."""
        refusal = motion_refusal(state)
        if refusal:
            self._give_up(refusal)

    def on_deadline(self, stamp: int) -> Iterator[Emission]:
        """Send the next part, look what has become of the goal, tell the joints again."""
        self._time = max(self._time, stamp)
        self._looked_at = max(self._looked_at, stamp)
        state = self.last(self.AXES)
        last = self._joints_at
        again = last is not None and stamp >= last + nanoseconds(self._config.rest_period)
        if state is not None and again:
            yield from self._joint_states(state, stamp)
        run = self._run
        if run is not None and not run.complete and run.next_send <= stamp:
            yield run.send(stamp)
            self._moved_until = max(self._moved_until, run.at_rest)
        elif run is not None:
            self._look(run, stamp)
        yield from self._begin(stamp)

    def on_request(self, name: str, arguments: Mapping[str, Any], stamp: int) -> Answer:
        """`activate`, `deactivate` (comes to rest), `follow` a goal and `cancel` it."""
        self._time = max(self._time, stamp)
        if name == 'activate':
            return self._activate()
        if name == 'deactivate':
            return self._deactivate()
        if name == 'follow':
            return self._follow(arguments)
        if name == 'cancel':
            return self._cancel(str(arguments['goal']))
        return super().on_request(name, arguments, stamp)

    def health(self) -> list[Health]:
        """Report the goal that is followed and how the last one ended."""
        values, run = {}, self._run
        if run is not None:
            values['goal'] = run.goal.name
            values['duration [s]'] = f'{run.length:.3f}'
            values['sent [%]'] = f'{100.0 * run.progress:.0f}'
        return [Health('goal', self._level, self._text, values)]

    def _activate(self) -> Answer:
        if self._active:
            return Answer(False, 'already active')
        self._active, self._epoch = True, 0
        self._say(Level.OK, 'waiting for a goal')
        return Answer(True, 'active: goals are followed')

    def _deactivate(self) -> Answer:
        if not self._active:
            return Answer(False, 'not active')
        emissions = self._stop(GoalCode.INVALID_GOAL, 'the node was deactivated')
        if self._ending is not None:
            self._conclude(self._ending)
        if self._waiting is not None:
            self._end(self._waiting.name, GoalCode.INVALID_GOAL, 'the node was deactivated')
        self._active, self._waiting = False, None
        self._say(Level.OK, 'inactive')
        return Answer(True, 'inactive; the axes come to rest', tuple(emissions))

    def _follow(self, arguments: Mapping[str, Any]) -> Answer:
        """Take a goal, which ends the one before, or tell its sender why not."""
        name = str(arguments['goal'])
        try:
            if not self._active:
                raise GoalError(
                    GoalCode.INVALID_GOAL, 'expected an active node but it is inactive'
                )
            goal = Goal.of(arguments, self._config)
            self._check_start(goal)
            JointPath(goal, self._place(self._time, self._run), self._config)
        except GoalError as error:
            self._end(name, error.code, str(error))
            return Answer(False, str(error))
        emissions = self._stop(GoalCode.INVALID_GOAL, f'replaced by the newer goal {name}')
        if self._waiting is not None:
            text = f'replaced by the newer goal {name} before it could start'
            self._end(self._waiting.name, GoalCode.INVALID_GOAL, text)
        self._waiting, self._looked_at = goal, self._time
        self._say(Level.OK, f'{name} waits for its start')
        return Answer(True, 'accepted', (*emissions, *self._begin(self._time)))

    def _cancel(self, name: str) -> Answer:
        """End a goal as its sender wants it: at rest on the way."""
        if self._waiting is not None and self._waiting.name == name:
            self._end(name, GoalCode.SUCCESSFUL, 'cancelled before it started', cancelled=True)
            self._waiting = None
            return Answer(True, 'cancelled')
        if self._run is None or self._run.goal.name != name or self._ending is not None:
            return Answer(False, f'{name} is not being followed')
        emissions = self._stop(GoalCode.SUCCESSFUL, 'cancelled; the axes rest', cancelled=True)
        return Answer(True, 'coming to rest', tuple(emissions))

    def _check_start(self, goal: Goal) -> None:
        """Refuse a goal that should have begun already."""
        age = self._time - goal.start
        if goal.start and age > nanoseconds(self._config.age_max):
            raise GoalError(
                GoalCode.OLD_HEADER_TIMESTAMP,
                f'header.stamp: expected 0 or at most {self._config.age_max:g} s ago (parameter '
                f'age_max) but found {age / SECOND:.3f} s ago; is the sender on the same clock?',
            )

    def _begin(self, stamp: int) -> Iterator[Emission]:
        """Start the goal that waits, if it is time and the axes are free."""
        goal = self._waiting
        lead = nanoseconds(self._config.lead)
        if goal is None or self._run is not None or stamp < goal.start - lead:
            return
        self._waiting = None
        try:
            path = JointPath(goal, self._place(stamp, None), self._config)
        except GoalError as error:
            self._end(goal.name, error.code, str(error))
            return
        self._goals += 1
        header = self._header(f'joint_trajectory_{self._goals}')
        run = JointRun(path, header, self._config, max(goal.start, stamp + lead))
        self._begin_run(run, stamp)
        self._ending = self._finished = None
        self._looked_at = stamp
        self._say(Level.OK, f'following {goal.name}')
        yield run.send(stamp)
        self._moved_until = max(self._moved_until, run.at_rest)

    def _judge(self, run: JointRun, state: AxisState) -> Iterator[Emission]:
        """Look whether the axes are where they should be."""
        if self._ending is not None:
            self._look(run, state.stamp)
            return
        wanted = run.wanted(state.stamp)
        if wanted is None:
            return
        goal, (position, velocity) = run.goal, self._measured(run, state)
        names = tuple(self._config.joint_names[column] for column in goal.column)
        off = (position - wanted.position, velocity - wanted.velocity)
        if self._finished is not None:
            if not goal.goal_tolerance.breach(names, *off):
                self._conclude(GoalResult(goal.name, GoalCode.SUCCESSFUL, 'arrived'))
            else:
                self._look(run, state.stamp)
            return
        breach = goal.path_tolerance.breach(names, *off)
        if breach:
            yield from self._stop(GoalCode.PATH_TOLERANCE_VIOLATED, breach)

    def _look(self, run: JointRun, stamp: int) -> None:
        """Tell the end of a run whose axes rest or should rest."""
        if not run.complete:
            return
        ended = self._finished is not None and self._finished <= stamp
        if self._ending is not None and ended:
            self._conclude(self._ending)
        elif not ended and stamp > run.at_rest + nanoseconds(GRACE):
            self._give_up('the machine did not say that it has finished')
        elif ended and stamp > run.at_rest + run.goal.goal_time:
            self._conclude(
                GoalResult(run.goal.name, GoalCode.GOAL_TOLERANCE_VIOLATED, self._away(run))
            )

    def _away(self, run: JointRun) -> str:
        """Say how far the axes are from the end of a goal."""
        state, wanted = self.last(self.AXES), run.wanted(run.at_rest)
        if state is None or wanted is None:
            return 'where the axes are is unknown'
        position, velocity = self._measured(run, state)
        names = tuple(self._config.joint_names[column] for column in run.goal.column)
        found = run.goal.goal_tolerance.breach(
            names, position - wanted.position, velocity - wanted.velocity
        )
        return f'{found} {run.goal.goal_time / SECOND:g} s after its end'

    def _stop(self, code: GoalCode, text: str, *, cancelled: bool = False) -> list[Emission]:
        """Have the run come to rest on its way; its outcome is told when it does."""
        run = self._run
        if run is None or self._ending is not None:
            return []
        emissions = run.stop(self._time)
        self._ending = GoalResult(run.goal.name, code, text, cancelled)
        self._moved_until = max(self._moved_until, run.at_rest)
        self._say(Level.OK if cancelled else Level.WARN, f'{run.goal.name}: {text}')
        return emissions

    def _finish(self, run: JointRun, stamp: int) -> None:
        if self._finished is None:
            self._finished = stamp

    def _give_up(self, why: str) -> None:
        """Send no more of the run: the machine moves by somebody else's word, or not at all."""
        run = self._run
        if run is not None:
            self._conclude(
                self._ending
                or GoalResult(run.goal.name, GoalCode.INVALID_GOAL, f'given up: {why}')
            )

    def _conclude(self, outcome: GoalResult) -> None:
        """Leave the run."""
        if self._finished is not None:
            self._moved_until = self._finished
        self._run = self._ending = self._finished = None
        self._end(outcome.goal, outcome.code, outcome.text, cancelled=outcome.cancelled)

    def _end(self, name: str, code: GoalCode, text: str, *, cancelled: bool = False) -> None:
        """Tell how a goal ended."""
        self._outcomes.append(GoalResult(name, code, text, cancelled))
        good = code is GoalCode.SUCCESSFUL
        self._say(Level.OK if good else Level.WARN, f'{name}: {code.name}, {text}')

    def _place(self, stamp: int, run: JointRun | None) -> Floats:
        """Return where the axes rest, or will rest when a run is stopped [m].

        Raises
        ------
        GoalError
            If nobody knows, or somebody else moves them.
        """
        found = self._obstacle(stamp, run)
        axes = self.newest(self.AXES, stamp)
        if axes is None:
            found = found or 'no fresh axis_state: where the axes are is unknown'
            raise GoalError(GoalCode.INVALID_GOAL, found)
        told = dict(zip(axes.axis, axes.reference.tolist(), strict=True))
        place = np.array([told.get(name, np.nan) for name in self._config.axes])
        if run is not None:
            place[list(run.goal.column)] = run.rest_place()
        lost = [self._config.axes[k] for k in np.flatnonzero(~np.isfinite(place))]
        if not found and lost:
            found = f'axis_state does not tell where {", ".join(lost)} is commanded to be'
        moving = np.abs(axes.velocity).max(initial=0.0) > SWAYING
        if not found and moving and stamp > self._moved_until + nanoseconds(SETTLED):
            found = 'the axes move: another commander has them'
        if found:
            raise GoalError(GoalCode.INVALID_GOAL, found)
        return place

    def _obstacle(self, stamp: int, run: JointRun | None) -> str:
        """Say why nothing may be started; empty if it may."""
        unready, state = self._unready(stamp), self.last(self.FOLLOWED)
        if unready or state is None:
            return unready
        if run is None and state.status == TrajectoryStatus.FOLLOWING:
            return f'another commander has the axes: the machine follows {state.path_id}'
        if run is None and stamp < self._moved_until:
            return 'the axes are still on their way to rest; send the goal again'
        return ''

    def _measured(self, run: JointRun, state: AxisState) -> tuple[Floats, Floats]:
        """Return positions and velocities of the joints of a run [m, m/s]; NaN where unknown."""
        found = []
        for values in (state.position, state.velocity):
            told = dict(zip(state.axis, values.tolist(), strict=True))
            found.append(np.array([told.get(axis, np.nan) for axis in run.path.axes]))
        return found[0], found[1]

    def _axes_known(self, stamp: int) -> bool:
        """Return True if the newest state of the machine's axes still holds."""
        return self.newest(self.AXES, stamp) is not None

    def _joint_states(self, state: AxisState, stamp: int) -> Iterator[Emission]:
        """Tell where the joints are; nothing while the axes are clamped and told by nobody."""
        self._joints_at = stamp
        plain = np.isfinite(state.position) & np.isfinite(state.velocity)
        place = {name: k for k, name in enumerate(state.axis) if plain[k]}
        known = [k for k, name in enumerate(self._config.axes) if name in place]
        if not known:
            return
        column = [place[self._config.axes[k]] for k in known]
        yield Emission(
            'joint_states',
            JointStates(
                stamp=stamp,
                frame_id=self.frame('workpiece'),
                name=tuple(self._config.joint_names[k] for k in known),
                position=state.position[column],
                velocity=state.velocity[column],
                effort=np.zeros(0),
            ),
        )

# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Trajectory input of a machine: the machine side of motion, with its own limits.

It trusts nobody.  Whatever it is told, the commanded positions go on from where they are, within
the machine's own velocity and acceleration, and come to rest on the path by themselves when what
follows does not come in time.
"""

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import ArrayLike

from fuzzycnc_ros.core.arrays import Array
from fuzzycnc_ros.core.config import Config, param

SECOND = 1_000_000_000
"""One second [ns]."""

_PLAUSIBLE = {'position': 1000.0, 'velocity': 1000.0, 'arc_length': 1e9}
"""Sizes beyond which a number is a mix-up of units or worse [m, m/s, m]; keeps sums finite."""

_ROOM = 1.01
"""Share of a limit that rounding and the sender's own arithmetic may take up."""


@dataclass(frozen=True, kw_only=True)
class TrajectoryInputConfig(Config):
    """Limits that the machine side keeps whatever it is told; all axes are equal."""

    period: float = param(
        1e-3, 's', 'Time between two positions of a trajectory', low=1e-5, high=0.1
    )
    velocity_max: float = param(0.25, 'm/s', 'Largest velocity of an axis', low=1e-4, high=10.0)
    acceleration_max: float = param(
        4.0, 'm/s^2', 'Largest acceleration of an axis', low=1e-3, high=1000.0
    )
    lead_max: float = param(
        10.0, 's', 'How far ahead of the machine a path may start', low=0.0, high=3600.0
    )
    samples_max: int = param(
        1_000_000, '-', 'Samples that are kept for later', low=1, high=100_000_000
    )


@dataclass(frozen=True, kw_only=True, eq=False)
class TrajectoryPart:
    """Motion over the next stretch of time, with a way to rest at its end.

    Attributes
    ----------
    path_id : str
        Path that the motion is along.
    epoch : int
        Owner epoch, 1 or more; a new owner comes with a higher one.
    part : int
        Number of this part, counted from 0 along a path.
    last : bool
        Whether the path ends with this part.
    start : int
        Machine time of the first sample [ns].
    period : float
        Time between two samples [s].
    committed : int
        Number of samples before the next part begins; those behind lead to rest.
    axis : sequence of str
        Axes of the part; those left out stand still.
    position, velocity : ndarray, shape (n * len(axis),)
        Samples row by row [m, m/s].
    arc_length : ndarray, shape (n,)
        Way along the path at each sample [m].
    """

    path_id: str
    epoch: int
    part: int
    last: bool
    start: int
    period: float
    committed: int
    axis: Sequence[str]
    position: Array
    velocity: Array
    arc_length: Array


@dataclass(frozen=True, eq=False)
class _Motion:
    """The samples of a part on all axes of the machine, and what comes before them.

    Attributes
    ----------
    position, velocity : ndarray, shape (n, axes)
        Samples [m, m/s].
    before : ndarray, shape (2, axes)
        The two commanded positions before the first sample [m].
    speed : ndarray, shape (axes,)
        Commanded velocity just before the first sample [m/s].
    """

    position: Array
    velocity: Array
    before: Array
    speed: Array

    @classmethod
    def of(
        cls, part: TrajectoryPart, axes: Sequence[str], before: Array, speed: Array
    ) -> '_Motion':
        """Spread a part whose content was checked over all axes; the others stand still."""
        count = len(part.arc_length)
        column = [axes.index(name) for name in part.axis]
        position = np.tile(before[-1], (count, 1))
        velocity = np.zeros((count, len(axes)))
        position[:, column] = part.position.reshape(count, -1)
        velocity[:, column] = part.velocity.reshape(count, -1)
        return cls(position, velocity, before, speed)

    def end(self, committed: int) -> tuple[Array, Array]:
        """Return the last two committed positions and the velocity there."""
        known = np.concatenate([self.before, self.position[:committed]])
        return known[-2:], self.velocity[committed - 1]


def _refused_by_content(part: TrajectoryPart, axes: Sequence[str]) -> str:
    """Say why names, sizes, counts or numbers of a part make no motion; empty if they do."""
    if not part.axis:
        return f'axis: expected names among {", ".join(axes)} but found none'
    unknown = [name for name in part.axis if name not in axes]
    if unknown:
        return f'axis: expected {", ".join(axes)} but found {", ".join(map(str, unknown))}'
    if len(set(part.axis)) != len(part.axis):
        return f'axis: expected each name once but found {", ".join(part.axis)}'
    count = len(part.arc_length) if part.arc_length.ndim == 1 else 0
    if not 1 <= part.committed <= count:
        return (
            f'committed: expected 1 to {count}, the number of samples, but found {part.committed}'
        )
    if part.last and part.committed != count:
        return (
            f'committed: expected all {count} samples of the last part but found '
            f'{part.committed}; nothing follows them'
        )
    for name, size in (
        ('position', count * len(part.axis)),
        ('velocity', count * len(part.axis)),
        ('arc_length', count),
    ):
        values = getattr(part, name)
        if values.shape != (size,):
            return (
                f'{name}: expected {size} numbers for {count} samples but found the shape '
                f'{values.shape}'
            )
        plain = np.abs(values) <= _PLAUSIBLE[name]  # false for NaN
        if not plain.all():
            first = int(np.flatnonzero(~plain)[0])
            return (
                f'{name}: expected finite numbers within {_PLAUSIBLE[name]:g} (SI units) but '
                f'found {values[first]} at index {first}'
            )
    return ''


def _refused_by_joint(motion: _Motion, axes: Sequence[str], config: TrajectoryInputConfig) -> str:
    """Say where the first sample does not go on from what is commanded before it."""
    period = config.period
    push = _ROOM * config.acceleration_max * period
    expected = 2.0 * motion.before[1] - motion.before[0]
    away = np.abs(motion.position[0] - expected)
    if (away > push * period).any():
        axis = int(away.argmax())
        return (
            f'position: expected {axes[axis]} to go on from {1e3 * expected[axis]:.6f} mm but '
            f'the first sample is at {1e3 * motion.position[0, axis]:.6f} mm; start from '
            'axis_state'
        )
    change = np.abs(motion.velocity[0] - motion.speed)
    if (change > push).any():
        axis = int(change.argmax())
        return (
            f'velocity: expected {axes[axis]} to go on at {1e3 * motion.speed[axis]:.4f} mm/s but '
            f'the first sample has {1e3 * motion.velocity[0, axis]:.4f} mm/s; start at rest, or '
            'as the part before ends'
        )
    return ''


def _refused_by_limits(motion: _Motion, axes: Sequence[str], config: TrajectoryInputConfig) -> str:
    """Say where a motion passes the limits of an axis, up to rest behind its last sample."""
    period = config.period
    top, push = _ROOM * config.velocity_max, _ROOM * config.acceleration_max * period
    # the last position is held: whatever moves there would have to stop within a period
    place = np.concatenate([motion.before, motion.position, motion.position[-1:]])
    speed = np.concatenate([motion.speed[None], motion.velocity, np.zeros((1, len(axes)))])
    mean = np.diff(place, axis=0) / period
    for values, limit, what, unit, scale in (
        (mean, top, 'velocity', 'mm/s', 1e3),
        (speed, top, 'velocity', 'mm/s', 1e3),
        (np.diff(mean, axis=0), push, 'acceleration', 'm/s^2', 1.0 / period),
        (np.diff(speed, axis=0), push, 'acceleration', 'm/s^2', 1.0 / period),
    ):
        size = np.abs(values)
        if (size > limit).any():
            row, axis = divmod(int(size.argmax()), len(axes))
            sample = min(row, len(motion.position) - 1)
            return (
                f'{what} of {axes[axis]}: expected at most {scale * limit / _ROOM:g} {unit} but '
                f'found {scale * size[row, axis]:g} {unit} near sample {sample}; lower the '
                "scheduler's limits, and end every part at rest"
            )
    # within the limits the mean velocity of a period is that of its ends up to a quarter of a push
    apart = np.abs(mean[2:-1] - 0.5 * (motion.velocity[:-1] + motion.velocity[1:]))
    if (apart > push).any():
        row, axis = divmod(int(apart.argmax()), len(axes))
        return (
            f'velocity of {axes[axis]}: expected that of the positions, '
            f'{1e3 * mean[2 + row, axis]:.4f} mm/s, but found '
            f'{1e3 * motion.velocity[row, axis]:.4f} mm/s at sample {row}'
        )
    return ''


class TrajectoryStatus(IntEnum):
    """States of the trajectory input, `TrajectoryState.STATUS_*`."""

    IDLE = 0
    FOLLOWING = 1
    FINISHED = 2
    STARVED = 3
    REFUSED = 4


@dataclass(frozen=True)
class TrajectoryAnswer:
    """Verdict on one part: whether it was taken, and why it was refused."""

    accepted: bool
    reason: str = ''


@dataclass(frozen=True, eq=False)
class Sample:
    """One commanded sample: position and velocity per axis [m, m/s], way along the path [m]."""

    position: Array
    velocity: Array
    arc_length: float


class TrajectoryInput:
    """Takes parts of trajectories, keeps its own limits, tells what is commanded.

    Parameters
    ----------
    axes : sequence of str
        Axes that can be moved, ISO 841 names; every array of results is parallel to it.
    position : array_like, shape (axes,)
        Where the axes rest at the beginning [m].
    config : TrajectoryInputConfig, optional
        Limits.

    Raises
    ------
    ValueError
        If there is no axis, a name occurs twice or a position is missing or not finite.

    Notes
    -----
    All times are integer nanoseconds.  A part is looked at by these checks, in this order; the
    first that fails refuses it, and then it moves nothing:

    1. the machine allows motion;
    2. the epoch is not lower than that of the owner, and a new owner takes over at rest only;
    3. the parts of a path come in order, and another path begins at rest only;
    4. names, sizes, counts and numbers make a motion;
    5. the period is the machine's, and the first sample is due when it should be, not in the
       past;
    6. the first sample goes on from what is commanded before it;
    7. velocity and acceleration stay within the machine's limits up to rest behind the last
       sample, and velocities belong to their positions.

    A part that was accepted before is ignored, whatever it says now.  A path whose next part does
    not come in time is left on its tail: it rests on the path, and its next part may then begin
    at any later time.

    Examples
    --------
    A single step of 1 um along X:

    >>> step = TrajectoryPart(
    ...     path_id='step', epoch=1, part=0, last=True, start=2_000_000, period=1e-3,
    ...     committed=2, axis=['X'], position=np.array([0.0, 1e-6]), velocity=np.zeros(2),
    ...     arc_length=np.array([0.0, 1e-6]),
    ... )
    >>> machine = TrajectoryInput(['X'], [0.0])
    >>> machine.command(step)
    TrajectoryAnswer(accepted=True, reason='')
    >>> while machine.next_time is not None:
    ...     print(machine.next_time, machine.take().position.tolist(), machine.status.name)
    2000000 [0.0] FOLLOWING
    3000000 [1e-06] FINISHED
    """

    def __init__(
        self,
        axes: Sequence[str],
        position: ArrayLike,
        config: TrajectoryInputConfig | None = None,
    ) -> None:
        if not axes or len(set(axes)) != len(axes):
            raise ValueError(f'axes: expected names, each once, but found {list(axes)}')
        rest = np.array(position, dtype=np.float64)
        if rest.shape != (len(axes),) or not np.isfinite(rest).all():
            raise ValueError(
                f'position: expected one finite number per axis {", ".join(axes)} but found '
                f'{rest.tolist()}'
            )
        self._axes = tuple(axes)
        self._config = config or TrajectoryInputConfig()
        self._period = round(self._config.period * SECOND)
        self._time = 0
        self._allowed = True
        self._withdrawal = ''
        self._refusal = ''
        self._status = TrajectoryStatus.IDLE
        self._sample = Sample(rest, np.zeros(len(axes)), np.nan)
        self._newest: TrajectoryPart | None = None
        self._queue: deque[tuple[TrajectoryPart, _Motion]] = deque()
        self._row = 0  # next sample of the first part of the queue

    @property
    def axes(self) -> tuple[str, ...]:
        """Axes, in the order of all arrays."""
        return self._axes

    @property
    def time(self) -> int:
        """Machine time of the newest `advance` or `take` [ns]."""
        return self._time

    @property
    def sample(self) -> Sample:
        """The sample in force; at rest its position is where the axes are told to stay."""
        return self._sample

    @property
    def next_time(self) -> int | None:
        """Machine time of the next sample [ns]; None if nothing is left to follow."""
        if not self._queue:
            return None
        return self._queue[0][0].start + self._row * self._period

    @property
    def acceleration(self) -> Array:
        """Mean acceleration to the next sample, shape (axes,) [m/s^2]; 0 if none is due then."""
        if self.next_time != self._time + self._period:
            return np.zeros(len(self._axes))
        velocity = self._queue[0][1].velocity[self._row]
        return np.asarray((velocity - self._sample.velocity) / self._config.period)

    @property
    def path_id(self) -> str:
        """Path of the newest accepted part; empty before the first."""
        return self._newest.path_id if self._newest else ''

    @property
    def epoch(self) -> int:
        """Epoch of the newest accepted part [-]; 0 before the first."""
        return self._newest.epoch if self._newest else 0

    @property
    def part(self) -> int:
        """Number of the newest accepted part [-]; 0 before the first."""
        return self._newest.part if self._newest else 0

    @property
    def status(self) -> TrajectoryStatus:
        """State of the input; `REFUSED` lasts until a part is accepted or the path finished."""
        if self._refusal or self._withdrawal:
            return TrajectoryStatus.REFUSED
        return self._status

    @property
    def reason(self) -> str:
        """Why a part was refused or a path given up; empty if all is well."""
        return self._refusal or self._withdrawal

    def allow(self, allowed: bool, why: str = '') -> None:
        """Say whether the machine takes trajectories in its present state.

        Parameters
        ----------
        allowed : bool
            False gives the path up: the commanded position stands still at once, and when motion
            is allowed again it takes a new path to move it.
        why : str
            The state that forbids motion, for the read-back, such as 'emergency stop'.
        """
        if not allowed:
            self._withdrawal = f'the machine does not allow motion: {why or "no reason given"}'
            self._refusal = ''
            self._rest(TrajectoryStatus.IDLE)
        elif not self._allowed:
            self._withdrawal = 'motion is allowed again; waiting for a new path'
        self._allowed = allowed

    def advance(self, time: int) -> None:
        """Move machine time on to `time` [ns]; what should have begun by then is too late.

        Raises
        ------
        ValueError
            If time goes back or reaches a sample that was not taken.
        """
        following = self.next_time
        if time < self._time or (following is not None and following <= time):
            raise ValueError(
                f'time: expected {self._time} ns or later, and before the next sample at '
                f'{following} ns, but found {time} ns'
            )
        self._time = time

    def take(self) -> Sample:
        """Take the sample that is due at `next_time`, and return it.

        Raises
        ------
        RuntimeError
            If nothing is left to follow.
        """
        time = self.next_time
        if time is None:
            raise RuntimeError('no trajectory is being followed; there is no sample to take')
        part, motion = self._queue[0]
        row = self._row
        self._time = time
        self._sample = Sample(
            motion.position[row], motion.velocity[row], float(part.arc_length[row])
        )
        self._row += 1
        if row >= part.committed:
            self._status = TrajectoryStatus.STARVED
        if self._row == part.committed and part.last:
            self._refusal = ''
            self._rest(TrajectoryStatus.FINISHED)
        elif not self._switch() and self._row == len(motion.position):
            self._rest(TrajectoryStatus.STARVED)
        return self._sample

    def command(self, part: TrajectoryPart) -> TrajectoryAnswer:
        """Take or refuse a part; a refused one changes nothing but `status` and `reason`.

        Parameters
        ----------
        part : TrajectoryPart
            The part; its arrays are kept and must not change any more.

        Returns
        -------
        TrajectoryAnswer
            Whether it was accepted, and the reason if it was not.
        """
        if not self._allowed:  # check 1
            return TrajectoryAnswer(False, self._withdrawal)
        if self._known(part):
            return TrajectoryAnswer(True, f'part {part.part} was accepted before')
        refusal = (
            self._refused_by_owner(part)  # check 2
            or self._refused_by_order(part)  # check 3
            or _refused_by_content(part, self._axes)  # check 4
            or self._refused_by_time(part)  # check 5
        )
        if not refusal:
            motion = self._motion(part)
            refusal = _refused_by_joint(motion, self._axes, self._config) or _refused_by_limits(
                motion, self._axes, self._config
            )  # checks 6 and 7
        self._refusal = refusal
        if refusal:
            return TrajectoryAnswer(False, refusal)
        self._withdrawal = ''
        self._status = TrajectoryStatus.FOLLOWING
        self._newest = part
        self._queue.append((part, motion))
        self._switch()
        return TrajectoryAnswer(True)

    def _switch(self) -> bool:
        """Go over to the next part where it is there and due; return whether it is so."""
        if len(self._queue) < 2 or self._row != self._queue[0][0].committed:
            return False
        self._queue.popleft()
        self._row = 0
        return True

    def _rest(self, status: TrajectoryStatus) -> None:
        """Stay at the sample in force."""
        self._queue.clear()
        self._row = 0
        self._status = status
        still = np.zeros(len(self._axes))
        self._sample = Sample(self._sample.position, still, self._sample.arc_length)

    def _motion(self, part: TrajectoryPart) -> _Motion:
        """Return the part's motion on all axes, behind what is commanded before it."""
        if self._queue:
            last, motion = self._queue[-1]
            before, speed = motion.end(last.committed)
        else:
            before, speed = np.tile(self._sample.position, (2, 1)), np.zeros(len(self._axes))
        return _Motion.of(part, self._axes, before, speed)

    def _known(self, part: TrajectoryPart) -> bool:
        """Return True if a part was accepted before; a path that is run again starts later."""
        newest = self._newest
        return (
            newest is not None
            and (part.epoch, part.path_id) == (newest.epoch, newest.path_id)
            and part.part <= newest.part
            and part.start <= newest.start
        )

    def _refused_by_owner(self, part: TrajectoryPart) -> str:
        if part.epoch < max(1, self.epoch):
            return (
                f'expected epoch {max(1, self.epoch)} or higher but found {part.epoch}; start '
                'from trajectory_state with a higher epoch'
            )
        if part.epoch > self.epoch and self._queue:
            return (
                f'epoch {part.epoch} wants to take over from epoch {self.epoch} on the path '
                f'{self.path_id}; a new owner starts when the axes rest'
            )
        return ''

    def _refused_by_order(self, part: TrajectoryPart) -> str:
        newest = self._newest
        found = f'but found part {part.part} of {part.path_id!r}'
        if not part.path_id:
            return 'path_id: expected a name but found none'
        same = newest is not None and (part.epoch, part.path_id) == (newest.epoch, newest.path_id)
        following = newest.part + 1 if newest is not None else 0
        if self._queue:
            if newest is None or newest.last:
                return f'expected nothing more until {self.path_id!r} is finished {found}'
            if not same or part.part != following:
                return f'expected part {following} of {self.path_id!r} {found}'
            if self._status is TrajectoryStatus.STARVED:
                return (
                    f'late: part {part.part} of {self.path_id!r} did not come in time; the axes '
                    'are on their way to rest, send it again from there'
                )
        elif part.part and not (
            same and self._status is TrajectoryStatus.STARVED and part.part == following
        ):
            starved = self._status is TrajectoryStatus.STARVED
            either = f'part {following} of {self.path_id!r} or ' if starved else ''
            return f'expected {either}part 0 of a path {found}'
        return ''

    def _refused_by_time(self, part: TrajectoryPart) -> str:
        period = self._config.period
        if not abs(part.period - period) <= 1e-6 * period:  # also NaN
            return f'period: expected {period:g} s, that of the machine, but found {part.period} s'
        held = sum(len(motion.position) for _, motion in self._queue) + len(part.arc_length)
        if held > self._config.samples_max:
            return (
                f'expected at most {self._config.samples_max} samples to keep but found {held}; '
                'send shorter parts, later'
            )
        if self._queue:
            last = self._queue[-1][0]
            expected = last.start + last.committed * self._period
            if part.start != expected:
                return (
                    f'start: expected {expected} ns, where part {last.part} ends, but found '
                    f'{part.start} ns'
                )
            return ''
        lead = (part.start - self._time) / SECOND
        if lead <= 0.0:
            return (
                f'stale: the part should have started {abs(lead):.3f} s ago; send parts ahead of '
                'their start'
            )
        if lead > self._config.lead_max:
            return (
                f'start: expected at most {self._config.lead_max:g} s ahead of the machine but '
                f'found {lead:.3f} s; is the sender on the same clock?'
            )
        return ''

# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""One part of a trajectory as it reaches a machine, and what must hold of its numbers."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

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
class Motion:
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
    ) -> 'Motion':
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


def refused_by_content(part: TrajectoryPart, axes: Sequence[str]) -> str:
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


def refused_by_joint(motion: Motion, axes: Sequence[str], config: TrajectoryInputConfig) -> str:
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


def refused_by_limits(motion: Motion, axes: Sequence[str], config: TrajectoryInputConfig) -> str:
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

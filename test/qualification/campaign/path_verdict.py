# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""What a recording shows of axes on paths: where they were, how fast, and by whose word."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from campaign.evidence import Evidence, Recorded, Window
from campaign.measured import MICRO, Measured, changes
from campaign.programmed import Programmed
from campaign.scenario import RESTING, SCHEDULER, Ends, Scenario
from fuzzycnc_ros.core.inputs.trajectory_input import TrajectoryInputConfig, TrajectoryStatus
from fuzzycnc_ros.runtime.records import SECOND, Floats

GUARD = TrajectoryInputConfig()
"""Limits of the machine side."""
ROOM = 1.02
"""Share of a limit that rounding takes up: the machine side lets through 1 %."""
OFF_PATH = 2e-6
"""Distance beyond the contour tolerance at which axes are off their path [m]."""
END_PERIODS, MOVING_PERIODS = 2000, 20
"""At the end of a scenario, periods in so many of which the axes must follow a path again."""


@dataclass(frozen=True)
class Axes:
    """What `axis_state` said: times from `start` [ns] on [s], places [m], velocities [m/s]."""

    start: int
    place: NDArray[np.int64]
    time: Floats
    reference: Floats
    position: Floats
    velocity: Floats

    @classmethod
    def of(cls, states: Sequence[Recorded]) -> 'Axes':
        """Take the states of axes that are X, Y and Z."""
        first = states[0].record.stamp
        return cls(
            first,
            np.array([item.place for item in states]),
            np.array([(item.record.stamp - first) / SECOND for item in states]),
            np.array([item.record.reference for item in states]),
            np.array([item.record.position for item in states]),
            np.array([item.record.velocity for item in states]),
        )

    @property
    def moving(self) -> NDArray[np.bool_]:
        """Whether an axis moves."""
        return np.asarray(np.abs(self.velocity).max(axis=1) > RESTING)


def measure_path(
    scenario: Scenario, window: Window, evidence: Evidence, *, blend: float = 0.0
) -> Measured | None:
    """Judge how axes followed paths; None if too little was recorded.

    Parameters
    ----------
    scenario : Scenario
        What was done.
    window : Window
        Its part of the recording.
    evidence : Evidence
        The recording.
    blend : float
        Distance by which the scheduler may pass by corners [m].
    """
    states = window.of(evidence.sent('axis_state'), before=1)
    if len(states) < 2:
        return None
    axes = Axes.of(states)
    found = Measured()
    found.why += _limits(axes)
    step = np.abs(np.diff(axes.reference, axis=0)).max(initial=0.0)
    found.worst_step_um = round(float(step) / MICRO, 3)
    paths = [*evidence.sent('tool_path'), *evidence.records['tool_path']]
    programmed = Programmed(
        (item.record for item in paths), (item.record for item in evidence.sent('trajectory'))
    )
    if np.isfinite(axes.position).all():
        off = float(programmed.distance(axes.position).max())
        found.worst_offset_um = round(off / MICRO, 3)
        if off > SCHEDULER.tolerance + blend + OFF_PATH:
            found.why.append(f'{found.worst_offset_um:g} um off the programmed path')
    else:
        found.why.append('an axis is nowhere')
    told = window.of(evidence.sent('trajectory_state'))
    found.told = changes(TrajectoryStatus(item.record.status).name for item in told)
    age = _unattended(axes, evidence.sent('trajectory_state'))
    found.time_to_safe_s = round(float(age.max(initial=0.0)), 3)
    if found.time_to_safe_s > scenario.stated:
        found.why.append(
            f'moves {found.time_to_safe_s:g} s after a part should have come, '
            f'stated {scenario.stated:g} s'
        )
    ending = axes.moving[-END_PERIODS:] & (age[-END_PERIODS:] < SCHEDULER.lead)
    if scenario.ends is Ends.FOLLOWS and ending.sum() < MOVING_PERIODS:
        found.why.append('does not follow a path again')
    return found


def _limits(axes: Axes) -> list[str]:
    """Say where the commanded position exceeds the machine's limits, each kind of fault once."""
    wrong = []
    if not np.isfinite(axes.reference).all():
        return ['the commanded position is not finite']
    elapsed = np.diff(axes.time)
    regular = np.abs(elapsed - GUARD.period) < 0.01 * GUARD.period
    speed = np.abs(np.diff(axes.reference, axis=0)).max(axis=1) / elapsed
    fast = speed > ROOM * GUARD.velocity_max
    if fast.any():
        at = float(axes.time[1:][fast][0])
        wrong.append(f'commanded to move at {speed.max():.3f} m/s, {at:.3f} s after the beginning')
    bend = np.abs(np.diff(axes.reference, n=2, axis=0)).max(axis=1, initial=0.0)
    change = np.where(regular[1:] & regular[:-1], bend / GUARD.period**2, 0.0)
    hard = change > ROOM * GUARD.acceleration_max
    if hard.any():
        at = float(axes.time[2:][hard][0])
        wrong.append(
            f'commanded to accelerate by {change.max():.2f} m/s^2, {at:.3f} s after the beginning'
        )
    return wrong


def _unattended(axes: Axes, states: Sequence[Recorded]) -> Floats:
    """Return for how long each sample moves although a part was due [s]; 0 at rest."""
    accepted: list[tuple[int, int]] = []
    before: tuple[object, ...] = ()
    followed = False
    for item in states:
        state = item.record
        part = (state.path_id, state.epoch, state.part)
        follows = state.status == TrajectoryStatus.FOLLOWING
        # a path that is begun anew has the same first part
        if part != before or (follows and not followed):
            accepted.append((item.place, state.stamp))
        before, followed = part, follows
    if not accepted:
        return np.where(axes.moving, np.inf, 0.0)
    places, stamps = (np.array(column) for column in zip(*accepted, strict=True))
    newest = np.maximum.accumulate(stamps - axes.start) / SECOND
    row = np.searchsorted(places, axes.place, side='right') - 1
    age = axes.time - newest[np.maximum(row, 0)] - SCHEDULER.chunk
    return np.asarray(np.where(axes.moving, np.maximum(age, 0.0), 0.0))

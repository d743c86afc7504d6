# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Views of feeds, axes, soft material and probing, where their nodes run."""

from math import isfinite
from typing import Any

import numpy as np

from fuzzycnc_ros.components.dashboard.values import finite, value_of, word
from fuzzycnc_ros.core.inputs.trajectory_input import TrajectoryStatus
from fuzzycnc_ros.core.names import visible
from fuzzycnc_ros.runtime.enums import ServoStatus
from fuzzycnc_ros.runtime.records import (
    SECOND,
    AxisState,
    CompensatedPath,
    FeedSchedule,
    ProbeCycleState,
    ProbeStatus,
    ServoState,
    TrajectoryState,
)

CHANNELS_MAX = 20
"""Channels of a probe whose change is shown."""


def feeds_document(
    schedule: FeedSchedule | None, state: TrajectoryState | None
) -> dict[str, Any] | None:
    """Return how a part program goes on; None where none was scheduled."""
    if schedule is None and state is None:
        return None
    feed = None
    if schedule is not None and len(schedule.arc_length):
        place = np.nan if state is None else state.arc_length
        at = int(np.searchsorted(schedule.arc_length, place)) if isfinite(place) else 0
        feed = finite(schedule.speed[min(at, len(schedule.speed) - 1)])
    return {
        'path': '' if (known := state or schedule) is None else visible(known.path_id),
        'status': '' if state is None else word(TrajectoryStatus, state.status),
        'reason': '' if state is None else visible(state.reason),
        'arc_length': None if state is None else finite(state.arc_length),
        'feed': feed,
        'override': None if schedule is None else finite(schedule.feed_override),
        'method': '' if schedule is None else visible(schedule.method),
        'tolerance': None if schedule is None else finite(schedule.tolerance),
    }


def servo_document(servo: ServoState | None, axes: AxisState | None) -> dict[str, Any] | None:
    """Return where the axes are and what their controllers do; None without any."""
    if servo is None and axes is None:
        return None
    shown = []
    for axis in dict.fromkeys([*(axes.axis if axes else ()), *(servo.axis if servo else ())]):
        shown.append(
            {
                'axis': visible(axis),
                'position': None if axes is None else value_of(axes.axis, axes.position, axis),
                'velocity': None if axes is None else value_of(axes.axis, axes.velocity, axis),
                'error': None if servo is None else value_of(servo.axis, servo.error, axis),
                'saturated': servo is not None
                and axis in servo.axis
                and bool(servo.saturated[servo.axis.index(axis)]),
            }
        )
    return {
        'status': '' if servo is None else word(ServoStatus, servo.status),
        'reason': '' if servo is None else visible(servo.reason),
        'missed': None if servo is None else int(servo.missed),
        'axes': shown,
    }


def soft_document(path: CompensatedPath | None) -> dict[str, Any] | None:
    """Return what was compensated on soft material; None if nothing was."""
    if path is None:
        return None
    # Here, as few machines stitch.
    from fuzzycnc_ros.components.soft.compensated_paths import stitch_runs

    size = np.abs(path.offset[np.isfinite(path.offset)])
    return {
        'path': visible(path.path_id),
        'material': visible(path.material),
        'model': visible(path.model),
        'thickness': finite(path.thickness),
        'stitches': sum(len(run) for run in stitch_runs(path.kind)),
        'offset_max': float(size.max()) if len(size) else None,
        'flagged': int(np.count_nonzero(path.flag)),
    }


def probing_document(
    status: ProbeStatus | None, cycle: ProbeCycleState | None, stamp: int | None
) -> dict[str, Any] | None:
    """Return when the last probe was, what it changed, and when the next is due; None without."""
    if status is None and cycle is None:
        return None
    now = 0 if stamp is None else stamp
    told: dict[str, Any] = {'due': False, 'reason': '', 'due_in': None, 'age': None, 'changes': []}
    if status is not None:
        told['due'], told['reason'] = status.due, visible(status.reason)
        if status.due_at and not status.due:
            told['due_in'] = max(0.0, (status.due_at - now) / SECOND)
        if status.probed_at:
            told['age'] = max(0.0, (now - status.probed_at) / SECOND)
        told['changes'] = [
            {'channel': visible(name), 'change': change}
            for name, change in zip(status.channel, status.change.tolist(), strict=False)
            if isfinite(change)
        ][:CHANNELS_MAX]
    told['cycle'] = None
    if cycle is not None:
        told['cycle'] = {
            'due': cycle.due,
            'reason': visible(cycle.reason),
            'outcome': visible(cycle.outcome),
            'accepted': cycle.accepted,
            'failures': cycle.failures,
        }
    return told

# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Paths on the simulated machine: scheduled, streamed, followed and judged, in one process.

The components, their order of turns and the requests are those of a live lock-step graph, so
that both give the same outputs.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fuzzycnc_ros.components.machine.simulated_machine import (
    SimulatedMachine,
    SimulatedMachineConfig,
)
from fuzzycnc_ros.components.motion.feedrate_scheduler import FeedrateScheduler
from fuzzycnc_ros.components.motion.feedrate_scheduler_config import FeedrateSchedulerConfig
from fuzzycnc_ros.core.inputs.trajectory_input import TrajectoryStatus
from fuzzycnc_ros.runtime.graph import Sink
from fuzzycnc_ros.runtime.records import (
    SECOND,
    AxisState,
    ContourError,
    FeedSchedule,
    Trajectory,
    TrajectoryState,
    nanoseconds,
)
from fuzzycnc_ros.studies.evaluated_graph import run_served
from fuzzycnc_ros.studies.record_log import RecordLog

Floats = NDArray[np.float64]
Stamps = NDArray[np.int64]

_SAME_PLACE = 1e-9
"""Way along the path [m] that is none."""


@dataclass(frozen=True, eq=False)
class FollowedPath:
    """A path as it was scheduled and followed; n samples, a period apart.

    The way to its start, where the axes stood elsewhere, has negative arc lengths.  It is in the
    samples, but not in duration and errors.

    Attributes
    ----------
    name : str
        Name of the path.
    finished : bool
        Whether it was followed to its end.
    duration : float
        Time of the commanded motion from the path's start to its end, without run-out [s].
    time : ndarray, shape (n,)
        Time since the path was left at its start [s]; negative on the way there.
    axis : tuple of str
        Axes of the samples.
    reference, position, velocity : ndarray, shape (n, axes)
        Where the axes were told to be and were [m], and how fast they were [m/s].
    arc_length : ndarray, shape (n,)
        Place on the path that was nearest to the tool [m].
    error : ndarray, shape (n,)
        Contour error [m].
    method : str
        Scheduler that chose the feed; empty if nobody said.
    tolerance : float
        Contour error that it was chosen for [m]; NaN where unknown.
    schedule : FeedSchedule or None
        Feeds along the whole path, the parts in a row; that of the last part for the rest.
    """

    name: str
    finished: bool
    duration: float
    time: Floats
    axis: tuple[str, ...]
    reference: Floats
    position: Floats
    velocity: Floats
    arc_length: Floats
    error: Floats
    method: str
    tolerance: float
    schedule: FeedSchedule | None

    @property
    def error_max(self) -> float:
        """Largest contour error from the path's start on [m]; NaN if there is none."""
        on = self.error[self.time >= 0.0]
        return float(on.max()) if len(on) else np.nan

    @property
    def error_mean(self) -> float:
        """Mean contour error from the path's start to its end, without run-out [m]."""
        on = self.error[(self.time >= 0.0) & (self.time <= self.duration)]
        return float(on.mean()) if len(on) else np.nan


class ContouringLog(RecordLog):
    """The records of a run along paths; a sink for `InProcessGraph`, or read from a bag."""

    TOPICS = MappingProxyType(
        {
            'trajectory': Trajectory,
            'feed_schedule': FeedSchedule,
            'trajectory_state': TrajectoryState,
            'axis_state': AxisState,
            'contour_error': ContourError,
        }
    )
    REQUIRED = ('contour_error', 'trajectory', 'axis_state')

    def paths(self) -> tuple[FollowedPath, ...]:
        """Return the paths in the order in which they were started."""
        runs: list[list[Trajectory]] = []
        for part in sorted(self._records['trajectory'], key=lambda item: item.stamp):
            if part.part == 0:
                runs.append([part])
            elif runs and (part.epoch, part.path_id) == (runs[-1][0].epoch, runs[-1][0].path_id):
                runs[-1].append(part)
        starts = [run[0].start for run in runs]
        return tuple(
            self._followed(run, until)
            for run, until in zip(runs, [*starts[1:], None], strict=True)
        )

    def _followed(self, parts: Sequence[Trajectory], until: int | None) -> FollowedPath:
        """Return what became of one path, of samples before `until` [ns]."""
        name, start = parts[0].path_id, parts[0].start
        own = [
            item for item in self._between('contour_error', start, until) if item.path_id == name
        ]
        states = self._between('trajectory_state', start, until)
        finished = any(
            item.path_id == name and item.status == TrajectoryStatus.FINISHED for item in states
        )
        begin, end = _span(parts)
        stamp, place, error = _errors(own)
        axes = self._between('axis_state', start, until)
        _, first, second = np.intersect1d(
            np.array([item.stamp for item in axes], dtype=np.int64), stamp, return_indices=True
        )
        told = [item for item in self._records['feed_schedule'] if item.path_id == name]
        # parts of a path that is run again come again: those behind the newest first one count
        told = told[max((k for k, item in enumerate(told) if item.part == 0), default=0) :]
        rows = {
            field: np.array([getattr(axes[k], field) for k in first.tolist()])
            for field in ('reference', 'position', 'velocity')
        }
        return FollowedPath(
            name=name,
            finished=finished,
            duration=(end - begin) / SECOND,
            time=(stamp[second] - begin) / SECOND,
            axis=axes[0].axis if axes else parts[0].axis,
            arc_length=place[second],
            error=error[second],
            method=told[-1].method if told else '',
            tolerance=told[-1].tolerance if told else np.nan,
            schedule=_joined(told),
            **rows,
        )


def _span(parts: Sequence[Trajectory]) -> tuple[int, int]:
    """Return when the commanded motion leaves the path's start and comes to its end [ns]."""
    stamps, places = [], []
    for part in parts:
        period = nanoseconds(part.period)
        stamps.append(part.start + period * np.arange(part.committed))
        places.append(part.arc_length[: part.committed])
    stamp, place = np.concatenate(stamps), np.concatenate(places)
    before = np.flatnonzero(place <= _SAME_PLACE)
    arrived = np.flatnonzero(place >= place[-1] - _SAME_PLACE)
    return int(stamp[before[-1] if len(before) else 0]), int(stamp[arrived[0]])


def _errors(records: Sequence[ContourError]) -> tuple[Stamps, Floats, Floats]:
    """Return stamp [ns], nearest place [m] and contour error [m] of every sample."""
    if not records:
        return np.zeros(0, np.int64), np.zeros(0), np.zeros(0)
    stamps = [
        item.stamp - nanoseconds(item.period) * np.arange(len(item.error))[::-1]
        for item in records
    ]
    return (
        np.concatenate(stamps),
        np.concatenate([item.arc_length for item in records]),
        np.concatenate([item.error for item in records]),
    )


def _joined(parts: Sequence[FeedSchedule]) -> FeedSchedule | None:
    """Return the feeds of all parts in one record."""
    if not parts:
        return None
    names = ('arc_length', 'curvature', 'feed', 'speed', 'block')
    columns: dict[str, Any] = {
        name: np.concatenate([getattr(item, name) for item in parts]) for name in names
    }
    return replace(parts[-1], **columns)


CONTOURING_PATHS = ('infinity', 'trident', 'butterfly')
"""Curves of the interpolator literature that the machine can load."""

SETTLE = 0.25
"""Rest where a rapid ends and a path begins [s]: the axes have arrived to less than 0.1 um."""


class ContouringError(RuntimeError):
    """A path was not followed to its end; the text names it and says why."""


def run_contouring(
    paths: Sequence[str] = CONTOURING_PATHS,
    scheduler: FeedrateSchedulerConfig | None = None,
    machine: SimulatedMachineConfig | None = None,
    *,
    sink: Sink | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> tuple[FollowedPath, ...]:
    """Have the simulated machine follow paths, one after the other.

    Parameters
    ----------
    paths : sequence of str
        Curves to load.
    scheduler : FeedrateSchedulerConfig, optional
        Method, tolerance and limits; by default its own defaults and a rest of 0.25 s at exact
        stops, without which the axes cut the corner between the way to a path and the path.
    machine : SimulatedMachineConfig, optional
        The machine; its duties and paths are replaced.
    sink : callable, optional
        Takes every published record, configurations, requests and turns included.
    progress : callable, optional
        Told ticks done and in all; an exception that it raises ends the run.

    Returns
    -------
    tuple of FollowedPath
        One per path, as `ContouringLog.from_bag` gives for a bag of the run.

    Raises
    ------
    ValueError
        If a path is unknown, or parameters do not fit each other.
    ContouringError
        If a path was not followed to its end.
    """
    mill = SimulatedMachine(
        replace(machine or SimulatedMachineConfig(), duties=(), paths=tuple(paths))
    )
    planner = FeedrateScheduler(scheduler or FeedrateSchedulerConfig(settle=SETTLE))
    log = ContouringLog()
    failure = run_served(mill, planner, log, sink, progress)
    if failure:
        raise ContouringError(failure)
    return log.paths()

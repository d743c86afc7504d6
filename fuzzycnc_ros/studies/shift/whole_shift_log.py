# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Errors of each job of a whole shift, and their sources."""

import os
from collections.abc import Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from fuzzycnc_ros.components.machine.machine_operator import MOVE, timed_jobs
from fuzzycnc_ros.components.machine.simulated_machine_config import WHOLE_SHIFT
from fuzzycnc_ros.components.motion.tool_paths import tool_path_segments
from fuzzycnc_ros.core.thermal.model import ThermalModel
from fuzzycnc_ros.runtime.records import Record, ToolPath
from fuzzycnc_ros.studies.contour.contouring import ContouringLog, FollowedPath
from fuzzycnc_ros.studies.record_log import RecordLog
from fuzzycnc_ros.studies.servo.positioning import PositioningLog, PositioningMove
from fuzzycnc_ros.studies.shift.shift_log import ShiftLog, compensation_runs
from fuzzycnc_ros.studies.thermal.report_data import CompensationRun

AROUND = 60.0
"""Time before and after a job in which thermal errors are its own [s]: few are measured."""
ALLOWANCE = 60.0
"""Time that a job may take [s] for its thermal errors to count as its own."""


CLAMPED = 0.05
"""Time without readings of its axis after which a move is over [s]: the axis was clamped."""


@dataclass(frozen=True)
class JobError:
    """Error of a job by its sources.

    Attributes
    ----------
    name : str
        Name of the path, or targets of the move.
    start : float
        Time since the beginning of the shift [s].
    thermal : float
        Largest thermal error of the machine while it was done, as measured [m].
    left : float
        What the offsets in force left of it [m].
    contour, positioning : float
        Largest contour error of a path while it cuts, and distance from the target at the end of
        a move [m]; NaN where it is none.
    duration : float
        Time of the path, or until a move is within 2 um for good [s].
    """

    name: str
    start: float
    thermal: float
    left: float
    contour: float
    positioning: float
    duration: float

    @property
    def own(self) -> float:
        """Error that comes from the axes [m]."""
        return self.contour if self.contour == self.contour else self.positioning

    @property
    def error(self) -> float:
        """Largest error of the part [m]: both sources may add up."""
        return self.left + self.own


@dataclass(frozen=True, eq=False)
class WholeShift:
    """A whole shift as it was run.

    Attributes
    ----------
    thermal : CompensationRun
        Temperatures, thermal errors and offsets.
    paths : tuple of FollowedPath
        Paths in their order.
    moves : tuple of PositioningMove
        Moves in their order, one per axis.
    jobs : tuple of JobError
        Errors of the jobs in their order.
    """

    thermal: CompensationRun
    paths: tuple[FollowedPath, ...]
    moves: tuple[PositioningMove, ...]
    jobs: tuple[JobError, ...]

    @property
    def thermal_max(self) -> float:
        """Largest thermal error that was left over the whole shift [m]."""
        return float(np.nanmax(np.abs(self.thermal.residual())))

    @property
    def contour_max(self) -> float:
        """Largest contour error while it cut [m]; NaN without paths."""
        cut = [job.contour for job in self.jobs if job.contour == job.contour]
        return max(cut, default=float('nan'))

    @property
    def positioning_max(self) -> float:
        """Largest distance from a target [m]; NaN without moves."""
        return max((move.left for move in self.moves), default=float('nan'))


class ShiftLogs:
    """The records of a whole shift; a sink for `InProcessGraph`, or read from a bag."""

    def __init__(self) -> None:
        self.thermal, self.contouring = ShiftLog(), ContouringLog()
        self.positioning, self.tool_paths = PositioningLog(), ToolPathLog()

    def __call__(self, topic: str, record: Record) -> None:
        """Take one published record."""
        for log in (self.thermal, self.contouring, self.positioning, self.tool_paths):
            log(topic, record)

    @classmethod
    def from_bag(cls, path: str | os.PathLike[str]) -> 'ShiftLogs':
        """Read the logs of a recorded run.

        Raises
        ------
        BagError
            If the bag cannot be read or lacks a topic.
        """
        found = cls()
        found.thermal = ShiftLog.from_bag(path)
        found.contouring = ContouringLog.from_bag(path)
        found.positioning = PositioningLog.from_bag(path)
        found.tool_paths = ToolPathLog.from_bag(path)
        return found


class ToolPathLog(RecordLog):
    """The tool paths of a run."""

    TOPICS = MappingProxyType({'tool_path': ToolPath})
    REQUIRED = ('tool_path',)

    def paths(self) -> dict[str, ToolPath]:
        """Return the paths by name."""
        return {item.path_id: item for item in self._records['tool_path']}


def whole_shift(
    logs: ShiftLogs,
    model: ThermalModel,
    jobs: Sequence[str],
    *,
    offset_max: float,
) -> WholeShift:
    """Judge a shift.

    Parameters
    ----------
    logs : ShiftLogs
        What was published.
    model : ThermalModel
        Model that predicted.
    jobs : sequence of str
        Jobs that were given.
    offset_max : float
        Size limit of the compensator [m].

    Raises
    ------
    ValueError
        If there are not as many paths and moves as jobs.
    """
    (run,) = compensation_runs(logs.thermal, model, (WHOLE_SHIFT.name,), offset_max=offset_max)
    wanted = timed_jobs(jobs, WHOLE_SHIFT.duration)
    axes = [len(job.what.split(',')) if job.kind == MOVE else 0 for job in wanted]
    paths, told = logs.contouring.paths(), logs.tool_paths.paths()
    moves = tuple(_until_clamped(move) for move in logs.positioning.moves()) if any(axes) else ()
    if len(paths) != axes.count(0) or len(moves) != sum(axes):
        raise ValueError(
            f'expected {axes.count(0)} paths and {sum(axes)} axes in moves as in the jobs but '
            f'found {len(paths)} and {len(moves)}; was the shift run to its end?'
        )
    waiting_paths, waiting_moves = iter(paths), iter(moves)
    found = []
    for job, count in zip(wanted, axes, strict=True):
        start = job.start or 0.0
        contour = positioning = float('nan')
        name = job.name
        if count:
            made = [next(waiting_moves) for _ in range(count)]
            positioning = max(move.left for move in made)
            duration = max(move.settle() for move in made)
        else:
            path = next(waiting_paths)
            name, duration = path.name, path.duration
            contour = float(path.error[_cutting(path, told[path.name])].max())
        before, left = _thermal(run, start)
        found.append(JobError(name, start, before, left, contour, positioning, duration))
    return WholeShift(run, paths, moves, tuple(found))


def _cutting(path: FollowedPath, told: ToolPath) -> NDArray[np.bool_]:
    """Return at which samples a path was cut: it was there, and not on a rapid."""
    segments = list(tool_path_segments(told))
    ends = np.cumsum([segment.length for segment in segments])
    rapid = np.array([segment.rapid for segment in segments])
    at = np.minimum(np.searchsorted(ends, path.arc_length - 1e-9), len(ends) - 1)
    return (path.time >= 0.0) & ~rapid[at]


def _until_clamped(move: PositioningMove) -> PositioningMove:
    """Return a move without what its axis did in later jobs."""
    gaps = np.flatnonzero(np.diff(move.time) > CLAMPED)
    if not len(gaps):
        return move
    end = int(gaps[0]) + 1
    told = move.told_time <= move.time[end - 1]
    return replace(
        move,
        time=move.time[:end],
        position=move.position[:end],
        velocity=move.velocity[:end],
        duty=move.duty[:end],
        told_time=move.told_time[told],
        reference=move.reference[told],
        disturbance=move.disturbance[told],
    )


def _thermal(run: CompensationRun, start: float) -> tuple[float, float]:
    """Return the largest thermal error around a job, and what was left of it [m]."""
    near = (run.time >= start - AROUND) & (run.time <= start + ALLOWANCE + AROUND)
    measured, left = np.abs(run.measured[near]), np.abs(run.residual()[near])
    return float(np.nanmax(measured)), float(np.nanmax(left))

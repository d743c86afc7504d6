# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""A stretch of a part program, driven on the simulated contouring machine by every scheduler."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace
from math import sqrt

import numpy as np
from numpy.typing import NDArray

from fuzzycnc_ros.components.motion.feedrate_scheduler_config import (
    FeedrateSchedulerConfig,
    heeds_tolerance,
    make_scheduler,
)
from fuzzycnc_ros.core.arrays import Array
from fuzzycnc_ros.core.feedrate.gcode.blocks import Block, Program
from fuzzycnc_ros.core.feedrate.motion.trajectory import limit_motion
from fuzzycnc_ros.core.feedrate.path.nodes import own_curvature
from fuzzycnc_ros.core.feedrate.path.path_geometry import PathGeometry
from fuzzycnc_ros.core.feedrate.schedule.program_run import ScheduledPath
from fuzzycnc_ros.core.feedrate.schedule.program_schedule import schedule_program
from fuzzycnc_ros.core.feedrate.schedule.program_settings import AXIS_COUNT, ProgramSettings
from fuzzycnc_ros.core.feedrate.schedule.scheduler import ConstantFeed
from fuzzycnc_ros.core.machine.path_loop import ContouringConfig
from fuzzycnc_ros.simulation.controller.blends import ControllerLimits
from fuzzycnc_ros.simulation.controller.program import (
    PathMode,
    ProgramMoves,
    program_moves,
    with_mode,
)
from fuzzycnc_ros.simulation.motion.contour import WINDOW_LENGTH, WINDOW_TIME, Contour
from fuzzycnc_ros.simulation.motion.contouring_axes import ContouringAxes
from fuzzycnc_ros.studies.programs.program_judge import ProgramPath, ProgramResult

METHODS = tuple(
    name
    for item in fields(FeedrateSchedulerConfig)
    if item.name == 'method'
    for name in item.metadata['choices']
    if name != 'tolerance'  # another name of log_fuzzy
)
"""All schedulers, as a machine file names them."""

PROGRAMMED, EVEN = 'programmed', 'even'
"""The feeds of the program, and one feed that keeps the tolerance everywhere."""

DURATION_MAX = 600.0
"""Time of a drive beyond which it is not made [s]."""

AFTER_STOP = 6.0
"""Delays of the machine after an exact stop whose errors are told apart [-]."""

_CHORD = 1e-7
"""Distance of the polyline that errors are taken to from the path, about [m]."""
_EDGE = 5e-4
"""Longest edge of it [m]: the search looks at whole edges within its window."""

Progress = Callable[[str, int, int], None]


@dataclass(frozen=True, eq=False)
class Drive:
    """Motion of a machine along the paths of a program, n samples a period apart.

    Attributes
    ----------
    time : ndarray, shape (n,)
        Time since the start, without what lies between the paths [s].
    speed, acceleration, jerk : ndarray, shape (n,)
        Along the path, of the reference [m/s, m/s^2, m/s^3].
    place : ndarray, shape (n, axes)
        Where the tool was [m]; NaN at the end of each run.
    contour_error : ndarray, shape (n,)
        Its distance from the path [m]; at the end of each run the largest of the run-out.
    duration : float
        Time of the programmed motion [s].
    error : float
        Largest contour error [m].
    error_away : float
        The same later than `AFTER_STOP` delays after exact stops; NaN where nothing is.
    """

    time: Array
    speed: Array
    acceleration: Array
    jerk: Array
    place: Array
    contour_error: Array
    duration: float
    error: float
    error_away: float


@dataclass(frozen=True, eq=False)
class MethodDrive:
    """A method on a stretch of a program.

    Attributes
    ----------
    name : str
        One of `METHODS`, `PROGRAMMED` or `EVEN`.
    knows_tolerance : bool
        Whether its feeds are made for the tolerance.
    duration : float
        Time of the paths [s].
    drive : Drive or None
        What the machine did; None where it would have taken more than `DURATION_MAX`.
    feed : float
        The one feed of `EVEN` [m/s], else NaN.
    """

    name: str
    knows_tolerance: bool
    duration: float
    drive: Drive | None
    feed: float = np.nan


def compare_methods(
    program: Program,
    config: FeedrateSchedulerConfig,
    settings: ProgramSettings,
    machine: ContouringConfig,
    *,
    progress: Progress = lambda text, done, total: None,
) -> dict[str, MethodDrive]:
    """Schedule a program by several methods and drive each schedule on the simulated machine.

    Parameters
    ----------
    program : Program
        The program, or the beginning of one.
    config : FeedrateSchedulerConfig
        Parameters of the methods.
    settings : ProgramSettings
        How the program is scheduled, but for the method.
    machine : ContouringConfig
        The simulated machine.
    progress : callable
        Told before each method.

    Returns
    -------
    dict
        By name: `METHODS`, the feeds of the program, and one feed for all that keeps the
        tolerance.
    """
    found: dict[str, MethodDrive] = {}
    total = len(METHODS) + 2
    for name in METHODS:
        progress(f'driving: {name}', len(found), total)
        chosen = replace(config, method=name)
        paths = _paths(program, replace(settings, scheduler=make_scheduler(chosen)))
        found[name] = _driven(name, paths, settings, machine, heeds_tolerance(chosen))
        if PROGRAMMED not in found:
            own = [replace(path, feed=path.programmed) for path in paths]
            found[PROGRAMMED] = _driven(PROGRAMMED, own, settings, machine, False)
    sharpest = max((_sharpest(path, settings.sharpest) for path in paths), default=0.0)
    feed = config.feed_max
    if sharpest > 0.0:
        feed = min(feed, sqrt(config.tolerance / (config.machine_constant * sharpest)))
    progress(f'driving: {EVEN}', len(found), total)
    least = min(config.feed_min, feed)
    even = replace(settings, scheduler=ConstantFeed(feed_max=feed, feed_min=least))
    drive = _driven(EVEN, _paths(program, even), settings, machine, True)
    found[EVEN] = replace(drive, feed=feed)
    return found


def drive_paths(
    paths: Sequence[ScheduledPath], settings: ProgramSettings, machine: ContouringConfig
) -> Drive:
    """Drive scheduled paths on the simulated machine, each run from rest to rest.

    Parameters
    ----------
    paths : sequence of ScheduledPath
        Paths with their feeds.
    settings : ProgramSettings
        Limits and rest at stops.
    machine : ContouringConfig
        The machine; its own limits clip what the axes are asked for.
    """
    drives = [_drive_run(run, settings, machine) for run in runs(paths)]
    start = np.cumsum([0.0, *(drive.duration for drive in drives)])
    away = [drive.error_away for drive in drives if np.isfinite(drive.error_away)]
    return Drive(
        np.concatenate([one.time + begin for one, begin in zip(drives, start, strict=False)]),
        np.concatenate([drive.speed for drive in drives]),
        np.concatenate([drive.acceleration for drive in drives]),
        np.concatenate([drive.jerk for drive in drives]),
        np.concatenate([drive.place for drive in drives]),
        np.concatenate([drive.contour_error for drive in drives]),
        float(start[-1]),
        max(drive.error for drive in drives),
        max(away, default=np.nan),
    )


def runs(paths: Sequence[ScheduledPath]) -> list[list[ScheduledPath]]:
    """Return paths by run."""
    found: list[list[ScheduledPath]] = []
    for path in paths:
        if path.first or not found:
            found.append([])
        found[-1].append(path)
    return found


def whole_path(run: Sequence[ScheduledPath]) -> tuple[PathGeometry, Array]:
    """Return the geometry of a run and the feeds at both ends of its pieces, (m, 2) [m/s]."""
    length = np.concatenate([np.diff(part.path.geometry.node) for part in run])
    stop = np.concatenate([run[0].path.stop[:1], *(part.path.stop[1:] for part in run)])
    stop[[0, -1]] = False
    geometry = PathGeometry(
        np.concatenate([part.path.geometry.coefficient for part in run]),
        np.append(0.0, np.cumsum(length)),
        stop,
    )
    return geometry, np.concatenate([part.feed for part in run])


def _paths(program: Program, settings: ProgramSettings) -> tuple[ScheduledPath, ...]:
    return schedule_program(program, settings).paths


def _sharpest(part: ScheduledPath, most: float) -> float:
    """Return the largest curvature of a path [1/m]."""
    return min(float(own_curvature(part.path.geometry).max()), most)


def _driven(
    name: str,
    paths: Sequence[ScheduledPath],
    settings: ProgramSettings,
    machine: ContouringConfig,
    knows: bool,
) -> MethodDrive:
    """Drive the paths of a method, unless that takes too long."""
    least = sum(
        float((np.diff(part.path.geometry.node) / part.feed.max(axis=1)).sum()) for part in paths
    )
    if not paths or least > DURATION_MAX:
        return MethodDrive(name, knows, least if paths else 0.0, None)
    drive = drive_paths(paths, settings, machine)
    return MethodDrive(name, knows, drive.duration, drive)


def _drive_run(
    run: Sequence[ScheduledPath], settings: ProgramSettings, machine: ContouringConfig
) -> Drive:
    geometry, feed = whole_path(run)
    most = settings.limits.table(geometry.axes)[0]
    feed = np.minimum(feed, min(most[0], float(np.linalg.norm(most[1:]))))
    motion = limit_motion(geometry, feed, settings.limits, window=settings.window)
    period = machine.interpolation_period
    rest = round(settings.settle / period) + 1  # the sample at a stop, and those of the rest
    sample = motion.sample(period)
    way, speed, rise = sample.arc_length, sample.speed, motion.along(sample.time)[2]
    stops = np.append(geometry.node[geometry.stop], geometry.length)
    if settings.settle > 0.0:
        at = np.searchsorted(way, stops[:-1] - 1e-12)
        way, speed, rise = (
            np.insert(values, np.repeat(at, rest - 1), np.repeat(filling, rest - 1))
            for values, filling in (
                (way, stops[:-1]), (speed, np.zeros(len(at))), (rise, np.zeros(len(at)))
            )
        )  # fmt: skip
    duration = motion.duration + settings.settle * len(stops)
    out = round((machine.run_out + settings.settle) / period)
    reference_way = np.append(way, np.full(out, way[-1]))
    reference = geometry.evaluate(reference_way)
    position = np.empty_like(reference)
    position[0] = reference[0]
    position[1:] = ContouringAxes(reference[0], machine).follow(reference[:-1])
    time = period * np.arange(len(reference_way), dtype=np.float64)
    delayed = np.interp(time - machine.delay, time, reference_way)
    reach = WINDOW_LENGTH + WINDOW_TIME * float(speed.max())
    error = _contour(geometry).distance(position, delayed, reach).distance
    stopped = time[np.searchsorted(reference_way, np.append(0.0, stops) - 1e-12)]
    near = _soon_after(time, stopped, AFTER_STOP * machine.delay)
    last = len(way) - 1
    place = position[: len(way)].copy()
    place[last] = np.nan
    return Drive(
        time[: len(way)],
        speed,
        rise,
        np.gradient(rise, period) if len(rise) > 1 else np.zeros(len(rise)),
        place,
        np.append(error[:last], error[last:].max()),
        duration,
        float(error.max()),
        float(error[~near].max()) if not near.all() else np.nan,
    )


def _soon_after(time: Array, stopped: Array, span: float) -> NDArray[np.bool_]:
    """Return which samples come within a span of the last stop; the start counts as one."""
    last = stopped[np.searchsorted(stopped, time, 'right') - 1]
    return np.asarray(time - last < span)


def _contour(geometry: PathGeometry) -> Contour:
    """Return the path as a polyline whose corners are vertices."""
    length = np.diff(geometry.node)
    bend = own_curvature(geometry).max(axis=1)
    chords = np.minimum(length * np.sqrt(bend / (8.0 * _CHORD)), 64.0)
    count = np.ceil(np.maximum(chords, length / _EDGE)).astype(int)
    piece = np.repeat(np.arange(len(length)), count)
    first = np.append(0, np.cumsum(count))
    share = (np.arange(first[-1]) - first[piece]) / count[piece]
    place = np.append(geometry.node[piece] + length[piece] * share, geometry.length)
    points = geometry.evaluate(place)
    points[first] = np.vstack([geometry.coefficient[:, 0], geometry.coefficient[-1:, 5]])
    return Contour.polyline(points, vertices=2)


def _with_corners(moves: ProgramMoves, settings: ProgramSettings) -> ProgramMoves:
    """Return a program that passes corners as it was scheduled for."""
    found = with_mode(moves, PathMode(settings.blend, settings.blend))
    if not settings.own_corners:
        return found
    own = moves.moves
    said = ~np.isinf(own.rounding)  # infinite: G64 without P, or nothing was said
    changed = replace(
        found.moves,
        rounding=np.where(said, own.rounding, found.moves.rounding),
        merging=np.where(said, own.merging, found.moves.merging),
    )
    return replace(found, moves=changed)


LONGEST = 600.0
"""Motion beyond which lines are not driven [s]."""


def drive_words(
    blocks: Sequence[tuple[Block, float | None]],
    settings: ProgramSettings,
    machine: ContouringConfig,
) -> tuple[ProgramResult | None, ProgramResult | None]:
    """Drive lines of a program as they were, and with their chosen feeds.

    Parameters
    ----------
    blocks : sequence of (Block, float or None)
        Lines with their feeds [m/s], None for their own.
    settings : ProgramSettings
        Limits, rounding of corners, rest at stops.
    machine : ContouringConfig
        Lags of the axes.

    Returns
    -------
    tuple of ProgramResult or None
        As they were and with the chosen feeds; None where nothing moves or it takes too long.

    Notes
    -----
    Corners are passed as the schedule was made for: as the settings say, or the program where
    its own words count.
    """
    lines = [block for block, _ in blocks]
    try:
        moves = program_moves(lines)
    except ValueError:  # nothing of it moves
        return None, None
    moves = _with_corners(moves, settings)
    rest = np.maximum(moves.moves.rest, settings.settle)
    moves = replace(moves, moves=replace(moves.moves, rest=rest))
    feeds = np.array(
        [np.nan if feed is None else feed for block, feed in blocks if block.segment is not None]
    )
    velocity, rise, _ = settings.limits.table(AXIS_COUNT)
    path, speed, gain = velocity[0], velocity[1:], rise[1:]
    limits = ControllerLimits(
        velocity=tuple(np.minimum(speed, path).tolist()),
        acceleration=tuple(np.where(np.isfinite(gain), gain, rise[0]).tolist()),
        path_velocity=float(path),
        period=machine.interpolation_period,
    )
    driven = (moves, moves.with_feeds(feeds))
    least = [float((one.moves.length / np.minimum(one.moves.feed, path)).sum()) for one in driven]
    if min(least) > LONGEST:
        return None, None
    judge = ProgramPath(moves)
    found = [
        judge.run(one, limits, machine) if time <= LONGEST else None
        for one, time in zip(driven, least, strict=True)
    ]
    return found[0], found[1]

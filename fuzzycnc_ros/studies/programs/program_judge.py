# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The contour error of a part program on a controller: commanded positions, followed by axes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import NDArray

from fuzzycnc_ros.core.arrays import Array
from fuzzycnc_ros.core.machine.path_loop import ContouringConfig
from fuzzycnc_ros.simulation.controller.blends import ControllerLimits
from fuzzycnc_ros.simulation.controller.motion import Commanded
from fuzzycnc_ros.simulation.controller.moves import Moves
from fuzzycnc_ros.simulation.controller.program import ProgramMoves, simulate, turns
from fuzzycnc_ros.simulation.motion.contour import WINDOW_TIME, Contour
from fuzzycnc_ros.simulation.motion.contouring_axes import ContouringAxes

CORNER = np.radians(20.0)
"""Turn between two moves from which they meet at a corner [rad]."""

AFTER_CORNER = 4.0
"""Delays of the machine after a corner that count as being at it [-]."""

_CHORD = 3e-7
"""Distance of the lines that stand for an arc from it [m], about."""

_EDGE, _EDGES = 1e-4, 200_000
"""Longest of these lines [m], and how many there are at most where they could be longer: the
search is quick where none is much longer than its neighbours."""

_WINDOW = 5e-4
"""The nearest point is looked for that far around the axes' place [m], and the way of
`WINDOW_TIME`: turns of a narrow helix that come later are not taken for this one."""

_STILL = 1e-10
"""Step below which a recorded sample has not moved [m]."""

_TRACKED, _ASTRAY = 20, 3e-4
"""Samples that are looked for on the path at a time, and how far they may be from where the
steps so far have led [m]."""

_STEP, _EVERY = 1e-5, 8
"""Way of the commands after which a sample is measured [m], and samples after which one is."""

_PEAKS = 32
"""Largest peaks beside which every sample is measured."""


@dataclass(frozen=True)
class ProgramResult:
    """A program on a controller.

    Attributes
    ----------
    duration : float
        Time of its motion and waits, where the program tells it [s].
    error, rms : float
        Distance of the axes from the programmed path while cutting, largest and rms [m].
    corner_error, smooth_error : float
        The largest one at corners, and later than `AFTER_CORNER` delays after them [m]; NaN
        where there is no such place.
    deviation : float
        Largest distance of the commanded positions from the programmed path [m].
    line : int
        Line of the program at which the error is largest; 0 where nothing is cut.
    """

    duration: float
    error: float
    rms: float
    corner_error: float
    smooth_error: float
    deviation: float
    line: int


@dataclass(frozen=True, eq=False)
class LocalErrors:
    """Errors along a path, n samples.

    Attributes
    ----------
    error, place, speed : ndarray, shape (n,)
        Distance of the axes from the path while cutting, else 0 [m], way along it to the nearest
        point [m], and the speed that was commanded there [m/s].
    judged : ProgramResult
        Their summary.
    """

    error: Array
    place: Array
    speed: Array
    judged: ProgramResult


@dataclass(frozen=True, eq=False)
class _ErrorSamples:
    """Errors at some samples of a path.

    How many samples each stands for, errors of the axes and of the commands, whether a corner is
    near, in which move, where on the path, and the speed commanded there.
    """

    weight: Array
    error: Array
    deviation: Array
    corner: NDArray[np.bool_]
    move: NDArray[np.intp]
    place: Array
    speed: Array


class ProgramPath:
    """The path of a program, by which runs of it are judged.

    Parameters
    ----------
    moves : ProgramMoves
        The program as it was written.
    """

    def __init__(self, moves: ProgramMoves) -> None:
        self.program = moves
        self._runs = moves.runs()
        self._contours = [_contour(run) for run in self._runs]

    def judge(self, commanded: Sequence[Commanded], machine: ContouringConfig) -> ProgramResult:
        """Judge what was commanded for each path without a gap.

        Parameters
        ----------
        commanded : sequence of Commanded
            One for each path of the program.
        machine : ContouringConfig
            Lags of the axes; commands keep the limits of the axes, so that these are lifted.
        """
        return self._figures(self._courses(commanded, machine, asked=True), commanded)

    def errors(self, commanded: Sequence[Commanded], machine: ContouringConfig) -> LocalErrors:
        """Return the errors along the path, sample by sample, without deviations; see `judge`."""
        course = self._courses(commanded, machine, asked=False)
        cutting = ~self.program.moves.rapid[course.move]
        return LocalErrors(
            np.where(cutting, course.error, 0.0), course.place, course.speed,
            self._figures(course, commanded),
        )  # fmt: skip

    def _courses(
        self, commanded: Sequence[Commanded], machine: ContouringConfig, asked: bool
    ) -> _ErrorSamples:
        axes = replace(machine, velocity_max=10.0, acceleration_max=1000.0)
        courses = [
            _course(run, contour, one, axes, asked)
            for run, contour, one in zip(self._runs, self._contours, commanded, strict=True)
        ]
        first = np.cumsum([0, *(len(run) for run in self._runs)])
        courses = [
            replace(course, move=course.move + low)
            for course, low in zip(courses, first, strict=False)
        ]
        return _ErrorSamples(
            *(
                np.concatenate([getattr(course, item.name) for course in courses])
                for item in fields(_ErrorSamples)
            )
        )

    def _figures(self, course: _ErrorSamples, commanded: Sequence[Commanded]) -> ProgramResult:
        weight, error, corner, move = course.weight, course.error, course.corner, course.move
        deviation, cutting = course.deviation, ~self.program.moves.rapid[move]
        if not cutting.any():
            return ProgramResult(_time(commanded), 0.0, 0.0, np.nan, np.nan, 0.0, 0)
        worst = int(np.argmax(np.where(cutting, error, -1.0)))
        return ProgramResult(
            duration=_time(commanded),
            error=float(error[worst]),
            rms=float(np.sqrt(np.average(error[cutting] ** 2, weights=weight[cutting]))),
            corner_error=_largest(error[cutting & corner]),
            smooth_error=_largest(error[cutting & ~corner]),
            deviation=float(deviation[cutting].max()),
            line=int(self.program.line[move[worst]]),
        )

    def recorded(self, position: Array, period: float) -> list[Commanded]:
        """Return what a real controller commanded as `judge` takes it.

        Parameters
        ----------
        position : ndarray, shape (n, 3)
            Commanded positions, a period apart, from rest to rest [m].
        period : float
            [s]

        Raises
        ------
        ValueError
            If the path of the program has gaps.
        """
        if len(self._runs) != 1:
            raise ValueError(
                f'expected a program whose whole path is known but found {len(self._runs) - 1} '
                'gaps in it: changes of the work offset or of the tool length, cycles, calls'
            )
        moved = np.flatnonzero(np.abs(np.diff(position, axis=0)).max(axis=1) > _STILL)
        if not len(moved):
            raise ValueError('expected a program that moves the tool but it stood still')
        cut = position[moved[0] : moved[-1] + 2]
        place = _tracked(self._runs[0], self._contours[0], cut)
        return [Commanded(cut, place, period * (len(cut) - 1))]

    def run(
        self, moves: ProgramMoves, limits: ControllerLimits, machine: ContouringConfig
    ) -> ProgramResult:
        """Simulate a program of the same path on a controller, and judge it.

        Parameters
        ----------
        moves : ProgramMoves
            The program, perhaps with other feeds and path modes or in more blocks.
        limits : ControllerLimits
            Of the controller.
        machine : ContouringConfig
            Lags of the axes.
        """
        return self.judge(simulate(moves, limits), machine)

    def run_within(
        self,
        longest: float,
        moves: ProgramMoves,
        limits: ControllerLimits,
        machine: ContouringConfig,
    ) -> ProgramResult | None:
        """Do what `run` does, without deviations, for a program that takes a time at most.

        None if it takes longer than that [s]; to measure errors takes most of the time.
        """
        commanded = simulate(moves, limits)
        if _time(commanded) > longest:
            return None
        return self.errors(commanded, machine).judged


def _time(commanded: Sequence[Commanded]) -> float:
    return sum(one.duration for one in commanded)


def _largest(error: Array) -> float:
    return float(error.max()) if len(error) else float('nan')


def _course(
    run: Moves, contour: Contour, one: Commanded, machine: ContouringConfig, asked: bool
) -> _ErrorSamples:
    """Follow the commands of a path, and measure the axes by it; if asked, the commands too."""
    period = machine.interpolation_period
    out = round(machine.run_out / period)
    reference = np.concatenate([one.position, np.repeat(one.position[-1:], out, axis=0)])
    axes = np.concatenate(
        [one.position[:1], ContouringAxes(one.position[0], machine).follow(reference[:-1])]
    )
    begin = run.place[0, 0]
    place = np.append(one.place, np.full(out, one.place[-1])) - begin
    index = np.arange(len(place))
    delayed = np.interp(index - machine.delay / period, index, place)
    pace = np.diff(place, prepend=place[0]) / period
    reach = _WINDOW + WINDOW_TIME * float(pace.max())
    kept = np.flatnonzero(
        (np.diff(np.floor(delayed / _STEP), prepend=-1.0) > 0.0) | (index % _EVERY == 0)
    )
    error = contour.distance(axes[kept], delayed[kept], reach)
    edge = run.place[:, 1] - begin
    move = np.clip(np.searchsorted(edge, error.arc_length), 0, len(run) - 1)
    way = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(axes, axis=0), axis=1)))[kept]
    most = 0.5 * (error.distance[:-1] + error.distance[1:] + np.diff(way))
    most[np.diff(move) == 0] = 0.0
    beside = _left_out(kept, np.where(run.rapid[move], 0.0, error.distance), most)
    more = contour.distance(axes[beside], delayed[beside], reach)
    order = np.argsort(np.append(kept, beside), kind='stable')  # quick where two parts are sorted
    kept = np.append(kept, beside)[order]
    distance = np.append(error.distance, more.distance)[order]
    nearest = np.append(error.arc_length, more.arc_length)[order]
    deviation = np.zeros(len(kept))
    if asked:
        rows = kept[kept < len(one.place)]
        deviation[: len(rows)] = contour.distance(one.position[rows], place[rows], reach).distance
    move = np.clip(np.searchsorted(edge, nearest), 0, len(run) - 1)
    at = np.append(0.0, edge[(turns(run) > CORNER) | run.stop])
    passed = np.searchsorted(place, at - 1e-9)
    last = np.searchsorted(passed, kept, 'right') - 1
    since = kept - passed[np.maximum(last, 0)]
    coming = np.append(passed, np.inf)[last + 1] - kept
    near = (since < AFTER_CORNER * machine.delay / period) | (coming < machine.delay / period)
    return _ErrorSamples(
        np.diff(kept, append=len(place)).astype(float),
        distance,
        deviation,
        near,
        move,
        begin + nearest,
        np.interp(kept - machine.delay / period, index, pace),
    )


def _left_out(kept: NDArray[np.intp], error: Array, most: Array) -> NDArray[np.intp]:
    """Return the samples that were left out where one of them may have the largest error.

    Errors are smooth but where the nearest point of the path comes to another move.  There they
    have a sharp peak at corners, and jump between rapids and cutting, but an error is no larger
    than those beside it and the way to them let it be, which `most` says.
    """
    high = np.pad(error, 1, constant_values=-1.0)
    peaks = np.flatnonzero((error > 0.0) & (error >= high[:-2]) & (error >= high[2:]))
    peaks = peaks[np.argsort(error[peaks])[-_PEAKS:]]
    sharp = np.flatnonzero(most > error.max())
    gap = np.unique(np.concatenate([peaks - 1, peaks, sharp]))
    gap = gap[(gap >= 0) & (gap < len(kept) - 1)]
    left_out = [np.arange(kept[one] + 1, kept[one + 1]) for one in gap.tolist()]
    return np.concatenate([kept[:0], *left_out])


def _tracked(run: Moves, contour: Contour, position: Array) -> Array:
    """Return the way along the path at commanded positions, each looked for after the last."""
    step = np.append(0.0, np.linalg.norm(np.diff(position, axis=0), axis=1))
    place, here = np.empty(len(position)), 0.0
    for first in range(0, len(position), _TRACKED):
        rows = slice(first, min(first + _TRACKED, len(position)))
        way = here + np.cumsum(step[rows])
        found = contour.distance(position[rows], way, _ASTRAY)
        place[rows] = np.maximum.accumulate(np.maximum(found.arc_length, here))
        here = float(place[rows.stop - 1])
    return place + run.place[0, 0]


def _contour(moves: Moves) -> Contour:
    """Return a path as lines whose corners are kept."""
    radius = moves.radius()
    chords = np.where(moves.arc, moves.sweep * np.sqrt(radius / (8.0 * _CHORD)), 1.0)
    longest = max(_EDGE, float(moves.length.sum()) / _EDGES)
    count = np.ceil(np.maximum(chords, moves.length / longest)).astype(int)
    move = np.repeat(np.arange(len(moves)), count)
    first = np.cumsum(count) - count
    share = (np.arange(count.sum()) - first[move]) / count[move]
    points = np.concatenate([moves.position(move, share), moves.end[-1:]])
    return Contour.polyline(points, vertices=2)

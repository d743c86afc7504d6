# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The contour error of a part program on a controller: commanded positions, followed by axes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from fuzzycnc_ros.core.arrays import Array
from fuzzycnc_ros.core.feedrate.job.controller_program import ProgramMoves, simulate, turns
from fuzzycnc_ros.core.feedrate.motion.controller_blends import ControllerLimits
from fuzzycnc_ros.core.feedrate.motion.controller_motion import Commanded
from fuzzycnc_ros.core.feedrate.motion.controller_moves import Moves
from fuzzycnc_ros.core.machine.contour import Contour
from fuzzycnc_ros.core.machine.contouring_axes import ContouringAxes, ContouringConfig
from fuzzycnc_ros.core.machine.path_error import WINDOW_LENGTH, WINDOW_TIME

CORNER = np.radians(20.0)
"""Turn between two moves from which they meet at a corner [rad]."""

AFTER_CORNER = 4.0
"""Delays of the machine after a corner that count as being at it [-]."""

_CHORD = 1e-7
"""Distance of the lines that stand for an arc from it [m], about."""

_EDGE, _EDGES = 1e-4, 200_000
"""Longest of these lines [m], and how many there are at most where they could be longer: the
search is quick where none is much longer than its neighbours."""

_STEP, _EVERY = 1e-5, 8
"""Way of the commands after which a sample is measured [m], and samples after which one is."""


@dataclass(frozen=True)
class Judged:
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

    def document(self) -> dict[str, float]:
        """Return all figures by name (SI)."""
        return dict(self.__dict__)


@dataclass(frozen=True, eq=False)
class _Course:
    """Errors at some samples: how many each stands for, of the axes, of the commands, whether a
    corner is near, and in which move."""

    weight: Array
    error: Array
    deviation: Array
    corner: NDArray[np.bool_]
    move: NDArray[np.intp]


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

    def judge(self, commanded: Sequence[Commanded], machine: ContouringConfig) -> Judged:
        """Judge what was commanded for each path without a gap.

        Parameters
        ----------
        commanded : sequence of Commanded
            One for each path of the program.
        machine : ContouringConfig
            Lags of the axes; commands keep the limits of the axes, so that these are lifted.
        """
        axes = replace(machine, velocity_max=10.0, acceleration_max=1000.0)
        courses = [
            _course(run, contour, one, axes)
            for run, contour, one in zip(self._runs, self._contours, commanded, strict=True)
        ]
        weight, error, deviation, corner = (
            np.concatenate([getattr(course, name) for course in courses])
            for name in ('weight', 'error', 'deviation', 'corner')
        )
        first = np.cumsum([0, *(len(run) for run in self._runs)])
        move = np.concatenate(
            [course.move + low for course, low in zip(courses, first, strict=False)]
        )
        cutting = ~self.program.moves.rapid[move]
        if not cutting.any():
            return Judged(_time(commanded), 0.0, 0.0, np.nan, np.nan, 0.0, 0)
        worst = int(np.argmax(np.where(cutting, error, -1.0)))
        return Judged(
            duration=_time(commanded),
            error=float(error[worst]),
            rms=float(np.sqrt(np.average(error[cutting] ** 2, weights=weight[cutting]))),
            corner_error=_largest(error[cutting & corner]),
            smooth_error=_largest(error[cutting & ~corner]),
            deviation=float(deviation[cutting].max()),
            line=int(self.program.line[move[worst]]),
        )

    def run(
        self, moves: ProgramMoves, limits: ControllerLimits, machine: ContouringConfig
    ) -> Judged:
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


def _time(commanded: Sequence[Commanded]) -> float:
    return sum(one.duration for one in commanded)


def _largest(error: Array) -> float:
    return float(error.max()) if len(error) else float('nan')


def _course(run: Moves, contour: Contour, one: Commanded, machine: ContouringConfig) -> _Course:
    """Follow the commands of a path, and measure both by it."""
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
    speed = float(np.diff(one.place, prepend=one.place[0]).max()) / period
    reach = WINDOW_LENGTH + WINDOW_TIME * speed
    kept = np.flatnonzero(
        (np.diff(np.floor(delayed / _STEP), prepend=-1.0) > 0.0) | (index % _EVERY == 0)
    )
    error = contour.distance(axes[kept], delayed[kept], reach)
    asked = kept[kept < len(one.place)]
    deviation = contour.distance(one.position[asked], place[asked], reach).distance
    edge = run.place[:, 1] - begin
    move = np.clip(np.searchsorted(edge, error.arc_length), 0, len(run) - 1)
    at = np.append(0.0, edge[(turns(run) > CORNER) | run.stop])
    passed = np.searchsorted(place, at - 1e-9)
    last = np.searchsorted(passed, kept, 'right') - 1
    since = kept - passed[np.maximum(last, 0)]
    coming = np.append(passed, np.inf)[last + 1] - kept
    near = (since < AFTER_CORNER * machine.delay / period) | (coming < machine.delay / period)
    return _Course(
        np.diff(kept, append=len(place)).astype(float),
        error.distance,
        np.append(deviation, np.zeros(len(kept) - len(asked))),
        near,
        move,
    )


def _contour(moves: Moves) -> Contour:
    """Return a path as lines whose corners are kept."""
    radius = moves.radius()
    chords = np.where(
        moves.arc, moves.sweep * np.sqrt(radius / (8.0 * _CHORD)), 1.0
    )
    longest = max(_EDGE, float(moves.length.sum()) / _EDGES)
    count = np.ceil(np.maximum(chords, moves.length / longest)).astype(int)
    move = np.repeat(np.arange(len(moves)), count)
    first = np.cumsum(count) - count
    share = (np.arange(count.sum()) - first[move]) / count[move]
    points = np.concatenate([moves.position(move, share), moves.end[-1:]])
    return Contour.polyline(points, vertices=2)

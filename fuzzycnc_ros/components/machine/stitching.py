# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The soft sheet in the simulated machine: it is stitched where the tool comes by a stitch.

It is a part of `simulated_machine`, and the only place where a sheet's drag and drift are known.
"""

from collections.abc import Iterable, Iterator
from math import dist, hypot

import numpy as np

from fuzzycnc_ros.components.machine.machine_axes import Axes
from fuzzycnc_ros.components.soft.compensated_paths import check_compensated
from fuzzycnc_ros.runtime.component import Emission, Health, Level
from fuzzycnc_ros.runtime.enums import PrimitiveKind
from fuzzycnc_ros.runtime.records import (
    SECOND,
    AxisState,
    CompensatedPath,
    Material,
    StitchedPath,
)
from fuzzycnc_ros.simulation.soft.foam_sheet import FoamSheet, FoamStitching

REACH = 0.5
"""Share of the way from one point to the next within which the tool comes by the next."""
ARRIVED = 5e-6
"""Distance from a point at which the tool that rests there has arrived [m]."""
RESTING = 1e-5
"""Speed towards a point below which the tool rests there [m/s]."""

BEGUN = 1e-9
"""Way along a path from which on it is being followed [m]."""

Point = tuple[float, float]


class Stitching:
    """Stitch compensated paths on a sheet while the tool follows them.

    A stitch is made where the tool is nearest to its point: between two periods where it goes
    by, or where it rests.  Each path is stitched once, from a fresh start on a sheet whose
    stiffness and friction, like the noise of its stitches, are drawn anew.  Jumps and stops are
    not stitched; after a jump or a trim the sheet is fresh again.

    Parameters
    ----------
    sheet : FoamSheet
        The sheet that lies there at the beginning.
    seed : int
        Seed of scatter and noise, counted up path by path; none of both below 0.

    Attributes
    ----------
    failure : str
        Which path was not stitched to its end though it was followed; empty if none.
    """

    def __init__(self, sheet: FoamSheet, seed: int) -> None:
        self._sheet, self._seed = sheet, seed
        self._path: CompensatedPath | None = None
        self._run: _StitchRun | None = None
        self._tool: tuple[int, Point] | None = None  # newest place of the tool and its stamp
        self._count = 0
        self._level, self._text = Level.OK, 'nothing to stitch'
        self.failure = ''

    def clamp(self, material: Material) -> None:
        """Take another sheet, of the same friction."""
        x, y = material.size.tolist()
        self._sheet = FoamSheet(
            material.thickness,
            (x, y),
            material.young_modulus,
            material.poisson_ratio,
            self._sheet.friction,
        )

    def load(self, path: CompensatedPath) -> None:
        """Take a path that is to be stitched when the axes follow it."""
        self.drop('another path was loaded')
        try:
            check_compensated(path)
        except ValueError as error:
            self._say(Level.ERROR, f'{path.path_id} not stitched: {error}')
            return
        self._path, self._tool = path, None
        self._say(Level.OK, f'{path.path_id} loaded')

    def drop(self, why: str) -> None:
        """Leave a path that is being stitched."""
        if self._run is not None:
            self._say(Level.ERROR, f'{self._run.progress}, then left: {why}')
            self._path = self._run = None

    def tick(self, moved: Iterable[Emission], motion: Axes, frame_id: str) -> Iterator[Emission]:
        """Stitch what the tool has come by since the last tick.

        Parameters
        ----------
        moved : iterable of Emission
            What the axes told in this tick.
        motion : Axes
            The axes.
        frame_id : str
            Frame of what is published.
        """
        path = self._path
        if path is None:
            return
        state = next((item.record for item in moved if item.output == 'axis_state'), None)
        if not isinstance(state, AxisState):
            return
        place = dict(zip(state.axis, state.position.tolist(), strict=True))
        now = (state.stamp, (place['X'], place['Y']))
        before, self._tool = self._tool or now, now
        if self._run is None:
            # one that has ended is an earlier run of the same name
            if motion.place(path.path_id) < BEGUN or motion.finished(path.path_id):
                return
            self._run = self._begin(path, before)
        run = self._run
        run.move(before, now)
        if not run.left:
            self._say(Level.OK, run.progress)
            self._path = self._run = None
            yield Emission('stitched_path', run.record(state.stamp, frame_id))
        elif motion.finished(path.path_id):
            self.failure = f'{run.progress}: the tool did not come by the next one'
            self.drop('the path has ended')

    def health(self) -> Health:
        """Report what is stitched."""
        text = self._text if self._run is None else self._run.progress
        return Health('stitching', self._level, text)

    def _begin(self, path: CompensatedPath, tool: tuple[int, Point]) -> '_StitchRun':
        rng = np.random.default_rng(self._seed + self._count) if self._seed >= 0 else None
        self._count += 1
        sheet = self._sheet if rng is None else self._sheet.scattered(rng)
        self._say(Level.OK, '')
        return _StitchRun(path, sheet, rng, tool)

    def _say(self, level: Level, text: str) -> None:
        self._level, self._text = level, text


class _StitchRun:
    """One path on its way to the sheet.

    Parameters
    ----------
    path : CompensatedPath
        Points, depths and turns.
    sheet : FoamSheet
        Sheet of this run.
    rng : Generator or None
        Draws the noise of the stitches.
    tool : tuple
        Stamp [ns] and place [m] of the first stitch.
    """

    def __init__(
        self,
        path: CompensatedPath,
        sheet: FoamSheet,
        rng: np.random.Generator | None,
        tool: tuple[int, Point],
    ) -> None:
        commanded = (path.nominal + path.offset).reshape(-1, 2)
        self._points: list[Point] = [(x, y) for x, y in commanded.tolist()]
        self._depth, self._turn = path.depth.tolist(), np.sign(path.turn).astype(int).tolist()
        self._kind = path.kind.tolist()
        self._path_id = path.path_id
        stamp, place = tool
        self._start = stamp
        self._sheet, self._rng = sheet, rng
        self._chain = FoamStitching(sheet, place, rng)
        self._stamps, self._tools, self._stitched = [stamp], [place], [self._chain.stitched]

    @property
    def left(self) -> int:
        """Number of stitches that are still to be made."""
        return len(self._points) - len(self._stamps)

    @property
    def progress(self) -> str:
        """Progress in words."""
        return f'{self._path_id}: {len(self._stamps)} of {len(self._points)} stitches'

    def move(self, before: tuple[int, Point], now: tuple[int, Point]) -> None:
        """Make the stitches whose points the tool comes by between two of its places."""
        begin, (x, y) = before
        end, (to_x, to_y) = now
        along_x, along_y = to_x - x, to_y - y
        square = along_x * along_x + along_y * along_y
        duration = end - begin
        while self.left:
            index = len(self._stamps)
            goal, last = self._points[index], self._points[index - 1]
            if goal == last:  # given twice: the needle goes in twice
                self.stitch(self._stamps[-1], self._tools[-1])
                continue
            ahead = (goal[0] - x) * along_x + (goal[1] - y) * along_y
            if ahead < square:  # nearest on the way
                share = max(ahead / square, 0.0)
                place = (x + share * along_x, y + share * along_y)
                if dist(place, goal) > REACH * dist(goal, last):
                    return
                self.stitch(begin + round(share * duration), place)
                continue
            left = dist((to_x, to_y), goal)
            gained = hypot(goal[0] - x, goal[1] - y) - left
            if left > ARRIVED or gained * SECOND > RESTING * duration:
                return
            self.stitch(end, (to_x, to_y))

    def stitch(self, stamp: int, place: Point) -> None:
        """Make the next stitch, or pass by a point that has none."""
        index = len(self._stamps) - 1
        kind = self._kind[index]
        if kind in (PrimitiveKind.JUMP, PrimitiveKind.TRIM):
            self._chain = FoamStitching(self._sheet, place, self._rng)
        elif kind != PrimitiveKind.STOP:
            self._chain.step(place, self._depth[index], self._turn[index])
        self._stitched.append(self._chain.stitched)
        self._stamps.append(stamp)
        self._tools.append(place)

    def record(self, stamp: int, frame_id: str) -> StitchedPath:
        """Return all stitches."""
        return StitchedPath(
            stamp=stamp,
            frame_id=frame_id,
            path_id=self._path_id,
            time=(np.array(self._stamps) - self._start) / SECOND,
            tool=np.array(self._tools).ravel(),
            stitched=np.array(self._stitched).ravel(),
        )

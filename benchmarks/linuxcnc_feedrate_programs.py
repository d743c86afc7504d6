# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Part programs of `bench_linuxcnc_feedrate.py`: constant or chosen feeds on curves and a part."""

import os
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cache
from itertools import pairwise
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1] / 'test' / 'support'))

import numpy as np
from programs.without_feeds import strip_feeds
from scipy.interpolate import BPoly, PPoly

from fuzzycnc_ros.components.motion.feedrate_scheduler_config import FeedrateSchedulerConfig
from fuzzycnc_ros.components.motion.program_request import program_settings
from fuzzycnc_ros.core.arrays import Array
from fuzzycnc_ros.core.feedrate.gcode.reader import read_program
from fuzzycnc_ros.core.feedrate.gcode.segments import Segment, sample_path
from fuzzycnc_ros.core.feedrate.gcode.writer import write_program
from fuzzycnc_ros.core.feedrate.path.curves import CURVES, SHEET_SCALES
from fuzzycnc_ros.core.feedrate.path.nurbs import NurbsCurve
from fuzzycnc_ros.core.feedrate.schedule.program_schedule import schedule_program
from fuzzycnc_ros.simulation.motion.contour import Contour

POINTS = 2000
"""Points of a curve as lines, even in its parameter."""
CHORD, SPACING = 1e-3, 2.0
"""Distance of chords from the curve, and length of chords, at most [mm]."""
DATA = Path(os.environ.get('FUZZYCNC_DATA', Path(__file__).parents[2] / 'shared' / 'data'))
CORNER, REST = 20.0, 0.1
"""A turn that counts as corner [deg], and the wait there: as long as `settle` [s]."""
PART, PART_LINES = 'gcode/ugs/Gates_combined_R12.nc', (9850, 10100)
"""A part program, and the first lines of a contour in it: lines and arcs at one depth."""


@dataclass(frozen=True)
class Variant:
    """A way to run a path.

    Parameters
    ----------
    path : str
        A curve of the literature, or `part`.
    form : str
        `lines` of `POINTS` points, `chords` of no more than `CHORD`, or `G5.2`; of a part
        `lines`, or `rests`: with a wait at each corner.
    mode : str
        How LinuxCNC goes from block to block: G61, or P and Q of G64 [mm].
    feed : float
        Constant feed, or the largest where feeds are chosen [mm/min].
    tolerance : float
        Contour error for which feeds are chosen [um]; 0 for a constant feed.
    step : float
        How far feeds differ that share one word [%].
    acceleration : float
        Limit of the acceleration of X and Y in LinuxCNC [mm/s^2]; 0 for that of its INI file.
    """

    path: str
    form: str
    mode: str
    feed: float
    tolerance: float = 0.0
    step: float = 5.0
    acceleration: float = 0.0

    @property
    def name(self) -> str:
        """What it is called in tables and files."""
        words = [self.path, self.form, self.mode, f'F{self.feed:.6g}']
        if self.tolerance:
            words += [f'scheduled for {self.tolerance:g} um', f'step {self.step:g} %']
        if self.acceleration:
            words.append(f'at most {self.acceleration:.4g} mm/s^2')
        return ', '.join(words)

    @property
    def blend(self) -> float:
        """How far LinuxCNC may leave the path [m]."""
        return 0.0 if self.mode == 'G61' else 1e-3 * float(self.mode.split()[0][1:])


@dataclass(frozen=True, eq=False)
class PathForm:
    """A path as blocks of a program.

    Parameters
    ----------
    start : tuple of float
        Where it begins [mm].
    blocks : str
        Its blocks.
    contour : Contour
        The true path.
    """

    start: tuple[float, float]
    blocks: str
    contour: Contour


def program_of(variant: Variant) -> tuple[str, Contour]:
    """Return the part program of a variant and the true path.

    Rests before and after the cut tell it from the rest.
    """
    form = path_form(variant.path, variant.form)
    mode = variant.mode if variant.mode == 'G61' else f'G64 {variant.mode}'
    text = (
        f'G21 G90 G94 G17 G40\n{mode}\nG0 X{form.start[0]:.7f} Y{form.start[1]:.7f}\nG4 P0.4\n'
        f'F{variant.feed:.6f}\n{form.blocks}G4 P0.4\nM2\n'
    )
    if not variant.tolerance:
        return text, form.contour
    config = FeedrateSchedulerConfig(tolerance=1e-6 * variant.tolerance, blend=variant.blend)
    settings = replace(program_settings(config), feed_step=0.01 * variant.step)
    program = read_program(text)
    return write_program(program, schedule_program(program, settings).feeds), form.contour


@cache
def path_form(path: str, form: str) -> PathForm:
    """Return a path in a form."""
    if path == 'part':
        return _part(form)
    curve = CURVES[path](SHEET_SCALES[path])
    blocks: Mapping[str, Callable[[NurbsCurve], str]] = {
        'lines': lambda curve: _lines(curve, np.linspace(0.0, 1.0, POINTS)),
        'chords': lambda curve: _lines(curve, _chord_ends(curve)),
        'G5.2': _beziers,
    }
    first = 1e3 * curve.point([0.0])[0]
    return PathForm((first[0], first[1]), blocks[form](curve), Contour.curve(curve.point))


def _lines(curve: NurbsCurve, parameter: Array) -> str:
    point = 1e3 * curve.point(parameter)
    return ''.join(f'G1 X{x:.5f} Y{y:.5f}\n' for x, y in point[1:].tolist())


def _chord_ends(curve: NurbsCurve) -> Array:
    """Return parameters of points between which chords leave the curve by `CHORD` or less."""
    parameter = np.linspace(0.0, 1.0, 200_001)
    bend = 1e-3 * curve.curvature(parameter)
    density = np.maximum(np.sqrt(bend / (8.0 * CHORD)), 1.0 / SPACING)
    way = 1e3 * curve.arc_length(parameter)
    count = np.append(0.0, np.cumsum(np.diff(way) * np.maximum(density[1:], density[:-1])))
    wanted = np.linspace(0.0, count[-1], int(np.ceil(count[-1])) + 1)
    return np.asarray(np.interp(wanted, count, parameter))


def _beziers(curve: NurbsCurve) -> str:
    """Return one G5.2 block per span: G5.2 has even knots only, and this needs none."""
    weight = np.asarray(curve.weight)[:, np.newaxis]
    homogeneous = np.hstack([1e3 * np.asarray(curve.control) * weight, weight])
    columns = []
    for column in homogeneous.T:
        power = PPoly.from_spline((np.asarray(curve.knot), column, curve.degree))
        kept = np.diff(power.x) > 0.0  # spans between equal knots are none
        power = PPoly(power.c[:, kept], np.append(power.x[:-1][kept], power.x[-1]))
        columns.append(BPoly.from_power_basis(power).c)
    found = []
    for span in np.moveaxis(np.stack(columns, axis=-1), 1, 0):
        share = span[:, 2]
        place = (span[:, :2] / share[:, np.newaxis]).tolist()
        found.append(f'G5.2 P{share[0]:.9f} L4\n')
        found += [
            f'X{x:.7f} Y{y:.7f} P{p:.9f}\n'
            for (x, y), p in zip(place[1:], share[1:].tolist(), strict=True)
        ]
        found.append('G5.3\n')
    return ''.join(found)


def _part(form: str) -> PathForm:
    text = (DATA / PART).read_text()
    first, last = PART_LINES
    blocks = [block for block in read_program(text).blocks if first <= block.line <= last]
    segments = [block.segment for block in blocks if block.segment is not None]
    start = 1e3 * np.asarray(segments[0].start)
    point = sample_path(segments, 2e-5).point[:, :2]
    contour = Contour.polyline(point, vertices=2)
    lines = [strip_feeds(block.text) for block in blocks]
    if form == 'rests':
        for index, (one, other) in enumerate(pairwise(segments)):
            if _turn(one, other) > CORNER:
                lines[index] += f'G4 P{REST:g}\n'
    return PathForm((start[0], start[1]), ''.join(lines), contour)


def _turn(one: Segment, other: Segment) -> float:
    """Return by which angle the path turns between two segments [deg]."""
    ends = one.points(1000)[-2:], other.points(1000)[:2]
    before, after = (np.diff(points, axis=0)[0] for points in ends)
    across = np.linalg.norm(np.cross(before, after))
    return float(np.degrees(np.arctan2(across, before @ after)))

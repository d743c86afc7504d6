# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Samples for training and adapting, taken from recorded paths and their stitches."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from fuzzycnc_ros.core.arrays import Array
from fuzzycnc_ros.core.deformation.compensation import (
    REFERENCE_LENGTH,
    SAMPLE_LENGTH,
    feature_rows,
    initial_rate_factor,
)
from fuzzycnc_ros.core.deformation.features import DEPTH_RATIO_MAX, PROCESS_VALUES
from fuzzycnc_ros.core.deformation.stitch_path import LINE, SheetMaterial, StitchPath

_LENGTHS = np.arange(20.0, 200.1, 2.5) * 1e-3  # that are tried [m]
_SETTLED = 4  # least steps of a side that its two figures can be told from


@dataclass(frozen=True, eq=False)
class Relaxation:
    """Drift of the sheet identified from a recorded run; lengths go into `CompensationConfig`.

    Attributes
    ----------
    leak_length : float
        Way over which the drift fades [m].
    prompt_length : float
        Way whose drift the sheet gives way at once [m].
    rate : ndarray, shape (sides, 2)
        Drift that a side adds per feed [-].
    jump : ndarray, shape (sides, 2)
        Drift that is there as long as the foot goes along a side [m].
    residual : float
        Root mean square of what is left, over both axes [m].
    tried, error : ndarray, shape (lengths,)
        Fading lengths that were tried and their residuals [m].
    """

    leak_length: float
    prompt_length: float
    rate: Array
    jump: Array
    residual: float
    tried: Array
    error: Array


def identify_relaxation(
    commanded: ArrayLike,
    stitched: ArrayLike,
    corners: Sequence[int],
    lengths: ArrayLike = _LENGTHS,
) -> Relaxation:
    """Identify how the drift fades from one run of straight sides.

    The drift commanded minus stitched is taken for D + o_side with
    D' = D exp(-length / leak_length) + g_side length; for each
    fading length the g and o follow by least squares, and the length with the least residual is
    kept.  Ratio of o to g, over all sides, is `prompt_length`.

    Parameters
    ----------
    commanded, stitched : array_like, shape (n + 1, 2)
        Points of a run without compensation, in the order of stitching [m].
    corners : sequence of int
        Indices at which sides begin and end, first and last point included.
    lengths : array_like, shape (lengths,)
        Fading lengths to be tried [m].

    Returns
    -------
    Relaxation
        Lengths, rates and residuals.

    Raises
    ------
    ValueError
        If the points are not finite or not parallel, the corners do not cut the path into two
        or more sides of four steps at least, or the run is too short or too straight to tell
        fading lengths from one another: the least residual lies at the end of those tried.
    """
    path, found = np.asarray(commanded, float), np.asarray(stitched, float)
    if path.ndim != 2 or path.shape[1] != 2 or path.shape != found.shape:
        raise ValueError(
            f'expected commanded and stitched points of the same shape (n + 1, 2) but found '
            f'{path.shape} and {found.shape}'
        )
    drift = path - found
    if not np.isfinite(drift).all():
        raise ValueError('points: expected finite coordinates [m] but found some that are not')
    cuts = np.asarray(corners)
    if (
        len(cuts) < 3
        or cuts[0] != 0
        or cuts[-1] != len(path) - 1
        or (np.diff(cuts) < _SETTLED).any()
    ):
        raise ValueError(
            f'corners: expected 0 to {len(path) - 1} in two or more sides of at least {_SETTLED} '
            f'steps but found {cuts.tolist()}'
        )
    tried = np.asarray(lengths, float)
    way = np.hypot(*np.diff(path, axis=0).T)
    side = np.repeat(np.arange(len(cuts) - 1), np.diff(cuts))
    fits = [_fit(drift, way, side, length) for length in tried]
    error = np.array([np.sqrt(np.mean(left**2)) for _, left in fits])
    best = int(error.argmin())
    if best in (0, len(tried) - 1):
        raise ValueError(
            f'lengths: expected the least residual between {1e3 * tried[0]:g} and '
            f'{1e3 * tried[-1]:g} mm but found it at {1e3 * tried[best]:g} mm; record a longer '
            'run with corners, or widen the lengths that are tried'
        )
    rate, jump = np.split(fits[best][0], 2)
    prompt = max(float((jump * rate).sum() / (rate**2).sum()), 0.0)
    return Relaxation(float(tried[best]), prompt, rate, jump, float(error[best]), tried, error)


def _fit(drift: Array, way: Array, side: NDArray[np.intp], length: float) -> tuple[Array, Array]:
    """Return rates and jumps of the sides, shape (2 sides, 2), and what they leave [m]."""
    sides = int(side[-1]) + 1
    steps = np.zeros((len(way), sides))
    steps[np.arange(len(way)), side] = way
    columns = np.zeros((len(way), 2 * sides))
    fed = np.zeros(sides)
    for n, fading in enumerate(np.exp(-way / length)):
        fed = fed * fading + steps[n]
        columns[n, :sides] = fed
    columns[:, sides:] = steps > 0.0
    solution, *_ = np.linalg.lstsq(columns, drift[1:] - drift[0], rcond=None)
    return solution, drift[1:] - drift[0] - columns @ solution


_SHORTEST = 0.9
"""Least length of a single primitive, as a share of the length that a sample is meant for."""

_SAME_POINT = 1e-6
"""Offsets below that are none [m]."""

RESIDUAL_MAX = 0.1
"""Largest remainder of the drift, RMS, with which a fading drift is believed [-]."""

_PER_POINT = ('nominal', 'offset', 'stitched')
_PER_STEP = ('primitive', 'kind', 'turn', 'depth', 'step')
_STEPS_MIN = 4  # of a side that fading can be told from
_MM = 1e-3


@dataclass(frozen=True, eq=False, kw_only=True)
class RecordedPath:
    """A path as it was commanded and stitched; n steps.

    Attributes
    ----------
    path_id : str
        Name of the pattern.
    material : SheetMaterial
        The sheet.
    nominal, offset, stitched : ndarray, shape (n + 1, 2)
        Nominal points, offsets that were added, and where the stitches lie [m].
    primitive : ndarray of int, shape (n,)
        Primitive of the pattern that each step belongs to.
    kind : ndarray, shape (n,)
        1 for arcs, 2 for lines.
    turn : ndarray, shape (n,)
        Angle by which the primitive turns, positive to the left [rad]; 0 for lines.
    depth, step : ndarray, shape (n,)
        Feed depth and nominal stitch step [m].
    source : str
        Where it is from, for messages.
    jump : ndarray of bool, shape (n,), optional
        Steps without a stitch; what follows begins on a fresh sheet.
    """

    path_id: str
    material: SheetMaterial
    nominal: Array
    offset: Array
    stitched: Array
    primitive: NDArray[np.int64]
    kind: Array
    turn: Array
    depth: Array
    step: Array
    source: str = ''
    jump: NDArray[np.bool_] | None = None

    @property
    def run_points(self) -> list[slice]:
        """Points of the runs between the jumps."""
        jumps = [] if self.jump is None else np.flatnonzero(self.jump).tolist()
        return [slice(a + 1, b + 1) for a, b in pairwise([-1, *jumps, len(self.nominal) - 1])]

    def runs(self) -> list[RecordedPath]:
        """Return the runs between the jumps that have a step."""
        return [
            replace(
                self,
                jump=None,
                **{name: getattr(self, name)[points] for name in _PER_POINT},
                **{
                    name: getattr(self, name)[points.start : points.stop - 1] for name in _PER_STEP
                },
            )
            for points in self.run_points
            if points.stop > points.start + 1
        ]

    @property
    def commanded(self) -> Array:
        """Points that were commanded [m], shape (n + 1, 2)."""
        return np.asarray(self.nominal + self.offset)

    @property
    def cuts(self) -> list[int]:
        """Points at which primitives begin and end, first and last point included."""
        changes = np.flatnonzero(np.diff(self.primitive)) + 1
        return [0, *changes.tolist(), len(self.primitive)]


class PathSamples(NamedTuple):
    """Samples of one or more paths.

    Attributes
    ----------
    x : ndarray, shape (k, 5)
        Process values, see `features`.
    s : ndarray, shape (k, 2)
        Compensations that were needed [mm per 50 mm].
    path : ndarray of int, shape (k,)
        Number of the path of each sample.
    relaxed : int
        How many were taken by the fading of the drift; the others began on a fresh sheet.
    left_out : mapping of str to int
        Why primitives gave no sample, and how many.
    """

    x: Array
    s: Array
    path: NDArray[np.int64]
    relaxed: int
    left_out: Mapping[str, int]


def samples_of_paths(paths: list[RecordedPath]) -> PathSamples:
    """Return the samples of recorded paths.

    A sample is the drift against the fed length of a primitive that begins on a fresh sheet,
    without offsets: 50 mm of a line, 30 mm of an arc, and of longer
    ones that much.  Sides of a path of lines that come later, or were compensated, give the rate
    of their drift beside its fading, see `identify_relaxation`, from which their sample follows.

    Parameters
    ----------
    paths : list of RecordedPath
        The paths.

    Returns
    -------
    PathSamples
        Samples in the order of paths and primitives.

    Notes
    -----
    On the simulated sheet a sample by fading differs from the one on a fresh sheet at the same
    place by 3 %, and by up to 10 % where the path was compensated: the foot then turns along a
    side.  A primitive near a clamped edge drifts less than one in the middle; no process value
    says so.
    """
    rows: list[Array] = []
    needed: list[Array] = []
    numbers: list[int] = []
    relaxed, left_out = 0, Counter[str]()
    parts = [(number, part) for number, path in enumerate(paths) for part in path.runs()]
    for number, path in parts:
        relaxation, why_not = _relaxation(path)
        cuts = path.cuts
        for index, (first, last) in enumerate(pairwise(cuts)):
            reason = _unusable(path, first)
            value = None
            if not reason:
                value, reason = _fresh(path, first, last)
            if value is None and not reason:
                if relaxation is None:
                    reason = why_not
                else:
                    value = _relaxed(path, first, last, relaxation, index)
                    relaxed += 1
            if value is None:
                left_out[reason] += 1
                continue
            rows.append(value[0])
            needed.append(value[1])
            numbers.append(number)
    width = len(PROCESS_VALUES)
    return PathSamples(
        np.array(rows).reshape(-1, width),
        np.array(needed).reshape(-1, 2),
        np.array(numbers, dtype=np.int64),
        relaxed,
        dict(left_out),
    )


def joined_groups(*labels: ArrayLike) -> NDArray[np.int64]:
    """Return one group number per row: rows that share any label belong together.

    Parameters
    ----------
    *labels : array_like of int, shape (k,)
        Labels from 0, such as the sheet and the process values of each row.

    Examples
    --------
    >>> joined_groups([0, 0, 1, 1, 2], [0, 1, 1, 2, 3]).tolist()
    [0, 0, 0, 0, 1]
    """
    columns = [np.asarray(label, dtype=np.int64) for label in labels]
    count, place = len(columns[0]), np.arange(len(columns[0]))
    edges, nodes = [], count
    for column in columns:
        edges.append((place, nodes + column))
        nodes += int(column.max(initial=-1)) + 1
    rows, marks = (np.concatenate(part) for part in zip(*edges, strict=True))
    graph = coo_array((np.ones(len(rows)), (rows, marks)), shape=(nodes, nodes))
    _, component = connected_components(graph, directed=False)
    _, group = np.unique(component[:count], return_inverse=True)
    return np.asarray(group.ravel(), dtype=np.int64)


def _unusable(path: RecordedPath, step: int) -> str:
    """Return why a primitive is of no use whatever was recorded of it."""
    if path.kind[step] != LINE and path.turn[step] < 0.0:
        return 'arcs that turn right'
    if path.depth[step] / path.material.thickness > DEPTH_RATIO_MAX:
        return f'depths of more than {DEPTH_RATIO_MAX:g} of the thickness'
    return ''


def _fresh(path: RecordedPath, first: int, last: int) -> tuple[tuple[Array, Array] | None, str]:
    """Return the sample of a primitive on a fresh sheet, or why it is none for good."""
    compensated = np.abs(path.offset[first : last + 1]).max() > _SAME_POINT
    if first > 0 or compensated:
        return None, ''
    points = path.nominal[first : last + 1]
    way = np.append(0.0, np.cumsum(np.hypot(*np.diff(points, axis=0).T)))
    wanted = SAMPLE_LENGTH[int(path.kind[first])]
    if way[-1] < _SHORTEST * wanted:
        short = f'single primitives shorter than {1e3 * _SHORTEST * wanted:g} mm'
        return None, '' if last < len(path.primitive) else short
    end = int(np.abs(way - wanted).argmin())
    drift = points[: end + 1] - path.stitched[first : first + end + 1]
    slope = way[: end + 1] @ (drift - drift[0]) / (way[: end + 1] @ way[: end + 1])
    return _sample(path, first, points[[0, end]], slope), ''


def _relaxed(
    path: RecordedPath, first: int, last: int, relaxation: Relaxation, side: int
) -> tuple[Array, Array]:
    """Return the sample that a line would give on a fresh sheet, from its rate of drift."""
    factor = initial_rate_factor(
        SAMPLE_LENGTH[LINE], path.step[first], relaxation.leak_length, relaxation.prompt_length
    )
    ends = path.commanded[[first, last]]
    return _sample(path, first, ends, relaxation.rate[side] / factor)


def _sample(path: RecordedPath, step: int, ends: Array, slope: Array) -> tuple[Array, Array]:
    """Return process values and compensation of a drift per feed between two points."""
    chord = StitchPath(
        ends, path.kind[step], depth=path.depth[step], step=path.step[step],
        turn=np.sign(path.turn[step]),
    )  # fmt: skip
    x, sign = feature_rows(chord, path.material)
    return x[0], np.asarray(sign[0] * slope * (REFERENCE_LENGTH / _MM))


def _relaxation(path: RecordedPath) -> tuple[Relaxation | None, str]:
    """Return how the drift of a path fades, or why that cannot be told."""
    if (path.kind != LINE).any():
        return None, 'later or compensated primitives of a path with arcs'
    cuts = path.cuts
    if len(cuts) < 3 or min(np.diff(cuts)) < _STEPS_MIN:
        return None, (
            f'later or compensated primitives of a path without two sides of {_STEPS_MIN} steps'
        )
    try:
        found = identify_relaxation(path.commanded, path.stitched, cuts)
    except ValueError:
        return None, 'later or compensated sides of a path whose fading cannot be told'
    drift = path.commanded - path.stitched
    if found.residual > RESIDUAL_MAX * float(np.sqrt(np.mean((drift - drift[0]) ** 2))):
        return None, 'later or compensated sides of a path whose drift does not fade evenly'
    return found, ''

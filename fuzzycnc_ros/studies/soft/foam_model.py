# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""What compensation on soft material came to: tracks, cycles of learning, and trainings."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from fuzzycnc_ros.studies.page.document import INLINE

if TYPE_CHECKING:
    from fuzzycnc_ros.core.arrays import Array
    from fuzzycnc_ros.simulation.soft.foam_tracks import TrackQuality

NONE, STS, NTS, PUBLISHED = 'none', 'sts', 'nts', 'published'

METHODS = {
    NONE: 'no compensation',
    STS: 'linear rules (STS)',
    NTS: 'hidden layer (NTS, default)',
    PUBLISHED: 'as published: 4 inputs, ramp',
}
"""Ways to compensate by name, as tables and plots call them."""

PUBLISHED_MEANS = {
    NONE: (5.09, 0.44, 2.86),
    STS: (4.06, 0.34, 5.66),
    PUBLISHED: (2.42, 0.25, 3.05),
}
"""Published averages: angle error [deg], straightness [mm], time of a primitive [s]."""


@dataclass(frozen=True, eq=False)
class MethodFigures:
    """What one way to compensate does on one track.

    Attributes
    ----------
    mean : TrackQuality
        Mean of the runs, SI.
    angle_spread : float
        Standard deviation of the angle error over the runs [rad].
    refused, limited : int
        Steps that the model was not asked for, and that a limit was at work on.
    commanded, stitched : ndarray, shape (n + 1, 2)
        Commanded points, and the stitches of the first run [m].
    """

    mean: TrackQuality = field(metadata=INLINE)
    angle_spread: float
    refused: int
    limited: int
    commanded: Array
    stitched: Array


@dataclass(frozen=True, eq=False)
class TrackFigures:
    """One track under all methods, and learnt.

    Attributes
    ----------
    name : str
        What it is called.
    angle, thickness, depth : float
        Angle of the parallelogram [rad], thickness of the sheet and feed depth [m].
    nominal : ndarray, shape (n + 1, 2)
        Nominal points [m].
    methods : mapping of str to MethodFigures
        By name as in `METHODS`.
    learning : mapping of str to sequence of TrackQuality
        Means over the runs before each cycle and after the last one, by what it began with.
    """

    name: str
    angle: float
    thickness: float
    depth: float
    nominal: Array
    methods: Mapping[str, MethodFigures]
    learning: Mapping[str, Sequence[TrackQuality]]


@dataclass(frozen=True, eq=False)
class FoamComparison:
    """All tracks.

    Attributes
    ----------
    seed, runs : int
        Seed of samples and runs, and runs of each track and method.
    tracks : sequence of TrackFigures
        The tracks.
    """

    seed: int
    runs: int
    tracks: Sequence[TrackFigures]


@dataclass(frozen=True, eq=False)
class Coverage:
    """Samples of one thickness.

    Attributes
    ----------
    thickness : float
        Thickness [m].
    lines, arcs : int
        Samples of each kind.
    direction, depth, step : tuple of float
        Least and largest direction [rad], depth and step [m].
    """

    thickness: float
    lines: int
    arcs: int
    direction: tuple[float, float]
    depth: tuple[float, float]
    step: tuple[float, float]


@dataclass(frozen=True, eq=False)
class MethodErrors:
    """Errors of one kind of model on samples that were held out.

    Attributes
    ----------
    name : str
        What it is called.
    predicted : ndarray, shape (k, 2)
        Compensations of all samples, each held out in turn [mm per 50 mm].
    rms : float
        Root mean square of both axes over all samples [mm per 50 mm].
    by_thickness : mapping of float to float
        The same by thickness [m].
    """

    name: str
    predicted: Array
    rms: float
    by_thickness: Mapping[float, float]


@dataclass(frozen=True, eq=False)
class FoamTraining:
    """A training, judged.

    Attributes
    ----------
    coverage : sequence of Coverage
        Samples by thickness.
    needed : ndarray, shape (k, 2)
        Compensations that were needed [mm per 50 mm].
    errors : sequence of MethodErrors
        Held-out errors, the model in use first.
    folds, groups : int
        Parts that were held out in turn, and groups of samples that were kept together.
    """

    coverage: Sequence[Coverage]
    needed: Array
    errors: Sequence[MethodErrors]
    folds: int
    groups: int

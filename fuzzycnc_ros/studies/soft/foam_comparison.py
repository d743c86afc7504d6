# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Tracks on the simulated soft sheet, stitched without and with compensation, and learnt."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from fuzzycnc_ros.core.arrays import Array
from fuzzycnc_ros.core.deformation.compensation import (
    CompensationConfig,
    OffsetPath,
    compensate_path,
    learn_offsets,
)
from fuzzycnc_ros.core.deformation.model import DeformationModel
from fuzzycnc_ros.core.deformation.network import TSFuzzyNetwork
from fuzzycnc_ros.core.deformation.stitch_path import SheetMaterial, StitchPath
from fuzzycnc_ros.simulation.soft.foam_samples import foam_samples
from fuzzycnc_ros.simulation.soft.foam_sheet import FoamSheet
from fuzzycnc_ros.simulation.soft.foam_tracks import FoamTrack, TrackQuality
from fuzzycnc_ros.studies.page.document import INLINE

Tell = Callable[[str, int, int], None]

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

RUNS = 11
"""Runs of a track under each method, as published."""

CYCLES = 3
"""Cycles of learning."""

FIRST_RUN = 500
"""Seed of the first run with seed 0; a seed has a hundred to itself."""

STEP = 3e-3
"""Nominal stitch step [m]."""

SIZE = (0.15, 0.1)
"""Sheet of the tracks [m]; models are trained on a larger one."""

_NETWORKS = {
    STS: lambda: TSFuzzyNetwork('sts'),
    NTS: TSFuzzyNetwork,
    PUBLISHED: lambda: TSFuzzyNetwork(features='paper', width_floor=0.5),
}
_RAMP = CompensationConfig(accumulate='ramp', rate_max=0.5, offset_max=0.1)  # nothing limited


@dataclass(frozen=True, eq=False)
class MethodFigures:
    """Figures of one way to compensate on one track.

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

    @property
    def title(self) -> str:
        """Name for readers."""
        return self.name.replace(' deg', '°')


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


@dataclass(frozen=True)
class TrackCase:
    """A parallelogram of 70 mm by 50 mm on a sheet.

    Parameters
    ----------
    angle : float
        Its angle [deg].
    thickness, depth : float
        Thickness of the sheet and feed depth [mm].
    """

    angle: float
    thickness: float
    depth: float

    @property
    def name(self) -> str:
        """Name of the case."""
        return f'{self.angle:g} deg, {self.thickness:g} mm thick, {self.depth:g} mm deep'

    @cached_property
    def track(self) -> FoamTrack:
        """Its points."""
        return FoamTrack.parallelogram(float(np.radians(self.angle)), step=STEP)

    @cached_property
    def material(self) -> SheetMaterial:
        """The sheet as the compensation knows it."""
        return SheetMaterial(1e-3 * self.thickness, SIZE)

    @cached_property
    def sheet(self) -> FoamSheet:
        """The sheet itself."""
        return FoamSheet(1e-3 * self.thickness, SIZE)

    @cached_property
    def path(self) -> StitchPath:
        """Path to be stitched."""
        return StitchPath(self.track.points, depth=1e-3 * self.depth, step=STEP)

    def stitch(self, commanded: Array, rng: np.random.Generator) -> Array:
        """Return the stitches of a run on a sheet of its own."""
        return self.sheet.scattered(rng).stitch(commanded, 1e-3 * self.depth, rng=rng)

    def compensated(
        self, model: DeformationModel, config: CompensationConfig | None = None
    ) -> OffsetPath:
        """Return the path with the offsets of a model."""
        return compensate_path(
            self.path,
            self.material,
            model.predict,
            config=config,
            gate=model,
            support=model.support,
        )


TRACKS = (
    TrackCase(45, 15, 6),
    TrackCase(30, 15, 6),
    TrackCase(60, 15, 6),
    TrackCase(45, 20, 8),
    TrackCase(45, 25, 10),
)
"""The published track and four others."""


def compare_foam(
    seed: int = 0,
    *,
    runs: int = RUNS,
    progress: Tell = lambda text, done, total: None,
) -> FoamComparison:
    """Stitch tracks without and with compensation, and learn them.

    Parameters
    ----------
    seed : int
        Seed of the training samples, and of sheets and stitches of the runs.
    runs : int
        Runs of each track and method, each on a sheet that scatters; at least 1.
    progress : callable
        Told what is going on, steps done and in all.

    Returns
    -------
    FoamComparison
        Means and first runs.
    """
    samples = foam_samples(seed)
    total = len(_NETWORKS) + len(TRACKS)
    models = {}
    for done, (name, network) in enumerate(_NETWORKS.items()):
        progress('training', done, total)
        models[name] = network().fit(*samples).model_
    seeds = range(FIRST_RUN + 100 * seed, FIRST_RUN + 100 * seed + runs)
    found = []
    for done, case in enumerate(TRACKS):
        progress(case.name, len(_NETWORKS) + done, total)
        paths = {NONE: OffsetPath.unchanged(case.track.points)}
        for name, model in models.items():
            paths[name] = case.compensated(model, _RAMP if name == PUBLISHED else None)
        found.append(
            TrackFigures(
                name=case.name,
                angle=float(np.radians(case.angle)),
                thickness=1e-3 * case.thickness,
                depth=1e-3 * case.depth,
                nominal=case.track.points,
                methods={name: _figures(case, path, seeds) for name, path in paths.items()},
                learning={name: _learning(case, paths[name], seeds) for name in (NONE, NTS)},
            )
        )
    return FoamComparison(seed, runs, found)


def _figures(case: TrackCase, path: OffsetPath, seeds: Sequence[int]) -> MethodFigures:
    """Return what the runs of a commanded path come to."""
    commanded = path.commanded
    stitched = [case.stitch(commanded, np.random.default_rng(seed)) for seed in seeds]
    found = [case.track.measure(run, commanded) for run in stitched]
    refused = path.refused
    return MethodFigures(
        mean=_mean(found),
        angle_spread=float(np.std([quality.angle_error for quality in found])),
        commanded=commanded,
        stitched=stitched[0],
        refused=int(refused.sum()),
        limited=int(((path.flag != 0) & ~refused).sum()),
    )


def _learning(
    case: TrackCase, start: OffsetPath, seeds: Sequence[int]
) -> tuple[TrackQuality, ...]:
    """Return the qualities before each cycle of learning and after the last one."""
    courses = []
    for seed in seeds:
        rng, path, course = np.random.default_rng([seed, 1]), start, []
        for _ in range(CYCLES + 1):
            stitched = case.stitch(path.commanded, rng)
            course.append(case.track.measure(stitched, path.commanded))
            path = learn_offsets(path, stitched, size=SIZE)
        courses.append(course)
    return tuple(_mean(found) for found in zip(*courses, strict=True))


def _mean(found: Sequence[TrackQuality]) -> TrackQuality:
    return TrackQuality(*np.mean(found, axis=0).tolist())

# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Bags of stitched tracks and samples, as a run with `deformation_compensator` records them."""

from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np

from fuzzycnc_ros.runtime.enums import PrimitiveKind
from fuzzycnc_ros.runtime.records import CompensatedPath, Material, StitchedPath
from fuzzycnc_ros.simulation.soft.foam_sheet import FoamSheet
from fuzzycnc_ros.simulation.soft.foam_tracks import FoamTrack
from fuzzycnc_ros.studies.published_bag import PublishedBag

SECOND = 10**9
SIZE = (0.15, 0.1)


@dataclass
class Run:
    """One stitched path: a 45 deg track unless told otherwise."""

    path_id: str = 'track'
    name: str = 'foam'
    thickness: float = 15e-3
    depth: float = 6e-3
    step: float = 3e-3
    nominal: np.ndarray = field(
        default_factory=lambda: FoamTrack.parallelogram(np.radians(45.0)).points
    )
    primitive: np.ndarray | None = None
    kind: np.ndarray | None = None
    offset: np.ndarray | None = None
    friction: float = 0.35
    seed: int | None = None
    cut: int = 0
    size: tuple[float, ...] = SIZE

    def records(self, stamp):
        """Return the topics and records of the run, from a stamp on."""
        steps = len(self.nominal) - 1
        offset = np.zeros_like(self.nominal) if self.offset is None else self.offset
        sides = np.searchsorted([23, 40, 63], np.arange(steps), side='right')
        primitive = sides if self.primitive is None else self.primitive
        kind = np.zeros(steps, np.uint8) if self.kind is None else self.kind
        rng = None if self.seed is None else np.random.default_rng(self.seed)
        sheet = FoamSheet(self.thickness, self.size or (0.2, 0.12), friction=self.friction)
        fresh = [0, *np.flatnonzero(kind == PrimitiveKind.JUMP) + 1, steps + 1]
        stitched = np.concatenate([
            sheet.stitch((self.nominal + offset)[a:b], self.depth, rng=rng)
            for a, b in pairwise(fresh)
        ])  # fmt: skip
        stitched = stitched[: len(stitched) - self.cut]
        frame = {'frame_id': 'quilter/workpiece'}
        yield 'material', Material(
            stamp=stamp, name=self.name, thickness=self.thickness,
            size=np.array(self.size), **frame,
        )  # fmt: skip
        yield 'compensated_path', CompensatedPath(
            stamp=stamp, path_id=self.path_id, material=self.name, thickness=self.thickness,
            model='', nominal=self.nominal.ravel(), offset=offset.ravel(),
            primitive=primitive.astype(np.uint32),
            kind=kind, turn=np.zeros(steps),
            depth=np.full(steps, self.depth), step=np.full(steps, self.step),
            compensation=np.zeros(2 * steps), support=np.full(steps, np.nan),
            flag=np.zeros(steps, np.uint8), **frame,
        )  # fmt: skip
        yield 'stitched_path', StitchedPath(
            stamp=stamp + 12 * SECOND, path_id=self.path_id,
            time=np.arange(1.0, len(stitched)), tool=np.full(2 * len(stitched), np.nan),
            stitched=stitched.ravel(), **frame,
        )  # fmt: skip


def write_bag(path, *runs):
    """Write a bag of runs, one after the other."""
    with PublishedBag(path, machine='quilter') as bag:
        for number, run in enumerate(runs):
            for topic, record in run.records((1 + 20 * number) * SECOND):
                bag(topic, record)


def sample_run(row, number):
    """Return the run of one sample that is a line, given by its process values."""
    direction, depth, _, step, thickness = row
    along = np.array([np.cos(np.radians(direction)), np.sin(np.radians(direction))])
    steps = round(50.0 / step)
    centre = np.array([0.1, 0.06])
    points = centre + np.outer(np.linspace(-25e-3, 25e-3, steps + 1), along)
    return Run(
        path_id=f'sample {number}', name=f'foam {thickness:g}', thickness=1e-3 * thickness,
        depth=1e-3 * depth, step=1e-3 * step, nominal=points, primitive=np.zeros(steps, int),
        size=(0.2, 0.12),
    )  # fmt: skip

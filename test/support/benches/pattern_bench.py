# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""A deformation compensator that knows its sheet, and patterns for it."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
from benches.component_bench import Bench
from kept import kept

from fuzzycnc_ros.components.soft.deformation_compensator import (
    DeformationCompensator,
    DeformationCompensatorConfig,
)
from fuzzycnc_ros.components.soft.stitch_patterns import stitch_pattern
from fuzzycnc_ros.core.deformation.model import write_model
from fuzzycnc_ros.core.deformation.network import TSFuzzyNetwork
from fuzzycnc_ros.core.deformation.stitch_path import Primitive
from fuzzycnc_ros.runtime.enums import PrimitiveKind
from fuzzycnc_ros.runtime.records import Material, nanoseconds
from fuzzycnc_ros.simulation.soft.foam_samples import foam_samples
from fuzzycnc_ros.simulation.soft.foam_tracks import FoamTrack

FRAME = 'mill/workpiece'
TRACK = FoamTrack.parallelogram(np.radians(45.0))
CORNERS = [(float(x), float(y)) for x, y in TRACK.points[list(TRACK.corners)]]
SIDES = [Primitive(start, end, 6e-3, 3e-3) for start, end in pairwise(CORNERS)]


@kept
def model_text():
    """Return a model of simulated samples."""
    return write_model(TSFuzzyNetwork().fit(*foam_samples(0)).model_)


def material(time=1.0, **changes):
    """Return a sheet of 150 x 100 x 15 mm."""
    values = {'name': 'foam', 'thickness': 15e-3, 'size': np.array([0.15, 0.1]), **changes}
    return Material(**{'stamp': nanoseconds(time), 'frame_id': FRAME, **values})


def pattern(primitives=SIDES, time=2.0, path_id='track', **changes):
    """Return a pattern of primitives, with fields changed afterwards."""
    made = stitch_pattern(
        primitives, path_id=path_id, feed=0.021, stamp=nanoseconds(time), frame_id=FRAME
    )
    return replace(made, **changes)


def with_travel(lines, travels):
    """Return a pattern of lines, with kinds of travel behind some of them.

    Parameters
    ----------
    lines : sequence of Primitive
        Lines; where one does not begin at the end of the last, the tool jumps there.
    travels : mapping of int to tuple of PrimitiveKind
        Trims and stops behind lines by their number.
    """
    rows = []
    for number, line in enumerate(lines):
        if rows and line.start != rows[-1][1]:
            rows.append((PrimitiveKind.JUMP, line.start))
        rows.append((PrimitiveKind.LINE, line.end))
        rows += [(kind, line.end) for kind in travels.get(number, ())]
    stitched = np.array([kind == PrimitiveKind.LINE for kind, _ in rows])
    return pattern(
        lines,
        kind=np.array([kind for kind, _ in rows], np.uint8),
        end=np.array([end for _, end in rows]).ravel(),
        centre=np.full(2 * len(rows), np.nan),
        turn=np.zeros(len(rows)),
        depth=np.where(stitched, 6e-3, 0.0),
        step=np.where(stitched, 3e-3, 0.0),
        feedrate=np.where(stitched, 0.021, 0.05),
    )


class Compensator(Bench):
    """An active compensator that knows its sheet."""

    def __init__(self, model='', *, sheet=True, offsets='', **config):
        super().__init__(DeformationCompensator(DeformationCompensatorConfig(**config)))
        if model:
            assert self.request('use_model', model=model).success
        if offsets:
            assert self.request('use_offsets', offsets=offsets).success
        assert self.request('activate').success
        if sheet:
            self.give('material', material())

    def stitch(self, made):
        """Hand over a pattern; return the compensated path and the tool path, None if none."""
        found = {item.output: item.record for item in self.give('stitch_pattern', made)}
        assert set(found) in (set(), {'compensated_path', 'tool_path'})
        return found.get('compensated_path'), found.get('tool_path')

    def refusal(self, made):
        """Hand over a pattern that is refused; return why."""
        assert self.stitch(made) == (None, None)
        health = self.component.health()[0]
        assert health.level.name == 'ERROR'
        return health.message


def points(values):
    """Return flat X and Y as rows."""
    return values.reshape(-1, 2)

# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The component of soft sheets at work."""

import random
from dataclasses import replace
from functools import cache

import numpy as np
from benches import pattern_bench
from benches.component_bench import Bench
from fuzzing.targets import CopiedTarget, work

from fuzzycnc_ros.core.deformation.compensation import StepFlag
from fuzzycnc_ros.core.deformation.offset_file import StitchOffsets, write_offsets
from fuzzycnc_ros.simulation.soft.foam_tracks import FoamTrack

LEARNT = 'learnt track'
"""Name of the pattern that offsets were learnt for."""


@cache
def offsets_text() -> str:
    """Return a file of learnt offsets."""
    points = FoamTrack.parallelogram(np.radians(45.0)).points
    shift = 1e-4 * np.sin(np.arange(2 * len(points))).reshape(-1, 2)
    shift[0] = 0.0
    return write_offsets(StitchOffsets(LEARNT, 'foam', points, shift))


class DeformationTarget(CopiedTarget):
    """A deformation compensator with a model that knows its sheet."""

    component = 'deformation_compensator'
    inputs = ('material', 'stitch_pattern')
    offsets = False

    def make(self) -> Bench:
        text = offsets_text() if self.offsets else ''
        bench = pattern_bench.Compensator(pattern_bench.model_text(), offsets=text)
        bench.component.machine = 'mill'
        return bench

    def good(self, name, stamp, rng):
        if name == 'material':
            return replace(pattern_bench.material(), stamp=stamp)
        path_id = LEARNT if self.offsets else f'track {stamp}'
        return replace(pattern_bench.pattern(path_id=path_id), stamp=stamp)

    def recover(self, bench, stamp):
        for name in self.inputs:
            bench.push(name, self.good(name, stamp + 1, random.Random(0)))
        work(bench, stamp + 1)
        path = bench.records('compensated_path')[-1]
        assert path.stamp == stamp + 1, bench.health()
        assert path.model
        assert np.any(path.offset)
        assert bench.records('tool_path')[-1].path_id == path.path_id

    def check(self, bench):
        paths, tools = bench.records('compensated_path'), bench.records('tool_path')
        assert [item.path_id for item in paths] == [item.path_id for item in tools]
        for item in paths:
            steps = len(item.flag)
            assert len(item.nominal) == len(item.offset) == 2 * steps + 2
            refused = item.flag & int(StepFlag.OUTSIDE_DOMAIN | StepFlag.RIGHT_TURN) != 0
            assert not np.any(item.compensation.reshape(-1, 2)[refused])
            reach = np.hypot(*item.offset.reshape(-1, 2).T)
            assert reach.max() <= bench.component.configuration.offset_max * (1.0 + 1e-9)


class LearntTarget(DeformationTarget):
    """A deformation compensator with learnt offsets for the pattern."""

    offsets = True

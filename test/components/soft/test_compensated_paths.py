# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Compensated paths that the machine side takes, and those that it refuses."""

import re
from dataclasses import replace

import numpy as np
import pytest

from fuzzycnc_ros.components.machine.stitching import Stitching
from fuzzycnc_ros.runtime.component import Level
from fuzzycnc_ros.runtime.records import CompensatedPath
from fuzzycnc_ros.simulation.soft.foam_sheet import FoamSheet

PATH = CompensatedPath(
    stamp=0,
    path_id='p',
    material='foam',
    thickness=15e-3,
    model='',
    nominal=np.linspace(0.03, 0.05, 12),
    offset=np.zeros(12),
    primitive=np.zeros(5, np.uint32),
    kind=np.zeros(5, np.uint8),
    turn=np.zeros(5),
    depth=np.full(5, 6e-3),
    step=np.full(5, 3e-3),
    compensation=np.zeros(10),
    support=np.full(5, np.nan),
    flag=np.zeros(5, np.uint8),
)


@pytest.mark.parametrize(
    ('changes', 'complaint'),
    [
        ({'offset': np.zeros(4)}, 'offset: expected 12 values for 5 stitches, not 4'),
        ({'turn': np.zeros(4)}, 'turn: expected 5 values'),
        ({'kind': np.full(5, 9, np.uint8)}, 'kind: expected 0 to 4 but found 9'),
        ({'turn': np.full(5, np.nan)}, 'turn: expected finite'),
        ({'depth': np.zeros(0)}, 'depth: expected 1 to 200000 stitches but found 0'),
        ({'depth': np.full(5, -6e-3)}, 'depth: expected more than 0 m but found -0.006'),
        ({'depth': np.full(5, np.nan)}, 'depth: expected more than 0 m but found nan'),
        ({'nominal': np.full(12, np.nan)}, 'nominal: expected up to 1000 m but found nan'),
        ({'offset': np.full(12, 1e300)}, r'offset: expected up to 1000 m but found 1e\+300'),
    ],
)
def test_paths_that_mean_nothing_are_not_stitched(changes, complaint):
    stitching = Stitching(FoamSheet(15e-3, (0.15, 0.1)), -1)
    stitching.load(replace(PATH, **changes))
    assert stitching.health().level is Level.ERROR
    assert re.search(f'p not stitched: {complaint}', stitching.health().message)


def test_paths_of_the_compensator_are_taken():
    stitching = Stitching(FoamSheet(15e-3, (0.15, 0.1)), -1)
    stitching.load(PATH)
    assert stitching.health().message == 'p loaded'

# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The contour error of a program on a controller."""

import numpy as np
import pytest

from fuzzycnc_ros.core.feedrate.gcode.reader import read_program
from fuzzycnc_ros.core.machine.path_loop import ContouringConfig
from fuzzycnc_ros.simulation.controller.blends import ControllerLimits
from fuzzycnc_ros.simulation.controller.program import program_moves
from fuzzycnc_ros.studies.programs import program_judge

LIMITS = ControllerLimits(velocity=(0.4,) * 3, acceleration=(0.5,) * 3, path_velocity=0.5)


def slow_corners(seed):
    """Return a program of short slow lines in all directions."""
    random = np.random.default_rng(seed)
    x = y = 0.0
    lines = ['G92 X0 Y0 Z0', 'G21 G90 G64 P0.004']
    for _ in range(40):
        heading = random.uniform(-np.pi, np.pi)
        x, y = x + 0.3 * np.cos(heading), y + 0.3 * np.sin(heading)
        lines.append(f'G1 X{x:.4f} Y{y:.4f} F{random.uniform(50, 110):.2f}')
    return '\n'.join(lines) + '\n'


@pytest.mark.parametrize('seed', [0, 1, 10, 14])
def test_no_corner_has_a_larger_error_than_the_one_that_is_said(seed, monkeypatch):
    """However many other peaks are larger than the samples beside it."""
    moves = program_moves(read_program(slow_corners(seed)).blocks)

    def error():
        return program_judge.ProgramPath(moves).run(moves, LIMITS, ContouringConfig()).error

    monkeypatch.setattr(program_judge, '_PEAKS', 1)
    said = error()
    monkeypatch.setattr(program_judge, '_EVERY', 1)  # every sample
    assert said == pytest.approx(error(), rel=1e-9)

# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The simulated controller beside a real LinuxCNC, on random short programs that it ran."""

import json
from math import ceil
from pathlib import Path

import numpy as np
import pytest
from equipment.linuxcnc_short import compared, figures
from programs.short_programs import PLUNGES

from fuzzycnc_ros.core.feedrate.gcode.reader import read_program
from fuzzycnc_ros.core.machine.path_loop import ContouringConfig
from fuzzycnc_ros.simulation.controller import agreement
from fuzzycnc_ros.simulation.controller.blends import ControllerLimits
from fuzzycnc_ros.simulation.controller.program import program_moves
from fuzzycnc_ros.studies.programs.program_judge import ProgramPath

MEASURED = json.loads(Path(__file__).with_name('short_programs.json').read_text())
"""What LinuxCNC 2.9 took and left: `benchmarks/linuxcnc_short_programs.py`."""
PLUNGED = json.loads(Path(__file__).with_name('short_plunges.json').read_text())
"""The same of plunges after rapids."""
HIDDEN = (24, 95, 98, 107)
"""Those of which a bend has larger errors than the samples after the worst one of a plunge."""
SPACE = {'lines in space', 'helix'}
ARCS = {'line and arc', 'arcs', 'lines and arcs'}


def rows(step=1):
    """Compare every so many programs; those whose queue had run short as they ran again."""
    found = figures(MEASURED['driven']) | figures(MEASURED['again'])
    return compared(MEASURED['seed'], dict(list(found.items())[::step]))


def largest(found):
    """Return the largest error driven over simulated, by what programs have."""
    ratios = {agreement.LINES: [1.0], agreement.ARCS: [1.0], agreement.SPACE: [1.0]}
    for row in found:
        kind = agreement.SPACE if row.kind in SPACE else agreement.LINES
        ratios[agreement.ARCS if row.kind in ARCS else kind].append(row.error_ratio)
    return {kind: max(values) for kind, values in ratios.items()}


def test_time_and_error_are_those_of_linuxcnc():
    found = rows(step=7)
    assert len(found) > 70
    assert all(row.agrees for row in found)
    times, errors = np.array([(row.time_ratio, row.error_ratio) for row in found]).T
    assert np.quantile(np.abs(times - 1.0), 0.95) < 0.02
    assert np.quantile(np.abs(errors - 1.0), 0.95) < 0.03
    for kind, ratio in largest(found).items():
        assert ratio <= agreement.LARGEST[kind]


def test_what_a_rapid_leaves_counts_from_the_first_sample_of_the_plunge():
    found = figures(PLUNGED['driven'])
    for row in compared(PLUNGED['seed'], {number: found[number] for number in HIDDEN}, PLUNGES):
        assert row.time_ratio == pytest.approx(1.0, abs=0.01)
        assert row.error_ratio == pytest.approx(1.0, abs=0.01)


@pytest.mark.slow
def test_plunges_leave_what_linuxcnc_does():
    found = compared(PLUNGED['seed'], figures(PLUNGED['driven']), PLUNGES)
    assert len(found) == 120
    assert all(row.agrees for row in found)
    assert max(row.error_ratio for row in found) <= agreement.LARGEST[agreement.ARCS]


@pytest.mark.slow
def test_the_disagreement_that_advice_carries_is_the_largest_that_was_measured():
    found = rows()
    assert len(found) == 500
    assert all(row.agrees for row in found)
    rounded = {kind: ceil(100.0 * ratio) / 100.0 for kind, ratio in largest(found).items()}
    assert rounded == agreement.LARGEST


@pytest.mark.parametrize(
    ('text', 'kinds'),
    [
        ('G0 Z5\nX1 Y1 Z0\nG1 X5 Y2 F100\nZ-1\n', {'lines'}),
        ('G1 X5 F100\nG2 X6 Y1 I0 J1\n', {'lines', 'arcs'}),
        ('G1 X5 Y1 Z2 F100\n', {'lines', 'space'}),
        ('G2 X1 Y1 Z2 I0 J1 F100\n', {'lines', 'arcs', 'space'}),
        ('G2 X0 Y0 Z2 I0 J1 F100\n', {'lines', 'arcs', 'space'}),
    ],
)
def test_kinds_of_motion(text, kinds):
    start = 'G92 X0 Y0 Z0\n'
    assert agreement.kinds(program_moves(read_program(start + text).blocks).moves) == kinds


@pytest.mark.parametrize(
    ('acceleration', 'duration', 'error'),
    [(0.3, 0.714, 21.95), (1.0, 0.653, 31.05), (3.0, 0.664, 18.06)],
)
def test_a_short_slow_block_is_entered_too_fast_as_linuxcnc_does(acceleration, duration, error):
    """Its planner brakes for a feed one part ahead only, and what rounds a corner is a part."""
    text = (
        'G21 G90 G94 G17 G40\nG92 X0 Y0 Z0\nG64 P0.004 Q0.004\nF1016\nG1 X2.0000\n'
        'X2.1384 Y0.0269 F128\nX2.1943 Y0.1098 F114\nX2.2502 Y0.1927 F1016\n'
        'X2.3062 Y0.2756 F177\nX3.4246 Y1.9337 F300\nM2\n'
    )
    moves = program_moves(read_program(text).blocks)
    limits = ControllerLimits(
        velocity=(0.4,) * 3, acceleration=(acceleration,) * 3, path_velocity=0.5
    )
    judged = ProgramPath(moves).run(moves, limits, ContouringConfig())
    assert judged.duration == pytest.approx(duration, abs=0.003)
    assert 1e6 * judged.error == pytest.approx(error, rel=0.01)

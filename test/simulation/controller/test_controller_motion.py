# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The simulated controller: laws of its motion, and what a real LinuxCNC took for the same."""

from dataclasses import replace
from math import inf, isnan, pi, sqrt

import numpy as np
import pytest

from fuzzycnc_ros.core.feedrate.gcode.reader import read_program
from fuzzycnc_ros.core.feedrate.path.curves import CURVES, SHEET_SCALES
from fuzzycnc_ros.core.machine.path_loop import ContouringConfig
from fuzzycnc_ros.simulation.controller.blends import ControllerLimits
from fuzzycnc_ros.simulation.controller.moves import merged
from fuzzycnc_ros.simulation.controller.program import (
    PathMode,
    path_modes,
    program_moves,
    simulate,
    with_mode,
)
from fuzzycnc_ros.studies.programs.program_judge import ProgramPath

LIMITS = ControllerLimits(velocity=(0.4,) * 3, acceleration=(2.0,) * 3, path_velocity=0.5)
PERIOD = LIMITS.period


def moves(text, mode=None):
    return program_moves(read_program(text).blocks, mode)


def only(text, mode=None, limits=LIMITS):
    """What is commanded for a program without a gap."""
    [found] = simulate(moves(text, mode), limits)
    return found


def zigzag(seed, count=30):
    """A program of lines and arcs with corners of all kinds."""
    random = np.random.default_rng(seed)
    lines, x, y = ['G1 F3000'], 0.0, 0.0
    for _ in range(count):
        angle, way = random.uniform(0.0, 2.0 * pi), random.choice([0.1, 1.0, 8.0])
        x, y = x + way * np.cos(angle), y + way * np.sin(angle)
        if random.random() < 0.3:
            lines.append(f'G3 X{x:.4f} Y{y:.4f} R{0.6 * way:.4f}')
        else:
            lines.append(f'G1 X{x:.4f} Y{y:.4f}')
    return '\n'.join(lines) + '\n'


def test_a_line_takes_its_trapezoid():
    # up to 0.1 m/s in 50 ms and 2.5 mm, and down again
    found = only('G61 G1 X100 F6000\n')
    assert found.duration == pytest.approx(0.95 + 2 * 0.05, abs=4 * PERIOD)
    short = only('G61 G1 X2 F6000\n')
    assert short.duration == pytest.approx(2.0 * sqrt(2e-3 / 2.0), abs=4 * PERIOD)
    # the last move of G64 might have to share its acceleration with a next one
    half = only('G64 G1 X100 F6000\n')
    assert half.duration == pytest.approx(0.9 + 2 * 0.1, abs=4 * PERIOD)


@pytest.mark.parametrize('seed', range(6))
@pytest.mark.parametrize('mode', [PathMode(0.0), PathMode(1e-5, 1e-5), PathMode(1e-4, 0.0)])
def test_from_start_to_end_within_the_limits_and_the_tolerance(seed, mode):
    program = moves(zigzag(seed), mode)
    [found] = simulate(program, LIMITS)
    plain = program.moves
    assert found.position[[0, -1]] == pytest.approx(
        np.stack([plain.start[0], plain.end[-1]]), abs=1e-9
    )
    assert np.all(np.diff(found.place) > -1e-6)
    speed = np.diff(found.position, axis=0) / PERIOD
    # moves that overlap, and curves that stand for arcs, run a little faster
    assert np.linalg.norm(speed, axis=1).max() <= 0.05 * 1.06
    rise = np.diff(speed, axis=0) / PERIOD
    # kinks and blends are sampled, as in the controller itself
    assert np.quantile(np.abs(rise), 0.99) <= 2.0 * 1.3
    judged = ProgramPath(program).judge([found], ContouringConfig())
    assert (
        judged.deviation <= max(mode.rounding, mode.merging) * 1.3 + 3.1e-7
    )  # the lines of an arc


@pytest.mark.parametrize('seed', range(4))
def test_less_is_slower_and_nearer(seed):
    program = moves(zigzag(seed), PathMode(5e-5, 0.0))
    path = ProgramPath(program)
    durations, errors = [], []
    for rise in (4.0, 1.0, 0.25, 0.06):
        judged = path.run(program, replace(LIMITS, acceleration=(rise,) * 3), ContouringConfig())
        durations.append(judged.duration)
        errors.append(judged.error)
    assert durations == sorted(durations)
    assert errors == sorted(errors, reverse=True)
    tighter = path.run(with_mode(program, PathMode(5e-6, 0.0)), LIMITS, ContouringConfig())
    assert tighter.duration >= path.run(program, LIMITS, ContouringConfig()).duration - PERIOD


def test_long_ways_end_and_rests_stand():
    """A way of 20 m is not told from its end by less than some femtometres."""
    found = only('G61 G1 X20000 F24000\nG4 P0.5\nX0 Y3\nG4 P0.25\n')
    still = np.abs(np.diff(found.position, axis=0)).max(axis=1) < 1e-12
    assert found.position[[0, -1]] == pytest.approx(np.array([[0, 0, 0], [0, 0.003, 0]]))
    assert still.sum() * PERIOD == pytest.approx(0.75, abs=0.02)
    assert found.position.max() < 20.0 + 1e-9


def test_no_corner_is_faster_than_the_look_ahead_can_brake_for():
    lines = ''.join(f'X{0.3 * k:.1f}\n' for k in range(1, 2000))
    near = only('G1 F20000\n' + lines, PathMode(1e-5, 0.0))
    far = only('G1 F20000\n' + lines, PathMode(1e-5, 0.0), replace(LIMITS, look_ahead=2000))
    top = np.diff(near.place).max() / PERIOD
    # fifty lines of 0.3 mm, braked to rest
    assert top == pytest.approx(sqrt(2.0 * 2.0 * 50 * 3e-4), rel=0.05)
    assert far.duration < near.duration


def test_lines_are_merged_within_the_tolerance_and_not_across_a_feed():
    wave = ''.join(f'X{0.1 * k:.1f} Y{0.004 * (k % 2):.3f}\n' for k in range(1, 51))
    program = moves('G64 P0.01\nG1 F600\n' + wave)
    assert len(merged(program.moves)) == 1
    assert len(merged(with_mode(program, PathMode(1e-5, 0.0)).moves)) == 50
    assert len(merged(with_mode(program, PathMode(1e-5, 1e-6)).moves)) > 25
    feeds = ''.join(
        f'X{0.1 * k:.1f} Y{0.004 * (k % 2):.3f} F{600 + 10 * (k // 10)}\n' for k in range(1, 51)
    )
    assert len(merged(moves('G64 P0.01\nG1 F600\n' + feeds).moves)) >= 5


def test_path_modes_of_a_program():
    text = 'G20 G64 P0.001\nG1 X1 F10\nG61.1\nX2\nG61 X3\nG64 P0.002 Q0.0005\nX4\nG64\nX5\n'
    found = {block.line: mode for block, mode in path_modes(read_program(text).blocks)}
    assert found[2].rounding == pytest.approx(25.4e-6)
    assert found[2].merging == pytest.approx(25.4e-6)
    assert isnan(found[4].rounding)
    assert found[5].rounding == 0.0
    assert found[7].merging == pytest.approx(12.7e-6)
    assert found[9].rounding == inf
    assert found[9].word == 'G64'


def test_waits_and_gaps():
    found = only('G1 X1 F600\nG4 P0.5\nX2\n')
    assert found.duration == pytest.approx(only('G1 X1 F600\nG61 X2\n').duration + 0.5, abs=0.02)
    gap = moves('G54 G1 X1 F600\nG55\nX5 Y0 Z0\nX6\n')
    assert gap.unknown >= 1
    assert len(gap.runs()) == 2
    with pytest.raises(ValueError, match='moves the tool'):
        moves('M3 S100\n')
    with pytest.raises(ValueError, match='velocity'):
        ControllerLimits(velocity=(0.0, 1.0, 1.0), acceleration=(1.0,) * 3)


@pytest.mark.parametrize(
    ('name', 'mode', 'feed', 'duration', 'error'),
    [
        ('butterfly', 'G64 P0.01', 12000, 3.69, 383.2),
        ('butterfly', 'G64 P0.01', 1500, 13.49, 210.1),
        ('butterfly', 'G64 P0.01 Q0', 12000, 3.98, 377.3),
        ('butterfly', 'G64 P0.001', 12000, 3.92, 380.3),
        ('infinity', 'G64 P0.01', 12000, 2.03, 384.8),
        ('infinity', 'G64 P0.01 Q0', 12000, 2.64, 348.4),
        ('infinity', 'G64 P0.01', 3000, 6.22, 174.3),
        ('infinity', 'G61', 12000, 27.03, 33.0),
    ],
)
def test_what_linuxcnc_took_and_left(name, mode, feed, duration, error):
    """LinuxCNC 2.9, measured: docs/explanation/linuxcnc-feedrate.md, more runs."""
    curve = CURVES[name](SHEET_SCALES[name])
    point = 1e3 * curve.point(np.linspace(0.0, 1.0, 2000))
    start = f'G92 X{point[0, 0]:.5f} Y{point[0, 1]:.5f} Z0\n'
    lines = ''.join(f'X{x:.5f} Y{y:.5f}\n' for x, y in point[1:, :2])
    program = moves(f'{start}{mode}\nG1 F{feed}\n{lines}')
    judged = ProgramPath(program).run(program, LIMITS, ContouringConfig())
    assert judged.duration == pytest.approx(duration, abs=0.01)
    assert 1e6 * judged.error == pytest.approx(error, rel=0.015)

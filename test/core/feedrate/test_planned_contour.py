# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Programs as the node plans them, on the simulated axes: blends and arcs keep the tolerance."""

from dataclasses import replace

import numpy as np
import pytest
from tiers import rest_slow

from fuzzycnc_ros.components.motion import feedrate_run
from fuzzycnc_ros.components.motion.feedrate_run import PathRun
from fuzzycnc_ros.components.motion.feedrate_scheduler_config import (
    FeedrateSchedulerConfig,
    make_scheduler,
)
from fuzzycnc_ros.components.motion.parts import PathHeader
from fuzzycnc_ros.components.motion.tool_paths import program_tool_path, tool_path_segments
from fuzzycnc_ros.core.feedrate.gcode.reader import read_program
from fuzzycnc_ros.core.machine.path_loop import ContouringConfig
from fuzzycnc_ros.simulation.motion.contour import Contour
from fuzzycnc_ros.simulation.motion.contouring_axes import ContouringAxes

TURNS = np.linspace(0.02, 6.2, 200)
PLACES = np.random.default_rng(3).uniform(0.0, 40.0, (15, 2))
PROGRAMS = {
    'square': 'F12000 G1 X30\nY30\nX0\nY0\n',
    'zigzag': 'F12000\n' + ''.join(f'G1 X{5 * i} Y{5 * (i % 2)}\n' for i in range(1, 12)),
    'arcs': 'F12000 G1 X20\nG2 X22 Y-2 R2\nG1 Y-20\nG3 X30 Y-20 R4\nG1 Y5\n',
    'random': 'F9000\n' + ''.join(f'G1 X{x:.3f} Y{y:.3f}\n' for x, y in PLACES),
    'dense': 'F6000\n'
    + ''.join(f'G1 X{20 * np.cos(t):.3f} Y{12 * np.sin(2 * t):.3f}\n' for t in TURNS),
}


def planned(program: str, config: FeedrateSchedulerConfig) -> np.ndarray:
    """Return the commanded positions of a program, (k, axes)."""
    segments = tool_path_segments(program_tool_path(read_program(program), path_id='test'))
    run = PathRun(PathHeader('test', 1, ''), segments, np.array(segments.start), config, start=0)
    parts = []
    while not run.complete:
        part = run.send(0)[0].record
        parts.append(part.position.reshape(-1, len(part.axis))[: part.committed])
    return np.concatenate(parts)


def largest_error(reference: np.ndarray) -> float:
    """Return the largest contour error of the simulated axes [m]."""
    machine = ContouringConfig()
    told = np.vstack([reference, np.repeat(reference[-1:], 300, axis=0)])
    driven = ContouringAxes(told[0], machine).follow(told)
    way = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(told, axis=0), axis=1)))
    time = machine.interpolation_period * np.arange(len(told))
    place = np.interp(time - machine.delay, time, way)
    found = Contour.polyline(told).distance(driven, place, 2e-3 + 0.012 * machine.velocity_max)
    return float(found.distance.max())


@pytest.mark.parametrize('name', PROGRAMS)
@pytest.mark.parametrize(
    ('blend', 'tolerance'), rest_slow([(1e-5, 1e-5), (5e-5, 1e-5), (1e-5, 5e-5)], 1)
)
def test_blended_program_keeps_the_tolerance(name, blend, tolerance):
    config = FeedrateSchedulerConfig(tolerance=tolerance, blend=blend, settle=0.25)
    assert largest_error(planned(PROGRAMS[name], config)) <= 1.05 * tolerance


def test_braking_into_a_tight_blend_needs_the_slope(monkeypatch):
    """Without it the axes are still far behind when the path turns."""
    config = FeedrateSchedulerConfig(tolerance=1e-5, blend=1e-5, settle=0.25)
    steep = replace(make_scheduler(config), approach_slope=1e6)
    monkeypatch.setattr(feedrate_run, 'make_scheduler', lambda _: steep)
    assert largest_error(planned(PROGRAMS['square'], config)) > 1.5e-5


@pytest.mark.parametrize('name', ['square', 'zigzag', 'random'])
def test_axes_arrive_at_exact_stops(name):
    """Then nothing is left of a corner."""
    reference = planned(PROGRAMS[name], FeedrateSchedulerConfig(settle=0.25))
    assert largest_error(reference) <= 1e-7
    rest = np.linalg.norm(np.diff(reference, axis=0), axis=1) == 0.0
    stops = read_program(PROGRAMS[name]).segments
    assert rest.sum() >= 248 * (len(stops) - 1)  # samples between two of the same place

# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Feed shares along the path: the program, the table, and what the simulated controller does."""

import hashlib

import numpy as np
import pytest
from benches.feed_thread import FeedThread

from fuzzycnc_ros.core.feedrate.gcode.reader import read_program
from fuzzycnc_ros.core.machine.path_loop import ContouringConfig
from fuzzycnc_ros.simulation.controller.blends import ControllerLimits
from fuzzycnc_ros.simulation.controller.motion import FeedShare
from fuzzycnc_ros.simulation.controller.program import program_moves, simulate
from fuzzycnc_ros.studies.programs.adaptive_feed import (
    LENGTH_OF_TOOL,
    NO_LENGTH,
    AdaptiveFeed,
    adaptive_program,
    coordinates,
    table_header,
)

PART = """G21 G90 G17 G64 P0.02
G54
G0 X-3 Y0
G43 Z10 H2
Z0
G0 X0
G1 X8 F1500
Y6
G3 X5 Y9 I-3 J0
G1 X4.95 F300
G3 X4.85 Y9.1 I0 J0.1
G1 X0 F1500
M2
"""
LIMITS = ControllerLimits(velocity=(0.4,) * 3, acceleration=(2.0,) * 3)
TOLERANCE = 20e-6


@pytest.fixture(scope='module')
def found():
    """Shares for a part with corners, arcs and a short slow arc."""
    search = AdaptiveFeed(PART, LIMITS, ContouringConfig())
    return (*search.keeping(TOLERANCE), search.own())


def test_shares_keep_the_tolerance_in_little_more_time(found):
    table, judged, own = found
    assert judged.error <= TOLERANCE < 0.2 * own.error
    assert own.duration < judged.duration < 1.6 * own.duration
    assert (table.adaptive.share <= 1.0).all()
    assert (table.adaptive.share >= 0.01).all()


def test_program_keeps_its_lines_and_feeds(found):
    table = found[0]
    added = {'M52 P1', 'M52 P0', 'G64 P0.002 Q0.002'}
    kept = [line for line in table.program.splitlines() if line not in added]
    assert kept == PART.replace(' G64 P0.02', '').splitlines()
    moves = program_moves(read_program(table.program).blocks).moves
    assert moves.place[-1, 1] == pytest.approx(table.adaptive.place[-1])


def test_table_is_read_by_the_component_and_names_its_program(found, tmp_path):
    table = found[0]
    text = table.text()
    file = tmp_path / 'part.feed'
    file.write_text(text)
    assert FeedThread(file).least == table.adaptive.share.min()
    program = hashlib.sha256(table.program.encode()).hexdigest()
    assert table_header(text) == (program, 540, 2)
    # the component finds the simulated tool where the simulated controller thinks it is
    thread = FeedThread(file)
    moves = program_moves(read_program(table.program).blocks)
    *_, commanded = simulate(moves, LIMITS, table.adaptive)
    thread.start(1e3 * commanded.position[0])
    edge, wrong = moves.moves.place[:-1, 1], 0
    for position, place in zip(commanded.position, commanded.place, strict=True):
        line = int(moves.line[np.searchsorted(edge, place)])
        share = thread.step(1e3 * position, line)
        wanted = np.interp(place, table.adaptive.place, table.adaptive.share)
        wrong += abs(share - wanted) > 0.1
    assert wrong < 0.05 * len(commanded.place)


def test_without_shares_nothing_changes():
    moves = program_moves(read_program(PART).blocks)
    ends = np.array([0.0, moves.moves.place[-1, 1]])
    *_, plain = simulate(moves, LIMITS)
    *_, full = simulate(moves, LIMITS, FeedShare(ends, ends**0))
    assert np.abs(plain.position - full.position).max() < 1e-12
    *_, half = simulate(moves, LIMITS, FeedShare(ends, 0.5 * ends**0))
    assert 1.5 * plain.duration < half.duration < 2.0 * plain.duration


@pytest.mark.parametrize(
    ('line', 'wanted'),
    [
        ('G1 X1', (0, NO_LENGTH)),
        ('G55 G49', (550, 0)),
        ('G59.2 G43 H7', (592, 7)),
        ('G43', (0, LENGTH_OF_TOOL)),
    ],
)
def test_coordinates_of_a_program(line, wanted):
    assert coordinates(f'{line}\nM2\n') == wanted


@pytest.mark.parametrize(
    ('text', 'told'),
    [
        ('G1 X1 F60\nG92 X0\nX3\n', 'line 2: expected a program that leaves its coordinates'),
        ('G41 D1\nG1 X1 F60\n', 'found G41'),
        ('G10 L2 P1 X3\nG1 X1 F60\n', 'found G10'),
        ('M52 P1\nG1 X1 F60\n', 'line 1: expected a program without M52'),
        ('G0 X0 Y0 Z0\nG1 X1 F60\nG28\nG0 X5 Y5 Z5\nG1 X3\n', 'whole path is known'),
    ],
)
def test_programs_that_no_table_can_follow_are_refused(text, told):
    with pytest.raises(ValueError, match=told):
        AdaptiveFeed(text, LIMITS, ContouringConfig())


@pytest.mark.parametrize('text', ['G1 X1 F60', '%\nG1 X1 F60\n%\n', 'G1 X1 F60\nM30\n'])
def test_adaptive_feed_ends_with_the_program(text):
    lines = adaptive_program(text).splitlines()
    assert lines.index('M52 P0') > lines.index('G1 X1 F60')
    assert lines[-1] in ('M52 P0', '%', 'M30')

# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Hostile part programs: refused with the line, or read into finite motion."""

import random

import numpy as np
import pytest
from fuzzing.campaign import SEEDS, bounded, fuzz, refusal
from fuzzing.file_mutations import mutated_bytes, mutated_text
from hypothesis import given

from fuzzycnc_ros.components.motion.feedrate_scheduler_config import FeedrateSchedulerConfig
from fuzzycnc_ros.components.motion.program_request import program_settings, schedule_text
from fuzzycnc_ros.core.feedrate.gcode import reader
from fuzzycnc_ros.core.feedrate.gcode.reader import read_program
from fuzzycnc_ros.core.feedrate.gcode.segments import ProgramError
from fuzzycnc_ros.core.feedrate.schedule.program_schedule import schedule_program


@pytest.fixture(autouse=True)
def short_runs(monkeypatch):
    """Damaged loops often run for ever: give them up earlier than a user's."""
    monkeypatch.setattr(reader, 'PASSES', 2000)


pytestmark = pytest.mark.filterwarnings('ignore::RuntimeWarning')

PROGRAMS = (
    """%
(lines and arcs)
N10 G21 G90 G17 G94
N20 G0 X0 Y0 Z5
N30 G1 Z0 F300
N40 X10 F600
N50 G2 X12 Y2 I0 J2
N60 G3 X10 Y4 R2
N70 G1 X5 Y6 ; a remark
N80 G91 X-1.5 Y.25
N90 G90 G4 P0.2
N110 G20 G1 X0.2 Y0.2 F20
N120 G18 G2 X0.4 I0.1 K0
N130 G17 M3 S1000 T1 M6
M30
%
""",
    """G21 G90
G0 X0 Y0 Z0
G5.2 X3 Y4 P1 L3 F300
X5 Y6 P1
X7 Y4 P2
X9 Y4 P1
G5.3
G1 X10 Y0 Z0
M2
""",
    """G21
G0 X1 Y1 Z1
G6.2 P3 K0 X1 Y1 Z1 F500
K0 X2 Y2 Z1
K0 X3 Y1 Z1
K1
K1
K1
G1 X5 Y5 Z0 F200
""",
    """G21 G90 G99
#<depth> = -1 #31 = [2 + SIN[30] * 4]
o<hole> sub
G1 Z[#<_z> - #1] F[100 * #2]
o<hole> return [#1 / 2]
o<hole> endsub
G0 X0 Y0 Z5
o100 while [#31 GT 0]
  G0 X[#31 * 2] Y-#31
  o101 if [#31 EQ 2]
    o<hole> call [1] [6]
  o101 elseif [EXISTS[#<depth>]]
    G1 X#31 F300
    #31 = [#31 - 2]
    o100 continue
  o101 else
    o100 break
  o101 endif
  #31 = [#31 - 1]
o100 endwhile
o102 repeat [3]
G1 @[5 + #31] ^30 F200
o102 endrepeat
G81 X1 Y1 Z-1 R2 L2
M98 P200 L2
M2
O200
G91 G1 X1 F600
M99
""",
    """O7
G21 G40
G50 S2500
G28 U0 W0
T0101 G97 S500 M3
G0 X60. Z2.
G98 G1 Z-20. F300
U2. W-1.
G2 U4. W-2. R2.
G71 U2. R.5
G71 P10 Q20 U.4 W.1 F.3
G90 X50. Z-20. F.2
G112
G1 X40. C10. F500
G113
G99 G1 X70. Z-25. F.2
M30
""",
    """M862.3 P "MK3S" ; check
M201 X1000 Y1000 Z200 E5000
M104 S210
SET_VELOCITY_LIMIT ACCEL=1500
G28 X Y
M117 layer (5
G92 E0
G1 X10 Y10 Z.2 F3000
G1 X20 E1
Y20 E2
G1 E-2 F1800
G4 P500
M84 X Y E
""",
    """G20 G64 P0.001
G68.2 X0 Y0 Z0 I0 J30 K0
G 0 1 X 1 Y 0 Z 0 F 6 0
G61
TRANSMIT
G1 X1 C5
TRAFOOF
G43.4 H1
G1 X1 Y1 Z1
G2 X-1 Y1.002 I-1 J0
G5.2 X1 Y1 P1 L3
X1 Y1
X1 Y1
X2 Y1
G5.3
G10 L2 P1 X0
G91 G1 X1 F10
G3 X1 Y1 R1
M2
""",
)


def damaged(seed: int) -> str:
    """Return a damaged program."""
    rng = random.Random(seed)
    program = rng.choice(PROGRAMS)
    if rng.random() < 0.2:
        return mutated_bytes(program.encode(), rng).decode('utf-8', 'surrogateescape')
    return mutated_text(program, rng)


@pytest.mark.parametrize('text', PROGRAMS)
def test_the_programs_themselves_are_read(text):
    assert len(read_program(text).segments) > 2


@fuzz(100, share=0.2)
@given(seed=SEEDS)
def test_programs_are_read_or_refused(seed):
    text = damaged(seed)
    if refusal(ProgramError, lambda: read_program(text)):
        return
    with bounded():
        program = read_program(text)
        assert program.text == text
        for segment in program.segments:
            assert np.isfinite(segment.length), segment


@fuzz(15, share=0.2)
@given(seed=SEEDS)
def test_programs_are_scheduled_or_refused(seed):
    text = damaged(seed)
    found = []

    def schedule():
        config = FeedrateSchedulerConfig()
        where = {'units': '', 'path_id': '', 'stamp': 1, 'frame_id': 'mill/workpiece'}
        found.append(schedule_text(config, text, **where, run=True))

    if refusal(ValueError, schedule):
        return
    assert found[0].message
    if found[0].path is not None:
        assert np.isfinite(found[0].path.data).all()


def relative_moves(seed: int) -> str:
    """Return lines and arcs in G91."""
    rng = random.Random(seed)
    lines = ['G91 F600']
    for _ in range(rng.randint(1, 8)):
        x, y, z = (rng.choice([0, 0.5, -3, 12.25]) for _ in range(3))
        radius = 0.6 * (x * x + y * y) ** 0.5 + 0.1
        lines.append(
            rng.choice(
                [
                    f'G1 X{x} Y{y} Z{z}',
                    f'G0 X{x} Z{z}',
                    f'G1 Y{y}',
                    f'G2 X{x} Y{y} R{radius}' if x or y else 'G1 Z1',
                    f'G3 I{x + 0.5} J{y} P{rng.randint(1, 3)}',
                ]
            )
        )
    return '\n'.join(lines) + '\n'


@fuzz(60, share=0.2)
@given(seed=SEEDS)
def test_relative_moves_are_as_long_wherever_they_begin(seed):
    moves = relative_moves(seed)
    known = read_program(f'G90 G0 X0 Y0 Z0\n{moves}')
    unknown = read_program(f'G10 L2 P1 X0 Y0 Z0\n{moves}')
    lengths = [[part.length for part in one.segments] for one in (known, unknown)]
    assert lengths[0][1:] == pytest.approx(lengths[1], rel=1e-12, abs=1e-15)
    times = schedule_program(unknown, program_settings(FeedrateSchedulerConfig())).times
    assert times.untimed == times.chosen == 0
    assert times.kept >= sum(p.length / p.feed for p in unknown.segments if p.feed) * (1.0 - 1e-12)


def still_curve(seed: int) -> str:
    """Return a NURBS block many of whose control points are equal or in line."""
    rng = random.Random(seed)
    order = rng.randint(3, 5)
    points: list[tuple[float, float]] = []
    while len(points) < order + 2:
        point = rng.choice([0.0, 1.0, 4.0, 9.5]), rng.choice([0.0, 0.0, 3.0])
        points += [point] * rng.choice([1, 1, 2, order - 1, order, order + 1])
    words = [f'X{x} Y{y} P{rng.choice([1, 1, 2.5])}' for x, y in points]
    return f'G0 X0 Y0\nF600\nG5.2 L{order} ' + '\n'.join(words) + '\nG5.3\nG1 X20 Y20\n'


@pytest.mark.filterwarnings('error::RuntimeWarning')
@fuzz(25, share=0.2)
@given(seed=SEEDS)
def test_curves_that_stand_still_are_scheduled_or_refused_by_their_line(seed):
    settings = program_settings(FeedrateSchedulerConfig())
    made = []
    text = still_curve(seed)
    why = refusal(ValueError, lambda: made.append(schedule_program(read_program(text), settings)))
    if why:
        assert why.startswith('line 3: ')
        return
    [found] = made
    assert np.isfinite([found.duration, found.times.length, found.times.error]).all()
    for part in found.paths:
        assert np.isfinite(part.path.geometry.coefficient).all()
        assert (np.diff(part.path.geometry.node) > 0.0).all()

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
from fuzzycnc_ros.components.motion.program_request import schedule_text
from fuzzycnc_ros.core.feedrate.gcode import reader
from fuzzycnc_ros.core.feedrate.gcode.reader import read_program
from fuzzycnc_ros.core.feedrate.gcode.segments import ProgramError


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

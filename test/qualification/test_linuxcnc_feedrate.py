# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""A part program that `fuzzycnc schedule` wrote keeps its tolerance on a real LinuxCNC."""

import re
import shutil
import tempfile
from pathlib import Path

import numpy as np
import pytest
from equipment.linuxcnc_machine import LinuxcncMachine, exclusive
from equipment.linuxcnc_trace import Recorder, cut_of, judge
from programs.without_feeds import strip_feeds

from fuzzycnc_ros.cli.main import run
from fuzzycnc_ros.core.feedrate.path.curves import butterfly
from fuzzycnc_ros.simulation.motion.contour import Contour

pytestmark = [pytest.mark.ros, pytest.mark.realtime, pytest.mark.qualify]

TOLERANCE, BLEND = 50e-6, 10e-6
SCALE, POINTS = 0.875, 2000
FAST = 12000
"""Feed of the program, far too fast for the tolerance [mm/min]."""
TIMEOUT = 60.0


@pytest.fixture
def recorder():
    """A LinuxCNC that is ready, and what records it."""
    with exclusive():
        folder = Path(tempfile.mkdtemp(prefix='fuzzycnc-linuxcnc-'))
        machine = LinuxcncMachine(folder)
        try:
            machine.start()
            machine.ready()
            yield Recorder(machine, folder)
        finally:
            machine.end()
            shutil.rmtree(folder, ignore_errors=True)


def test_scheduled_program_runs_and_keeps_the_tolerance(recorder, tmp_path):
    curve = butterfly(SCALE)
    contour = Contour.curve(curve.point)
    point = curve.point(np.linspace(0.0, 1.0, POINTS))
    middle = 0.5 * (point[1:] + point[:-1])
    chord = contour.distance(middle, np.linspace(0.0, contour.length, len(middle)), 0.1)
    (x, y), *rest = (1e3 * point).tolist()
    blocks = ''.join(f'G1 X{x:.5f} Y{y:.5f}\n' for x, y in rest)
    before, after = tmp_path / 'butterfly.ngc', tmp_path / 'scheduled.ngc'
    before.write_text(
        f'G21 G90 G94 G17\nG64 P{1e3 * BLEND:g} Q0\nG0 X{x:.5f} Y{y:.5f}\nG4 P0.4\n'
        f'F{FAST}\n{blocks}G4 P0.4\nM2\n'
    )
    lengths = '--tolerance', f'{1e6 * TOLERANCE:g}um', '--blend', f'{1e6 * BLEND:g}um'
    assert run(['schedule', str(before), '--out', str(after), *lengths]) == 0
    assert strip_feeds(after.read_text()) == strip_feeds(before.read_text())
    assert len(re.findall('F', after.read_text())) > 100

    ran = {}
    for path in (before, after):
        cut = cut_of(recorder.run(path.read_text(), TIMEOUT)[:, :2])
        assert cut[[0, -1]] == pytest.approx(point[[0, -1]], abs=1e-6), 'not from start to end'
        ran[path] = judge(cut, contour)
        # LinuxCNC rounds corners by P; the lines themselves leave the curve by their chords.
        assert ran[path].deviation < BLEND + chord.distance.max() + 1e-6
    assert ran[after].contour < TOLERANCE
    assert ran[before].contour > 5.0 * TOLERANCE, 'a program that needed no schedule'
    assert ran[before].duration < ran[after].duration < 15.0

# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""An exported controller and its simulated axis in LinuxCNC's servo thread, bit by bit."""

import contextlib
import shutil

import numpy as np
import pytest
from equipment.linuxcnc_machine import exclusive

from fuzzycnc_ros.adapters.linuxcnc.axis_loop import PLANT, LoopController, axis_loop
from fuzzycnc_ros.adapters.linuxcnc.control import LinuxcncError
from fuzzycnc_ros.adapters.linuxcnc.simulation import Limits
from fuzzycnc_ros.core.servo.axis_control import make_axis_controller
from fuzzycnc_ros.machine_file.reader import read_machine_file
from fuzzycnc_ros.replay.replay import replay
from fuzzycnc_ros.studies.servo.c_export import hal_controller
from fuzzycnc_ros.studies.servo.c_text import ExportOrigin
from fuzzycnc_ros.studies.servo.linuxcnc_bag import write_axis_bag
from fuzzycnc_ros.studies.servo.plant_export import hal_plant

pytestmark = [pytest.mark.slow, pytest.mark.ros]

HASH = '0123abcd' * 8
NAME = 'fuzzycnc_loop_axis'
LIMITS = Limits(200.0, 1500.0, -250.0, 250.0)
RECORD = ('feedback', 'output', 'position', 'fault-code')


@pytest.fixture(autouse=True)
def linuxcnc():
    with exclusive():
        pass  # skips where there is none
    if shutil.which('halcompile') is None:
        pytest.skip('expected halcompile (Debian: apt-get install linuxcnc-uspace-dev)')


def looped(machine, law, in_use=HASH):
    """Return a LinuxCNC with an axis of a built-in machine under a law."""
    data = read_machine_file(machine).axes['X']
    origin = ExportOrigin(NAME, law, machine, HASH)
    own = LoopController(
        NAME,
        hal_controller(make_axis_controller(data, law), origin),
        {'machine-file': f'0x{in_use[:8]}'},
    )
    plant = hal_plant(data.plant, origin._replace(name=PLANT))
    return axis_loop([own], plant, LIMITS, RECORD, max(data.plant.noise, 1.5e-8))


@pytest.mark.parametrize(
    ('machine', 'law', 'follows'),
    [('ballscrew', 'pid', 0.02), ('lathe', 'variable_universe', 0.1)],
)
def test_what_linuxcnc_ran_is_repeated_in_python(machine, law, follows, tmp_path):
    with looped(machine, law) as loop:
        loop.ready()
        loop.run_program('G21 G90\nG1 X3 F6000\nG0 X-20\nG4 P0.2\nG0 X0\nG4 P0.2\nM2\n')
        loop.run(loop.write_program('away', 'G21 G90\nG0 X50\nM2\n'))
        while abs(loop.state()['position'][0]) < 5.0:
            pass
        loop.estop()
        samples = loop.samples()
    samples = {name.removesuffix('-0'): values for name, values in samples.items()}
    enabled = samples['enable'] > 0.0
    stopped = np.flatnonzero(enabled)[-1] + 1
    assert abs(samples['command-deriv'][stopped - 1]) > 50.0, 'expected a stop in motion'
    assert samples['output'][stopped - 1] != 0.0
    assert not samples['output'][~enabled].any()
    assert not samples['fault-code'].any()
    error = (samples['command'][:-1] - samples['position'][1:])[enabled[1:]]
    assert abs(error).max() < follows  # mm
    data = read_machine_file(machine)
    write_axis_bag(tmp_path / 'run', data, 'X', law, samples)
    report = replay(tmp_path / 'run')
    assert report.identical, report
    assert len(report.given) == 2


def test_export_of_another_machine_file_gives_nothing_out():
    with looped('ballscrew', 'pid', in_use='f' * 8) as loop:
        with contextlib.suppress(LinuxcncError):  # it is on for two periods
            loop.on()
        while '100' not in loop.halcmd('getp', 'fuzzycnc-loop-axis.fault-code'):
            pass
        samples = loop.samples()
    assert samples['enable'].any()
    assert not samples['output-0'].any()
    assert set(samples['fault-code-0']) == {0.0, 100.0}

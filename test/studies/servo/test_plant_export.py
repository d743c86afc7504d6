# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Simulated axes in C, equal to those in Python to the last bit."""

import ctypes
import struct
import subprocess
from dataclasses import replace

import numpy as np
import pytest

from fuzzycnc_ros.machine_file.reader import read_machine_file
from fuzzycnc_ros.simulation.servo.axes import BallscrewAxis, LatheAxis
from fuzzycnc_ros.studies.servo.c_text import ExportOrigin
from fuzzycnc_ros.studies.servo.plant_export import hal_plant

ORIGIN = ExportOrigin('axis', 'Test', 'a test', '0123456789abcdef')
SWINGS = {'mode': 60.0, 'mode_ratio': 2.0, 'drive_lag': 2e-3, 'delay': 1.4e-3, 'direction': -1.0}
RUBS = {'stribeck_velocity': 2e-3, 'breakaway_ratio': 1.5, 'backlash': 5e-6}
ENCODER = {'sensor': 'encoder', 'backlash': 1e-5, 'delay': 2e-3}
CASES = {
    'ballscrew': ('ballscrew', {}),
    'ballscrew that swings': ('ballscrew', SWINGS),
    'ballscrew that rubs': ('ballscrew', {**RUBS, 'periodic_error': 5e-6, 'pitch_error': 1e-4}),
    'lathe': ('lathe', {}),
    'lathe with encoder': ('lathe', ENCODER),
    'lathe without friction': ('lathe', {'coulomb': 0.0, 'breakaway': 0.0, 'count': 0.0}),
}


class Compiled:
    """An axis in C."""

    def __init__(self, plant, folder):
        target = folder / 'axis.so'
        flags = ['-std=c99', '-O2', '-Wall', '-Wextra', '-Werror', '-ffp-contract=off']
        command = ['cc', *flags, '-shared', '-fPIC', '-x', 'c', '-', '-o', str(target), '-lm']
        component = hal_plant(plant, ORIGIN)
        axis = component[component.index('#include') : component.index('/* ---- What runs')]
        subprocess.run(command, input=axis.replace('static ', ''), text=True, check=True)
        self._library = ctypes.CDLL(str(target))
        self._memory = ctypes.create_string_buffer(8192)
        for name in ('measure', 'position'):
            getattr(self._library, f'axis_{name}').restype = ctypes.c_double
        self._library.axis_begin(self._memory, ctypes.c_double(0.0))

    def set(self, gain_factor, friction_factor, load):
        """Change the axis against its machine file."""
        struct.pack_into('3d', self._memory, 0, gain_factor, friction_factor, load)

    def position(self):
        return self._library.axis_position(self._memory)

    def measure(self, noise):
        return self._library.axis_measure(self._memory, ctypes.c_double(noise))

    def drive(self, duty):
        self._library.axis_drive(self._memory, ctypes.c_double(duty))


@pytest.mark.parametrize('steps', [3000, pytest.param(100_000, marks=pytest.mark.qualify)])
@pytest.mark.parametrize('case', CASES)
def test_equal_to_python(case, steps, tmp_path):
    machine, changes = CASES[case]
    plant = replace(read_machine_file(machine).axes['X'].plant, **changes)
    known = {'gain_factor': 1.2, 'load_time': 1.0}
    known |= (
        {'coulomb': 0.8 * plant.coulomb, 'breakaway': 0.8 * plant.breakaway, 'load': 0.05}
        if machine == 'lathe'
        else {'friction_factor': 0.8, 'load': 0.05 * plant.force_max}
    )
    python = (LatheAxis if machine == 'lathe' else BallscrewAxis)(replace(plant, **known))
    compiled = Compiled(plant, tmp_path)
    compiled.set(1.2, 0.8, 0.0)
    rng = np.random.default_rng(2)
    duty = 0.0
    for step in range(steps):
        assert compiled.position() == python.position, step
        noise = python._sensor._noise
        assert compiled.measure(noise) == python.measure(), step
        if rng.random() < 0.02:
            duty = rng.choice([0.0, 0.03, 1.5, *rng.normal(0.0, 0.2, 4)])
        if rng.random() < 0.01:
            duty = -8.0 * python.position
        if step == 1000:
            compiled.set(1.2, 0.8, 0.05)
        compiled.drive(duty)
        python.drive(duty)

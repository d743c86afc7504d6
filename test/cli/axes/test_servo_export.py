# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""`fuzzycnc servo export`: one C file of an axis' controller."""

import ctypes
import re
import shutil
import subprocess
from pathlib import Path

import pytest

from fuzzycnc_ros.core.servo.built_in import built_in_controller
from fuzzycnc_ros.simulation.servo.axes import BallscrewAxis


class Cycle(ctypes.Structure):
    """The structure of the example."""

    _fields_ = (
        ('enabled', ctypes.c_int),
        *(
            (name, ctypes.c_double)
            for name in (
                *('position', 'velocity', 'last', 'last_velocity'),
                *('reading', 'torque_share'),
            )
        ),
    )


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


def test_file_repeats_its_recorded_steps(fuzzycnc):
    words = ('servo', 'export', '--machine-file', 'ballscrew', '--out', 'axis.c')
    assert fuzzycnc(*words).code == 0
    command = ['gcc', '-DSELF_TEST', '-std=c99', '-O2', '-ffp-contract=off', 'axis.c', '-lm']
    subprocess.run([*command, '-o', 'axis'], check=True)
    done = subprocess.run(['./axis'], capture_output=True, text=True, check=True)
    assert done.stdout.startswith('0 of 400 duties differ')


def test_example_of_the_docs_follows_like_python(fuzzycnc, root):
    """The cycle of the page, on a ramp whose commands are for the end of each period."""
    words = ('servo', 'export', '--machine-file', 'ballscrew', '--out', 'axis_x.c')
    assert fuzzycnc(*words).code == 0
    page = (root / 'docs' / 'how-to' / 'servo-in-c.md').read_text()
    Path('cycle.c').write_text(re.search('```c\n(.*?)```', page, re.S)[1])
    flags = ['-std=c99', '-O2', '-Wall', '-Wextra', '-Werror', '-ffp-contract=off']
    subprocess.run(
        ['gcc', *flags, '-shared', '-fPIC', 'cycle.c', '-o', 'cycle.so', '-lm'], check=True
    )
    work = ctypes.CDLL('./cycle.so').work
    controller, axis = built_in_controller('ballscrew'), BallscrewAxis()
    cycle = Cycle(enabled=1)
    controller.reset(axis.measure())
    reference, speed = 0.0, 0.0
    for step in range(600):
        ahead = min(0.1, 1e-3 * step)
        place = reference + 0.5e-3 * (speed + ahead)
        cycle.position, cycle.velocity, cycle.reading = place, ahead, axis.measure()
        rise = (ahead - speed) / 1e-3 if step else 0.0
        duty = controller.step(reference, cycle.reading, speed if step else 0.0, rise)
        work(ctypes.byref(cycle))
        assert cycle.torque_share == duty, step
        axis.drive(duty)
        reference, speed = place, ahead
    assert abs(reference - axis.position) < 2e-5
    cycle.enabled = 0
    work(ctypes.byref(cycle))
    assert cycle.torque_share == 0.0


def test_what_cannot_be_written_is_refused(fuzzycnc, refused):
    words = ('servo', 'export', '--machine-file', 'ballscrew', '--out', 'axis.c')
    refused(*words, '--to', 'ada', naming=['--to', "'ada'"])
    assert fuzzycnc(*words).code == 0
    refused(*words, naming=['axis.c', 'choose another one'])


def test_components_bear_the_names_of_their_files(fuzzycnc, refused):
    words = ('servo', 'export', '--machine-file', 'ballscrew', '--to')
    refused(*words, 'hal', '--out', 'axis.c', naming=['fuzzycnc_axis_x.comp', 'axis.c'])
    refused(*words, 'hal', '--out', 'Axis X.comp', naming=['name', "'Axis X'"])
    naming = ['--controller', 'none']
    refused(*words, 'plant', '--controller', 'pid', '--out', 'plant.comp', naming=naming)
    for kind, name in (('hal', 'own_axis'), ('plant', 'own_plant')):
        assert fuzzycnc(*words, kind, '--out', f'{name}.comp').code == 0
        text = Path(f'{name}.comp').read_text()
        assert f'\ncomponent {name} "' in text
        assert re.search('\nmachine file [0-9a-f]{64}\n', text)


@pytest.mark.slow
@pytest.mark.skipif(not shutil.which('halcompile'), reason='halcompile is not installed')
@pytest.mark.parametrize('machine', ['ballscrew', 'lathe'])
def test_linuxcnc_builds_components_without_a_warning(machine, fuzzycnc):
    words = ('servo', 'export', '--machine-file', machine, '--to')
    for kind in ('hal', 'plant'):
        assert fuzzycnc(*words, kind, '--out', f'own_{kind}.comp').code == 0
        command = ['halcompile', '--compile', f'own_{kind}.comp']
        done = subprocess.run(command, capture_output=True, text=True, check=True)
        assert not done.stderr
        assert Path(f'own_{kind}.so').exists()

# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Controllers in C, equal to those in Python to the last bit, whatever happens."""

import ctypes
import re
import shutil
import struct
import subprocess

import numpy as np
import pytest

from fuzzycnc_ros.core.servo.axis_control import AXIS_CONTROLLERS, make_axis_controller
from fuzzycnc_ros.core.servo.built_in import built_in_controller
from fuzzycnc_ros.core.servo.pid_cascade import CascadeController, PidController
from fuzzycnc_ros.core.servo.variable_universe import (
    ContractedSurface,
    LinearSurface,
    VariableUniverseController,
)
from fuzzycnc_ros.machine_file.reader import read_machine_file
from fuzzycnc_ros.studies.servo.c_export import c_controller, hal_controller, trial_numbers
from fuzzycnc_ros.studies.servo.c_text import ExportOrigin

COMPILERS = [name for name in ('gcc', 'clang') if shutil.which(name)]
LAWS = ('pid', 'pid ballscrew', 'cascade', 'rules', 'ballscrew rules', 'tangent')
FAULTS = [
    '',
    'reading and reference are further',
    'reading or reference is not finite',
    'reading has jumped',
    'the loop swings',
    'axis runs away',
    'reading moves in other steps',
    'reading moves in steps of',
    'derivative of the reference',
]


def make(law):
    """Return a controller of the law, some with friction and limits."""
    if law == 'pid ballscrew':
        return built_in_controller('ballscrew')
    axis = built_in_controller('lathe').axis
    if law == 'pid':
        return PidController(axis, friction=(0.03, 0.02), duty_slew=200.0, sensor_lag=1e-3)
    if law == 'cascade':
        return CascadeController(axis, friction=(0.03, 0.02))
    if law == 'ballscrew rules':
        return built_in_controller('ballscrew', 'variable_universe')
    surface = LinearSurface if law == 'tangent' else ContractedSurface
    return VariableUniverseController(axis, friction=(0.03, 0.02), surface=surface)


def text_of(controller):
    return c_controller(controller, ExportOrigin('axis', 'Test', 'a test', '0123456789abcdef'))


class Compiled:
    """A controller in C."""

    def __init__(self, text, folder, compiler):
        source, target = folder / 'axis.c', folder / f'{compiler}.so'
        source.write_text(text)
        flags = ['-std=c99', '-O2', '-Wall', '-Wextra', '-Werror', '-ffp-contract=off']
        command = [compiler, *flags, '-shared', '-fPIC', str(source), '-o', str(target), '-lm']
        subprocess.run(command, check=True)
        library = ctypes.CDLL(str(target))
        self._step, self._reset = library.axis_step, library.axis_reset
        self._reset_at = library.axis_reset_at
        self._step.restype = ctypes.c_double
        self._step.argtypes = [ctypes.c_void_p, *[ctypes.c_double] * 4]
        self._reset.argtypes = [ctypes.c_void_p, ctypes.c_double]
        self._reset_at.argtypes = [ctypes.c_void_p, ctypes.c_double, ctypes.c_double]
        self._memory = ctypes.create_string_buffer(4096)

    def reset(self, position=None, duty=0.0):
        if position is None:
            self._reset(self._memory, duty)
        else:
            self._reset_at(self._memory, position, duty)

    def step(self, *inputs):
        return self._step(self._memory, *inputs)

    @property
    def fault(self):
        return struct.unpack_from('i', self._memory)[0]


def bits(value):
    return struct.pack('d', value)


def drive(law, controller, others, steps, seed):
    """Drive all with the same inputs in a loop on the axis; return which faults there were."""
    rng = np.random.default_rng(seed)
    held, entry, load = controller.axis.discrete()
    count = controller.watch.limits.count
    top = 0.3 * abs(controller.axis.gain)
    state, reference, velocity, acceleration = np.zeros(len(held)), 0.0, 0.0, 0.0
    disturbance, strength, seen = 0.0, 1.0, set()
    offset, coarse, faulty, burst, wrong, stuck = 0.0, 1.0, 0, 0, 0.0, 0
    for each in (controller, *others):
        each.reset()
    for step in range(steps):
        chance = rng.random()
        if chance < 0.004:
            acceleration = rng.choice([0.0, 1.0, -1.0]) * top * 10.0
        elif chance < 0.006:
            velocity = acceleration = 0.0
        elif chance < 0.008:
            reference += rng.normal(0.0, 1e-3)
        elif chance < 0.010:
            disturbance = rng.normal(0.0, 0.08)
        elif chance < 0.0105:
            strength = rng.choice([1.0, 1.0, 2.0, 3.0, 4.0, 6.0, -1.0])
        elif chance < 0.0108:
            offset = rng.normal(0.0, 1e-3)
        elif chance < 0.0110:
            coarse = rng.choice([1.0, 1.0, 3.0, 1.5])
        velocity = min(max(velocity + acceleration * controller.period, -top), top)
        reference += velocity * controller.period
        step_of = coarse * (count or 1e-9)
        reading = step_of * round(float(controller.axis.c @ state) / step_of) + offset
        gap = rng.random()
        if gap < 0.002:
            burst, wrong = int(rng.integers(1, 12)), rng.choice([np.nan, np.inf, 0.01, 0.9, 0.0])
        if burst > 0:
            burst -= 1
            reading = reading + wrong
        given = (reference, reading, velocity, acceleration if gap < 0.9995 else np.nan)
        duty = controller.step(*given)
        for other in others:
            found = other.step(*given)
            assert bits(found) == bits(duty), (step, found, duty, controller.watch.fault)
            assert bool(controller.watch.fault) == bool(other.fault)
            if other.fault:
                assert controller.watch.fault.startswith(FAULTS[other.fault]), step
                seen.add(other.fault)
        faulty = faulty + 1 if controller.watch.fault else 0
        relief = getattr(controller, '_relief', None)
        seen.add((relief.state if relief else '') or 'free')
        seen.add('less gain' if controller.taken_back else 'all gain')
        if gap > 0.999 and not stuck:
            stuck = int(rng.integers(20, 800))
        stuck = max(stuck - 1, 0)
        if not (0 < stuck < 700 and abs(duty) < 0.3):  # else friction holds it
            state = held @ state + strength * entry * duty + load * disturbance
        if faulty > 3 or rng.random() < 0.0005:
            state, velocity, strength, offset = np.zeros(len(held)), 0.0, 1.0, 0.0
            reference, coarse = 0.0, 1.0
            where = rng.choice([None, 0.0])
            duty = rng.normal(0.0, 0.2)
            for each in (controller, *others):
                each.reset(where, duty)
    return seen


def test_a_trial_has_the_numbers_of_its_settings_and_no_other_law():
    data = read_machine_file('ballscrew').axes['X']
    slow, fast = ({'bandwidth': speed, 'estimator': speed} for speed in (1.0, 2.0))
    for law in AXIS_CONTROLLERS:
        own, other = (make_axis_controller(data, law, given) for given in (slow, fast))
        text = hal_controller(own, ExportOrigin('axis', law, 'a test', '0' * 64))
        tuned = re.search('_set TUNED = {(.*?)\n};', text, re.S)[1]
        assert [float(one) for one in re.findall(r'[-\d.e]+', tuned)] == trial_numbers(own, own)
        assert trial_numbers(own, other) != trial_numbers(own, own)
        without = make_axis_controller(data, law, {**slow, 'friction': 0.5})
        with pytest.raises(ValueError, match='found another FRICTION'):
            trial_numbers(own, without)


@pytest.mark.parametrize(
    'steps',
    [
        4000,
        pytest.param(60_000, marks=pytest.mark.slow),
        pytest.param(1_000_000, marks=pytest.mark.qualify),
    ],
)
@pytest.mark.parametrize('law', LAWS)
def test_every_duty_is_that_of_python(law, steps, tmp_path):
    controller = make(law)
    text = text_of(controller)
    others = [Compiled(text, tmp_path, compiler) for compiler in COMPILERS]
    assert others, 'expected a C compiler'
    seen = drive(law, controller, others, steps, seed=1)
    if steps > 10_000:
        assert {1, 2, 3, 5, 6, 7, 8} <= seen
        rests = {'free', 'holding', 'dithering'}
        assert not getattr(controller, '_relief', None) or rests <= seen
    if steps > 100_000:
        assert 4 in seen


@pytest.mark.parametrize('law', ['pid', 'cascade', 'rules', 'tangent'])
def test_self_test_finds_a_changed_constant(law, tmp_path):
    text = text_of(make(law))

    def run(text):
        source, target = tmp_path / 'axis.c', tmp_path / 'axis'
        source.write_text(text)
        flags = ['-DSELF_TEST', '-std=c99', '-O2', '-ffp-contract=off']
        subprocess.run(['gcc', *flags, str(source), '-o', str(target), '-lm'], check=True)
        return subprocess.run([target], capture_output=True, text=True, check=False)

    assert run(text).stdout.startswith('0 of 400 duties differ')
    name = {
        **{'pid': 'DERIVATIVE', 'cascade': 'POSITION_GAIN'},
        **{'rules': 'RATE_EXPONENT', 'tangent': 'ERROR_GAIN'},
    }[law]
    changed, found = re.subn(rf'({name} = [^;]*);', r'\1 * 1.000001;', text)
    assert found == 1
    assert run(changed).returncode == 1


def test_what_cannot_be_exported_is_named():
    axis = built_in_controller('lathe').axis
    with pytest.raises(ValueError, match='found VariableUniverseController, mode static'):
        text_of(VariableUniverseController(axis, mode='static'))

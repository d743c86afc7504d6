# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Trials of settings in LinuxCNC's servo thread: held, let go, unstable, killed, refused."""

import shutil
import threading
import time
from contextlib import contextmanager
from dataclasses import replace

import numpy as np
import pytest
from equipment.linuxcnc_machine import exclusive

from fuzzycnc_ros.adapters.linuxcnc.axis_loop import PLANT, LoopController, axis_loop
from fuzzycnc_ros.adapters.linuxcnc.simulation import Limits
from fuzzycnc_ros.bags.reader import BagReader
from fuzzycnc_ros.cli.live.linuxcnc_trials import LinuxcncTrials
from fuzzycnc_ros.core.machine.machine_data import axis_hash
from fuzzycnc_ros.core.servo.axis_control import make_axis_controller
from fuzzycnc_ros.machine_file.reader import read_machine_file
from fuzzycnc_ros.replay.replay import replay
from fuzzycnc_ros.runtime.enums import TrialStatus
from fuzzycnc_ros.simulation.servo.axis_trials import trial_cases
from fuzzycnc_ros.simulation.servo.axis_tuning import AxisCase
from fuzzycnc_ros.studies.servo.c_export import hal_controller
from fuzzycnc_ros.studies.servo.c_text import ExportOrigin
from fuzzycnc_ros.studies.servo.plant_export import hal_plant

pytestmark = [pytest.mark.slow, pytest.mark.ros]

NAME = 'fuzzycnc_loop_axis'
PREFIX = NAME.replace('_', '-')
SLOW = {'bandwidth': 0.6, 'damping': 1.0, 'estimator': 0.5}
FAST = {'bandwidth': 2.0, 'damping': 1.0, 'estimator': 1.0}
STIFF = {'bandwidth': 4.0, 'damping': 1.0, 'estimator': 1.0}
CASE = AxisCase(way=0.006, gain=1.0, pace=0.5)
PERIODS = 500
"""Periods after the last sign of life at which a trial ends."""


@pytest.fixture(autouse=True)
def linuxcnc():
    with exclusive():
        pass  # skips where there is none
    if shutil.which('halcompile') is None:
        pytest.skip('expected halcompile (Debian: apt-get install linuxcnc-uspace-dev)')


class Key:
    """A key that is held, but for a moment in which it is let go."""

    def __init__(self):
        self.let_go = (np.inf, np.inf)

    @property
    def held(self):
        return not self.let_go[0] < time.monotonic() < self.let_go[1]


def slow_machine(**limits):
    """Return a ball screw of little travel and low gains."""
    machine = read_machine_file('ballscrew')
    data = machine.axes['X']
    limits = replace(data.limits, travel_low=-0.04, travel_high=0.04, **limits)
    return replace(
        machine, axes={'X': replace(data, limits=limits, controller='pid', settings=SLOW)}
    )


@contextmanager
def linuxcnc_of(machine, plant):
    """Run a LinuxCNC whose X is a plant under the exported controller of a machine."""
    data = machine.axes['X']
    known = axis_hash('X', data)
    origin = ExportOrigin(NAME, 'pid', 'ballscrew', known)
    source = hal_controller(make_axis_controller(data), origin)
    own = LoopController(NAME, source, {'machine-file': f'0x{known[:8]}'})
    velocity, acceleration, _ = data.limits.positioning
    ends = (velocity, acceleration, data.limits.travel_low, data.limits.travel_high)
    limits = Limits(*(1e3 * end for end in ends))
    simulated = hal_plant(plant, origin._replace(name=PLANT))
    with axis_loop([own], simulated, limits, ('feedback', 'position'), 1.5e-8) as loop:
        loop.ready()
        yield loop


def outcomes(bag):
    """Return status and reason of all trials in a bag, once their replay is the same."""
    report = replay(bag)
    assert report.identical, report
    with BagReader(bag) as reader:
        found = reader.messages(['/ballscrew/servo_trial_state'])
        return [(TrialStatus(one.message.status), one.message.reason) for one in found]


def test_trials_in_the_servo_thread_find_better_settings_and_end_with_their_operator(tmp_path):
    machine = slow_machine()
    data = machine.axes['X']
    with linuxcnc_of(machine, data.plant) as loop:
        key = Key()
        with LinuxcncTrials(key, machine, 'X', tmp_path / 'run', PREFIX) as drive:
            plain, strong, _ = trial_cases(data)
            before = drive('pid', SLOW, plain, 1e-2)
            after, stronger = (drive('pid', FAST, case, 1e-2) for case in (plain, strong))
            assert after.rms < 0.3 * before.rms
            assert not stronger.fault
            now = time.monotonic()
            key.let_go = (now + 0.8, now + 1.2)
            again = drive('pid', SLOW, CASE, 1e-2)
            assert not again.fault  # held anew, it went there and back
            with pytest.raises(ValueError, match='within its travel'):
                drive('pid', SLOW, replace(CASE, way=0.06), 1e-2)
            loop.line('M3 S100')
            with pytest.raises(ValueError, match='spindle: expected one at rest'):
                drive('pid', SLOW, CASE, 1e-2)
        other = replace(machine, axes={'X': replace(data, settings=STIFF)})
        with pytest.raises(ValueError, match='expected the state of X that'):
            LinuxcncTrials(key, other, 'X', tmp_path / 'three', PREFIX)
    told = outcomes(tmp_path / 'run')
    done = (TrialStatus.DONE, '')
    let_go = (TrialStatus.ENDED, 'its operator has ended it')
    running = (TrialStatus.RUNNING, '')
    assert told == [*[running, done] * 3, running, let_go, running, done]
    vertical = slow_machine(vertical=True)
    with pytest.raises(ValueError, match='a vertical one'):
        LinuxcncTrials(key, vertical, 'X', tmp_path / 'four', PREFIX)


def test_growth_and_silence_bring_the_tuned_settings_back_in_the_servo_thread(tmp_path):
    machine = slow_machine()
    late = replace(machine.axes['X'].plant, delay=3e-3)  # the model knows nothing of it
    with linuxcnc_of(machine, late) as loop:
        with LinuxcncTrials(Key(), machine, 'X', tmp_path / 'run', PREFIX) as drive:
            assert not drive('pid', SLOW, CASE, 5e-3).fault
            unstable = drive('pid', STIFF, CASE, 5e-3)
            assert 'swings' in unstable.fault or 'chatters' in unstable.fault
            assert not drive('pid', SLOW, CASE, 5e-3).fault
            killed = threading.Timer(0.7, drive._process.process.kill)
            killed.start()
            with pytest.raises(ValueError, match='has ended'):
                drive('pid', SLOW, CASE, 5e-3)
        end = time.monotonic() + 5.0
        while '5' not in loop.halcmd('getp', f'{PREFIX}.trial-state'):  # silent
            assert time.monotonic() < end
        time.sleep(0.3)
        samples = loop.samples()
        assert samples['enable'][-1], 'expected an axis that is held'
    error = samples['command'][:-1] - samples['position-0'][1:]
    assert abs(error).max() < 1.0  # mm
    assert abs(error[-200:]).max() < 5e-3
    told = outcomes(tmp_path / 'run')
    assert [status for status, _ in told] == [
        *(TrialStatus.RUNNING, TrialStatus.DONE),
        *(TrialStatus.RUNNING, TrialStatus.ENDED),
        *(TrialStatus.RUNNING, TrialStatus.DONE),
    ]

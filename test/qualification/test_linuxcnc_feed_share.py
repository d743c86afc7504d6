# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Feed shares along the path on a real LinuxCNC: followed, and given up when they must be."""

import signal
import subprocess
import time

import pytest

from fuzzycnc_ros.adapters.linuxcnc import feed_process
from fuzzycnc_ros.adapters.linuxcnc.component import FEED, install_component
from fuzzycnc_ros.adapters.linuxcnc.control import LinuxcncError
from fuzzycnc_ros.adapters.linuxcnc.recorder import PERIOD, recording
from fuzzycnc_ros.adapters.linuxcnc.simulation import PYTHON, shipped
from fuzzycnc_ros.core.feedrate.gcode.reader import read_program
from fuzzycnc_ros.core.machine.path_loop import ContouringConfig
from fuzzycnc_ros.simulation.controller.blends import ControllerLimits
from fuzzycnc_ros.simulation.controller.program import program_moves
from fuzzycnc_ros.studies.programs.adaptive_feed import NO_LENGTH, AdaptiveFeed, program_hash
from fuzzycnc_ros.studies.programs.program_judge import ProgramPath

pytestmark = pytest.mark.qualify

PART = """G21 G90 G17
G0 X0 Y0 Z0
G1 X8 F1500
Y6
G3 X5 Y9 I-3 J0
G1 X0
X-3 Y5
X5 Y1
X0 Y0
M2
"""
LIMITS = ControllerLimits(velocity=(0.4,) * 3, acceleration=(2.0,) * 3, path_velocity=0.5)
MACHINE = ContouringConfig()
TOLERANCE = 20e-6


@pytest.fixture(scope='module')
def table():
    search = AdaptiveFeed(PART, LIMITS, MACHINE)
    return search.keeping(TOLERANCE / search.disagreement)


@pytest.fixture
def recorder():
    try:
        install_component(shipped(f'{FEED}.comp'))
        with recording() as recorder:
            recorder.limit(LIMITS.velocity, LIMITS.acceleration)
            yield recorder
    except LinuxcncError as error:
        pytest.skip(str(error))


def judged(recorder, program):
    path = ProgramPath(program_moves(read_program(program).blocks))
    return path.judge(path.recorded(recorder.run(program, 200.0), PERIOD), MACHINE)


def test_driven_as_simulated_and_given_up_when_shifted(recorder, table):
    found, simulated = table
    recorder.follow(found.text())
    recorder.origin()
    driven = judged(recorder, found.program)
    assert driven.error <= TOLERANCE
    assert driven.duration == pytest.approx(simulated.duration, rel=0.05)
    # 0.1 mm beside the path: the least share, so slower, and the program still ends
    recorder.halcmd('sets', 'fuzzycnc-feed-offset-x', '0.1')
    recorder.halcmd('sets', 'fuzzycnc-feed-offset-y', '0.05')
    recorder.origin()
    shifted = judged(recorder, found.program)
    assert shifted.error <= TOLERANCE
    assert shifted.duration > 3.0 * driven.duration
    # disarmed: the feeds of the program
    recorder.halcmd('sets', 'fuzzycnc-feed-arm', '0')
    recorder.origin()
    assert judged(recorder, found.program).duration < 0.95 * driven.duration


def test_helper_arms_it_for_the_program_that_is_loaded(recorder, table):
    found, simulated = table
    recorder.follow(found.text())
    for name in ('arm', 'heartbeat'):
        recorder.halcmd('sets', f'fuzzycnc-feed-{name}', '0')
    recorder.halcmd('setp', 'fuzzycnc-feed.timeout', '0.5')
    words = [PYTHON, feed_process.__file__, program_hash(found.program), '0', str(NO_LENGTH)]
    recorder.origin()
    helper = subprocess.Popen(words, stdout=subprocess.PIPE, text=True)
    try:
        assert helper.stdout.readline().startswith('refused: ')  # another program is loaded
        # it is armed while no program runs alone: the first run loads it, and a helper that looks
        # between the two would be in time
        helper.send_signal(signal.SIGSTOP)
        assert judged(recorder, found.program).duration < 0.95 * simulated.duration
        helper.send_signal(signal.SIGCONT)
        time.sleep(1.0)
        assert judged(recorder, found.program).error <= TOLERANCE
    finally:
        helper.terminate()
        said, _ = helper.communicate(timeout=10.0)
    assert helper.returncode == 0
    assert said.splitlines()[-1] == 'armed'

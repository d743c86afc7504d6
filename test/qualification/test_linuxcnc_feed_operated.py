# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Feed shares of random programs on a real LinuxCNC whose operator interferes.

The share stays within the table and 1, the tool below the feed of the program, and every program
ends; where the table cannot be followed the helper says why.
"""

import contextlib
import subprocess
import time

import numpy as np
import pytest

from fuzzycnc_ros.adapters.linuxcnc import feed_process
from fuzzycnc_ros.adapters.linuxcnc.component import FEED, install_component
from fuzzycnc_ros.adapters.linuxcnc.control import LinuxcncError
from fuzzycnc_ros.adapters.linuxcnc.recorder import MILLIMETRE, PERIOD, recording
from fuzzycnc_ros.adapters.linuxcnc.simulation import PYTHON, shipped
from fuzzycnc_ros.simulation.controller.motion import FeedShare
from fuzzycnc_ros.studies.programs.adaptive_feed import FeedTable, coordinates, program_hash

pytestmark = pytest.mark.qualify

SEEDS = range(2)
WAYS = 12
"""Lines of a program; of so many some cross each other."""
FEED_RANGE, LEAST, TIMEOUT = (1200.0, 3000.0), 0.15, 120.0
OVERRIDE = 1.2
SAID = 0.3
"""Time in which the helper sees what has changed [s]."""


class RandomProgram:
    """Lines of one feed in a plane, with a table of random shares."""

    def __init__(self, seed, words=''):
        self.rng = rng = np.random.default_rng(seed)
        self.feed = rng.uniform(*FEED_RANGE)
        corners = rng.uniform(-6.0, 6.0, (WAYS + 1, 2)).round(3)
        head = [
            'G21 G90 G17',
            *words.split(),
            f'G1 F{self.feed:.3f}',
            'M52 P1',
            'G64 P0.002 Q0.002',
        ]
        lines = [f'G1 X{x:.3f} Y{y:.3f} Z0' for x, y in corners]
        self.text = '\n'.join([*head, *lines, 'M52 P0', 'M2', ''])
        self.first = len(head) + 1
        numbers = self.first + np.arange(1, WAYS + 1)
        self.table = FeedTable(
            self.text,
            FeedShare(np.arange(WAYS + 1.0), rng.uniform(LEAST, 1.0, WAYS + 1)),
            MILLIMETRE * np.column_stack([corners, np.zeros(WAYS + 1)]),
            np.append(numbers, numbers[-1]),
        )


@pytest.fixture(scope='module')
def recorder():
    try:
        install_component(shipped(f'{FEED}.comp'))
        with recording() as recorder:
            recorder.halcmd('loadrt', 'minmax', 'names=watch')
            recorder.halcmd('addf', 'watch', 'servo-thread')
            recorder.halcmd('net', 'fuzzycnc-feed-share', 'watch.in')
            yield recorder
    except LinuxcncError as error:
        pytest.skip(str(error))


class Helper:
    """The process that arms the component for a program, and its words."""

    def __init__(self, recorder, program):
        self._recorder = recorder
        for name in ('arm', 'heartbeat'):
            recorder.halcmd('sets', f'fuzzycnc-feed-{name}', '0')
        recorder.halcmd('setp', 'fuzzycnc-feed.timeout', '0.5')
        offset, length = coordinates(program.text)
        words = [
            PYTHON,
            feed_process.__file__,
            program_hash(program.text),
            str(offset),
            str(length),
        ]
        self._process = subprocess.Popen(words, stdout=subprocess.PIPE, text=True)
        self.said = ''

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self._process.terminate()
        self.said, _ = self._process.communicate(timeout=10.0)
        assert self._process.returncode == 0


def driven(recorder, program, during=lambda machine: None, line=0, most=1.0, origin=True):
    """Run a program, check what must never be, and return least and largest share and speed."""
    if origin:
        recorder.origin()
    recorder.halcmd('setp', 'watch.reset', '1')
    time.sleep(0.05)
    recorder.halcmd('setp', 'watch.reset', '0')
    path = recorder.run(program.text, TIMEOUT, during, line)
    machine = recorder._machine
    low, high = (
        float(machine.halcmd('getp', f'watch.{end}').split()[-1]) for end in ('min', 'max')
    )
    assert float(f'{program.table.adaptive.share.min():.4f}') - 1e-4 <= low <= high <= 1.0
    speed = np.linalg.norm(np.diff(path, axis=0), axis=1) / PERIOD / MILLIMETRE * 60.0
    assert speed.max() <= program.feed * most * 1.001, 'above the feed of the program'
    return low, high


def seen(helper, text):
    assert text in helper.said, helper.said


def interfere(rng, rounds=6):
    """Return an operator who pauses, holds and overrides at random."""

    def during(machine):
        for _ in range(rounds):
            time.sleep(rng.uniform(0.05, 0.5))
            action = rng.integers(3)
            if action == 0:
                machine.pause()
                time.sleep(rng.uniform(0.05, 0.4))
                machine.resume()
            elif action == 1:
                machine.halcmd('setp', 'motion.feed-hold', '1')
                time.sleep(rng.uniform(0.05, 0.4))
                machine.halcmd('setp', 'motion.feed-hold', '0')
            else:
                machine.override(float(rng.uniform(0.3, OVERRIDE)))
        machine.override(1.0)

    return during


@pytest.mark.parametrize('seed', SEEDS)
def test_operated_programs(recorder, seed):
    program = RandomProgram(seed)
    recorder.follow(program.table.text())
    with Helper(recorder, program) as helper:
        driven(recorder, program)  # loads it: armed from the next start on
        low, high = driven(recorder, program)
        assert low < 0.4 < high, 'the table is not followed'
        driven(recorder, program, interfere(program.rng), most=OVERRIDE)
        # a work offset that stands before the start shifts the table, too
        recorder._machine.line('G10 L2 P1 X1.5 Y-0.75 Z0.5')
        time.sleep(SAID)
        low, high = driven(recorder, program)
        assert low < high
        recorder._machine.line('G10 L2 P1 X0 Y0 Z0')
        line = program.first + int(program.rng.integers(2, WAYS - 2))
        driven(recorder, program, line=line)

        def aborted(machine):
            time.sleep(program.rng.uniform(0.2, 1.0))
            with contextlib.suppress(LinuxcncError):  # it may be over
                machine.abort()

        driven(recorder, program, aborted)
        driven(recorder, program)
    seen(helper, 'armed')


@pytest.mark.parametrize('seed', SEEDS)
def test_programs_that_are_not_that_of_the_table(recorder, seed):
    program, other = RandomProgram(seed), RandomProgram(seed + 100)
    recorder.follow(program.table.text())
    with Helper(recorder, program) as helper:
        other.table = program.table
        driven(recorder, other)
        low, high = driven(recorder, other, interfere(program.rng), most=OVERRIDE)
        assert low == high == 1.0
    seen(helper, 'expected the program of the table')
    # a table of another program that is armed all the same has the least share where it is lost
    with_its_table = RandomProgram(seed)
    recorder.follow(with_its_table.table.text())
    with_its_table.text = other.text
    with_its_table.feed = other.feed
    low, _ = driven(recorder, with_its_table)
    assert low == pytest.approx(program.table.adaptive.share.min(), abs=1e-4)
    # M52 is off: the pin is ignored
    without = RandomProgram(seed)
    without.text = without.text.replace('M52 P1', 'M52 P0')
    driven(recorder, without, interfere(program.rng), most=OVERRIDE)


def test_another_work_offset_is_told(recorder):
    program = RandomProgram(7, words='G54')
    recorder.follow(program.table.text())
    with Helper(recorder, program) as helper:
        driven(recorder, program)
        recorder._machine.line('G55')
        time.sleep(SAID)
        driven(recorder, program, origin=False)  # it chooses its own
    seen(helper, 'work offset: expected G54 but found G55')

# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""A duty on a real controller: the part program and the log, without a controller."""

import re
from dataclasses import replace
from math import pi

import numpy as np
import pytest
from benches.component_bench import applied

from fuzzycnc_ros.components.machine.simulated_machine_config import MACHINE_DUTIES
from fuzzycnc_ros.runtime.records import Displacement, ThermalReference, nanoseconds
from fuzzycnc_ros.studies.linuxcnc_duty import RADIUS, ClosedLoopLog, duty_program

MICRON = 1e-6


@pytest.mark.parametrize('duty', ['T2', 'T3', 'shift'])
@pytest.mark.parametrize('rate', [60.0, 300.0])
def test_program_turns_the_spindle_as_the_duty_does(duty, rate):
    """Read back from the text: speed and duration of each block."""
    blocks, speed, feed = [], 0.0, 0.0
    for line in duty_program(MACHINE_DUTIES[duty], rate).splitlines():
        if line.startswith('S'):
            speed = float(line.split()[0][1:])
        elif line == 'M5':
            speed = 0.0
        elif line.startswith('F'):
            feed = float(line[1:])
        elif found := re.fullmatch(r'o\d+ repeat \[(\d+)\]', line):
            minutes = int(found.group(1)) * 2.0 * pi * RADIUS / feed
            blocks.append((speed, 60.0 * minutes * rate))
    wanted = MACHINE_DUTIES[duty].blocks
    for (told, duration), block in zip(blocks, wanted, strict=True):
        assert told * 2.0 * pi / 60.0 == pytest.approx(block.spindle_speed, abs=0.06)
        assert duration == pytest.approx(block.duration, rel=1e-5)


def displacement(time, value, *, includes=True):
    return Displacement(
        stamp=nanoseconds(time),
        frame_id='mill/workpiece',
        axis=('Y', 'Z'),
        channel=('Y', 'Z'),
        displacement=MICRON * np.array(value),
        standard_deviation=np.full(2, MICRON),
        includes_compensation=includes,
    )


def test_log_takes_off_what_was_read_back_at_the_time():
    log = ClosedLoopLog()
    assert log.spans() == []
    log(
        'thermal_reference',
        ThermalReference(
            stamp=nanoseconds(200.0),
            frame_id='mill/machine',
            cold_since=nanoseconds(20.0),
            set_by='operator',
            sensor=('T1',),
            temperature=np.zeros(1),
            samples=3,
        ),
    )
    for time, offset in ((10.0, 0.0), (100.0, 4.0), (110.0, 6.0)):
        log('compensation_applied', applied(time, (MICRON * offset, -MICRON * offset)))
    log('compensation_applied', replace(applied(130.0, (0.0, 0.0)), axis=('Z', 'Y')))
    log('displacement', displacement(60.0, (1.0, 2.0)))
    log('displacement', displacement(120.0, (1.0, 2.0)))
    log('displacement', displacement(180.0, (5.0, 5.0), includes=False))
    found = log.records('displacement')
    np.testing.assert_allclose(
        [item.displacement for item in found],
        MICRON * np.array([[1.0, 2.0], [-5.0, 8.0], [5.0, 5.0]]),
        atol=1e-15,
    )
    assert not any(item.includes_compensation for item in found)
    assert log.spans() == [(nanoseconds(20.0), nanoseconds(180.0))]

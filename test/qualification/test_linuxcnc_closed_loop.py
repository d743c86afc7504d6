# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""A whole duty through a real LinuxCNC whose machine is simulated: what compensation leaves."""

import io
import json
import os

import numpy as np
import pytest
from equipment.linuxcnc_machine import exclusive
from rich.console import Console

from fuzzycnc_ros.cli.demo.linuxcnc import linuxcnc_demo
from fuzzycnc_ros.core.inputs.offset_input import OffsetStatus
from fuzzycnc_ros.runtime.enums import MachineMode
from fuzzycnc_ros.studies.linuxcnc_duty import ClosedLoopLog
from fuzzycnc_ros.studies.shift.shift_log import ShiftLog

pytestmark = [pytest.mark.ros, pytest.mark.realtime, pytest.mark.qualify]

MICRON = 1e-6
RATE = 150.0
"""Faster, and a node that a busy computer holds up for a second counts as dead."""
LEFT = 5 * MICRON
"""What may be left on each axis at any time of the duty."""


def test_residual_of_a_duty_through_linuxcnc(tmp_path, monkeypatch):
    with exclusive():
        pass  # the demo takes it itself; here it skips
    monkeypatch.setenv('ROS_DOMAIN_ID', os.environ.get('ROS_DOMAIN_ID', '0'))  # is set back
    linuxcnc_demo(Console(file=io.StringIO()), tmp_path, seed=1, rate=RATE)
    summary = json.loads((tmp_path / 'summary.json').read_text())
    assert summary['program_ran']
    log = ShiftLog.from_bag(tmp_path / 'bag')
    moved = log.records('displacement')
    assert len(moved) >= 195
    assert all(item.includes_compensation for item in moved)
    residual = np.array([item.displacement for item in moved])
    bare = np.array(
        [
            item.displacement
            for item in ClosedLoopLog.from_bag(tmp_path / 'bag').records('displacement')
        ]
    )
    print(f'left {1e6 * np.abs(residual).max(axis=0)} of {1e6 * np.abs(bare).max(axis=0)} um')
    assert (np.abs(residual).max(axis=0) <= LEFT).all()
    assert (np.abs(bare).max(axis=0) >= 25 * MICRON).all()
    # offsets were in force while the axes moved
    states = [s for s in log.records('machine_state') if s.state == MachineMode.RUNNING]
    place = np.array([dict(zip(s.axis, s.position, strict=True))['Y'] for s in states])
    assert np.ptp(place) > 19e-3
    applied = log.records('compensation_applied', start=moved[3].stamp)
    refused = [item for item in applied if item.status == OffsetStatus.REFUSED]
    assert not refused, refused[0]

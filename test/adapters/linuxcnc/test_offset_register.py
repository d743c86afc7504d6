# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""When LinuxCNC's offset registers are found to have a base, and when they only lag behind."""

import numpy as np
import pytest

from fuzzycnc_ros.adapters.linuxcnc.status import (
    SURE,
    LinuxcncStatus,
    OffsetRegisters,
    RegisterPhase,
)
from fuzzycnc_ros.core.inputs.lines import Travel
from fuzzycnc_ros.runtime.enums import MachineMode

SCALE = 1e-8


def status(tick, counts, register):
    """Return what is read, for one axis whose register is told in counts."""
    offset = np.array([register * SCALE])
    return LinuxcncStatus(
        mode=MachineMode.RUNNING,
        homed=True,
        ready=True,
        alive=True,
        frozen=False,
        soft_limited=False,
        position=np.zeros(1),
        applied=offset,
        register=offset,
        counts=np.array([float(counts)]),
        scale=np.array([SCALE]),
        travel=Travel(low=np.zeros(1), high=np.zeros(1)),
        tick=tick,
    )


@pytest.fixture
def registers():
    """Registers whose base is known to be zero, at 100 counts."""
    found = OffsetRegisters(1)
    for tick in range(2 * SURE):
        found.observe(status(tick, 100, 100))
    assert found.phase is RegisterPhase.FOLLOWING
    return found


def test_lag_of_a_servo_thread_that_stands_is_no_base(registers):
    """Its last period has moved the counts; the next one, which is to take them, does not come."""
    for _ in range(100):
        assert not registers.observe(status(50, 120, 100))
    assert registers.phase is RegisterPhase.FOLLOWING
    for tick in range(51, 60):
        assert not registers.observe(status(tick, 120, 120))
    assert registers.settled


def test_lag_of_a_steady_ramp_is_no_base(registers):
    for tick in range(50, 150):
        assert not registers.observe(status(tick, 100 + 20 * (tick - 49), 100 + 20 * (tick - 50)))
    assert registers.phase is RegisterPhase.FOLLOWING


def test_base_that_stands_for_some_periods_is_found(registers):
    found = [registers.observe(status(50 + n, 100, 60)) for n in range(SURE + 2)]
    assert found.count(True) == 1
    assert registers.phase is RegisterPhase.RAMPING
    assert registers.base[0] == pytest.approx(-40 * SCALE)


def test_looks_within_a_period_do_not_count(registers):
    for look in range(10 * SURE):
        assert not registers.observe(status(50 + look // 20, 100, 60))
    assert registers.phase is RegisterPhase.FOLLOWING

# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Nodes killed in a lock-step run: what the machine is told stays within limits, and says why."""

from itertools import pairwise

import numpy as np
import pytest

from fuzzycnc_ros.components.machine.simulated_machine import SimulatedMachineConfig
from fuzzycnc_ros.components.machine.simulated_machine_config import DAY_START
from fuzzycnc_ros.components.thermal.compensator import CompensatorConfig
from fuzzycnc_ros.core.inputs.offset_input import OffsetStatus
from fuzzycnc_ros.runtime.enums import CompensationState
from fuzzycnc_ros.runtime.records import (
    SECOND,
    Compensation,
    CompensationApplied,
    MachineState,
    Temperatures,
    ThermalError,
)

pytestmark = [pytest.mark.ros, pytest.mark.slow]

LIMITS, MACHINE = CompensatorConfig(), SimulatedMachineConfig()
MICRO = 1e-6
MINUTE = 60 * SECOND
START = int(DAY_START) * SECOND
"""Machine time at which the duty starts."""
RUN = {'duties': ('T2',), 'tick_period': 30.0, 'answer_timeout': 10.0}
"""400 ticks of 30 s: 200 minutes; only a dead node keeps silent for ten seconds."""


class Shift:
    """A shift that the test watches."""

    def __init__(self, graph, observer, model):
        self.observer = observer
        observer.watch_diagnostics()
        self.told = observer.records('compensation', Compensation)
        self.applied = observer.records('compensation_applied', CompensationApplied)
        self.error = observer.records('thermal_error', ThermalError)
        self.state = observer.records('machine_state', MachineState)
        self.temperatures = observer.records('temperatures', Temperatures)
        self.graph = graph
        self.nodes = graph.start_shift(model, lockstep=True, **RUN)
        self.machine = self.nodes['simulated_machine']

    @property
    def minute(self):
        """Machine time since the start of the duty [min]."""
        return (self.state[-1].stamp - START) / MINUTE if self.state else 0.0

    def until_minute(self, minute):
        """Spin until machine time has come so far."""

        def come():
            assert self.machine.process.poll() is None, 'the machine has ended'
            return self.minute >= minute

        self.observer.until(come, f'minute {minute}')

    def run_out(self):
        """Wait for the end of the duty."""
        assert self.observer.until_ended(self.machine) == 0

    def check_limits(self):
        """Hold what the machine was told and applied against size and slew limits."""
        for records, size, slew in (
            (self.told, LIMITS.offset_max, LIMITS.slew_max),
            (self.applied, MACHINE.offset_max, MACHINE.slew_max),
        ):
            assert len(records) > 10
            for before, after in pairwise(records):
                assert np.isfinite(after.offset).all()
                assert np.abs(after.offset).max() <= size
                if records is self.told and after.epoch != before.epoch:
                    continue  # a new owner starts from what the machine applies
                elapsed = (after.stamp - before.stamp) / SECOND
                step = np.abs(after.offset - before.offset).max()
                assert step <= slew * elapsed + 1e-12, f'at {after.stamp / SECOND} s'


def test_temperatures_stop(graph, observer, model_file):
    """Acquisition dies: offsets are held, ramp to zero and expire."""
    shift = Shift(graph, observer, model_file)
    shift.until_minute(60)
    graph.kill(shift.nodes['temperature_acquisition'])
    shift.run_out()
    assert 'temperature_acquisition' in shift.machine.outcome['lost']
    # Killed between a sample and its answer, it has not announced the sample to the predictor.
    last = shift.error[-1].stamp
    assert shift.temperatures[-1].stamp - last in (0, MINUTE)
    check_hold_and_ramp(shift, last)


def test_predictor_dies(graph, observer, model_file):
    shift = Shift(graph, observer, model_file)
    shift.until_minute(60)
    graph.kill(shift.nodes['thermal_predictor'])
    shift.run_out()
    assert 'thermal_predictor' in shift.machine.outcome['lost']
    check_hold_and_ramp(shift, shift.error[-1].stamp)


def check_hold_and_ramp(shift, last):
    """Check that the compensator held after the last error, then ramped to zero and rested."""
    shift.check_limits()
    after = [item for item in shift.told if item.stamp > last]
    states = [CompensationState(item.state) for item in after]
    assert states[0] is not CompensationState.EXPIRED
    assert CompensationState.HOLDING in states
    assert CompensationState.RAMPING in states
    assert states[-1] is CompensationState.EXPIRED
    assert not after[-1].offset.any()
    assert not shift.applied[-1].offset.any()
    held_until = next(i.stamp for i in after if i.state == CompensationState.RAMPING)
    held = (held_until - last) / SECOND
    assert held == pytest.approx(LIMITS.stale_after + LIMITS.hold_time, abs=2 * LIMITS.period)
    shift.observer.until(
        lambda: shift.observer.told('mill/compensator: state', 'thermal error is late'),
        f'says why, found {shift.observer.statuses.get("mill/compensator: state")}',
    )


def test_compensator_dies(graph, observer, model_file):
    """Nobody tells the machine anything: it ramps to zero by itself."""
    shift = Shift(graph, observer, model_file)
    shift.until_minute(60)
    graph.kill(shift.nodes['compensator'])
    shift.run_out()
    assert 'compensator' in shift.machine.outcome['lost']
    last = shift.told[-1]
    assert last.offset.any()
    shift.check_limits()
    expired = [item for item in shift.applied if item.stamp > last.valid_until]
    assert OffsetStatus(expired[0].status) is OffsetStatus.EXPIRED
    assert expired[0].offset.any()
    longest = np.abs(last.offset).max() / MACHINE.slew_max
    rested = [i for i in expired if i.stamp > last.valid_until + (longest + 40) * SECOND]
    assert rested
    assert not any(item.offset.any() for item in rested)
    item = 'mill/simulated_machine: compensation'
    assert observer.told(item, 'expired'), observer.statuses[item]

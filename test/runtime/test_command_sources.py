# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Machine side with several sources of commands: it refuses all of them, and says which."""

import numpy as np
import pytest
from benches.component_bench import Bench

from fuzzycnc_ros.components.machine.simulated_machine import (
    SimulatedMachine,
    SimulatedMachineConfig,
)
from fuzzycnc_ros.core.inputs.offset_input import OffsetStatus
from fuzzycnc_ros.runtime.component import REQUEST
from fuzzycnc_ros.runtime.enums import MachineMode
from fuzzycnc_ros.runtime.records import SECOND, Compensation, nanoseconds

MICRON = 1e-6
NODES = ['/mill/compensator', '/mill/stranger']


@pytest.fixture
def bench():
    """A machine that follows 10 um on Y."""
    made = Bench(SimulatedMachine(SimulatedMachineConfig(tick_period=1.0)))
    tick(made, 1)
    command(made, 10 * MICRON)
    tick(made, 25)
    assert told(made)[-1].offset[0] == pytest.approx(10 * MICRON)
    return made


def tick(bench, count):
    """Let the machine go on."""
    for _ in range(count):
        bench.emitted += bench.component.tick()
        bench.until(bench.component._time / SECOND)


def told(bench):
    """Return all read-backs."""
    return bench.records('compensation_applied')


def command(bench, offset, epoch=1):
    """Command an offset of Y."""
    stamp = bench.merger.time
    bench.component.on_compensation(
        Compensation(
            stamp=stamp,
            epoch=epoch,
            state=1,
            axis=('Y',),
            offset=np.array([offset]),
            slope=np.zeros(1),
            reference_position=np.zeros(1),
            at_limit=np.zeros(1, bool),
            slewing=np.zeros(1, bool),
            valid_until=stamp + nanoseconds(180.0),
            source=('thermal_error',),
        )
    )


def test_both_sources_of_offsets_are_refused_and_named(bench):
    assert bench.request(REQUEST, input='compensation', node=NODES).success
    command(bench, 30 * MICRON, epoch=9)
    tick(bench, 25)
    last = told(bench)[-1]
    assert last.status == OffsetStatus.REFUSED
    assert 'from several nodes, all are refused: /mill/compensator, /mill/stranger' in last.reason
    np.testing.assert_array_equal(last.offset, 0.0)
    moved = np.diff([item.offset[0] for item in told(bench)])
    assert np.abs(moved).max() <= SimulatedMachineConfig().slew_max + 1e-12
    assert not bench.records('machine_state')[-1].offsets_allowed
    assert '/mill/stranger' in bench.component.sources.refusals['compensation']


def test_one_alone_is_followed_again_from_a_fresh_command(bench):
    bench.request(REQUEST, input='compensation', node=NODES)
    tick(bench, 25)
    answer = bench.request(REQUEST, input='compensation', node=[])
    assert answer.success
    assert answer.message == 'compensation has one source again'
    tick(bench, 5)
    np.testing.assert_array_equal(told(bench)[-1].offset, 0.0)
    assert bench.records('machine_state')[-1].offsets_allowed
    assert not bench.component.sources.refusals
    command(bench, 1 * MICRON, epoch=2)
    tick(bench, 5)
    assert told(bench)[-1].status == OffsetStatus.FOLLOWING
    assert told(bench)[-1].offset[0] == pytest.approx(1 * MICRON)


def test_mode_and_sources_both_have_to_allow(bench):
    bench.request(REQUEST, input='compensation', node=NODES)
    bench.component.set_mode(MachineMode.ESTOP)
    bench.request(REQUEST, input='compensation', node=[])
    tick(bench, 5)
    assert not bench.records('machine_state')[-1].offsets_allowed
    bench.component.set_mode(MachineMode.ON)
    tick(bench, 1)
    assert bench.records('machine_state')[-1].offsets_allowed


def test_two_sources_of_duties_are_a_fault_of_the_machine():
    config = SimulatedMachineConfig(duties=(), servo_axes=('X:lathe',), moves=('X:-0.01',))
    bench = Bench(SimulatedMachine(config))
    tick(bench, 5)
    nodes = ['/mill/servo_controller', '/mill/stranger']
    bench.request(REQUEST, input='axis_command', node=nodes)
    tick(bench, 5)
    state = bench.records('machine_state')[-1]
    assert state.state == MachineMode.FAULT
    assert state.offsets_allowed
    found = bench.component.sources.refusals['axis_command']
    assert 'all are refused: /mill/servo_controller, /mill/stranger' in found
    bench.request(REQUEST, input='axis_command', node=[])
    tick(bench, 5)
    assert bench.records('machine_state')[-1].state == MachineMode.RUNNING


@pytest.mark.parametrize(
    ('arguments', 'naming'),
    [
        ({'input': 'trajectory', 'node': []}, 'expected compensation, axis_command'),
        ({'node': []}, 'but found None'),
        ({'input': 'compensation', 'node': [1]}, 'expected a list of node names'),
        ({'input': 'compensation', 'node': 7}, 'expected a list of node names'),
        ({'input': 'compensation', 'node': 'a'}, 'expected a list of node names'),
    ],
)
def test_facts_that_mean_nothing_are_refused(arguments, naming):
    answer = SimulatedMachine().on_request(REQUEST, arguments, 0)
    assert not answer.success
    assert naming in answer.message


def test_other_requests_are_unknown():
    answer = SimulatedMachine().on_request('dance', {}, 0)
    assert not answer.success
    assert 'knows no request dance' in answer.message

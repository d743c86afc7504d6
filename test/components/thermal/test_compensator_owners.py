# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Compensator and machine together: whoever owns the offsets, they never step."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from benches.component_bench import Bench, applied, machine_state, thermal_error
from hypothesis import given, settings
from hypothesis import strategies as st

from fuzzycnc_ros.components.thermal.compensator import Compensator, CompensatorConfig
from fuzzycnc_ros.core.inputs.offset_input import OffsetInput, OffsetInputConfig, OffsetStatus
from fuzzycnc_ros.runtime.enums import CompensationState
from fuzzycnc_ros.runtime.records import SECOND, CompensationApplied

MICRON = 1e-6
LIMITS, MACHINE = CompensatorConfig(), OffsetInputConfig()
TICK = 10
ERROR = (20 * MICRON, -10 * MICRON)


class Shop:
    """A machine side that several compensators talk to, every 10 s; errors come every minute."""

    def __init__(self):
        self.input = OffsetInput(('Y', 'Z'))
        self.benches: dict[str, Bench] = {}
        self.time = 0
        self.readings: list[CompensationApplied] = []
        self.restarts: set[int] = set()
        self.told: dict[str, list] = {}
        self.deaf = False

    def add(self, name):
        """Add a compensator, active at once."""
        bench = self.benches[name] = Bench(Compensator())
        bench.until(self.time)
        bench.component.on_request('activate', {}, self.time * SECOND)
        self.told.setdefault(name, [])

    def remove(self, name):
        """Kill a compensator."""
        del self.benches[name]

    def restart_machine(self):
        """Start the machine side anew, at zero; the read-back steps, the machine knows nothing."""
        self.input = OffsetInput(('Y', 'Z'), start=self.time * SECOND)
        self.restarts.add(len(self.readings))

    def run(self, duration, allowed=True, error=ERROR):
        """Let machine time go on [s]."""
        for _ in range(duration // TICK):
            self.time += TICK
            self.input.allow(allowed, 'several sources')
            self.input.advance(self.time * SECOND)
            reading = CompensationApplied(
                stamp=self.time * SECOND,
                epoch=self.input.epoch,
                status=int(self.input.status),
                reason=self.input.reason,
                axis=self.input.axes,
                offset=self.input.applied,
                at_limit=self.input.at_limit,
            )
            self.readings.append(reading)
            for name, bench in self.benches.items():
                bench.push('machine_state', machine_state(self.time, offsets_allowed=allowed))
                bench.push('compensation_applied', reading)
                if self.time % 60 == 0 and error is not None:
                    bench.push('thermal_error', thermal_error(self.time, error))
                for item in bench.until(self.time):
                    self.tell(name, item.record)

    def tell(self, name, record):
        """Pass a command on to the machine."""
        self.told[name].append(record)
        if not self.deaf:
            self.input.command(
                record.epoch,
                record.axis,
                record.offset,
                stamp=record.stamp,
                valid_until=record.valid_until,
            )

    def check(self):
        """Hold everything that was told and applied against the limits."""
        for number, (before, after) in enumerate(pairwise(self.readings), start=1):
            if number in self.restarts:
                continue
            moved = np.abs(after.offset - before.offset).max()
            assert moved <= MACHINE.slew_max * TICK + 1e-12
        for commands in self.told.values():
            for before, after in pairwise(commands):
                assert np.abs(after.offset).max() <= LIMITS.offset_max
                if after.epoch == before.epoch:
                    elapsed = (after.stamp - before.stamp) / SECOND
                    moved = np.abs(after.offset - before.offset).max()
                    assert moved <= LIMITS.slew_max * elapsed + 1e-12
            epochs = [command.epoch for command in commands]
            assert epochs == sorted(epochs)
            for command in (
                c for c, e in zip(commands, [0, *epochs], strict=False) if c.epoch > e
            ):
                in_force = [r for r in self.readings if r.stamp <= command.stamp][-1].offset
                moved = np.abs(command.offset - in_force).max()
                assert moved <= LIMITS.slew_max * LIMITS.period + 1e-12


@pytest.fixture
def shop():
    """A machine that has been compensated for ten minutes."""
    running = Shop()
    running.add('a')
    running.run(600)
    np.testing.assert_allclose(running.input.applied, [-20 * MICRON, 10 * MICRON])
    return running


def test_restart_within_validity_moves_nothing(shop):
    shop.remove('a')
    shop.run(100)
    shop.add('b')
    shop.run(600)
    np.testing.assert_allclose([r.offset for r in shop.readings[60:]], [[-2e-5, 1e-5]] * 70)
    assert [c.epoch for c in shop.told['b']] == [2] * len(shop.told['b'])
    shop.check()


def test_restart_after_expiry_starts_from_where_the_machine_has_gone(shop):
    """Not from the offsets of old: that would be a step at the machine's own slew limit."""
    shop.remove('a')
    shop.run(400)
    np.testing.assert_array_equal(shop.input.applied, 0.0)
    shop.add('b')
    shop.run(600)
    assert np.abs(shop.told['b'][0].offset).max() <= LIMITS.slew_max * LIMITS.period + 1e-15
    np.testing.assert_allclose(shop.input.applied, [-20 * MICRON, 10 * MICRON])
    shop.check()


def test_commands_that_expired_on_the_machine_are_not_taken_up_again(shop):
    """The compensator was cut off, or its process stood still; it is the same owner."""
    shop.deaf = True
    shop.run(400)
    shop.deaf = False
    np.testing.assert_array_equal(shop.input.applied, 0.0)
    before = len(shop.readings)
    shop.run(600)
    offsets = np.array([r.offset[0] for r in shop.readings[before:]])
    assert np.abs(np.diff(offsets)).max() <= LIMITS.slew_max * TICK + 1e-12
    assert offsets[-1] == pytest.approx(-20 * MICRON)
    shop.check()


def test_machine_side_that_is_started_anew_is_joined_at_zero(shop):
    shop.restart_machine()
    before = len(shop.readings)
    shop.run(600)
    offsets = np.array([r.offset[0] for r in shop.readings[before:]])
    # What was on its way from before is followed for a tick, at the machine's own slew limit.
    assert np.abs(np.diff(offsets[2:])).max() <= LIMITS.slew_max * TICK + 1e-12
    assert offsets[-1] == pytest.approx(-20 * MICRON)
    assert shop.told['a'][-1].epoch > 1


def test_older_owner_yields_and_comes_back_when_the_newer_is_gone(shop):
    shop.add('b')
    shop.run(120)
    assert shop.input.epoch == 2
    count = len(shop.told['a'])
    shop.run(300)
    assert len(shop.told['a']) == count
    assert 'the machine follows another compensator (epoch 2, this one has 1)' in (
        shop.benches['a'].health()
    )
    np.testing.assert_allclose(shop.input.applied, [-20 * MICRON, 10 * MICRON])
    shop.remove('b')
    shop.run(900)
    assert shop.input.epoch == 3
    assert shop.told['a'][-1].state == CompensationState.ACTIVE
    np.testing.assert_allclose(shop.input.applied, [-20 * MICRON, 10 * MICRON])
    shop.check()


def test_both_are_refused_and_the_last_one_left_ramps_up(shop):
    """What a machine side does that sees two sources, and what becomes of it."""
    shop.add('b')
    shop.run(120)
    shop.run(300, allowed=False)
    np.testing.assert_array_equal(shop.input.applied, 0.0)
    assert shop.readings[-1].status == OffsetStatus.REFUSED
    shop.remove('b')
    before = len(shop.readings)
    shop.run(900)
    offsets = np.array([r.offset[0] for r in shop.readings[before:]])
    assert np.abs(np.diff(offsets)).max() <= LIMITS.slew_max * TICK + 1e-12
    assert offsets[-1] == pytest.approx(-20 * MICRON)
    shop.check()


EVENTS = st.lists(
    st.tuples(
        st.sampled_from(['run', 'a', 'b', 'deaf', 'forbidden', 'silent', 'machine']),
        st.integers(min_value=12, max_value=40),
        st.tuples(*[st.floats(min_value=-80e-6, max_value=80e-6)] * 2),
    ),
    max_size=8,
)


@settings(max_examples=12, deadline=None)
@given(EVENTS)
def test_nothing_steps_whoever_comes_and_goes(events):
    """Owners that die and come back, lost commands, machines that refuse or start anew."""
    shop = Shop()
    shop.add('a')
    shop.run(120)
    for kind, ticks, error in events:
        shop.deaf = kind == 'deaf'
        if kind in ('a', 'b'):
            if kind in shop.benches:
                shop.remove(kind)
            else:
                shop.add(kind)
                shop.told[kind].clear()
        if kind == 'machine':
            shop.restart_machine()
        shop.run(TICK * ticks, kind != 'forbidden', None if kind == 'silent' else error)
    shop.deaf = False
    shop.benches.pop('b', None)
    if 'a' not in shop.benches:
        shop.add('a')
        shop.told['a'].clear()
    shop.run(1200)
    np.testing.assert_allclose(shop.input.applied, [-20 * MICRON, 10 * MICRON])
    shop.check()


def test_owner_that_yields_may_be_deactivated():
    bench = Bench(Compensator())
    bench.push('machine_state', machine_state(1.0))
    bench.give('compensation_applied', applied(1.0))
    bench.until(1.0)
    bench.request('activate')
    bench.give('thermal_error', thermal_error(60.0, ERROR))
    other = replace(applied(61.0, (5 * MICRON, 0.0), 9), status=int(OffsetStatus.FOLLOWING))
    bench.give('compensation_applied', other)
    assert bench.component.next_deadline is None
    assert bench.give('thermal_error', thermal_error(120.0, ERROR)) == []
    answer = bench.request('deactivate')
    assert answer.success
    assert answer.emissions == ()
    assert bench.component.at_rest

# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The machine side believes no stamp, no epoch and no validity that it has not bounded itself."""

import numpy as np
import pytest
from benches.bridge_bench import MICRON
from benches.linuxcnc_rig import CYCLE, SCALE, SLEW, Rig, settled

from fuzzycnc_ros.adapters.controller_bridge import STEPS_MAX
from fuzzycnc_ros.core.inputs.offset_input import OffsetStatus
from fuzzycnc_ros.core.inputs.offsets import EPOCH_STEP
from fuzzycnc_ros.runtime.component import REQUEST
from fuzzycnc_ros.runtime.records import SECOND, Compensation, nanoseconds

HOUR, DAY = 3600.0, 86400.0
STEP = SLEW * CYCLE + SCALE
"""Most that offsets may move in a cycle [m]."""


@pytest.mark.parametrize('told', [True, False])
@pytest.mark.parametrize('back', [2.0, HOUR, DAY])
def test_offsets_expire_although_the_clock_goes_back(back, told):
    rig = settled(validity_max=5.0)
    rig.set_clock(-back, told=told)
    rig.run(2.0)
    assert rig.at((10, -20, 30))
    rig.run(5.0)
    assert rig.last.status == OffsetStatus.EXPIRED
    assert rig.at((0, 0, 0))
    assert rig.largest_step <= STEP


@pytest.mark.parametrize('step', [-DAY, -HOUR, HOUR, DAY])
def test_commands_of_the_new_series_are_followed(step):
    rig = settled()
    rig.set_clock(step)
    rig.command((0, 5, 0), epoch=2)
    rig.run(2.0)
    assert rig.at((0, 5, 0))
    assert abs(rig.last.stamp - nanoseconds(rig.time)) <= 0.25 * SECOND
    assert rig.largest_step <= STEP


@pytest.mark.parametrize('told', [True, False])
def test_no_cycle_moves_further_however_far_the_clock_goes_forward(told):
    rig = settled()
    rig.set_clock(HOUR, told=told)
    rig.run(0.5)
    assert rig.largest_step <= STEP
    rig.run(3.0)
    assert rig.at((10, -20, 30) if told else (0, 0, 0))
    assert rig.largest_step <= STEP


def test_process_that_stood_still_goes_on_without_a_jump():
    rig = settled(cycle_period=CYCLE, validity_max=5.0)
    rig.time += 60.0
    rig.run(CYCLE)
    moved = np.abs(rig.bridge.orders.counts * SCALE - rig.applied).max()
    assert moved <= STEPS_MAX * SLEW * CYCLE + SCALE
    rig.run(3.0)
    assert rig.at((0, 0, 0))


@pytest.mark.parametrize('valid', [20.0, 2.0e9])
def test_silence_of_an_owner_ends_its_right(valid):
    rig = settled(validity_max=5.0)
    rig.command((40, 0, 0), valid=valid, epoch=6)
    rig.run(4.5)
    assert rig.at((40, 0, 0))
    rig.run(2.0)
    assert rig.last.status == OffsetStatus.EXPIRED
    assert rig.at((0, 0, 0))


@pytest.mark.parametrize('epoch', [2 + EPOCH_STEP, 2**40, 2**62])
def test_epoch_that_jumps_is_refused_and_locks_nobody_out(epoch):
    rig = settled()
    rig.command((40, 0, 0), epoch=epoch)
    rig.run(2.0)
    assert rig.at((10, -20, 30))
    assert rig.last.status == OffsetStatus.REFUSED
    assert f'expected epoch 1 to {1 + EPOCH_STEP} but found {epoch}' in rig.last.reason
    rig.command((5, 5, 5), epoch=2)
    rig.run(2.0)
    assert rig.at((5, 5, 5))


class Strangers:
    """Commands, clocks and restarts at random, beside an honest owner now and then.

    All of a run follows from its seed, so that what fails fails again.
    """

    VALIDITY, ADOPTED = 2.0, 1.0

    def __init__(self, seed):
        self.random = np.random.default_rng(seed)
        self.rig = Rig(
            validity_max=self.VALIDITY, adopt_time=self.ADOPTED, lead_max=0.5, cycle_period=0.005
        )
        self.rig.run(0.2)
        self.fed = 0.0  # time since somebody was heard or took hold [s]

    def command(self):
        """Send a command that nobody should trust."""
        rig, draw = self.rig, self.random
        sizes = (0.0, 1e-6, 30e-6, 60e-6, 1e-3, 1.0, 1e308, np.nan, np.inf)
        offset = draw.choice(sizes, 3) * draw.choice((-1.0, 1.0), 3)
        slope = draw.choice((0.0, 1e-5, 1.0, np.nan), 3, p=(0.7, 0.1, 0.1, 0.1))
        known = rig.bench.records('compensation_applied')[-1].epoch
        jump = int(draw.choice((-1, 0, 1, 5, EPOCH_STEP, EPOCH_STEP + 1, 2**40, 2**61)))
        stamp = rig.time + draw.choice((0.0, 0.0, -1.0, -HOUR, 0.4, 5.0, DAY))
        valid = draw.choice((0.0, 0.5, 5.0, HOUR, 2.0e9))
        rig.bench.push(
            'compensation',
            Compensation(
                stamp=max(0, nanoseconds(stamp)),
                epoch=max(0, known + jump),
                state=1,
                axis=('X', 'Y', 'Z')[: draw.integers(1, 4)],
                offset=offset,
                slope=slope,
                reference_position=np.zeros(3),
                at_limit=np.zeros(3, bool),
                slewing=np.zeros(3, bool),
                valid_until=max(0, nanoseconds(stamp + valid)),
                source=('stranger',),
            ),
        )
        rig.bench.merger.advance(nanoseconds(rig.time) + 10 * SECOND)
        self.fed = 0.0

    def happen(self):
        """Let one thing happen."""
        rig, draw = self.rig, self.random
        what = draw.choice(
            ('command', 'clock', 'unseen clock', 'restart', 'sources', 'deactivate', 'stop'),
            p=(0.8, 0.05, 0.05, 0.02, 0.03, 0.03, 0.02),
        )
        if what == 'command':
            self.command()
        elif what in ('clock', 'unseen clock'):
            step = draw.choice((-DAY, -HOUR, -2.0, 2.0, HOUR, DAY))
            rig.set_clock(max(step, DAY - rig.time), told=what == 'clock')
        elif what == 'restart':
            rig.restart()
            self.fed = 0.0
        elif what == 'sources':
            nodes = [[], ['/a', '/b']][draw.integers(2)]
            rig.bench.request(REQUEST, input='compensation', node=nodes)
        elif what == 'stop':
            rig.time += 10.0
        else:
            rig.bench.request('deactivate')
            rig.bench.request('activate')

    def cycle(self):
        """Let a cycle pass, and hold what must be true in each."""
        rig = self.rig
        before = rig.applied.copy()
        rig.run(CYCLE)
        self.fed += CYCLE
        assert np.abs(rig.applied).max() <= 60 * MICRON + SCALE
        assert np.abs(rig.applied - before).max() <= STEP
        ramp = 60 * MICRON / SLEW
        if self.fed > self.VALIDITY + 0.5 + self.ADOPTED + ramp + 0.5:
            assert np.abs(rig.applied).max() < 1e-15  # the rounding of its sums
        del rig.path[:], rig.on[:], rig.bench.emitted[:-50]

    def recover(self):
        """Let an honest owner come back, who starts from the read-back."""
        rig = self.rig
        rig.bench.request(REQUEST, input='compensation', node=[])
        rig.bench.clock_step(0.0, rig.time)
        for _ in range(round(8.0 / CYCLE)):
            self.cycle()
        wanted = self.random.integers(-50, 51, 3)
        rig.command(wanted, epoch=rig.last.epoch + 1)
        self.fed = 0.0
        for _ in range(round(1.9 / CYCLE)):
            self.cycle()
        assert rig.last.status == OffsetStatus.FOLLOWING, rig.last
        assert rig.at(wanted)


@pytest.mark.parametrize(
    ('seed', 'rounds'),
    [(0, 10), *(pytest.param(seed, 330, marks=pytest.mark.qualify) for seed in (1, 2))],
)
def test_whatever_strangers_say_the_machine_side_keeps_its_bounds(seed, rounds):
    """A round is some 1,500 cycles; those of `make qualify` make a million."""
    strangers = Strangers(seed)
    for _ in range(rounds):
        for _ in range(500):
            if strangers.random.random() < 0.05:
                strangers.happen()
            strangers.cycle()
        strangers.recover()


def test_stamps_stay_those_of_the_clock():
    rig = settled()
    rig.set_clock(-HOUR)
    rig.bench.emitted.clear()
    rig.run(1.0)
    stamps = [item.record.stamp for item in rig.bench.emitted]
    assert all(abs(stamp - nanoseconds(rig.time)) <= SECOND for stamp in stamps)


def test_simulated_time_may_run_at_any_speed():
    rig = Rig()
    rig.bridge.in_simulated_time()
    rig.run(0.2)
    rig.command((30, 0, 0))
    rig.time += 10.0
    rig.run(CYCLE)
    assert rig.bridge.orders.counts[0] * SCALE == pytest.approx(30 * MICRON)

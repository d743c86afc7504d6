# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The bridge to a control that takes lines, against the program of the guide, cycle by cycle."""

import numpy as np
import pytest
from benches.line_control import LineControl
from benches.line_rig import CYCLE, SLEW, TRAVEL, Rig, settled
from hypothesis import given, settings
from hypothesis import strategies as st

from fuzzycnc_ros.core.inputs.lines import Travel
from fuzzycnc_ros.core.inputs.offset_input import OffsetStatus


def test_inactive_it_writes_nothing():
    rig = Rig(active=False)
    rig.run(3.0)
    rig.command((10, 0))
    rig.run(1.0)
    assert rig.bridge.orders is None
    assert (rig.last.status, rig.last.reason) == (OffsetStatus.IDLE, '')
    assert not rig.sets
    assert not rig.allowed


def test_follows_at_the_slew_limit_and_says_so():
    rig = settled()
    assert rig.allowed
    assert rig.largest_way <= SLEW * (1.0 + 3 * CYCLE)
    assert rig.last.epoch == 1
    assert not rig.last.reason


def test_line_is_handed_over_and_follows_the_axis():
    rig = settled((0, 0))
    rig.command((10, 5), slope=(1e-4, 0), reference=(0.1, 0))
    rig.run(8.0)
    newest = rig.sets[-1].lines
    np.testing.assert_allclose(newest.offset, [10e-6, 5e-6], atol=1e-15)
    np.testing.assert_allclose(newest.slope, [1e-4, 0.0], atol=1e-15)
    np.testing.assert_allclose(newest.reference_position, [0.1, 0.0])
    rig.control.position = np.array([0.3, 0.0])
    rig.run(3.0)
    assert rig.at((30, 5))
    np.testing.assert_allclose(rig.last.slope, [1e-4, 0.0], atol=1e-15)
    np.testing.assert_allclose(rig.last.position, [0.3, 0.0])


def test_a_line_moves_nowhere_on_the_travel_faster_than_the_slew_limit():
    rig = settled((0, 0))
    rig.command((40, 0), slope=(1e-4, 0), reference=(0.3, 0))
    rig.run(10.0)
    rig.command((-40, 0), slope=(-1e-4, 0), reference=(0.0, 0))
    rig.run(10.0)
    for place in np.linspace(TRAVEL.low[0], TRAVEL.high[0], 7):
        offsets = [s.lines.at(np.array([place, 0.0]))[0] for s in rig.sets]
        # A set that waits for its acknowledgement is two cycles behind.
        assert np.abs(np.diff(offsets)).max() <= 3 * SLEW * CYCLE + 1e-12
        assert np.abs(offsets).max() <= 60e-6 + 1e-12


def test_line_is_cut_where_it_leaves_the_limit():
    rig = settled((0, 0))
    rig.command((50, 0), slope=(1e-4, 0), reference=(0, 0))
    rig.run(10.0)
    ends = TRAVEL.ends(rig.sets[-1].lines)
    np.testing.assert_allclose(ends[[0, 2]], [30e-6, 60e-6], atol=1e-12)
    assert rig.last.at_limit.tolist() == [True, False]
    assert 'cut at the limit of X 60.00 um' in rig.last.reason


def test_the_smaller_limit_counts():
    rig = settled((0, 0))
    rig.control.limit = np.array([60e-6, 15e-6])
    rig.run(0.2)
    rig.command((10, 40))
    rig.run(5.0)
    assert rig.at((10, 15))
    assert rig.sets[-1].lines.offset[1] == pytest.approx(15e-6)
    assert rig.last.at_limit.tolist() == [False, True]
    assert 'cut at the limit of Z 15.00 um' in rig.last.reason
    rig.command((10, 5))
    rig.run(0.5)
    assert rig.control.applied[1] < 15e-6 - 1e-7


def test_slew_limit_of_the_control_counts_if_it_is_smaller():
    control = LineControl()
    control.slew = 2e-6
    rig = Rig(control)
    rig.run(2.0)
    rig.command((20, 0))
    rig.run(12.0)
    assert rig.at((20, 0))
    offsets = [item.lines.offset[0] for item in rig.sets]
    assert np.abs(np.diff(offsets)).max() <= 3 * 2e-6 * CYCLE + 1e-12


def test_expired_command_goes_to_zero():
    rig = settled()
    rig.command((10, -20), valid=1.0)
    rig.run(5.0)
    assert rig.last.status == OffsetStatus.EXPIRED
    assert rig.at((0, 0))


@pytest.mark.parametrize(
    ('what', 'text'),
    [
        ('on', 'machine is off'),
        ('homed', 'not homed'),
        ('allowed', 'the control does not allow offsets'),
    ],
)
def test_nothing_while_the_control_forbids_it(what, text):
    rig = settled()
    setattr(rig.control, what, False)
    rig.run(5.0)
    assert rig.last.status == OffsetStatus.REFUSED
    assert text in rig.last.reason
    assert not rig.allowed
    assert rig.at((0, 0))
    rig.command((40, 40))
    rig.run(1.0)
    setattr(rig.control, what, True)
    rig.run(2.0)
    assert rig.at((0, 0))
    assert rig.allowed
    rig.command((5, 5))
    rig.run(2.0)
    assert rig.at((5, 5))


def test_limit_of_zero_is_refused():
    rig = Rig(active=False)
    rig.control.limit = np.array([60e-6, 0.0])
    rig.run(0.2)
    assert 'takes no offset on Z' in rig.bridge.refusal()


def test_slope_where_there_is_none_is_refused():
    rig = settled()
    rig.command((0, 0), slope=(0, 1e-5))
    rig.run(1.0)
    assert rig.last.status == OffsetStatus.REFUSED
    assert 'slope: the control takes none on Z' in rig.last.reason
    assert rig.at((10, -20))
    rig.command((0, 0))
    rig.run(4.0)
    assert rig.at((0, 0))
    assert not rig.last.reason


def test_unknown_axes_are_refused():
    rig = settled()
    rig.command((1, 1), axis=('X', 'Y'))
    rig.run(0.5)
    assert 'axis: expected X, Z but found Y' in rig.last.reason
    assert rig.at((10, -20))


def test_stale_and_old_owners_are_refused():
    rig = settled()
    rig.command((50, 50), valid=-1.0)
    rig.run(1.0)
    assert 'stale' in rig.last.reason
    assert rig.at((10, -20))
    rig.command((20, 20), epoch=5)
    rig.run(6.0)
    rig.command((0, 0), epoch=2)
    rig.run(2.0)
    assert rig.last.status == OffsetStatus.REFUSED
    assert rig.at((20, 20))


def test_control_that_does_not_go_there_is_told():
    rig = settled()
    rig.control.stuck = True
    rig.command((30, -20))
    rig.run(8.0)
    assert 'the control stays at X 10.00 um instead of X 30.00 um' in rig.last.reason


@given(
    st.lists(st.floats(-60e-6, 60e-6), min_size=4, max_size=4),
    st.lists(st.floats(-1.0, 1.0), min_size=2, max_size=2),
)
def test_ends_and_lines_are_the_same_thing(ends, reference):
    travel = Travel(low=np.array([-0.2, -0.5]), high=np.array([0.3, 0.5]))
    ends, reference = np.array(ends), np.array(reference)
    lines = travel.lines(ends, reference)
    np.testing.assert_allclose(travel.ends(lines), ends, atol=1e-15)
    np.testing.assert_allclose(lines.reference_position, reference)


EVENTS = st.sampled_from(
    ['command', 'off', 'on', 'freeze', 'thaw', 'kill', 'restart', 'limit', 'deactivate', 'other']
)


@settings(max_examples=15, deadline=None)
@given(st.lists(st.tuples(EVENTS, st.integers(-60, 60)), max_size=12))
def test_whatever_happens_it_never_steps_and_comes_back(events):
    rig = Rig()
    rig.run(1.5)
    killed = False
    for event, number in events:
        if event == 'command':
            rig.command((number, -number), slope=(1e-6 * number, 0))
        elif event in ('off', 'on'):
            rig.control.on = event == 'on'
        elif event in ('freeze', 'thaw'):
            rig.control.frozen = event == 'freeze'
        elif event == 'limit':
            rig.control.limit = np.full(2, 1e-6 * (abs(number) + 1))
        elif event == 'kill':
            killed = True
        elif event == 'restart':
            rig.restart()
            killed = False
        elif event == 'deactivate':
            rig.bench.request('deactivate')
        elif event == 'other':
            rig.control.sequence = 1 + abs(number)
        (rig.silence if killed else rig.run)(1.0)
    assert rig.largest_step <= rig.control.slew * CYCLE + 1e-12
    rig.control.on, rig.control.frozen = True, False
    rig.control.limit = np.full(2, 60e-6)
    rig.restart()
    rig.run(15.0)
    rig.command((7, 7), epoch=9)
    rig.run(15.0)
    assert rig.at((7, 7)), rig.last

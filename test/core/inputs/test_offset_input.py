# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fuzzycnc_ros.core.inputs.offset_input import (
    OffsetAnswer,
    OffsetInput,
    OffsetInputConfig,
    OffsetStatus,
)

SECOND = 1_000_000_000
CONFIG = OffsetInputConfig(offset_max=60e-6, slew_max=5e-6)


def offset_input(**changes):
    return OffsetInput(['Y', 'Z'], OffsetInputConfig(**changes) if changes else CONFIG)


def send(machine, offset=(8e-6, 4e-6), epoch=1, stamp=0.0, valid=10.0, **rest):
    return machine.command(
        epoch,
        rest.pop('axis', ['Y', 'Z']),
        offset,
        stamp=round(stamp * SECOND),
        valid_until=round(valid * SECOND),
        **rest,
    )


def advance(machine, seconds, position=None):
    return machine.advance(round(seconds * SECOND), position)


def test_axes_must_be_named_once():
    for axes in ([], ['Y', 'Y']):
        with pytest.raises(ValueError, match='axes'):
            OffsetInput(axes)


def test_time_does_not_go_back_and_positions_fit():
    machine = offset_input()
    send(machine)
    advance(machine, 1.0)
    before = machine.applied
    with pytest.raises(ValueError, match='time: expected 1000000000 ns or later'):
        advance(machine, 0.5)
    with pytest.raises(ValueError, match='one value per axis Y, Z'):
        advance(machine, 2.0, [0.0])
    assert machine.time == SECOND
    np.testing.assert_array_equal(machine.applied, before)


def test_idle_until_the_first_command():
    machine = offset_input()
    assert machine.status is OffsetStatus.IDLE
    assert (machine.epoch, machine.owner, machine.reason) == (0, '', '')
    np.testing.assert_array_equal(advance(machine, 100.0), [0.0, 0.0])


def test_moves_at_the_slew_limit_and_stays():
    machine = offset_input()
    assert send(machine).accepted
    np.testing.assert_allclose(advance(machine, 0.5), [2.5e-6, 2.5e-6])
    np.testing.assert_allclose(advance(machine, 1.0), [5e-6, 4e-6])
    np.testing.assert_allclose(advance(machine, 2.0), [8e-6, 4e-6])
    assert machine.status is OffsetStatus.FOLLOWING
    assert machine.reason == ''


def test_expires_by_itself_and_ramps_to_zero():
    machine = offset_input()
    send(machine, valid=10.0)
    advance(machine, 9.999)
    np.testing.assert_allclose(advance(machine, 11.0), [3e-6, 0.0], atol=1e-15)
    assert machine.status is OffsetStatus.EXPIRED
    assert 'expired' in machine.reason
    np.testing.assert_array_equal(advance(machine, 12.0), [0.0, 0.0])


def test_expiry_inside_a_long_step_is_not_missed():
    machine = offset_input()
    send(machine, valid=2.0)
    np.testing.assert_allclose(advance(machine, 3.0), [3e-6, 0.0], atol=1e-15)


def test_command_takes_effect_at_its_stamp_and_the_one_before_meanwhile():
    machine = offset_input()
    send(machine, [5e-6, 0.0], valid=20.0)
    advance(machine, 2.0)
    assert send(machine, [0.0, 0.0], stamp=4.0, valid=20.0).accepted
    np.testing.assert_allclose(advance(machine, 3.0), [5e-6, 0.0])
    np.testing.assert_allclose(advance(machine, 4.5), [2.5e-6, 0.0])


def test_command_from_the_past_does_not_step():
    """A machine that was not advanced for a minute moves no further than since the stamp."""
    machine = offset_input()
    send(machine, stamp=4.0, valid=120.0)
    np.testing.assert_allclose(advance(machine, 4.5), [2.5e-6, 2.5e-6])


def test_axes_left_out_are_commanded_to_zero():
    machine = offset_input()
    send(machine, valid=20.0)
    advance(machine, 4.0)
    send(machine, [8e-6], axis=['Y'], stamp=4.0, valid=20.0)
    np.testing.assert_allclose(advance(machine, 8.0), [8e-6, 0.0])


def test_too_large_is_cut_and_flagged():
    machine = offset_input()
    answer = send(machine, [8e-6, -90e-6], valid=100.0)
    assert answer.accepted
    assert answer.reason == 'Z cut at the limit of 60 um'
    np.testing.assert_allclose(advance(machine, 50.0), [8e-6, -60e-6])
    assert machine.at_limit.tolist() == [False, True]
    assert machine.reason == answer.reason
    advance(machine, 101.0)
    assert machine.at_limit.tolist() == [False, False]


def test_slope_acts_on_the_distance_from_the_reference():
    machine = offset_input()
    send(machine, [1e-6, 0.0], slope=[1e-5, 1e-5], reference_position=[0.1, 0.0], valid=100.0)
    np.testing.assert_allclose(advance(machine, 5.0), [1e-6, 0.0])  # nothing known: no slope
    np.testing.assert_allclose(advance(machine, 10.0, [0.3, np.nan]), [3e-6, 0.0])
    np.testing.assert_allclose(advance(machine, 15.0, [np.nan, 0.2]), [3e-6, 2e-6])


def test_along_its_slope_an_offset_goes_with_the_axis_and_not_at_the_slew_limit():
    machine = offset_input(slew_max=0.1e-6, validity_max=1000.0)
    line = {'slope': [2e-4, 0.0], 'reference_position': [0.1, 0.0]}
    send(machine, [10e-6, 0.0], valid=1000.0, **line)
    advance(machine, 0.0, [0.1, 0.0])
    assert advance(machine, 200.0)[0] == pytest.approx(10e-6)
    assert advance(machine, 201.0, [0.3, 0.0])[0] == pytest.approx(50e-6)
    # At the limit it waits for the axis to come back, and the rest of the line is kept.
    assert advance(machine, 201.5, [0.5, 0.0])[0] == pytest.approx(60e-6)
    assert advance(machine, 202.0, [0.4, 0.0])[0] == pytest.approx(60e-6)
    assert advance(machine, 202.5, [0.2, 0.0])[0] == pytest.approx(30e-6)
    # Another line at a place is a change at that place, however steep it is.
    line['slope'] = [4e-4, 0.0]
    send(machine, [10e-6, 0.0], stamp=202.5, valid=1000.0, **line)
    assert advance(machine, 203.5)[0] == pytest.approx(30.1e-6)


def test_a_position_that_leaps_moves_nothing_at_once():
    machine = offset_input(slew_max=0.1e-6, speed_max=0.2)
    send(machine, slope=[2e-4, 0.0], offset=[0.0, 0.0], valid=1000.0)
    advance(machine, 1.0, [0.0, 0.0])
    assert advance(machine, 2.0, [0.21, 0.0])[0] == pytest.approx(0.1e-6)
    assert advance(machine, 3.0, [0.02, 0.0])[0] == pytest.approx(0.1e-6 - 38e-6 + 0.1e-6)


def test_a_slope_that_is_too_steep_is_cut():
    machine = offset_input(slope_max=1e-4)
    answer = send(machine, [0.0, 0.0], slope=[3e-4, -3e-4], valid=1000.0)
    assert answer == OffsetAnswer(True, 'slope of Y, Z cut at 100 um/m')
    advance(machine, 1.0, [0.0, 0.0])
    np.testing.assert_allclose(advance(machine, 2.0, [0.1, 0.2]), [10e-6, -20e-6])


@pytest.mark.parametrize(
    ('changes', 'message'),
    [
        ({'offset': [np.nan, 0.0]}, 'offset: expected finite'),
        ({'offset': [0.0, np.inf]}, 'offset: expected finite'),
        ({'offset': [8.0, 4.0]}, 'SI units'),
        ({'slope': [np.nan, 0.0]}, 'slope: expected finite'),
        ({'reference_position': [0.0, -np.inf]}, 'reference_position: expected finite'),
        ({'offset': [1e-6]}, 'offset: expected 2 values'),
        ({'axis': ['Y', 'Q']}, 'axis: expected Y, Z but found Q'),
        ({'axis': ['Y', 'Y']}, 'each name once'),
        ({'epoch': 2}, 'epoch 3 or higher but found 2'),
        ({'owner': 'other'}, 'two sources'),
        ({'stamp': 0.5}, 'none older'),
        ({'valid': 1.0}, 'stale'),
        ({'valid': 2.0}, 'stale'),
        ({'stamp': 60.0, 'valid': 70.0}, 'same clock'),
    ],
)
def test_refused_commands_change_nothing(changes, message):
    machine = offset_input()
    good = {'epoch': 3, 'owner': 'compensator', 'stamp': 1.0, 'valid': 50.0}
    send(machine, **good)
    advance(machine, 2.0)
    answer = send(machine, **{**good, 'stamp': 2.0, **changes})
    assert not answer.accepted
    assert message in answer.reason
    assert machine.status is OffsetStatus.REFUSED
    assert machine.reason == answer.reason
    assert (machine.epoch, machine.owner) == (3, 'compensator')
    np.testing.assert_allclose(advance(machine, 4.0), [8e-6, 4e-6])  # the old one is followed
    assert send(machine, **{**good, 'stamp': 4.0}).accepted
    assert machine.status is OffsetStatus.FOLLOWING


def test_epoch_zero_is_no_owner():
    assert 'epoch 1 or higher' in send(offset_input(), epoch=0).reason


def test_higher_epoch_takes_over_even_with_an_older_stamp():
    machine = offset_input()
    send(machine, stamp=1.0, owner='a')
    advance(machine, 2.0)
    assert send(machine, [0.0, 0.0], epoch=2, stamp=0.5, owner='b').accepted
    assert (machine.epoch, machine.owner) == (2, 'b')
    assert not send(machine, epoch=1, stamp=2.0, owner='a').accepted


def test_owner_outlives_the_expiry_of_its_command():
    machine = offset_input()
    send(machine, epoch=5)
    advance(machine, 20.0)
    assert not send(machine, epoch=4, stamp=20.0, valid=30.0).accepted
    assert send(machine, epoch=5, stamp=20.0, valid=30.0).accepted


def test_machine_that_does_not_allow_offsets_ramps_to_zero():
    machine = offset_input()
    send(machine, valid=100.0)
    advance(machine, 4.0)
    machine.allow(False, 'drives off')
    assert machine.status is OffsetStatus.REFUSED
    np.testing.assert_allclose(advance(machine, 5.0), [3e-6, 0.0], atol=1e-15)
    answer = send(machine, stamp=5.0, valid=100.0)
    assert not answer.accepted
    assert 'drives off' in answer.reason
    np.testing.assert_array_equal(advance(machine, 6.0), [0.0, 0.0])
    machine.allow(True)
    assert machine.status is OffsetStatus.EXPIRED  # the old command does not come back
    assert 'fresh command' in machine.reason
    np.testing.assert_array_equal(advance(machine, 10.0), [0.0, 0.0])
    assert send(machine, stamp=10.0, valid=100.0).accepted
    assert machine.reason == ''


# Laws, over any sequence of commands, refusals, state changes and steps.

number = st.one_of(st.floats(-100e-6, 100e-6), st.floats(allow_nan=True, allow_infinity=True))
pair = st.tuples(number, number)
event = st.one_of(
    st.tuples(
        st.just('command'),
        st.integers(0, 3),  # epoch
        pair,  # offset
        st.one_of(st.none(), pair),  # slope
        st.integers(-3 * SECOND, 6 * SECOND),  # stamp, from now
        st.integers(-2 * SECOND, 20 * SECOND),  # validity, from the stamp
        st.sampled_from(['a', 'b']),
    ),
    st.tuples(st.just('advance'), st.integers(0, 15 * SECOND), st.one_of(st.none(), pair)),
    st.tuples(st.just('allow'), st.booleans()),
)


def play(machine, events):
    """Do the events; yield (time step [ns], offsets before, offsets after) of each."""
    for kind, *rest in events:
        before, since = machine.applied, machine.time
        if kind == 'command':
            epoch, offset, slope, ahead, validity, owner = rest
            stamp = machine.time + ahead
            machine.command(
                epoch,
                ['Y', 'Z'],
                offset,
                slope,
                stamp=stamp,
                valid_until=stamp + validity,
                owner=owner,
            )
        elif kind == 'advance':
            machine.advance(machine.time + rest[0], rest[1])
        else:
            machine.allow(rest[0])
        yield machine.time - since, before, machine.applied


@given(events=st.lists(event, max_size=30))
@settings(max_examples=150, deadline=None)
def test_never_beyond_the_limit_never_faster_never_nan(events):
    machine = offset_input()
    per_second = CONFIG.slew_max + CONFIG.slope_max * CONFIG.speed_max
    for step, before, after in play(machine, events):
        assert np.isfinite(after).all()
        assert np.all(np.abs(after) <= CONFIG.offset_max)
        reach = per_second * 1e-9 * step
        assert np.all(np.abs(after - before) <= reach * (1 + 1e-9) + 1e-18)


@pytest.mark.qualify
def test_lines_move_no_place_beyond_the_limit_or_faster_than_slew_and_motion_allow():
    random, machine = np.random.default_rng(11), offset_input(slope_max=4e-4, speed_max=0.5)
    position, step, epoch = np.zeros(2), 10_000_000, 1
    for number in range(1_000_000):
        if number % 37 == 0:
            epoch += int(random.random() < 0.1)
            machine.command(
                epoch,
                ['Y', 'Z'],
                random.normal(0.0, 50e-6, 2),
                random.normal(0.0, 3e-4, 2),
                random.uniform(-0.5, 0.5, 2),
                stamp=machine.time,
                valid_until=machine.time + int(random.integers(1, 3_000_000_000)),
            )
        moved = random.uniform(-0.5, 0.5, 2) * 1e-9 * step
        if random.random() < 1e-3:
            moved = random.uniform(-1.0, 1.0, 2)  # a leap
        position = position + moved
        before = machine.applied
        after = machine.advance(machine.time + step, position)
        honest = np.abs(moved) <= 0.5e-9 * step
        reach = 5e-6 * 1e-9 * step + 4e-4 * np.where(honest, np.abs(moved), 0.0)
        assert np.all(np.abs(after - before) <= reach * (1 + 1e-9) + 1e-15)
        assert np.all(np.abs(after) <= 60e-6)


@given(events=st.lists(event, max_size=30))
@settings(max_examples=100, deadline=None)
def test_zero_after_the_last_expiry(events):
    machine = offset_input()
    latest = 0
    for kind, *rest in events:
        if kind == 'command':
            latest = max(latest, machine.time + rest[3] + rest[4])
        list(play(machine, [(kind, *rest)]))
    ramp = round(CONFIG.offset_max / CONFIG.slew_max * SECOND) + 1
    machine.advance(max(machine.time, latest) + ramp)
    np.testing.assert_array_equal(machine.applied, [0.0, 0.0])


@given(
    first=st.tuples(st.floats(-80e-6, 80e-6), st.floats(-80e-6, 80e-6)),
    second=st.tuples(st.floats(-80e-6, 80e-6), st.floats(-80e-6, 80e-6)),
    cuts=st.lists(st.integers(1, 5 * SECOND), min_size=1, max_size=10),
)
@settings(max_examples=60, deadline=None)
def test_offsets_do_not_depend_on_how_often_the_machine_is_advanced(first, second, cuts):
    whole, cut = offset_input(), offset_input()
    for machine in (whole, cut):
        send(machine, first, stamp=0.0, valid=9.0)
        machine.advance(SECOND)
        send(machine, second, stamp=4.0, valid=11.0)
    for duration in cuts:
        cut.advance(cut.time + duration)
    whole.advance(cut.time)
    np.testing.assert_allclose(cut.applied, whole.applied, atol=1e-15)

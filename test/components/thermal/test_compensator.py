# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Compensator: limits that hold whatever comes in, holding, ramping, owners, lifecycle."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from benches.component_bench import Bench, applied, machine_state, thermal_error
from hypothesis import given, settings
from hypothesis import strategies as st

from fuzzycnc_ros.components.thermal.compensator import Compensator, CompensatorConfig
from fuzzycnc_ros.runtime.enums import CompensationState, Reason
from fuzzycnc_ros.runtime.records import Compensation, nanoseconds

MICRON = 1e-6
FAST = CompensatorConfig(slew_max=1 * MICRON, ramp_rate=0.5 * MICRON)
STATES = CompensationState


def active_bench(config: CompensatorConfig | None = None, offset=(0.0, 0.0), epoch: int = 0):
    """Return a compensator that was activated and knows the read-back."""
    bench = Bench(Compensator(config))
    bench.push('machine_state', machine_state(1.0))
    bench.give('compensation_applied', applied(1.0, offset, epoch))
    bench.until(1.0)
    assert bench.request('activate').success
    return bench


def follow(bench: Bench, time: float, error=(0.0, 0.0), **changes) -> Compensation:
    """Give a thermal error with a fresh machine state; return the newest command."""
    bench.push('machine_state', machine_state(time))
    bench.give('thermal_error', thermal_error(time, error, **changes))
    return bench.records('compensation')[-1]


def test_follows_minus_the_error():
    bench = active_bench(FAST)
    for time in range(60, 601, 60):
        command = follow(bench, time, (10 * MICRON, -7 * MICRON))
    np.testing.assert_array_equal(command.offset, [-10 * MICRON, 7 * MICRON])
    assert command.state == STATES.ACTIVE
    assert not command.slewing.any()
    assert not command.at_limit.any()
    assert command.valid_until == command.stamp + nanoseconds(FAST.validity)
    assert command.axis == ('Y', 'Z')
    assert command.frame_id == 'mill/machine'
    np.testing.assert_array_equal(command.slope, 0.0)


def test_error_is_cut_at_the_size_limit_and_flagged():
    bench = active_bench(FAST)
    for time in range(60, 1201, 60):
        command = follow(bench, time, (80 * MICRON, 10 * MICRON))
    np.testing.assert_allclose(command.offset, [-50 * MICRON, -10 * MICRON])
    assert command.at_limit.tolist() == [True, False]
    assert 'WARN size limit: size limit active on Y' in bench.health()


def test_a_large_error_is_approached_at_the_slew_limit():
    bench = active_bench()
    first = follow(bench, 60.0, (40 * MICRON, 0.0))
    commands = [first, *(item.record for item in bench.until(180.0))]
    for before, after in pairwise(commands):
        elapsed = 1e-9 * (after.stamp - before.stamp)
        assert elapsed == pytest.approx(10.0)
        np.testing.assert_allclose(after.offset[0] - before.offset[0], -0.2 * MICRON * elapsed)
    assert commands[-1].slewing.tolist() == [True, False]


EVENTS = st.lists(
    st.tuples(
        st.sampled_from(
            [
                'error',
                'error',
                'error',
                'invalid',
                'outside',
                'nan',
                'silence',
                'forbidden',
                'lost',
            ]
        ),
        st.floats(min_value=0.001, max_value=400.0),
        st.tuples(*[st.floats(min_value=-200e-6, max_value=200e-6)] * 2),
    ),
    max_size=25,
)
CHANGES = {
    'invalid': {'valid': False, 'reason': int(Reason.SENSOR_LOST)},
    'outside': {'in_domain': False},
    'nan': {'error': np.array([np.nan, 1e-6])},
    'lost': {'axis': ('Y',), 'error': np.zeros(1)},
}


@settings(max_examples=150, deadline=None)
@given(EVENTS, st.tuples(*[st.floats(min_value=-50e-6, max_value=50e-6)] * 2), st.booleans())
def test_limits_hold_whatever_comes_in(events, offset, deactivates):
    """Size, slew, finite numbers, validity and order, from any read-back on."""
    config = CompensatorConfig()
    bench = active_bench(config, offset, epoch=3)
    time = 1.0
    for kind, step, error in events:
        time += step
        if kind != 'silence':
            allowed = kind != 'forbidden'
            bench.push('machine_state', machine_state(time, offsets_allowed=allowed))
            changes = CHANGES.get(kind, {})
            bench.give('thermal_error', thermal_error(time, **({'error': error} | changes)))
        else:
            bench.until(time)
    if deactivates:
        bench.request('deactivate')
    # 50 um at the ramp rate of 0.1 um/s, after staleness and hold time, with room to spare.
    bench.until(time + config.stale_after + config.hold_time + 800.0)

    last_stamp, last_offset = nanoseconds(1.0), np.array(offset)
    for command in bench.records('compensation'):
        assert np.isfinite(command.offset).all()
        assert (np.abs(command.offset) <= config.offset_max * (1 + 1e-12)).all()
        elapsed = 1e-9 * (command.stamp - last_stamp)
        assert elapsed >= 0.0
        allowed = config.slew_max * min(elapsed, config.period) + 1e-15
        assert (np.abs(command.offset - last_offset) <= allowed).all()
        assert command.valid_until == command.stamp + nanoseconds(config.validity)
        assert command.epoch == 4
        last_stamp, last_offset = command.stamp, command.offset
    commands = bench.records('compensation')
    if commands:
        np.testing.assert_array_equal(commands[-1].offset, 0.0)
        assert commands[-1].state in (STATES.EXPIRED, STATES.INACTIVE)
        assert bench.component.next_deadline is None


@settings(max_examples=50, deadline=None)
@given(EVENTS)
def test_machine_is_never_left_with_an_expired_command_while_offsets_are_in_force(events):
    """As long as an offset is not zero, the next command comes before the last one expires."""
    bench = active_bench()
    time = 1.0
    for kind, step, error in events:
        time += step
        bench.push('machine_state', machine_state(time))
        bench.give(
            'thermal_error', thermal_error(time, **({'error': error} | CHANGES.get(kind, {})))
        )
    bench.until(time + 2000.0)
    commands = bench.records('compensation')
    for before, after in pairwise(commands):
        if before.offset.any():
            assert after.stamp < before.valid_until


@pytest.mark.parametrize('stale_after', [60.0, 600.0, 3600.0])
def test_command_is_renewed_while_a_slow_error_is_awaited(stale_after):
    bench = active_bench(replace(FAST, stale_after=stale_after))
    follow(bench, 60.0, (5 * MICRON, 0.0))
    bench.until(60.0 + stale_after)
    commands = bench.records('compensation')
    gaps = np.diff([item.stamp for item in commands])
    assert (gaps < nanoseconds(FAST.validity)).all()
    assert commands[-1].stamp + nanoseconds(FAST.validity) > nanoseconds(60.0 + stale_after)


def test_silence_is_held_then_ramped_to_zero():
    config = FAST
    bench = active_bench(config)
    for time in (60.0, 120.0, 180.0):
        follow(bench, time, (20 * MICRON, 0.0))
    late = 180.0 + config.stale_after
    bench.until(late + 1.0)
    assert bench.records('compensation')[-1].state == STATES.HOLDING
    assert 'WARN state: holding: thermal error is late' in bench.health()
    bench.until(late + config.hold_time - 1.0)
    held = bench.records('compensation')[-1]
    assert held.state == STATES.HOLDING
    np.testing.assert_array_equal(held.offset, [-20 * MICRON, 0.0])

    bench.until(late + config.hold_time + 15.0)
    ramping = bench.records('compensation')[-1]
    assert ramping.state == STATES.RAMPING
    assert -20 * MICRON < ramping.offset[0] < 0.0
    assert 'ERROR state: ramping' in bench.health()

    bench.until(late + config.hold_time + 20 * MICRON / config.ramp_rate + 2 * config.period)
    last = bench.records('compensation')[-1]
    assert last.state == STATES.EXPIRED
    np.testing.assert_array_equal(last.offset, 0.0)
    count = len(bench.emitted)
    bench.until(1e5)
    assert len(bench.emitted) == count


@pytest.mark.parametrize(
    ('changes', 'reason'),
    [
        ({'valid': False, 'reason': 3, 'in_domain': False}, 'thermal error invalid: sensor lost'),
        ({'valid': False, 'reason': 200}, 'thermal error invalid: reason 200'),
        ({'in_domain': False}, 'outside what the model was trained on'),
        ({'error': np.array([np.inf, 0.0])}, 'error_max lets a model say, but found inf µm'),
        ({'error': np.array([0.0, np.nan])}, 'error_max lets a model say, but found nan µm'),
        ({'error': np.array([1.0, 0.0])}, 'error_max lets a model say, but found 1e+06 µm'),
        ({'error': np.array([0.0, -1e308])}, 'error_max lets a model say, but found -inf µm'),
        ({'error': np.array([201e-6, 0.0])}, 'error_max lets a model say, but found 201 µm'),
        ({'axis': ('Y', 'X')}, 'thermal error lacks axis Z'),
    ],
)
def test_unusable_error_is_held_at_once_and_says_why(changes, reason):
    bench = active_bench(FAST)
    good = follow(bench, 60.0, (5 * MICRON, 0.0))
    held = follow(bench, 120.0, **({'error': (30 * MICRON, 0.0)} | changes))
    assert held.state == STATES.HOLDING
    np.testing.assert_array_equal(held.offset, good.offset)
    assert reason in bench.health()
    again = follow(bench, 180.0, (5 * MICRON, 0.0))
    assert again.state == STATES.ACTIVE


@pytest.mark.parametrize(
    ('changes', 'reason'),
    [
        ({'offsets_allowed': False}, 'machine does not allow offsets'),
        ({'homed': False}, 'machine is not homed'),
    ],
)
def test_machine_that_forbids_offsets_is_obeyed(changes, reason):
    bench = active_bench(FAST)
    follow(bench, 60.0, (5 * MICRON, 0.0))
    for time in range(120, 1200, 60):
        bench.push('machine_state', machine_state(time, **changes))
        bench.give('thermal_error', thermal_error(time, (5 * MICRON, 0.0)))
        assert reason in bench.health()
    last = bench.records('compensation')[-1]
    assert last.state == STATES.EXPIRED
    np.testing.assert_array_equal(last.offset, 0.0)


def test_old_machine_state_is_no_permission():
    bench = active_bench(FAST)
    follow(bench, 60.0, (5 * MICRON, 0.0))
    bench.give('thermal_error', thermal_error(60.0 + 601.0, (5 * MICRON, 0.0)))
    assert 'no fresh machine_state' in bench.health()


def test_nothing_is_published_before_activation_and_read_back():
    bench = Bench(Compensator(FAST))
    follow_states = [machine_state(time) for time in (60.0, 120.0)]
    bench.push('machine_state', follow_states[0])
    bench.give('thermal_error', thermal_error(60.0, (5 * MICRON, 0.0)))
    assert bench.component.at_rest
    assert bench.request('activate').success
    bench.push('machine_state', follow_states[1])
    bench.give('thermal_error', thermal_error(120.0, (5 * MICRON, 0.0)))
    assert bench.emitted == []
    assert 'no finite read-back (compensation_applied)' in bench.health()
    bench.give('compensation_applied', applied(130.0))
    assert follow(bench, 180.0, (5 * MICRON, 0.0)).epoch == 1


def test_new_owner_starts_from_the_read_back_without_a_step():
    bench = active_bench(offset=(12 * MICRON, -3 * MICRON), epoch=7)
    command = follow(bench, 2.0, (0.0, 0.0))
    assert command.epoch == 8
    np.testing.assert_allclose(
        command.offset, [(12 - 0.2) * MICRON, (-3 + 0.2) * MICRON], rtol=0.0, atol=1e-15
    )


def test_read_back_after_activation_is_taken_over_too():
    bench = Bench(Compensator())
    bench.until(5.0)
    bench.request('activate')
    bench.give('compensation_applied', applied(10.0, (4 * MICRON, 0.0), 2))
    command = follow(bench, 11.0)
    assert command.epoch == 3
    assert command.offset[0] == pytest.approx(3.8 * MICRON)


def test_later_read_backs_do_not_move_a_running_owner():
    bench = active_bench(FAST)
    first = follow(bench, 60.0, (2 * MICRON, 0.0))
    bench.give('compensation_applied', applied(61.0, (40 * MICRON, 0.0), 1))
    second = follow(bench, 120.0, (2 * MICRON, 0.0))
    assert second.epoch == first.epoch
    np.testing.assert_array_equal(second.offset, first.offset)


def test_read_back_that_is_not_finite_is_not_taken_over():
    """NaN never leaves a component."""
    bench = active_bench(FAST, offset=(float('nan'), 0.0), epoch=1)
    bench.push('machine_state', machine_state(60.0))
    assert bench.give('thermal_error', thermal_error(60.0, (5 * MICRON, 0.0))) == []
    assert 'no finite read-back' in bench.health()
    bench.give('compensation_applied', applied(70.0, (0.0, 0.0), 1))
    assert np.isfinite(follow(bench, 120.0, (5 * MICRON, 0.0)).offset).all()


def test_refused_command_is_reported():
    bench = active_bench(FAST)
    follow(bench, 60.0, (2 * MICRON, 0.0))
    refusal = replace(applied(61.0, epoch=9), status=3, reason='expected epoch 9 or higher')
    bench.give('compensation_applied', refusal)
    assert 'ERROR read-back: refused by the machine: expected epoch 9 or higher' in bench.health()


def test_deactivation_ramps_to_zero_and_ends_inactive():
    bench = active_bench(FAST)
    follow(bench, 60.0, (10 * MICRON, -10 * MICRON))
    bench.until(80.0)
    answer = bench.request('deactivate')
    assert answer.success
    assert not bench.component.at_rest
    assert answer.emissions[0].record.state == STATES.RAMPING
    # what was wanted is no trouble
    assert bench.health() == 'OK state: ramping: deactivated'
    bench.until(80.0 + 10 * MICRON / FAST.ramp_rate + 2 * FAST.period)
    last = bench.records('compensation')[-1]
    assert last.state == STATES.INACTIVE
    np.testing.assert_array_equal(last.offset, 0.0)
    assert bench.component.at_rest
    assert bench.component.next_deadline is None


def test_error_is_ignored_after_deactivation():
    bench = active_bench(FAST)
    follow(bench, 60.0, (10 * MICRON, 0.0))
    bench.request('deactivate')
    for time in range(120, 600, 60):
        command = follow(bench, time, (40 * MICRON, 0.0))
    assert command.state == STATES.INACTIVE
    np.testing.assert_array_equal(command.offset, 0.0)


def test_impossible_requests_are_refused():
    bench = Bench(Compensator())
    assert not bench.request('deactivate').success
    assert bench.request('activate').success
    assert bench.request('activate').message == 'already active'
    answer = bench.request('dance')
    assert not answer.success
    assert 'knows no request dance' in answer.message


def test_reactivation_starts_from_what_is_in_force():
    bench = active_bench(FAST)
    follow(bench, 60.0, (10 * MICRON, 0.0))
    bench.until(80.0)
    bench.request('deactivate')
    bench.give('compensation_applied', applied(85.0, (-7 * MICRON, 0.0), 1))
    before = bench.records('compensation')[-1]
    assert bench.request('activate').success
    command = follow(bench, 86.0, (10 * MICRON, 0.0))
    assert command.epoch == before.epoch + 1
    assert abs(command.offset[0] + 7 * MICRON) <= FAST.slew_max * 1.0 + 1e-15


def test_new_limits_act_within_the_slew_limit():
    bench = active_bench(FAST)
    for time in (60.0, 120.0, 180.0):
        follow(bench, time, (20 * MICRON, 0.0))
    bench.component.reconfigure(replace(FAST, offset_max=5 * MICRON))
    first = follow(bench, 190.0, (20 * MICRON, 0.0))
    assert first.offset[0] == pytest.approx(-10 * MICRON)
    assert first.at_limit.tolist() == [True, False]
    bench.until(240.0)
    assert bench.records('compensation')[-1].offset[0] == pytest.approx(-5 * MICRON)


@pytest.mark.parametrize(
    ('changes', 'message'),
    [
        ({'axes': ('Y', 'Q')}, r'axes: expected distinct names of X, Y, .* but found Y, Q'),
        ({'axes': ('Y', 'Y')}, r'axes: expected distinct names'),
        ({'axes': ()}, r'axes: .* but found none'),
        ({'ramp_rate': 1e-6}, r'ramp_rate = 1e-06 m/s must not exceed slew_max = 2e-07 m/s'),
        ({'validity': 5.0}, r'validity = 5\.0 s must not be shorter than period = 10\.0 s'),
    ],
)
def test_contradicting_parameters_are_refused(changes, message):
    with pytest.raises(ValueError, match=message):
        Compensator(CompensatorConfig(**changes))


def test_refused_change_leaves_the_limits_in_force():
    component = Compensator()
    with pytest.raises(ValueError, match='must not exceed'):
        component.reconfigure(replace(CompensatorConfig(), slew_max=1e-9))
    assert component.configuration == CompensatorConfig()


def test_first_channel_speaks_for_an_axis_with_several():
    bench = active_bench(FAST)
    for time in (60.0, 120.0):
        command = follow(
            bench,
            time,
            axis=('Y', 'Y', 'Z'),
            channel=('y1', 'y2', 'z'),
            error=np.array([1.0, 9.0, 3.0]) * MICRON,
            standard_deviation=np.full(3, MICRON),
        )
    np.testing.assert_array_equal(command.offset, [-1 * MICRON, -3 * MICRON])


def test_silent_machine_side_is_said_with_what_stood():
    """The compensator is who still speaks when a bridge was killed."""
    silence = active_bench().component.silence
    name = 'compensation_applied'
    told = silence(name, applied(70.0, (0.0, -12.34 * MICRON), 1))
    assert told.startswith('Z -12.34 um stood then, which nobody may own now')
    assert silence(name, applied(80.0, (3e-10, 0.0), 1)) == ''  # rounding of a controller
    assert silence('machine_state', machine_state(80.0)) == ''

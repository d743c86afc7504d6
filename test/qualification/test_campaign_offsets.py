# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""What scenarios of thermal compensation are judged by."""

from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip('rclpy')

from campaign.evidence import Recorded
from campaign.offset_verdict import streams
from campaign.rogue_nodes import STRANGER
from campaign.scenario import BY_COMPENSATOR, BY_MACHINE, MACHINE, Ends
from campaign.table import result_tables
from campaign.verdict import Verdict, judge
from fault_records import SCENARIO, TICK, applied, command, error, evidence_of, judged

from fuzzycnc_ros.core.inputs.offset_input import OffsetStatus
from fuzzycnc_ros.runtime.enums import CompensationState
from fuzzycnc_ros.runtime.records import SECOND


def test_a_graph_that_follows_is_safe():
    verdict = judged()
    assert verdict.safe, verdict.why
    assert verdict.told == 'active'
    assert verdict.worst_offset_um == 5.0
    assert (verdict.worst_step_um, verdict.time_to_safe_s, verdict.lost_messages) == (0, 0, 0)


@pytest.mark.parametrize(
    ('topic', 'make', 'why'),
    [
        ('compensation_applied', lambda t: applied(t, 61.0), 'exceeds the clamp'),
        ('compensation_applied', lambda t: applied(t, np.nan), 'not finite'),
        ('compensation_applied', lambda t: applied(t, 12.0), 'applied offset moved by 7.00 um'),
        ('compensation', lambda t: command(t, 50.5), 'exceeds the clamp'),
        ('compensation', lambda t: command(t, np.nan), 'told offset is not finite'),
        ('compensation', lambda t: command(t, 7.5), 'told offset moved by 2.50 um'),
    ],
)
def test_one_sample_beyond_a_limit_is_unsafe(topic, make, why):
    verdict = judged(lambda tick: {topic: make(tick * TICK)} if tick == 30 else {})
    assert not verdict.safe
    assert any(why in text for text in verdict.why), verdict.why


def test_a_step_before_the_window_is_none_of_its_business():
    verdict = judged(
        lambda tick: {'compensation_applied': applied(tick * TICK, 40.0)} if tick == 1 else {}
    )
    assert verdict.safe, verdict.why


@pytest.mark.parametrize(
    ('change', 'stated'),
    [
        (
            lambda tick: {'compensation': command(tick * TICK, state=CompensationState.HOLDING)},
            BY_COMPENSATOR,
        ),
        (lambda tick: {'thermal_error': error(tick * TICK, valid=False)}, BY_COMPENSATOR),
        (
            lambda tick: {
                'compensation_applied': applied(tick * TICK, status=OffsetStatus.EXPIRED)
            },
            BY_MACHINE,
        ),
    ],
    ids=['holding', 'invalid error', 'expired'],
)
@pytest.mark.parametrize('scenario', [SCENARIO, replace(SCENARIO, stated=BY_COMPENSATOR)])
def test_offsets_that_nothing_fresh_stands_behind_are_unsafe_once_the_time_is_over(
    scenario, change, stated
):
    count = int(stated // 12)
    ticks, longer = range(10, 10 + count), range(10, 30 + count)
    within = judged(lambda tick: change(tick) if tick in ticks else {}, scenario, ticks=150)
    assert within.safe, within.why
    assert within.time_to_safe_s <= scenario.stated
    over = judged(lambda tick: change(tick) if tick in longer else {}, scenario, ticks=150)
    assert not over.safe
    assert 'out of a safe state' in over.why[0]


def test_the_time_to_safe_is_that_of_the_side_which_has_to_make_it_safe():
    def change(tick):
        return {
            'compensation': command(tick * TICK, state=CompensationState.HOLDING),
            'compensation_applied': applied(
                tick * TICK,
                status=OffsetStatus.EXPIRED if tick in range(20, 25) else OffsetStatus.FOLLOWING,
            ),
        }

    held = judged(lambda tick: change(tick) if tick in range(15, 30) else {})
    assert (
        held.time_to_safe_s == 5 * 12.0
    )  # from the last tick that follows to the last that does not
    both = replace(SCENARIO, stated=BY_COMPENSATOR)
    held = judged(lambda tick: change(tick) if tick in range(15, 30) else {}, both)
    assert held.time_to_safe_s == 15 * 12.0


def test_nothing_is_known_of_a_time_without_a_recorder():
    def change(tick):
        later = 0 if tick < 30 else 3000 * SECOND
        stamp = tick * TICK + later
        status = OffsetStatus.EXPIRED if tick == 30 else OffsetStatus.FOLLOWING
        return {
            'thermal_error': error(stamp),
            'compensation': command(stamp),
            'compensation_applied': applied(stamp, status=status),
        }

    assert judged(change).time_to_safe_s == 3012.0
    assert judged(change, replace(SCENARIO, loses=True)).time_to_safe_s == 0.0


def test_the_end_must_be_what_is_stated():
    at_zero = replace(SCENARIO, ends=Ends.ZERO)
    assert 'not at zero' in judged(scenario=at_zero).why[0]

    def ramp(tick):
        left = max(0.0, 5.0 - max(0, tick - 20))
        return {'compensation_applied': applied(tick * TICK, left)}

    assert judged(ramp, at_zero).safe
    assert 'does not follow again' in judged(ramp).why[0]
    assert judged(ramp, replace(SCENARIO, ends=Ends.EITHER)).safe


def test_a_late_error_at_the_very_end_is_none_of_the_fault():
    def late(tick):
        return {'compensation': command(tick * TICK, state=CompensationState.HOLDING)}

    assert judged(lambda tick: late(tick) if tick > 57 else {}).safe
    often = judged(lambda tick: late(tick) if tick % 5 else {})
    assert 'does not follow again' in often.why[0]


def test_messages_that_are_missing_are_unsafe_unless_destroyed():
    found = evidence_of(60)
    found.lost = [5, 20, 21]
    assert judge(SCENARIO, found).lost_messages == 2
    assert not judge(SCENARIO, found).safe
    assert judge(replace(SCENARIO, loses=True), found).safe
    assert judged(destroyed=7).lost_messages == 7
    assert judged(destroyed=7).safe
    assert 'missing' in judged(unrecorded=1).why[0]
    assert judged(findings=['it hangs']).why == ['it hangs']


def test_diagnostics_must_say_what_is_stated():
    found = evidence_of(60)
    found.told = [
        (1, 1, 'mill/compensator: state', 'late by 3 s'),
        (30, 1, 'mill/compensator: state', 'late by 4.5 s'),
        (40, 2, 'mill/compensator: read-back', 'refused: epoch 7'),
        (41, 2, 'mill/compensator: read-back', 'refused: epoch 8'),
        (42, 0, 'mill/compensator: input', 'in time'),
    ]
    verdict = judge(replace(SCENARIO, says='refused'), found)
    assert verdict.safe
    assert verdict.diagnostics == ['mill/compensator: read-back: refused: epoch 7']
    assert not judge(replace(SCENARIO, says='late'), found).safe


def test_a_machine_with_other_axes_does_not_belong_there():
    def other(tick):
        record = replace(applied(tick * TICK), axis=('X',), offset=np.zeros(1))
        return {'compensation_applied': record} if tick == 30 else {}

    assert 'who else is there' in judged(other).why[0]


def test_too_little_is_no_proof():
    found = evidence_of(60)
    found.windows.clear()
    assert judge(SCENARIO, found).why == ['too little was recorded to judge it']


def test_publishers_of_one_topic_are_told_apart():
    numbers = [50, 51, 1, 52, 2, 53, 3]
    items = [Recorded(n, number, command(n * TICK)) for n, number in enumerate(numbers)]
    found = [[item.sequence for item in stream] for stream in streams(items)]
    assert found == [[50, 51, 52, 53], [1, 2, 3]]
    owners = [Recorded(n, n, command(n * TICK, epoch=1 + n // 2)) for n in range(4)]
    assert [len(stream) for stream in streams(owners)] == [2, 2]


def test_orders_of_strangers_are_not_held_against_the_compensator():
    found = evidence_of(60)
    place = found.records['compensation'][40].place
    order = replace(command(41 * TICK, 1000.0, epoch=9), source=STRANGER)
    found.records['compensation'].insert(41, Recorded(place, 1, order))
    assert judge(SCENARIO, found).safe


def test_stated_times_follow_from_the_limits():
    # 180 s until the command expires, 60 um at 0.5 um/s, two ticks.
    assert BY_MACHINE == pytest.approx(180 + 120 + 24)
    # 150 s late, 300 s held, 50 um at 0.1 um/s, two updates and ticks.
    assert BY_COMPENSATOR == pytest.approx(150 + 300 + 500 + 20 + 24)
    assert MACHINE.tick_period == 12.0


def test_long_tales_are_cut_short_in_the_table():
    told = ' > '.join(['active', 'holding'] * 5)
    text = result_tables([Verdict('n', 'w', 1.0, told=told)])[0].to_text()
    assert 'active > holding > active > holding > ... > holding' in text

# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""`fuzzycnc faults`: what a scenario is judged by, and what disturbs routes and values."""

import itertools
from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip('rclpy')

from fuzzycnc_ros.components.codes import AppliedStatus, CompensationState
from fuzzycnc_ros.components.records import (
    SECOND,
    Compensation,
    CompensationApplied,
    ThermalError,
)
from fuzzycnc_ros.convert import encode
from fuzzycnc_ros.faults.campaign import STAGES, chosen, scenarios
from fuzzycnc_ros.faults.cutting import CUTS, cut_and_repair
from fuzzycnc_ros.faults.evidence import Evidence, Recorded, Window
from fuzzycnc_ros.faults.falsified import FIELDS, KINDS, falsified, shifted
from fuzzycnc_ros.faults.relay import Delay, Drop, Duplicate, Falsify, record_types, remappings
from fuzzycnc_ros.faults.scenario import BY_COMPENSATOR, BY_MACHINE, MACHINE, Ends, Scenario
from fuzzycnc_ros.faults.strangers import STRANGE_EPOCH, highest_order
from fuzzycnc_ros.faults.table import result_table
from fuzzycnc_ros.faults.verdict import Verdict, judge, streams

MICRO = 1e-6
TICK = 12 * SECOND
NAME = 'trial'
SCENARIO = Scenario(NAME, 'nothing is done', lambda live: None, BY_MACHINE)


def error(stamp, valid=True):
    """Return a thermal error."""
    return ThermalError(
        stamp=stamp,
        axis=('Y', 'Z'),
        channel=('Y', 'Z'),
        error=np.full(2, -5 * MICRO),
        standard_deviation=np.zeros(2),
        valid=valid,
        reason=0,
        in_domain=True,
        model='',
        substituted=(),
        substitute=(),
    )


def command(stamp, offset=5.0, state=CompensationState.ACTIVE, epoch=1):
    """Return a command of an offset [um]."""
    return Compensation(
        stamp=stamp,
        epoch=epoch,
        state=int(state),
        axis=('Y', 'Z'),
        offset=np.full(2, offset * MICRO),
        slope=np.zeros(2),
        reference_position=np.zeros(2),
        at_limit=np.zeros(2, bool),
        slewing=np.zeros(2, bool),
        valid_until=stamp + 180 * SECOND,
        source=(),
    )


def applied(stamp, offset=5.0, status=AppliedStatus.FOLLOWING):
    """Return a read-back of an offset [um]."""
    return CompensationApplied(
        stamp=stamp,
        epoch=1,
        status=int(status),
        reason='',
        axis=('Y', 'Z'),
        offset=np.full(2, offset * MICRO),
        at_limit=np.zeros(2, bool),
    )


def evidence_of(ticks, change=None):
    """Return what a graph that follows all the time would show; `change` may replace records."""
    found, place, number = Evidence(), itertools.count(1), itertools.count(1)
    for tick in range(1, ticks + 1):
        made = {
            'thermal_error': error(tick * TICK),
            'compensation': command(tick * TICK),
            'compensation_applied': applied(tick * TICK),
        }
        made.update(change(tick) if change else {})
        sequence = next(number)
        for topic, record in made.items():
            found.records[topic].append(Recorded(next(place), sequence, record))
    found.windows[NAME] = Window(10, next(place))
    return found


def judged(change=None, scenario=SCENARIO, ticks=60, **what):
    """Return the verdict on such a recording."""
    return judge(scenario, evidence_of(ticks, change), **what)


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
        ('compensation', lambda t: command(t, 6.5), 'told offset moved by 1.50 um'),
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
                'compensation_applied': applied(tick * TICK, status=AppliedStatus.EXPIRED)
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
                status=AppliedStatus.EXPIRED if tick in range(20, 25) else AppliedStatus.FOLLOWING,
            ),
        }

    held = judged(lambda tick: change(tick) if tick in range(15, 30) else {})
    assert held.time_to_safe_s == 5 * 12.0  # from the last tick that follows to the last that does not
    both = replace(SCENARIO, stated=BY_COMPENSATOR)
    held = judged(lambda tick: change(tick) if tick in range(15, 30) else {}, both)
    assert held.time_to_safe_s == 15 * 12.0


def test_nothing_is_known_of_a_time_without_a_recorder():
    def change(tick):
        later = 0 if tick < 30 else 3000 * SECOND
        stamp = tick * TICK + later
        status = AppliedStatus.EXPIRED if tick == 30 else AppliedStatus.FOLLOWING
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


@pytest.mark.parametrize('topic', FIELDS)
def test_every_falsified_field_is_an_array_or_number_of_an_input(topic):
    assert FIELDS[topic].field in record_types()[topic].__dataclass_fields__


@pytest.mark.parametrize('kind', KINDS)
def test_values_are_falsified(kind):
    change = falsified('compensation', kind)
    first = change(command(0, 5.0))
    hour = change(command(3600 * SECOND, 6.0))
    wanted = {
        'nan': (np.nan, np.nan),
        'stuck': (5.0, 5.0),
        'jump': (1005.0, 1006.0),
        'drift': (5.0, 406.0),
    }[kind]
    found = [record.offset[0] / MICRO for record in (first, hour)]
    np.testing.assert_allclose(found, wanted)
    assert hour.stamp == 3600 * SECOND


def test_unknown_kind_is_refused():
    with pytest.raises(ValueError, match='expected one of nan, stuck'):
        falsified('compensation', 'late')


def test_stamps_do_not_fall_below_zero():
    assert shifted(-600.0)(command(60 * SECOND)).stamp == 0
    assert shifted(600.0)(command(60 * SECOND)).stamp == 660 * SECOND


def test_routes_are_disturbed_by_seed():
    dropped = Drop(0.5, 7)
    kept = sum(len(dropped.passed('t', b'x')) for _ in range(1000))
    assert 450 < kept < 550
    assert dropped.count == 1000 - kept
    assert Duplicate(0.1).passed('t', b'x') == [(0.0, b'x'), (0.1, b'x')]
    waits = [Delay(0.0, 1.0, 7).passed('t', b'x')[0][0] for _ in range(2)]
    assert waits[0] == waits[1]
    assert 0.0 < waits[0] < 1.0


def test_only_the_messages_of_one_topic_are_falsified():
    from rclpy.serialization import deserialize_message, serialize_message

    from fuzzycnc_ros.nodes.messages import RCLPY, message_class

    payload = bytes(serialize_message(encode(command(TICK), RCLPY)))
    fault = Falsify('compensation', falsified('compensation', 'jump'))
    assert fault.passed('other', payload) == [(0.0, payload)]
    ((_, content),) = fault.passed('compensation', payload)
    message = deserialize_message(content, message_class(Compensation.TYPE))
    np.testing.assert_allclose(message.offset, 1.005e-3)


def test_the_relay_stands_between_publisher_and_readers():
    assert remappings({'/clock': 'a', 'temperatures': 'b'}) == [
        'a:/clock:=direct/clock',
        'b:temperatures:=direct/temperatures',
    ]


def test_strangers_order_by_the_highest_rank():
    told = command(TICK, epoch=4)
    order = highest_order('compensation', 2 * TICK, told)
    assert order.epoch == STRANGE_EPOCH > told.epoch
    assert order.axis == told.axis
    assert (order.offset > MACHINE.offset_max).all()
    assert highest_order('axis_command', TICK, None).epoch == STRANGE_EPOCH
    with pytest.raises(ValueError, match='told none'):
        highest_order('compensation', TICK, None)


def test_orders_of_strangers_are_not_held_against_the_compensator():
    found = evidence_of(60)
    place = found.records['compensation'][40].place
    order = command(41 * TICK, 1000.0, epoch=STRANGE_EPOCH)
    found.records['compensation'].insert(41, Recorded(place, 1, order))
    assert judge(SCENARIO, found).safe


def test_cut_bags_keep_what_lies_before_the_cut(tmp_path, fuzzycnc, bag):
    recorded = bag('log', rows=400)
    lost, wrong = cut_and_repair(recorded, tmp_path / 'cuts', 3)
    assert (lost, wrong) == (0, [])
    assert not (tmp_path / 'cuts').exists()
    assert CUTS >= 10


def test_what_is_broken_covers_all_that_is_asked_for():
    names = {scenario.name for scenario in scenarios()}
    assert len(names) == sum(len(stage.scenarios) for stage in STAGES)
    for node in (
        'temperature_acquisition',
        'sensor_selector',
        'thermal_predictor',
        'compensator',
        'recorder',
        'simulated_machine',
    ):
        assert {f'kill_{node}', f'stop_{node}'} <= names
    for topic, kind in itertools.product(FIELDS, KINDS):
        assert f'{kind}_{topic}' in names
    assert {
        'drop',
        'delay',
        'duplicate',
        'reorder',
        'clock_ahead',
        'clock_back',
        'disk_full',
        'bag_cut',
        'model_damaged',
        'parameter_out_of_range',
        'two_compensators',
        'foreign_compensation',
        'foreign_axis_command',
    } <= names


def test_stated_times_follow_from_the_limits():
    # 180 s until the command expires, 60 um at 0.5 um/s, two ticks.
    assert BY_MACHINE == pytest.approx(180 + 120 + 24)
    # 150 s late, 300 s held, 50 um at 0.1 um/s, two updates and ticks.
    assert BY_COMPENSATOR == pytest.approx(150 + 300 + 500 + 20 + 24)
    assert MACHINE.tick_period == 12.0


def test_chosen_scenarios_keep_their_stages():
    stages = chosen(['kill_recorder', 'nan_compensation'])
    assert [stage.name for stage in stages] == ['kills', 'compensation']
    assert [len(stage.scenarios) for stage in stages] == [1, 1]


def test_unknown_scenario_is_refused(refused):
    refused('faults', '--only', 'kill_operator', naming=['kill_recorder', 'kill_operator'])
    refused('faults', '--list', '--only', 'kill_operator', naming=['kill_operator'])


def test_folder_that_exists_is_refused(refused, tmp_path):
    (tmp_path / 'there').mkdir()
    refused('faults', '--out', 'there', naming=['there', 'exists'])


def test_scenarios_are_listed(fuzzycnc):
    outcome = fuzzycnc('faults', '--list')
    assert outcome.code == 0
    for scenario in scenarios():
        assert scenario.name in outcome.out


def test_figures_are_written(fuzzycnc, monkeypatch, tmp_path):
    import json

    from fuzzycnc_ros.cli import faults

    found = [judged(), judged(unrecorded=3)]
    monkeypatch.setattr(faults, 'campaign', lambda *given: found)
    outcome = fuzzycnc('faults', '--json', 'faults.json')
    assert outcome.code == 1
    assert '1 of 2 scenarios are safe' in outcome.out
    assert '3 messages are missing' in outcome.out
    (first, second) = json.loads((tmp_path / 'faults.json').read_text())['scenarios']
    wanted = {'name', 'safe', 'worst_offset_um', 'worst_step_um', 'time_to_safe_s'}
    assert wanted | {'lost_messages', 'diagnostics'} <= set(first)
    assert (first['safe'], second['safe'], second['lost_messages']) == (True, False, 3)
    found.pop()
    assert fuzzycnc('faults').code == 0


def test_long_tales_are_cut_short_in_the_table():
    told = ' > '.join(['active', 'holding'] * 5)
    text = result_table([Verdict('n', 'w', 1.0, told=told)]).to_text()
    assert 'active > holding > active > holding > ... > holding' in text

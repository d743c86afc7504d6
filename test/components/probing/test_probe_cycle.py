# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Probing cycle: what touches mean, what is never believed, and when a cycle is due."""

import numpy as np
import pytest
from benches.probe_rig import MICRON, ProbeRig, sphere, two_blocks, zeroed

from fuzzycnc_ros.components.probing.probe_cycle import ProbeCycle
from fuzzycnc_ros.core.probing.plan import ProbePlan
from fuzzycnc_ros.runtime.enums import TouchKind
from fuzzycnc_ros.runtime.records import nanoseconds


def test_the_first_cycle_after_the_reference_is_the_zero():
    rig = zeroed()
    (probe,) = rig.probes
    np.testing.assert_allclose(probe.displacement, 0.0, atol=1e-15)
    assert (probe.axis, probe.channel) == (('Y', 'Z'), ('Y', 'Z'))
    np.testing.assert_allclose(probe.position, [-0.04, -0.12])
    assert not probe.includes_compensation
    assert rig.state.accepted
    np.testing.assert_allclose(rig.state.zero, [-0.04, -0.1045])
    np.testing.assert_allclose(rig.state.size, [0.031, np.nan])


@pytest.mark.parametrize('told', [False, True])
@pytest.mark.parametrize('offset', [[0.0, 0.0], [3.0, -20.0]])
def test_a_later_cycle_tells_the_displacement_with_the_offset_in_force(offset, told):
    rig = zeroed()
    rig.includes_offset = told
    rig.error, rig.offset = {'Y': 7.0, 'Z': -12.5}, offset
    rig.cycle()
    probe = rig.probes[-1]
    wanted = np.array([7.0, -12.5]) + offset
    np.testing.assert_allclose(probe.displacement / MICRON, wanted, atol=1e-6)
    assert probe.includes_compensation == any(offset)


def test_offsets_that_move_during_a_cycle_are_taken_off_touch_by_touch():
    rig = zeroed()
    rig.error = {'Y': 7.0, 'Z': -12.5}
    rig.begin()
    for number in range(1, rig.plan.count + 1):
        rig.offset = [-0.3 * number, 0.5 * number]
        rig.touch(number)
    rig.tell(TouchKind.END, 0)
    wanted = np.array([7.0, -12.5]) + rig.offset
    np.testing.assert_allclose(rig.probes[-1].displacement / MICRON, wanted, atol=1e-6)


@pytest.mark.parametrize('told', [False, True])
def test_with_a_slope_in_force_each_place_has_its_own_offset(told):
    rig = zeroed(plan=two_blocks())
    rig.includes_offset = told
    near, far = (place.position for place in rig.plan.places)
    rig.error, rig.offset, rig.slope = {'Y': 7.0, 'Z': 0.0}, [-30.0, 0.0], [200.0, 0.0]
    rig.cycle()
    probe = rig.probes[-1]
    offset = [rig.applied.offset_at('Y', place) for place in (near, far)]
    assert abs(offset[1] - offset[0]) > 20 * MICRON
    # The touch is a slope times the error away from its place.
    np.testing.assert_allclose((probe.displacement - offset) / MICRON, 7.0, atol=0.02)


def test_the_spread_is_the_noise():
    rig = zeroed(touch_noise=1e-9)
    rig.cycle({7: 1.0, 8: -1.0})
    spread = rig.probes[-1].standard_deviation / MICRON
    assert spread[1] == pytest.approx(1.0 / np.sqrt(3.0), rel=0.01)
    assert spread[0] < 0.01


def test_one_touch_of_three_may_be_a_chip():
    rig = zeroed()
    rig.error = {'Y': 0.0, 'Z': 10.0}
    rig.cycle({8: 60.0})
    assert rig.probes[-1].displacement[1] / MICRON == pytest.approx(10.0)
    rig.cycle({8: 60.0, 9: 30.0})
    assert np.isnan(rig.probes[-1].displacement[1])
    assert 'touches differ by 60.0 µm' in rig.state.outcome
    assert rig.probes[-1].displacement[0] == pytest.approx(0.0)


@pytest.mark.parametrize(('place', 'way'), [(0, -1.0), (1, 1.0)])
def test_two_touches_that_agree_are_a_chip_if_the_third_goes_deeper(place, way):
    rig = zeroed()
    chip = (1, 2) if place == 0 else (8, 9)
    rig.cycle(dict.fromkeys(chip, way * 60.0))
    assert np.isnan(rig.probes[-1].displacement[place])
    assert 'touches differ by 60.0 µm' in rig.state.outcome


def test_a_chip_on_one_side_shows_in_the_size():
    rig = zeroed()
    rig.error = {'Y': 5.0, 'Z': 5.0}
    rig.cycle({1: -20.0, 2: -20.0, 3: -20.0})
    probe = rig.probes[-1]
    assert np.isnan(probe.displacement[0])
    assert probe.displacement[1] / MICRON == pytest.approx(5.0)
    assert '+20.0 µm further apart than at the reference' in rig.state.outcome
    assert 'WARN cycle: left, Y' in rig.health()


@pytest.mark.parametrize(
    ('wrong', 'text'),
    [(-600.0, 'expected within 0.5 mm'), (300.0, 'moved by +300.0 µm since the reference')],
)
def test_a_probe_that_trips_early_is_not_believed(wrong, text):
    rig = zeroed()
    rig.cycle(dict.fromkeys((7, 8, 9), wrong))
    assert np.isnan(rig.probes[-1].displacement[1])
    assert text in rig.state.outcome


def test_nothing_is_told_of_a_cycle_that_missed():
    rig = zeroed()
    rig.begin()
    rig.touch(1)
    rig.tell(TouchKind.MISS, 5)
    rig.tell(TouchKind.TOUCH, 2, 0.0)
    rig.tell(TouchKind.END, 0)
    assert len(rig.probes) == 1
    assert not rig.state.accepted
    assert rig.state.outcome.startswith('left, Y: no touch where one was expected')
    rig.error = {'Y': 1.0, 'Z': 1.0}
    rig.cycle()
    assert rig.state.accepted
    assert len(rig.probes) == 2


@pytest.mark.parametrize('lost', [1, 4, 9])
def test_a_touch_that_was_not_heard_spoils_the_cycle(lost):
    rig = zeroed()
    rig.begin()
    for number in range(1, rig.plan.count + 1):
        if number != lost:
            rig.touch(number)
    rig.tell(TouchKind.END, 0)
    assert len(rig.probes) == 1
    assert rig.state.failures == 1
    missing = f'touch {lost} was not heard' if lost < 9 else 'ended after 8 of 9 touches'
    assert rig.state.outcome == missing


def test_a_cycle_that_never_ends_was_broken_off():
    rig = zeroed(cycle_time_max=60.0)
    rig.begin()
    rig.touch(1)
    rig.until(rig.time + 100.0)
    assert rig.state.outcome == 'the cycle was broken off'
    rig.time += 100.0
    rig.begin()
    rig.touch(1)
    rig.cycle()
    assert rig.state.accepted
    assert rig.state.failures == 0


def test_a_program_of_another_file_is_refused():
    rig = zeroed()
    rig.tell(TouchKind.BEGIN, rig.plan.signature % 1000 + 1)
    for number in range(1, rig.plan.count + 1):
        rig.touch(number)
    rig.tell(TouchKind.END, 0)
    assert len(rig.probes) == 1
    assert 'write it anew from probe_file' in rig.state.outcome


def test_a_zero_that_comes_late_is_none():
    rig = ProbeRig(zero_time=600.0)
    rig.reference()
    assert rig.state.due
    rig.time += 601.0
    rig.cycle()
    assert not rig.probes
    assert 'no zero was probed within zero_time 600 s' in rig.state.outcome
    rig.time += 601.0
    rig.ask(due=True)
    assert not rig.state.due


def test_a_zero_is_probed_well_or_not_at_all():
    rig = ProbeRig()
    rig.cycle()
    assert 'no thermal reference yet' in rig.state.outcome
    rig.reference()
    rig.cycle({7: 60.0, 8: 20.0})
    assert not rig.probes
    assert rig.state.outcome.startswith('no zero: left, Z: touches differ')
    rig.cycle()
    assert len(rig.probes) == 1


def test_a_new_reference_needs_a_new_zero():
    rig = zeroed()
    rig.time += 3600.0
    rig.error = {'Y': 7.0, 'Z': -12.5}
    rig.reference()
    assert rig.state.due
    assert 'it is the zero of all others' in rig.state.reason
    rig.cycle()
    np.testing.assert_allclose(rig.probes[-1].displacement, 0.0, atol=1e-12)


def test_a_cycle_is_due_when_the_predictor_wants_one_but_not_at_once_again():
    rig = zeroed(interval_min=300.0)
    assert not rig.state.due
    rig.ask(due=True, reason='Z is known to 9 um')
    assert not rig.state.due
    rig.until(rig.time + 297.0)
    assert not rig.state.due
    rig.until(rig.time + 299.0)
    assert rig.state.due
    assert rig.state.reason == 'Z is known to 9 um'
    rig.time += 302.0
    rig.cycle()
    assert not rig.state.due


def test_a_probe_that_fails_again_and_again_is_not_called_any_more():
    rig = zeroed(interval_min=10.0, failures_max=3)
    for count in range(1, 4):
        rig.time += 20.0
        rig.ask(due=True)
        assert rig.state.due == (count < 4)
        rig.begin()
        rig.tell(TouchKind.MISS, 1)
    rig.time += 20.0
    rig.ask(due=True)
    assert not rig.state.due
    assert '3 cycles in a row were not used' in rig.state.reason
    assert 'ERROR cycle' in rig.health()
    rig.cycle()  # by hand, with a new stylus
    rig.time += 20.0
    rig.ask(due=True)
    assert rig.state.due


def test_the_zero_outlasts_a_restart():
    rig = zeroed()
    again = ProbeRig()
    again.component.restore('probe_cycle_state', rig.state)
    again.time = 1000.0
    again.reference()
    again.time = rig.time + 100.0
    again.error = {'Y': 7.0, 'Z': -12.5}
    again.cycle()
    np.testing.assert_allclose(again.probes[-1].displacement / MICRON, [7.0, -12.5], atol=1e-6)


def test_another_file_has_another_zero():
    rig = zeroed()
    rig.time += 3600.0
    assert rig.request('use_plan', plan=sphere().to_json().replace('0.0005', '0.0004')).success
    rig.plan = ProbePlan.from_json(rig.plan.to_json().replace('0.0005', '0.0004'))
    rig.cycle()
    assert len(rig.probes) == 1
    assert 'no zero was probed' in rig.state.outcome
    assert not rig.request('use_plan', plan='{}').success


def test_without_a_plan_nothing_is_due():
    component = ProbeCycle()
    assert [item.message for item in component.health()] == [
        'no plan of a cycle; set the parameter probe_file'
    ]
    assert not next(iter(component.on_deadline(nanoseconds(5.0)))).record.due

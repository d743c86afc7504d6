# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Compensator: axes that are known too little, and the first activation with a wrong probe."""

from dataclasses import replace

import numpy as np
import pytest
from benches.component_bench import Bench, applied, machine_state, thermal_error
from stepped_shift import Shift

from fuzzycnc_ros.components.thermal.axis_trust import CAUTIOUS
from fuzzycnc_ros.components.thermal.compensator import Compensator, CompensatorConfig
from fuzzycnc_ros.core.thermal.confirmation import is_right, is_wrong
from fuzzycnc_ros.runtime.enums import MachineMode
from fuzzycnc_ros.runtime.records import (
    CompensationApplied,
    Displacement,
    ProbeEvidence,
    nanoseconds,
)

MICRON = 1e-6


def bench_of(**changes):
    bench = Bench(Compensator(CompensatorConfig(slew_max=1e-3, **changes)))
    bench.push('machine_state', machine_state(1.0))
    bench.give('compensation_applied', applied(1.0))
    bench.until(1.0)
    assert bench.request('activate').success
    return bench


def follow(bench, time, error, deviation=1.0, other=0.0, mode=MachineMode.ON):
    """Give an error of Y [um] with its deviation; return the offset of Y [um] that is told."""
    bench.push('machine_state', machine_state(time, state=int(mode)))
    values = {'standard_deviation': np.array([deviation, 1.0]) * MICRON}
    bench.give('thermal_error', thermal_error(time, np.array([error, other]) * MICRON, **values))
    return bench.records('compensation')[-1].offset[0] / MICRON


def told(bench, evidence, time=0.0, frame='mill/machine'):
    """Tell what probes under an offset of Y and Z have said."""
    record = ProbeEvidence(
        stamp=nanoseconds(time),
        frame_id=frame,
        axis=('Y', 'Z'),
        channel=('Y', 'Z'),
        evidence=np.array(evidence),
    )
    bench.push('probe_evidence', record)


def test_an_axis_that_is_known_too_little_is_not_followed():
    bench = bench_of(band_share=0.5)
    assert follow(bench, 60.0, 10.0, deviation=4.0) == 0.0
    assert 'OK band: not followed, known too little: Y +10.0 ± 8.0 µm' in bench.health()
    assert follow(bench, 120.0, 10.0, deviation=2.0) == pytest.approx(-10.0)
    # It stays followed until the band is wider than the error.
    assert follow(bench, 180.0, 10.0, deviation=4.0) == pytest.approx(-10.0)
    assert follow(bench, 240.0, 10.0, deviation=5.1) == 0.0
    assert follow(bench, 300.0, 10.0, deviation=4.0) == 0.0


def test_a_part_is_followed_until_probes_confirm_it():
    bench = bench_of(first_share=0.5)
    assert follow(bench, 60.0, 20.0) == pytest.approx(-10.0)
    assert 'OK first activation: followed in part until a probe confirms it: Y 50 %' in (
        bench.health()
    )
    told(bench, [0.9, 0.0], 90.0)
    assert follow(bench, 700.0, 20.0) == pytest.approx(-10.0)
    told(bench, [2.0, 0.0], 750.0)
    assert follow(bench, 1349.0, 20.0) == pytest.approx(-10.0)
    assert follow(bench, 1350.0, 20.0) == pytest.approx(-20.0)
    # What was confirmed belongs to the machine, not to this activation.
    assert bench.request('deactivate').success
    assert bench.request('activate').success
    assert follow(bench, 1440.0, 20.0) == pytest.approx(-20.0)


def test_an_axis_waits_for_the_end_of_a_program():
    bench = bench_of(band_share=0.5, program_wait=600.0)
    running = {'mode': MachineMode.RUNNING}
    assert follow(bench, 60.0, 10.0, **running) == 0.0
    assert 'OK program: followed anew when the program has ended: Y 100 %' in bench.health()
    assert follow(bench, 120.0, 10.0) == pytest.approx(-10.0)
    # Followed, it follows within a program, and is let go after it.
    assert follow(bench, 180.0, 12.0, **running) == pytest.approx(-12.0)
    assert follow(bench, 240.0, 12.0, 7.0, **running) == pytest.approx(-12.0)
    assert 'followed anew when the program has ended: Y 0 %' in bench.health()
    assert follow(bench, 300.0, 12.0, 7.0) == 0.0
    # A program without end is not waited for longer than that.
    for time in (360.0, 480.0, 600.0, 720.0, 840.0, 959.0):
        assert follow(bench, time, 10.0, **running) == 0.0
    assert follow(bench, 960.0, 10.0, **running) == pytest.approx(-10.0)


def test_wrong_probes_do_not_wait_for_the_end_of_a_program():
    bench = bench_of(first_share=0.5, program_wait=6000.0)
    assert follow(bench, 60.0, 20.0) == pytest.approx(-10.0)
    told(bench, [-3.0, 0.0], 90.0)
    assert follow(bench, 720.0, 20.0, mode=MachineMode.RUNNING) == 0.0


def test_that_probes_of_another_machine_are_right_confirms_nothing():
    bench = bench_of(first_share=0.5)
    told(bench, [2.0, 0.0], 0.0, frame='lathe/machine')
    assert follow(bench, 700.0, 20.0) == pytest.approx(-10.0)


def test_wider_limits_have_to_be_allowed_anew():
    bench = bench_of(first_share=0.5, hold_time=0.0, ramp_rate=1e-3)
    narrow = CompensatorConfig(slew_max=1e-3, first_share=0.5, hold_time=0.0, ramp_rate=1e-3)
    assert follow(bench, 60.0, 20.0) == pytest.approx(-10.0)
    bench.component.reconfigure(replace(narrow, offset_max=40e-6))
    assert follow(bench, 120.0, 20.0) == pytest.approx(-10.0)
    bench.component.reconfigure(narrow)
    follow(bench, 180.0, 20.0)
    assert follow(bench, 240.0, 20.0) == 0.0
    assert 'offset_max was set wider than what was allowed' in bench.health()
    bench.request('deactivate')
    bench.request('activate')
    bench.give('compensation_applied', applied(250.0))
    assert follow(bench, 300.0, 20.0) == pytest.approx(-10.0)


def test_axes_are_tried_one_by_one():
    bench = bench_of(first_share=0.5, band_share=0.5)
    follow(bench, 60.0, 20.0, other=30.0)
    assert bench.records('compensation')[-1].offset.tolist() == [0.0, -15.0 * MICRON]
    assert 'Y after that' in bench.health()
    told(bench, [0.0, 2.0], 90.0)
    follow(bench, 720.0, 20.0, other=30.0)
    np.testing.assert_allclose(
        bench.records('compensation')[-1].offset, [-10.0 * MICRON, -30.0 * MICRON]
    )


def test_an_axis_that_probes_contradict_is_not_followed():
    bench = bench_of(first_share=0.5)
    follow(bench, 60.0, 20.0)
    told(bench, [-3.0, 0.0], 90.0)
    assert follow(bench, 720.0, 20.0) == 0.0
    assert 'ERROR probes: Y not followed: probes do not see the offset as it is' in bench.health()
    told(bench, [0.0, 0.0], 750.0)  # forgotten
    assert follow(bench, 1380.0, 20.0) == pytest.approx(-10.0)


def test_without_the_parameter_nothing_is_held_back():
    bench = bench_of()
    told(bench, [-3.0, 0.0])
    assert follow(bench, 60.0, 20.0) == pytest.approx(-20.0)


def wrong(kind, record):
    """Return a probe as it is told by a cycle that has had an error from its first day on."""
    value = record.displacement
    changed = {
        'sign': -value,
        'diameter for radius': 2.0 * value,
        'inches': 25.4 * value,
        'swapped axes': value[::-1].copy(),
    }.get(kind, value)
    return replace(record, displacement=changed)


def read_back(kind, record, told):
    """Return a read-back as it is told by a bridge with a fault."""
    told.append(record)
    if kind == 'ten minutes late':
        return replace(told[-min(len(told), 10)], stamp=record.stamp)
    factor = {'wrong sign': -1.0, 'doubled': 2.0, 'none in force': 0.0}.get(kind, 1.0)
    return replace(record, offset=factor * record.offset)


def learnt_shift(kind):
    """Return the offsets of Y and Z [um] and the errors left by a machine learnt from nothing."""
    left, told = [], []

    def change(emission):
        if isinstance(emission.record, CompensationApplied):
            return replace(emission, record=read_back(kind, emission.record, told))
        if not isinstance(emission.record, Displacement):
            return emission
        left.append(emission.record.displacement / MICRON)
        return replace(emission, record=wrong(kind, emission.record))

    shift = Shift(
        '',
        'T3',
        change=change,
        probe_interval=1800.0,
        displacement_compensated=True,
        compensator=CompensatorConfig(**CAUTIOUS),
        learn=True,
        learn_axes=('Y', 'Z'),
    ).run()
    return shift, np.array(shift.applied), np.array(left)


def evidence_of(shift):
    return shift.posteriors[-1].evidence


def test_a_machine_learnt_from_nothing_is_compensated():
    shift, offsets, left = learnt_shift('true')
    assert np.abs(offsets).max() > 5.0
    assert is_right(evidence_of(shift)).all()
    later = np.abs(left[8:])
    assert later.max() < 5.0


@pytest.mark.parametrize('kind', ['sign', 'inches', 'swapped axes', 'diameter for radius'])
def test_wrong_probes_from_the_first_one_on_do_not_feed_on_themselves(kind):
    shift, offsets, _ = learnt_shift(kind)
    assert not is_right(evidence_of(shift)).any()
    # Wrong by a factor of 25 they are beyond all bounds, and nothing is followed at all.
    assert is_wrong(evidence_of(shift)).any() or kind == 'inches'
    assert ('they are not learnt' in shift.health[-1].get('probes', '')) == (kind != 'inches')
    # Half of what was learnt was told while it was tried, and nothing afterwards.
    assert np.abs(offsets).max() < 30.0
    assert not offsets[-1].any()


@pytest.mark.parametrize('kind', ['wrong sign', 'doubled', 'none in force', 'ten minutes late'])
def test_a_false_read_back_does_not_feed_on_itself(kind):
    shift, _, left = learnt_shift(kind)
    told = np.array([item.offset for item in shift.compensation]) / MICRON
    bare = learnt_shift('true')[2]
    assert np.abs(told).max() < 32.0
    if kind != 'ten minutes late':
        assert not is_right(evidence_of(shift)).any()
    # At no time is more left than the machine does without any offset.
    assert np.abs(left).max() < 1.2 * np.abs(bare).max() + 10.0

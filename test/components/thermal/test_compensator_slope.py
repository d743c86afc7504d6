# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Compensator along an axis: both ends of the travel are guarded, whatever the errors are."""

from dataclasses import replace

import numpy as np
import pytest
from benches.component_bench import Bench, applied, machine_state, thermal_error

from fuzzycnc_ros.components.thermal.compensator import Compensator, CompensatorConfig
from fuzzycnc_ros.core.inputs.offset_input import OffsetStatus
from fuzzycnc_ros.runtime.enums import CompensationState
from fuzzycnc_ros.runtime.records import Compensation, CompensationApplied

MICRON = 1e-6
SLOPING = CompensatorConfig(
    travel=('Y:-0.5:0.1',), offset_max=100e-6, slew_max=1e-6, ramp_rate=0.5e-6
)
LOW, HIGH = -0.5, 0.1


def bench_of(config: CompensatorConfig = SLOPING, read_back=None) -> Bench:
    """Return an active compensator."""
    bench = Bench(Compensator(config))
    bench.push('machine_state', machine_state(1.0))
    bench.give('compensation_applied', read_back or applied(1.0))
    assert bench.request('activate').success
    return bench


def follow(bench: Bench, time: float, error=(10e-6, -4e-6), slope=-100e-6, **changes):
    """Give an error that slopes along Y; return the newest command."""
    given = {
        'slope': np.array([slope, np.nan]),
        'slope_deviation': np.array([4e-6, np.nan]),
        'reference_position': np.array([-0.25, np.nan]),
    }
    bench.push('machine_state', machine_state(time))
    bench.give('thermal_error', thermal_error(time, error, **(given | changes)))
    return bench.records('compensation')[-1]


def at(command: Compensation, position: float) -> float:
    """Return the offset of Y at a position [m]."""
    way = position - command.reference_position[0]
    return float(command.offset[0] + command.slope[0] * way)


def test_offset_and_slope_are_minus_those_of_the_error():
    bench = bench_of()
    for time in range(60, 601, 60):
        command = follow(bench, time)
    assert command.offset == pytest.approx([-10e-6, 4e-6])
    assert command.slope == pytest.approx([100e-6, 0.0])
    assert command.reference_position == pytest.approx([-0.25, 0.0])
    assert not command.at_limit.any()
    values = bench.component.health()[0].values
    assert values['slope Y [um/m]'] == '100.0'
    assert 'slope Z [um/m]' not in values


def test_without_a_travel_only_the_error_at_the_reference_is_followed_and_that_is_said():
    bench = bench_of(replace(SLOPING, travel=()))
    for time in range(60, 601, 60):
        command = follow(bench, time)
    assert command.offset == pytest.approx([-10e-6, 4e-6])
    assert not command.slope.any()
    assert 'WARN travel: the error of Y slopes along the axis' in bench.health()


def test_the_far_end_is_cut_where_the_middle_is_far_from_the_limit():
    bench = bench_of()
    for time in range(60, 1201, 60):
        command = follow(bench, time, slope=-400e-6)
    # -(10 - 400 * 0.35) = 130 um at the upper end are too much; 90 um at the lower one are not.
    assert at(command, HIGH) == pytest.approx(100e-6)
    assert at(command, LOW) == pytest.approx(-110e-6, abs=11e-6)
    assert command.at_limit.tolist() == [True, False]


def test_a_slope_that_is_too_steep_is_cut():
    bench = bench_of(replace(SLOPING, slope_max=50e-6))
    for time in range(60, 601, 60):
        command = follow(bench, time)
    assert command.slope[0] == pytest.approx(50e-6)
    assert command.at_limit.tolist() == [True, False]


def test_an_error_that_no_model_may_say_counts_at_the_ends_too():
    bench = bench_of(replace(SLOPING, error_max=100e-6))
    follow(bench, 60.0, slope=-450e-6)
    assert 'thermal error of Y: expected at most 100 µm' in bench.component.health()[0].message


def test_a_restart_goes_on_from_the_line_in_force():
    moved = replace(
        applied(1.0, (20e-6, 0.0), 3),
        slope=np.array([80e-6, 0.0]),
        position=np.array([-0.4, 0.0]),
        status=int(OffsetStatus.FOLLOWING),
    )
    command = follow(bench_of(read_back=moved), 1.0)
    assert command.epoch == 4
    assert at(command, -0.4) == pytest.approx(20e-6)
    assert command.slope[0] == pytest.approx(80e-6)


def test_a_slope_about_an_unknown_place_is_none():
    told = replace(applied(1.0, (20e-6, 0.0), 3), slope=np.array([80e-6, 0.0]))
    command = follow(bench_of(read_back=told), 1.0)
    assert not command.slope.any()


def test_the_band_counts_where_the_error_is_largest():
    careful = replace(SLOPING, band_share=0.8)
    assert follow(bench_of(careful), 60.0, error=(0.0, 0.0)).slope[0] != 0.0
    wide = np.array([60e-6, np.nan])
    assert follow(bench_of(careful), 60.0, (0.0, 0.0), slope_deviation=wide).slope[0] == 0.0


@pytest.mark.parametrize('text', ['Y', 'Y:0', 'Y:0:0', 'Y:0.1:-0.5', 'Q:0:1', 'Y:a:1', 'Y:0:inf'])
def test_a_travel_that_is_none_is_refused(text):
    with pytest.raises(ValueError, match=r'travel: expected each of the axes Y, Z') as refusal:
        Compensator(CompensatorConfig(travel=(text,)))
    assert repr(text) in str(refusal.value)


def in_force(command: Compensation) -> CompensationApplied:
    """Return what a machine tells that follows a command."""
    told = applied(1e-9 * command.stamp, command.offset, command.epoch)
    return replace(
        told,
        stamp=command.stamp,
        slope=command.slope,
        position=command.reference_position,
        status=int(OffsetStatus.FOLLOWING),
    )


def check_random_errors(steps: int) -> None:
    """Hold every command to the limits at every place of the travel."""
    rng = np.random.default_rng(48)
    config = replace(SLOPING, slope_max=300e-6)
    bench = bench_of(config)
    place = np.linspace(LOW, HIGH, 7)
    time, before, number = 60.0, None, 0
    error, slope, reference = 0.0, 0.0, -0.25
    for _ in range(steps):
        time += float(rng.choice([0.1, 7.0, 60.0, 400.0], p=[0.3, 0.4, 0.28, 0.02]))
        if rng.random() < 0.3:
            error = float(rng.normal(0.0, 80e-6))
            slope = float(rng.normal(0.0, 250e-6))
        if rng.random() < 0.02:
            reference = float(rng.uniform(LOW, HIGH))
        if rng.random() < 0.02:
            bench.request(str(rng.choice(['activate', 'deactivate'])))
        follow_ = {'reference_position': np.array([reference, np.nan])}
        bench.push('machine_state', machine_state(time, homed=bool(rng.random() < 0.95)))
        bench.give(
            'thermal_error',
            thermal_error(
                time,
                (error, 0.0),
                slope=np.array([slope, np.nan]),
                valid=bool(rng.random() < 0.95),
                **follow_,
            ),
        )
        commands = bench.records('compensation')
        bench.emitted.clear()
        number += len(commands)
        for command in commands:
            offsets = command.offset[0] + command.slope[0] * (
                place - command.reference_position[0]
            )
            assert np.isfinite(offsets).all()
            assert np.abs(offsets).max() <= config.offset_max * (1 + 1e-9)
            assert abs(command.slope[0]) <= config.slope_max * (1 + 1e-9)
            if before is not None:
                last, earlier = before
                elapsed = min(1e-9 * (command.stamp - earlier), config.period)
                assert np.abs(offsets - last).max() <= config.slew_max * elapsed + 1e-12
            before = (offsets, command.stamp)
        if commands:
            bench.give('compensation_applied', in_force(commands[-1]))
    assert number > steps / 3


@pytest.mark.parametrize(
    'steps',
    [
        150,
        pytest.param(10_000, marks=pytest.mark.slow),
        pytest.param(1_000_000, marks=pytest.mark.qualify),
    ],
)
def test_no_place_of_the_travel_is_beyond_the_limit_or_faster_than_slew(steps):
    check_random_errors(steps)


def test_deactivation_takes_the_whole_line_to_zero():
    bench = bench_of()
    for time in range(60, 301, 60):
        command = follow(bench, time)
    assert command.slope[0] > 50e-6
    bench.request('deactivate')
    bench.until(1000.0)
    last = bench.records('compensation')[-1]
    assert last.state == CompensationState.INACTIVE
    assert not last.offset.any()
    assert not last.slope.any()
    assert last.final

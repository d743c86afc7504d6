# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The C of the component `fuzzycnc_offset`, compiled without LinuxCNC."""

import math
import shutil
import subprocess

import numpy as np
import pytest
from benches.offset_thread import HEADER, OffsetLimits, OffsetThread

from fuzzycnc_ros.core.inputs.lines import Lines, Travel
from fuzzycnc_ros.core.inputs.offset_input import OffsetInput, OffsetInputConfig

PERIOD = 0.001
LOW, HIGH = -0.4, 0.1
SIZE, RATE, STEEP, SPEED = 60e-6, 50e-6, 3e-4, 1.0
LIMITS = OffsetLimits(size=SIZE, rate=RATE, slope=STEEP, speed=SPEED)
TRAVEL = Travel(low=np.array([LOW]), high=np.array([HIGH]))


def in_force(lines=(20e-6, 1e-4, 0.0), position=0.0):
    """Return an axis with a line in force."""
    thread = OffsetThread(LIMITS, LOW, HIGH)
    thread.aim(*lines)
    for _ in range(2000):
        thread.step(True, position, PERIOD)
    return thread


@pytest.mark.parametrize('steps', [3000, pytest.param(100_000, marks=pytest.mark.qualify)])
def test_equal_to_the_guard_of_the_bridges(steps):
    """Random lines, some too large or too steep, some taken back on the way."""
    rng = np.random.default_rng(steps)
    thread = OffsetThread(LIMITS, LOW, HIGH)
    most = SIZE + STEEP * (HIGH - LOW)
    guard = OffsetInput(['low', 'high'], OffsetInputConfig(offset_max=most, slew_max=RATE))
    position, speed, time = 0.0, 0.0, 0
    for step in range(steps):
        if rng.random() < 0.01:
            offset, slope = rng.normal(0.0, [50e-6, 2e-4])
            reference = rng.uniform(LOW, HIGH)
            thread.aim(offset, slope, reference)
            line = Lines(
                offset=np.array([offset]),
                slope=np.clip([slope], -STEEP, STEEP),
                reference_position=np.array([reference]),
            )
            ends = TRAVEL.ends(line)
            assert guard.command(1, guard.axes, ends, stamp=time, valid_until=10**15).accepted
        if rng.random() < 0.02:
            speed = rng.uniform(-SPEED, SPEED)
        position = min(HIGH, max(LOW, position + speed * PERIOD))
        time += round(PERIOD * 1e9)
        found = thread.step(True, position, PERIOD)
        ends = guard.advance(time)
        wanted = TRAVEL.lines(ends, np.zeros(1)).at(np.array([position]))[0]
        assert found == pytest.approx(min(SIZE, max(-SIZE, wanted)), abs=1e-15), step
        assert [thread.line.low, thread.line.high] == pytest.approx(ends.tolist(), abs=1e-15)


@pytest.mark.parametrize('steps', [20_000, pytest.param(1_000_000, marks=pytest.mark.qualify)])
def test_no_place_is_beyond_the_size_or_faster_than_the_rate(steps):
    """Whatever is asked for, and wherever the position leaps; modes change meanwhile."""
    rng = np.random.default_rng(steps)
    thread = OffsetThread(LIMITS, LOW, HIGH)
    places = (LOW, 0.3 * LOW, HIGH)
    chance, numbers = rng.random((4, steps)), rng.normal(size=(3, steps))
    position, speed, tracks = 0.0, 0.0, True
    before, value = [thread.at(place) for place in places], 0.0
    reach = RATE * PERIOD * (1.0 + 1e-9) + 1e-18
    for step in range(steps):
        if chance[0, step] < 0.01:
            scale = 10.0 ** (4.0 * chance[3, step])
            thread.aim(numbers[0, step] * 1e-5 * scale, numbers[1, step] * 1e-5 * scale, -0.1)
        if chance[1, step] < 0.01:
            speed = 2.0 * SPEED * (chance[3, step] - 0.5)
        leaps = chance[2, step] < 0.001
        if leaps:
            position = LOW + (HIGH - LOW) * chance[3, step]
            tracks = not tracks
        position = position + speed * PERIOD
        told = math.nan if chance[3, step] < 0.001 else position
        found = thread.step(tracks, told, PERIOD)
        after = [thread.at(place) for place in places]
        assert max(abs(offset) for offset in (found, *after)) <= SIZE
        assert max(abs(b - a) for a, b in zip(before, after, strict=True)) <= reach
        # along the line it goes as fast as an axis can, and no faster
        assert abs(found - value) <= reach + STEEP * SPEED * PERIOD
        before, value = after, found


def test_slope_is_never_steeper_than_its_limit():
    thread = in_force((10e-6, 5e-3, -0.1))
    slope = (thread.line.high - thread.line.low) / (HIGH - LOW)
    assert slope <= STEEP * (1.0 + 1e-12)


def test_follows_the_axis_in_the_same_period():
    thread = in_force()
    assert thread.step(True, 0.0005, PERIOD) == pytest.approx(20e-6 + 1e-4 * 0.0005)


@pytest.mark.parametrize('position', [math.nan, math.inf])
def test_position_that_is_none_moves_nothing(position):
    thread = in_force()
    for _ in range(10):
        assert thread.step(True, position, PERIOD) == pytest.approx(20e-6)
    # it is another place when it is known again: there at the rate
    assert thread.step(True, 0.05, PERIOD) == pytest.approx(20e-6 + RATE * PERIOD)


def test_leap_of_the_position_moves_at_the_rate():
    thread = in_force()
    assert thread.step(True, -0.3, PERIOD) == pytest.approx(20e-6 - RATE * PERIOD)
    for _ in range(1000):
        thread.step(True, -0.3, PERIOD)
    assert thread.line.value == pytest.approx(-10e-6)


def test_offset_stays_in_joint_mode():
    """What is asked for meanwhile comes at the rate when the mode is left."""
    thread = in_force()
    thread.aim(0.0, 0.0, 0.0)
    for place in np.linspace(0.0, -0.3, 500):
        assert thread.step(False, place, PERIOD) == pytest.approx(20e-6)
    assert thread.step(True, -0.3, PERIOD) == pytest.approx(20e-6 - RATE * PERIOD)


def test_nothing_is_left_of_a_dropped_line():
    thread = in_force()
    thread.drop()
    assert [thread.step(True, 0.05, PERIOD), thread.at(LOW), thread.at(HIGH)] == [0.0] * 3


@pytest.mark.parametrize('ends', [(0.0, 0.0), (0.1, -0.1), (-1e99, 1e99), (math.nan, 1.0)])
def test_without_a_travel_there_is_no_slope(ends):
    thread = OffsetThread(LIMITS, *ends)
    thread.aim(20e-6, 1e-4, 0.0)
    for _ in range(1000):
        thread.step(True, 0.05, PERIOD)
    assert thread.line.value == pytest.approx(20e-6)


@pytest.mark.slow
def test_component_builds(tmp_path):
    if shutil.which('halcompile') is None:
        pytest.skip('halcompile is not installed (Debian: apt-get install linuxcnc-uspace-dev)')
    for name in ('fuzzycnc_offset.comp', HEADER.name):
        shutil.copy(HEADER.with_name(name), tmp_path)
    subprocess.run(
        ['halcompile', '--compile', 'fuzzycnc_offset.comp'], cwd=tmp_path, check=True, timeout=120
    )
    assert (tmp_path / 'fuzzycnc_offset.so').exists()

# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Controlled axes that their machine clamps: no period is missed until it drives them again."""

import numpy as np
from benches.servo_bench import Axis

from fuzzycnc_ros.runtime.enums import ServoStatus
from fuzzycnc_ros.runtime.records import SECOND, AxisState


def clamp(axis):
    """Tell the controller that no axis is driven any more."""
    nothing = np.zeros(0)
    state = AxisState(
        stamp=axis.now,
        frame_id='mill/workpiece',
        axis=(),
        reference=nothing,
        position=nothing,
        velocity=nothing,
    )
    assert axis.push('axis_state', state)
    axis.emitted += axis.merger.advance(axis.now)


def test_clamped_axes_are_not_missed_and_taken_over_again():
    axis = Axis()
    axis.go(X=0.001)
    axis.run(0.5)
    first = axis.records('axis_command')[-1].epoch
    clamp(axis)
    assert axis.component.next_deadline is None
    assert axis.state.status == ServoStatus.INACTIVE
    axis.duty['X'] = 0.0
    axis.now += 100 * SECOND
    axis.run(0.2)
    assert axis.records('axis_command')[-1].epoch > first
    assert axis.state.status == ServoStatus.RESTING
    assert axis.state.missed == 0
    assert abs(axis.place() - 0.001) < 3e-6


def test_silence_without_a_word_is_a_fault_still():
    axis = Axis()
    axis.run(0.1)
    axis.now += SECOND
    axis.tick()
    assert axis.state.status == ServoStatus.FAULT


def test_clamping_mends_no_fault():
    axis = Axis()
    axis.run(0.1)
    axis.now += SECOND
    axis.tick()
    clamp(axis)
    axis.now += 1_000_000
    axis.run(0.01)
    assert axis.state.status == ServoStatus.FAULT

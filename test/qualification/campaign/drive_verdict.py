# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""What a recording shows of driven axes: how far and fast they went, and who answered for it."""

from bisect import bisect_left
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from campaign.evidence import Evidence, Recorded, Window
from campaign.measured import MICRO, Measured, changes
from campaign.path_verdict import END_PERIODS, MOVING_PERIODS
from campaign.scenario import RESTING, SERVO, Ends, Scenario
from fuzzycnc_ros.runtime.enums import ServoStatus
from fuzzycnc_ros.runtime.records import SECOND, Floats

GOAL = 0.04
"""The axis is sent back and forth between this and minus this [m]."""
TRAVEL = (-0.1, 0.1)
"""Ends of its travel, beyond which the machine side lets nothing drive it [m]."""
SPAN = 10
"""Periods over which speed is measured: what a count of the sensor adds is small then."""
SAME = 1e-12
"""Difference up to which what arrived is what was sent."""
PERIOD = SERVO.period


def measure_drive(scenario: Scenario, window: Window, evidence: Evidence) -> Measured | None:
    """Judge how axes were driven; None if too little was recorded.

    The machine side says where the axes really are, whatever arrives at the controller.
    """
    states = window.of(evidence.sent('axis_state'), before=1)
    if len(states) <= SPAN:
        return None
    found = Measured()
    time = np.array([item.record.stamp for item in states], dtype=np.int64)
    place = np.array([item.record.position[0] for item in states])
    if not np.isfinite(place).all():
        found.why.append('an axis is nowhere')
        return found
    low, high = TRAVEL
    if place.min() < low or place.max() > high:
        worst = max(low - place.min(), place.max() - high) / MICRO
        found.why.append(f'{worst:.0f} um beyond the travel')
    beyond = max(float(np.abs(place).max()) - GOAL, 0.0)
    found.worst_offset_um = round(beyond / MICRO, 3)
    found.worst_step_um = round(float(np.abs(np.diff(place)).max()) / MICRO, 3)
    speed = _speed(time, place)
    if speed.max() > scenario.speed_max:
        found.why.append(
            f'moves at {speed.max():.4f} m/s, at most {scenario.speed_max:.4f} m/s is allowed'
        )
    told = window.of(evidence.sent('servo_state'))
    found.told = changes(ServoStatus(item.record.status).name for item in told)
    led = _led(scenario, states, evidence)
    moving = speed > RESTING
    found.time_to_safe_s = round(_longest(time, moving & ~led), 3)
    if found.time_to_safe_s > scenario.stated:
        found.why.append(
            f'moves for {found.time_to_safe_s:g} s while nobody answers for it, stated '
            f'{scenario.stated:g} s'
        )
    working = (moving & led)[-END_PERIODS:]
    if scenario.ends is Ends.FOLLOWS and working.sum() < MOVING_PERIODS:
        found.why.append('is not driven again')
    return found


def _speed(time: NDArray[np.int64], place: Floats) -> Floats:
    """Return the speed over the last periods at each sample, 0 before there are so many [m/s]."""
    elapsed = (time[SPAN:] - time[:-SPAN]) / SECOND
    return np.concatenate([np.zeros(SPAN), np.abs(place[SPAN:] - place[:-SPAN]) / elapsed])


def _led(scenario: Scenario, states: Sequence[Recorded], evidence: Evidence) -> NDArray[np.bool_]:
    """Say of each sample whether a command in force answers for the axis.

    Where what is false has to be found out, a command that is false does not, nor one that
    answers a false reading.
    """
    arrived = evidence.records['axis_command']
    sent = {item.record.stamp: item.record.duty for item in evidence.sent('axis_command')}
    read = {item.record.stamp: item.record.position for item in evidence.records['axis_state']}
    found = np.zeros(len(states), dtype=bool)
    for row, item in enumerate(states):
        count = bisect_left(arrived, item.place, key=lambda one: one.place)
        if not count:
            continue
        command = arrived[count - 1].record
        valid = item.record.stamp <= command.valid_until and np.isfinite(command.duty).all()
        if valid and scenario.found:
            valid = _same(command.duty, sent.get(command.stamp)) and _same(
                read.get(item.record.stamp, item.record.position), item.record.position
            )
        found[row] = valid
    return found


def _same(arrived: Floats, sent: Any) -> bool:
    return sent is not None and bool(np.abs(arrived - sent).max(initial=0.0) <= SAME)


def _longest(time: NDArray[np.int64], wrong: NDArray[np.bool_]) -> float:
    """Return the longest time for which something was wrong without a break [s]."""
    longest, since = 0, int(time[0])
    for stamp, bad in zip(time.tolist(), wrong.tolist(), strict=True):
        if bad:
            longest = max(longest, stamp - since)
        else:
            since = stamp
    return longest / SECOND

# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""What a recording shows of offsets: how large, how fast, and what stood behind them."""

from bisect import bisect_left
from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import numpy as np

from campaign.evidence import Evidence, Recorded, Window
from campaign.measured import MICRO, Measured, changes, largest
from campaign.rogue_nodes import FORGED, STRANGER
from campaign.scenario import (
    BY_COMPENSATOR,
    BY_MACHINE,
    LIMITS,
    MACHINE,
    Ends,
    Scenario,
)
from fuzzycnc_ros.core.inputs.offset_input import OffsetStatus
from fuzzycnc_ros.runtime.enums import CompensationState
from fuzzycnc_ros.runtime.records import SECOND

ROUNDING = 1e-12
"""What may be lost in sums of offsets [m]."""
GAP = 10.0 * MACHINE.tick_period
"""Machine time [s] without a tick from which on a recording has a gap."""
END_TICKS, FOLLOWING_TICKS = 40, 5
"""At the end of a scenario, ticks among which so many in a row must follow: at hundreds of times
real time a busy computer alone makes an error late now and then, for which it is held."""
FRESH = LIMITS.stale_after + LIMITS.period + 2.0 * MACHINE.tick_period
"""Age of a thermal error [s of machine time] up to which following it is safe."""


def measure_offsets(scenario: Scenario, window: Window, evidence: Evidence) -> Measured | None:
    """Judge what the machine was told and what it applied; None if too little was recorded."""
    read = [r for r in evidence.sent('compensation_applied') if r.record.epoch != FORGED]
    applied = window.of(read, before=1)
    if len(applied) < 2:
        return None
    found = Measured()
    told = [r for r in evidence.sent('compensation') if r.record.source != STRANGER]
    found.why += _limits(applied, MACHINE.offset_max, MACHINE.slew_max, 'applied')
    for stream in streams(window.of(told, before=1)):
        found.why += _limits(stream, LIMITS.offset_max, LIMITS.slew_max, 'told')
    _measure(found, applied, window.of(told))
    safe = _safety(applied, told, evidence.sent('thermal_error'))
    found.why += _times(found, scenario, applied, safe)
    found.why += _ending(scenario, applied[-END_TICKS:], safe[-END_TICKS:])
    return found


def streams(told: Sequence[Recorded]) -> list[list[Recorded]]:
    """Tell publishers of one topic apart by their numbers, and what was told as one owner."""
    found: list[list[Recorded]] = []
    for item in told:
        own = [s for s in found if s[-1].sequence < item.sequence]
        nearest = max(own, key=lambda s: s[-1].sequence, default=None)
        if nearest is None or nearest[-1].record.epoch != item.record.epoch:
            found.append([item])
        else:
            nearest.append(item)
    return found


def _limits(items: Sequence[Recorded], offset_max: float, slew_max: float, what: str) -> list[str]:
    """Say where offsets exceed clamp or slew limit, each kind of fault once."""
    wrong: dict[str, str] = {}
    for item in items:
        offset = item.record.offset
        at = f'at {item.record.stamp / SECOND:.1f} s'
        if not np.isfinite(offset).all():
            wrong.setdefault('finite', f'{what} offset is not finite {at}')
        elif np.abs(offset).max(initial=0.0) > offset_max:
            worst = np.abs(offset).max() / MICRO
            wrong.setdefault('size', f'{what} offset of {worst:.2f} um {at} exceeds the clamp')
    for before, after in pairwise(items):
        elapsed = (after.record.stamp - before.record.stamp) / SECOND
        if after.record.axis != before.record.axis:
            wrong.setdefault('axes', f'{what} offsets are of other axes: who else is there?')
            continue
        if elapsed < 0.0:
            if what == 'applied' and after.record.offset.any():
                wrong.setdefault('life', 'a machine that was started anew has offsets')
            continue
        step = np.abs(after.record.offset - before.record.offset).max(initial=0.0)
        if not step <= slew_max * elapsed + ROUNDING:
            text = f'{what} offset moved by {step / MICRO:.2f} um in {elapsed:.3f} s'
            wrong.setdefault('slew', f'{text} at {after.record.stamp / SECOND:.1f} s')
    return list(wrong.values())


def _measure(found: Measured, applied: Sequence[Recorded], told: Sequence[Recorded]) -> None:
    found.worst_offset_um = largest(np.abs(item.record.offset) for item in applied)
    found.worst_step_um = largest(
        np.abs(after.record.offset - before.record.offset)
        for before, after in pairwise(applied)
        if after.record.stamp >= before.record.stamp and after.record.axis == before.record.axis
    )
    found.told = changes(CompensationState(item.record.state).name for item in told)


def _safety(
    applied: Sequence[Recorded], told: Sequence[Recorded], errors: Sequence[Recorded]
) -> list[bool]:
    """Say of each tick whether the machine is at zero or follows a fresh, valid error."""
    found = []
    valid = [item for item in errors if item.record.valid]
    for item in applied:
        now = item.record.stamp
        command, error = _newest(told, item.place), _newest(valid, item.place)
        fresh = error is not None and now - error.stamp <= FRESH * SECOND
        follows = (
            item.record.status == OffsetStatus.FOLLOWING
            and command is not None
            and command.state == CompensationState.ACTIVE
            and now < command.valid_until
            and fresh
        )
        found.append(follows or not item.record.offset.any())
    return found


def _newest(items: Sequence[Recorded], place: int) -> Any:
    count = bisect_left(items, place, key=lambda item: item.place)
    return items[count - 1].record if count else None


def _times(
    found: Measured, scenario: Scenario, applied: Sequence[Recorded], safe: Sequence[bool]
) -> list[str]:
    """Measure how long the machine was out of a safe state, and say where that was too long.

    A command that holds is the compensator's affair: on a busy computer an error may be late at
    any time. The machine side answers for the time in which it follows none, in all scenarios.
    """
    following = [item.record.status == OffsetStatus.FOLLOWING for item in applied]
    alone = [now or led for now, led in zip(safe, following, strict=True)]
    by_itself = _longest_unsafe(applied, alone, scenario.loses)
    in_all = _longest_unsafe(applied, safe, scenario.loses)
    own = scenario.stated <= BY_MACHINE
    found.time_to_safe_s = round(by_itself if own else in_all, 1)
    why = []
    if by_itself > BY_MACHINE:
        why.append(
            f'out of a safe state for {by_itself:g} s without a command, stated {BY_MACHINE:g} s'
        )
    stated = max(scenario.stated, BY_COMPENSATOR)
    if in_all > stated:
        why.append(f'out of a safe state for {in_all:g} s, stated {stated:g} s')
    return why


def _longest_unsafe(applied: Sequence[Recorded], safe: Sequence[bool], gaps: bool) -> float:
    """Return the longest machine time [s] from leaving a safe state to the next one.

    With `gaps` nothing is known of times in which nothing was recorded.
    """
    longest, since = 0.0, applied[0].record.stamp
    before = since
    for item, is_safe in zip(applied, safe, strict=True):
        now = item.record.stamp
        if now < since or (gaps and now - before > GAP * SECOND):
            since = now
        longest = max(longest, (now - since) / SECOND if not is_safe else 0.0)
        if is_safe:
            since = now
        before = now
    return longest


def _ending(scenario: Scenario, applied: Sequence[Recorded], safe: Sequence[bool]) -> list[str]:
    last = applied[-1].record
    if scenario.ends is Ends.FOLLOWS:
        row = longest = 0
        for item, is_safe in zip(applied, safe, strict=True):
            row = row + 1 if is_safe and item.record.offset.any() else 0
            longest = max(longest, row)
        if longest < FOLLOWING_TICKS:
            return [f'does not follow again: {last.reason or "no command is followed"}']
        return []
    if scenario.ends is Ends.ZERO and last.offset.any():
        return [f'ends with offsets of {largest([np.abs(last.offset)]):g} um, not at zero']
    return [] if safe[-1] else ['does not end in a safe state']

# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""A bridge to any control that takes offsets as lines K0 + slope (x - P0), by a hand-shake."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Generic, TypeVar

import numpy as np

from fuzzycnc_ros.adapters.controller_bridge import (
    CLOSE,
    SETTLING,
    ControllerBridge,
    ControllerBridgeConfig,
)
from fuzzycnc_ros.adapters.opcua.hand_shake import HandShake, WriterWatch
from fuzzycnc_ros.adapters.opcua.offset_lines import LineOrders, LineStatus
from fuzzycnc_ros.core.config import param
from fuzzycnc_ros.core.inputs.lines import Lines, Travel
from fuzzycnc_ros.core.inputs.offsets import describe
from fuzzycnc_ros.runtime.component import Emission
from fuzzycnc_ros.runtime.records import Bools, Floats, nanoseconds

MOTION = 0.01
"""Largest motion of an axis between the readings of its position and its offset [m]."""


@dataclass(frozen=True, kw_only=True)
class LineBridgeConfig(ControllerBridgeConfig):
    """Parameters of a bridge to a control that takes lines."""

    cycle_period: float = param(
        0.1, 's', 'Time between two exchanges with the control', low=0.01, high=1.0
    )
    validity: float = param(
        10.0,
        's',
        'How long the control may follow a set without a newer one',
        low=1.0,
        high=3600.0,
    )
    acknowledge_time: float = param(
        2.0, 's', 'How long the control may take to acknowledge a set', low=0.05, high=60.0
    )
    takeover_time: float = param(
        1.0,
        's',
        "Silence of other writers before this bridge takes over; below the control's watchdog "
        'time',
        low=0.1,
        high=60.0,
    )


LineConfigT = TypeVar('LineConfigT', bound=LineBridgeConfig)


class LineBridge(ControllerBridge[LineConfigT, LineStatus, LineOrders], Generic[LineConfigT]):
    """Guard the lines at the ends of the travel, hand them over, tell what is applied."""

    CONTROLLER = 'the control'
    CONFIG = LineBridgeConfig

    def __init__(self, config: LineConfigT | None = None) -> None:
        self._theirs = np.inf  # the slew limit of the control [m/s]
        super().__init__(config)
        size = len(self._axes)
        self._hand_shake = HandShake(self._config.validity)
        self._writers = WriterWatch(self._config.takeover_time)
        self._narrowed = np.zeros(size, bool)
        self._still = np.zeros(size)
        self._last = np.zeros(size)

    @property
    def moving(self) -> bool:
        """True while the control moves towards the newest command."""
        status, orders = self._status, self._orders
        if status is None or orders is None:
            return False
        return self._hand_shake.waits(self._time) > 0.0 or bool(np.any(self._apart(status)))

    @property
    def at_rest(self) -> bool:
        """True if it is inactive and the control has gone to zero, and said so."""
        status, lines = self._status, self._hand_shake.lines
        if self._active or not self._holding or status is None:
            return not self._active
        zero = lines is not None and not (np.any(lines.offset) or np.any(lines.slope))
        gone = not status.ready or not np.any(np.abs(status.applied) > self._close(status))
        return zero and gone and self._hand_shake.acknowledged(status)

    @property
    def wants_control(self) -> bool:
        """True if it is time to take hold: active without it, and no other writer."""
        status = self._status
        if status is None or not self._active or self._holding:
            return False
        return self._writers.free(self._time, status)

    def take_control(self) -> None:
        """Note that the hand-shake is this bridge's; go on from the offsets in force."""
        status = self._status
        assert status is not None, 'hold is taken after the control has been read'
        self._holding = True
        self._hand_shake.begin(self._time, status)
        self._resume(status)
        self._order(status)

    def refusal(self) -> str:
        """Say why the bridge must not be activated now; empty if it may."""
        status = self._status
        if status is None or self._holding:
            return ''
        if self._writers.other:
            return f'the control is written by {self._writers.other}; end it first'
        closed = [
            axis
            for axis, most in zip(self._axes, status.limits.offset_max, strict=True)
            if not most > 0.0
        ]
        if closed:
            return (
                f'the control takes no offset on {", ".join(closed)}: its own limit is zero; '
                'raise it there, or leave the axis out'
            )
        return ''

    def observe(self, stamp: int, status: LineStatus) -> Iterator[Emission]:
        """Take what was read at `stamp` [ns]; decide what to write, yield what is to be told."""
        before = self._time
        self._work_at(stamp)
        self._status, self._absent, self._last = status, '', status.applied
        self._look_for_others(status)
        # A control that heard nobody for so long may have gone elsewhere, and not say so.
        paused = self._time - before > nanoseconds(self._config.takeover_time)
        gone = paused and bool(np.any(self._apart(status)))
        if paused:
            self._hand_shake.await_no_more()
        if not self._leads or gone or self._theirs != status.limits.slew_max:
            self._resume(status)
        why = self._forbidden(status)
        self._input.allow(not why or not self._leads, why)
        self._input.advance(self._time)
        if self._holding:
            self._order(status)
            if not self._active and self.at_rest:
                self._holding, self._orders = False, None
        self._watch(status)
        yield from self._tell(status, why)

    def _left(self) -> Floats:
        """Return what was read last: the control goes on without a connection."""
        return self._last

    def _travel_of(self, status: LineStatus) -> Travel:
        return status.limits.travel

    def _flat(self, axes: str) -> str:
        return 'give slope, reference_position and travel in the control file, or command no slope'

    @property
    def _slew_max(self) -> float:
        return min(self._config.slew_max, max(self._theirs, 1e-9))

    @property
    def _leads(self) -> bool:
        """True if the control follows this bridge."""
        status = self._status
        if not self._holding or status is None or not status.alive or self._late:
            return False
        return status.ready or bool(np.any(np.abs(status.applied) > self._close(status)))

    @property
    def _late(self) -> bool:
        """True if the control should have acknowledged the newest set by now."""
        return self._hand_shake.waits(self._time) > self._config.acknowledge_time

    def _look_for_others(self, status: LineStatus) -> None:
        """Let go at once if somebody else writes."""
        ours = self._hand_shake.sequence != 0 and self._hand_shake.wrote(status)
        self._writers.look(self._time, status, ours=ours)
        if self._holding and not ours:
            self._holding, self._orders = False, None
            self._hand_shake.forget()
            self._writers.collide(self._time)

    def _resume(self, status: LineStatus) -> None:
        """Go on from what is in force."""
        lines = Lines.constant(np.where(np.isfinite(status.applied), status.applied, 0.0))
        if self._stands(status):
            lines = status.lines
        self._theirs = status.limits.slew_max
        self._adopt(lines, status)

    def _stands(self, status: LineStatus) -> bool:
        """Return True if the control follows the lines in its variables, as far as can be seen."""
        lines = status.lines
        numbers = (lines.offset, lines.slope, lines.reference_position)
        if not all(np.all(np.isfinite(item)) for item in numbers) or not status.alive:
            return False
        if status.sequence == 0 or status.acknowledged != status.sequence:
            return False
        idle = np.isnan(lines.at(status.position)) & (status.applied == 0.0)
        return not np.any(idle | self._away(status, lines))

    def _most(self, status: LineStatus) -> Floats:
        """Return the smaller of our limits and those of the control [m]."""
        theirs = np.maximum(status.limits.offset_max, 0.0)
        return np.minimum(self._config.offset_max, theirs)

    def _order(self, status: LineStatus) -> None:
        """Set what to write."""
        wanted = self._input.applied
        most = np.tile(self._most(status), 2)
        ends = np.clip(wanted, -most, most)  # their limit may have sunk since the command
        self._narrowed = np.any(np.split(ends != wanted, 2), axis=0)
        lines = status.limits.travel.lines(ends, self._reference)
        self._orders = self._hand_shake.orders(lines, ends, status, self._time)

    def _forbidden(self, status: LineStatus) -> str:
        """Say why commands are not followed now; empty if they are."""
        if not self._active:
            return 'the bridge is not active'
        if not self._holding:
            if self._writers.other:
                return (
                    f'two writers: the control is written by {self._writers.other}, not by this '
                    'bridge; end all but one'
                )
            return 'looking for other writers to the control'
        if status.obstacle:
            return status.obstacle
        if self._late:
            return (
                f'set {self._hand_shake.sequence} has not been acknowledged within '
                f'{self._config.acknowledge_time:g} s (the control is at {status.acknowledged}); '
                'does its program run'
            )
        if not status.alive:
            return (
                'the watchdog of the control hears no bridge; does its program see the heartbeat'
            )
        return self.sources.refusal('compensation')

    def _close(self, status: LineStatus) -> Floats:
        """Return the difference that counts as none on each axis [m]."""
        return np.maximum(CLOSE, status.limits.resolution)

    def _apart(self, status: LineStatus) -> Bools:
        """Return True for each axis that has not reached the set; False where that is unknown."""
        lines = self._hand_shake.lines
        if lines is None or not self._holding:
            return np.zeros(len(self._axes), bool)
        return self._away(status, lines)

    def _away(self, status: LineStatus, lines: Lines) -> Bools:
        """Return True for each axis that is not where lines put it."""
        apart = np.abs(status.applied - lines.at(status.position))
        near = self._close(status) + MOTION * np.abs(lines.slope)
        return np.asarray(apart > near, bool)

    def _watch(self, status: LineStatus) -> None:
        """Note since when the control has stood still where it should not."""
        still = np.all(np.abs(status.applied - self._still) <= 0.1 * self._close(status))
        if not (status.ready and np.any(self._apart(status))) or not still:
            self._apart_since, self._still = None, status.applied
        elif self._apart_since is None:
            self._apart_since = self._time

    def _cut(self, status: LineStatus) -> Bools:
        """Return True for each axis whose offset a limit cuts: ours, or that of the control."""
        full = np.abs(status.applied) >= status.limits.offset_max * (1.0 - 1e-6)
        guarded = (self._clipped | self._narrowed) & self._leads
        return np.asarray(guarded | (full & self._apart(status)), bool)

    def _limited(self, status: LineStatus) -> Bools:
        guard = np.any(np.split(self._input.at_limit, 2), axis=0)
        return np.asarray(guard | self._cut(status), bool)

    def _complaint(self, status: LineStatus) -> str:
        if self._apart_since is not None:
            if self._time - self._apart_since > nanoseconds(SETTLING):
                lines = self._hand_shake.lines
                assert lines is not None
                apart = self._apart(status)
                return (
                    f'the control stays at {describe(self._axes, status.applied, apart)} instead '
                    f'of {describe(self._axes, lines.at(status.position), apart)}'
                )
        return self._cut_text(status, self._clipped | self._narrowed)

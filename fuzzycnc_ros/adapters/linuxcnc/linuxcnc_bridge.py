# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Component `linuxcnc_bridge`: offsets into a running LinuxCNC, and what it really applies."""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from fuzzycnc_ros.adapters.controller_bridge import (
    CLOSE,
    NOTHING,
    SETTLING,
    ControllerBridge,
    ControllerBridgeConfig,
)
from fuzzycnc_ros.adapters.linuxcnc.status import (
    ControllerOutput,
    LinuxcncStatus,
    OffsetRegisters,
    RegisterPhase,
    ServoThreadLimits,
)
from fuzzycnc_ros.core.config import param
from fuzzycnc_ros.core.inputs.lines import Lines, Travel
from fuzzycnc_ros.core.inputs.offset_input import OffsetInputConfig
from fuzzycnc_ros.core.inputs.offsets import describe
from fuzzycnc_ros.runtime.component import Emission
from fuzzycnc_ros.runtime.records import Bools, Floats, nanoseconds

END_MAX = 1e-3
"""Largest offset that a line may have at an end of the travel [m]."""


@dataclass(frozen=True, kw_only=True)
class LinuxcncBridgeConfig(ControllerBridgeConfig):
    """Parameters of `linuxcnc_bridge`."""

    axes: tuple[str, ...] = param(
        ('X', 'Y', 'Z'), '-', 'Axes that take offsets, as in the HAL file'
    )
    offset_max: float = param(
        60e-6, 'm', 'Largest offset of an axis; below that of the HAL file', low=1e-6, high=1e-3
    )
    slew_max: float = param(
        5e-6, 'm/s', 'Fastest change of an offset; below the HAL file', low=1e-9, high=1e-3
    )
    cycle_period: float = param(
        0.005, 's', 'Time between two looks at LinuxCNC', low=0.001, high=0.1
    )
    interpreter: str = param(
        '/usr/bin/python3', '-', "Python that LinuxCNC's modules hal and linuxcnc are built for"
    )


class LinuxcncBridge(ControllerBridge[LinuxcncBridgeConfig, LinuxcncStatus, ControllerOutput]):
    """Guard the offsets, bring LinuxCNC's registers there, tell what is applied."""

    NAME = 'linuxcnc_bridge'
    SUMMARY = (
        'A real machine in place of the simulated one: compensation into a running LinuxCNC by '
        'external offsets, and its read-back. Managed lifecycle.'
    )
    CONTROLLER = 'LinuxCNC'
    PROBE_OFFSET = True
    CONFIG = LinuxcncBridgeConfig

    def __init__(self, config: LinuxcncBridgeConfig | None = None) -> None:
        super().__init__(config)
        self._registers = OffsetRegisters(len(self._axes))

    @property
    def moving(self) -> bool:
        """True while LinuxCNC moves towards the newest command."""
        status, orders = self._status, self._orders
        if status is None or orders is None or not status.led:
            return False
        wanted = Lines(
            offset=orders.counts, slope=orders.slope, reference_position=orders.reference
        ).at(status.position)
        apart = np.clip(wanted, -orders.limit, orders.limit) - status.counts
        return bool(
            np.any(np.abs(apart) > 1.0) or np.any(np.abs(status.applied - status.register) > CLOSE)
        )

    @property
    def at_rest(self) -> bool:
        """True if it is inactive with nothing to take back: the pins may be let go."""
        status = self._status
        if self._active or not self._holding or status is None:
            return not self._active
        return not status.ready or not (
            np.any(self._input.applied)
            or np.any(status.counts)
            or np.any(np.abs(status.register) > CLOSE)
        )

    @property
    def wants_control(self) -> bool:
        """True if it is time to take the pins: active without them, and nothing else moves."""
        return self._active and not self._holding and self._registers.settled

    def take_control(self) -> None:
        """Note that the pins are this bridge's; go on from the offsets in force."""
        status = self._status
        assert status is not None, 'pins are taken after LinuxCNC has been read'
        self._holding = True
        self._registers.restart()
        self._resume(status)
        self._orders = self._output(status.standing, status)

    def refusal(self, limits: ServoThreadLimits, status: LinuxcncStatus) -> str:
        """Say why offsets must not be written with the limits of the HAL file; empty if fine."""
        if not (np.all(np.isfinite(status.scale)) and np.all(status.scale > 0.0)):
            return (
                'eoffset-scale: expected a positive number on every axis but found '
                f'{status.scale.tolist()} m; set [FUZZYCNC]SCALE'
            )
        for what, own, unit, theirs in (
            ('offset_max', self._config.offset_max, 'µm', limits.counts_max),
            ('slew_max', self._config.slew_max, 'µm/s', limits.counts_rate),
            ('slope_max', self._config.slope_max, 'µm/m', limits.slope or np.inf),
        ):
            least = theirs * float(np.min(status.scale))
            if own > least:
                return (
                    f'{what} = {1e6 * own:g} {unit} is above the {1e6 * least:g} {unit} of the '
                    'HAL file; lower it, or raise [FUZZYCNC]COUNTS_* or SLOPE_MAX'
                )
        return ''

    def observe(self, stamp: int, status: LinuxcncStatus) -> Iterator[Emission]:
        """Take what was read at `stamp` [ns]; decide what to write, yield what is to be told."""
        self._work_at(stamp)
        self._status, self._absent = status, ''
        if not self._holding:
            self._registers.look(status)
        found = self._holding and self._registers.observe(status)
        if found or not self._leads:
            # Others move or clear the registers: when that is over, go on from where they are.
            self._resume(status)
        why = self._forbidden(status)
        self._input.allow(not why or not self._leads, why)
        ends = self._input.advance(self._time)
        if self._holding:
            wanted = status.travel.lines(ends, self._reference)
            self._orders = self._output(wanted, status)
            if not self._active and self.at_rest:
                self._holding, self._orders = False, None
        self._watch(status)
        yield from self._tell(status, why)

    def _forget(self) -> None:
        self._registers = OffsetRegisters(len(self._axes))

    def _output(self, wanted: Lines, status: LinuxcncStatus) -> ControllerOutput:
        return self._registers.output(wanted, status, self._config.offset_max)

    def _most_at_ends(self, status: LinuxcncStatus) -> Floats:
        # The servo thread cuts at the place where the axis is.
        span = status.travel.high - status.travel.low
        return np.tile(self._most(status) + self._config.slope_max * span, 2)

    @property
    def _limits(self) -> OffsetInputConfig:
        # A command has been cut before; its ends may be larger than what stands anywhere.
        return replace(super()._limits, offset_max=END_MAX)

    def _travel_of(self, status: LinuxcncStatus) -> Travel:
        return status.travel

    def _flat(self, axes: str) -> str:
        status = self._status
        if status is None or status.lines is None:
            return (
                'its HAL file is fuzzycnc.hal; load fuzzycnc_offset.hal, whose component '
                '`fuzzycnc linuxcnc install` builds, or command no slope'
            )
        return f'give MIN_LIMIT and MAX_LIMIT of {axes} in the INI file, or command no slope'

    def _resume(self, status: LinuxcncStatus) -> None:
        """Go on from what the registers hold: the lines that stand, and their base."""
        standing = status.standing
        here = np.where(np.isnan(status.position), 0.0, status.position)
        base = status.register - standing.at(here) if status.base is None else status.base
        self._adopt(replace(standing, offset=standing.offset + base), status)

    @property
    def _leads(self) -> bool:
        """True if the registers follow this bridge."""
        return self._holding and self._registers.phase is not RegisterPhase.SETTLING

    def _forbidden(self, status: LinuxcncStatus) -> str:
        """Say why commands are not followed now; empty if they are."""
        if not self._active:
            return 'the bridge is not active'
        if not self._holding:
            return f'waiting for the counts, which {status.writer or "nobody"} writes'
        if status.obstacle:
            return status.obstacle
        if status.frozen:
            return (
                f'eoffset-enable is off: frozen at {describe(self._axes, status.applied) or "0"}; '
                'set the signal fuzzycnc-on'
            )
        if not status.alive:
            return 'the watchdog of the HAL file has let the offsets go; taking them up again'
        if self._registers.phase is RegisterPhase.SETTLING:
            return 'finding out what the registers hold'
        if self._registers.phase is not RegisterPhase.FOLLOWING:
            return (
                'counts of zero meant '
                f'{describe(self._axes, self._registers.base) or "zero"} (scale or enable changed '
                'with counts standing); ramping to zero to start anew'
            )
        return self.sources.refusal('compensation')

    def _leaving(self, status: LinuxcncStatus) -> str:
        return 'frozen, eoffset-enable is off' if status.frozen else super()._leaving(status)

    def _watch(self, status: LinuxcncStatus) -> None:
        """Note since when LinuxCNC has not been where its registers are."""
        apart = status.ready and (
            not status.tracking or np.any(np.abs(status.applied - status.register) > CLOSE)
        )
        if not apart:
            self._apart_since = None
        elif self._apart_since is None:
            self._apart_since = self._time

    def _cut(self, status: LinuxcncStatus) -> Bools:
        """Return True for each axis whose offset LinuxCNC itself cuts."""
        apart = np.abs(status.applied - status.register) > CLOSE
        return np.asarray(apart & status.soft_limited, bool)

    def _limited(self, status: LinuxcncStatus) -> Bools:
        guard = (self._beyond(status) | self._steep) & self._leads
        return np.asarray(guard | self._cut(status), bool)

    def _complaint(self, status: LinuxcncStatus) -> str:
        cut = self._cut(status)
        if np.any(cut):
            return (
                f'a soft limit cuts {describe(self._axes, status.register, cut)} to '
                f'{describe(self._axes, status.applied, cut)}; programs need the largest offset '
                'as a margin'
            )
        if self._apart_since is None or self._time - self._apart_since <= nanoseconds(SETTLING):
            return self._cut_text(status, self._beyond(status))
        standing = describe(self._axes, status.applied, np.abs(status.applied) > CLOSE)
        wanted = self._input_at(status)
        if np.all(np.abs(status.applied - wanted) <= CLOSE):
            return self._cut_text(status, self._beyond(status))
        return (
            f'LinuxCNC stays at {standing or "zero"} instead of '
            f'{describe(self._axes, wanted) or "zero"}; offsets do not move in joint mode'
        )

    def _input_at(self, status: LinuxcncStatus) -> Floats:
        """Return the offsets that the guard allows where the axes are [m]."""
        return np.clip(self._asked_at(status), -self._config.offset_max, self._config.offset_max)

    def _asked_at(self, status: LinuxcncStatus) -> Floats:
        """Return the offsets of the lines in force where the axes are [m]."""
        lines = self._lines_in_force(status)
        return lines.at(np.where(np.isnan(status.position), 0.0, status.position))

    def _beyond(self, status: LinuxcncStatus) -> Bools:
        """Return True for each axis whose line the size limit cuts here or at an end."""
        here = np.abs(self._asked_at(status)) > self._config.offset_max + NOTHING
        return np.asarray(here | self._clipped, bool)

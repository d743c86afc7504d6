# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Component `linuxcnc_bridge`: offsets into a running LinuxCNC, and what it really applies.

It stands where `simulated_machine` does, but a real controller makes the time: the host reads
LinuxCNC in every cycle, hands the status over, and writes what comes back.  What is published is
the read-back, never the command.
"""

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from fuzzycnc_ros.components.codes import AppliedStatus, MachineMode
from fuzzycnc_ros.components.command_sources import REQUEST, CommandSources
from fuzzycnc_ros.components.compensator import AXES
from fuzzycnc_ros.components.component import (
    Answer,
    Component,
    Emission,
    Health,
    Input,
    Level,
    Output,
)
from fuzzycnc_ros.components.linuxcnc_bridge_config import LinuxcncBridgeConfig
from fuzzycnc_ros.components.linuxcnc_status import (
    ControllerLimits,
    ControllerOutput,
    ControllerStatus,
    describe,
)
from fuzzycnc_ros.components.offset_register import OffsetRegisters, RegisterPhase
from fuzzycnc_ros.components.records import (
    Compensation,
    CompensationApplied,
    Floats,
    MachineState,
    nanoseconds,
)
from fuzzycnc_ros.core.machine.offset_input import OffsetInput, OffsetInputConfig

CLOSE = 0.2e-6
"""Difference between register and read-back that counts as none [m]; LinuxCNC leaves 0.3 nm."""
ON_THE_WAY = 0.02
"""Time between two reports while offsets move [s]."""
NOTHING = 1e-12
"""Offset that is the rounding of sums [m]."""
SETTLING = 2.0
"""How long LinuxCNC may take to go to its registers [s] before that is reported."""


class LinuxcncBridge(Component):
    """Guard the offsets, bring LinuxCNC's registers there, tell what is applied."""

    NAME = 'linuxcnc_bridge'
    SUMMARY = (
        'A real machine in place of the simulated one: compensation into a running LinuxCNC by '
        'external offsets, and its read-back. Managed lifecycle.'
    )
    CONFIG = LinuxcncBridgeConfig
    INPUTS = (Input('compensation', Compensation, sole=True),)
    OUTPUTS = (
        Output('machine_state', MachineState),
        Output('compensation_applied', CompensationApplied),
    )
    MANAGED = True
    _config: LinuxcncBridgeConfig

    def __init__(self, config: LinuxcncBridgeConfig | None = None) -> None:
        super().__init__(config)
        self._axes = self._config.axes
        unknown = [axis for axis in self._axes if axis not in AXES]
        if unknown or not self._axes or len(set(self._axes)) != len(self._axes):
            raise ValueError(
                f'axes: expected distinct names of {", ".join(AXES)} but found '
                f'{", ".join(self._axes) or "none"}'
            )
        self._sources = CommandSources(type(self))
        self._input = self._adopting(np.zeros(len(self._axes)), 0)
        self._registers = OffsetRegisters(len(self._axes))
        self._status: ControllerStatus | None = None
        self._absent = 'LinuxCNC has not been found yet'
        self._active = False
        self._holding = False  # whether the pins are this bridge's
        self._time = 0
        self._apart_since: int | None = None
        self._told: dict[str, tuple[int, tuple[Any, ...]]] = {}
        self._orders: ControllerOutput | None = None

    @property
    def orders(self) -> ControllerOutput | None:
        """What to write; None while the pins are not this bridge's."""
        return self._orders

    @property
    def moving(self) -> bool:
        """Whether LinuxCNC is on its way to what was written last."""
        status, orders = self._status, self._orders
        if status is None or orders is None or not status.led:
            return False
        return bool(
            np.any(orders.counts != status.counts)
            or np.any(np.abs(status.applied - status.register) > CLOSE)
        )

    @property
    def active(self) -> bool:
        """Whether it may write, as soon as it has the pins."""
        return self._active

    @property
    def holding(self) -> bool:
        """Whether the pins are this bridge's."""
        return self._holding

    @property
    def at_rest(self) -> bool:
        """Whether it is inactive and has nothing to take back: the pins may be let go."""
        status = self._status
        if self._active or not self._holding or status is None:
            return not self._active
        return not status.ready or not (
            np.any(self._input.applied)
            or np.any(status.counts)
            or np.any(np.abs(status.register) > CLOSE)
        )

    @property
    def wants_pins(self) -> bool:
        """Whether it is time to take the pins: active without them, and nothing else moves."""
        return self._active and not self._holding and self._registers.settled

    def take_pins(self) -> None:
        """Note that the pins are this bridge's; go on from the offsets in force."""
        status = self._status
        assert status is not None, 'pins are taken after LinuxCNC has been read'
        self._holding = True
        self._registers.restart()
        self._input = self._adopting(status.register, self._time)
        self._orders = ControllerOutput(counts=status.counts.copy())

    def on_compensation(self, command: Compensation) -> None:
        """Take an offset command; the offset input decides whether it is followed."""
        if not (self._active and self._leads):
            return
        self._input.command(
            command.epoch,
            command.axis,
            command.offset,
            command.slope,
            command.reference_position,
            stamp=command.stamp,
            valid_until=command.valid_until,
        )

    def on_request(self, name: str, arguments: Mapping[str, Any], stamp: int) -> Answer:
        """`activate` starts from the read-back; `deactivate` ramps to zero first."""
        if name == 'activate':
            if self._active:
                return Answer(False, 'already active')
            self._active = True
            return Answer(True, f'active; {self._absent}' if self._absent else 'active')
        if name == 'deactivate':
            if not self._active:
                return Answer(False, 'not active')
            self._active = False
            return Answer(True, 'ramping to zero')
        if name == REQUEST:
            return self._sources.note(arguments)
        return super().on_request(name, arguments, stamp)

    def refusal(self, limits: ControllerLimits, status: ControllerStatus) -> str:
        """Say why offsets must not be written with the limits of the HAL file; empty if fine."""
        if not (np.all(np.isfinite(status.scale)) and np.all(status.scale > 0.0)):
            return (
                'eoffset-scale: expected a positive number on every axis but found '
                f'{status.scale.tolist()} m; set [FUZZYCNC]SCALE'
            )
        for what, own, unit, theirs in (
            ('offset_max', self._config.offset_max, 'um', limits.counts_max),
            ('slew_max', self._config.slew_max, 'um/s', limits.counts_rate),
        ):
            least = theirs * float(np.min(status.scale))
            if own > least:
                return (
                    f'{what} = {1e6 * own:g} {unit} is above the {1e6 * least:g} {unit} of the '
                    'HAL file; lower it, or raise [FUZZYCNC]COUNTS_*'
                )
        return ''

    def observe(self, stamp: int, status: ControllerStatus) -> Iterator[Emission]:
        """Take what was read at `stamp` [ns]; decide what to write, yield what is to be told."""
        self._time = max(self._time, stamp)
        self._status, self._absent = status, ''
        if not self._holding:
            self._registers.look(status)
        found = self._holding and self._registers.observe(status)
        if found or not self._leads:
            # Others move or clear the registers: when that is over, go on from where they are.
            self._input = self._adopting(status.register, self._time, self._input.epoch)
        why = self._forbidden(status)
        self._input.allow(not why or not self._leads, why)
        wanted = self._input.advance(self._time, status.position)
        if self._holding:
            self._orders = self._registers.output(wanted, status)
            if not self._active and self.at_rest:
                self._holding, self._orders = False, None
        self._watch(status)
        yield from self._tell(status, why)

    def lose(self, stamp: int, why: str) -> Iterator[Emission]:
        """Note that LinuxCNC is gone: nothing is applied, nothing is known."""
        self._time = max(self._time, stamp)
        if not self._absent:
            self._told = {}
        self._status, self._absent = None, why
        self._holding, self._orders, self._apart_since = False, None, None
        self._registers = OffsetRegisters(len(self._axes))
        self._input.allow(False, why)
        nothing = np.full(len(self._axes), np.nan)
        if not self._due('absent', (why,)):
            return
        yield Emission(
            'machine_state', self._state(MachineMode.OFF, False, nothing, np.nan, False)
        )
        yield Emission(
            'compensation_applied',
            self._applied(AppliedStatus.REFUSED, why, np.zeros_like(nothing), nothing > 0.0),
        )

    def health(self) -> list[Health]:
        """Report the controller, the offsets in force, and why a command was refused."""
        found = self._sources.health()
        status = self._status
        if status is None:
            return [Health('linuxcnc', Level.ERROR, self._absent), *found]
        values = {
            f'offset {axis} [um]': f'{1e6 * offset:.2f}'
            for axis, offset in zip(self._axes, status.applied, strict=True)
        }
        code, reason = self._verdict(status, self._forbidden(status))
        owned = self._active or not np.any(np.abs(status.applied) > CLOSE)
        level = (Level.WARN if reason else Level.OK) if owned else Level.ERROR
        return [
            Health('linuxcnc', Level.OK, status.mode.name.lower()),
            Health('compensation', level, reason or code.name.lower(), values),
            *found,
        ]

    def _adopting(self, offset: Floats, time: int, epoch: int = 0) -> OffsetInput:
        """Return an offset input that has `offset` [m] in force at `time` [ns].

        It is told so by a command that began so long ago that the offsets have got there.
        """
        config = OffsetInputConfig(
            offset_max=self._config.offset_max,
            slew_max=self._config.slew_max,
            lead_max=self._config.lead_max,
        )
        begin = time - nanoseconds(1.0 + 1.01 * config.offset_max / config.slew_max)
        fresh = OffsetInput(self._axes, config, start=begin)
        offset = np.where(np.abs(offset) > NOTHING, offset, 0.0)
        if epoch or np.any(offset):
            until = time + max(nanoseconds(self._config.adopt_time), 1)
            fresh.command(max(epoch, 1), self._axes, offset, stamp=begin, valid_until=until)
        fresh.advance(time)
        return fresh

    @property
    def _leads(self) -> bool:
        """Whether the registers go where this bridge says."""
        return self._holding and self._registers.phase is not RegisterPhase.SETTLING

    def _forbidden(self, status: ControllerStatus) -> str:
        """Say why commands are not followed now; empty if they are."""
        if not self._active:
            return 'the bridge is not active'
        if not self._holding:
            return f'waiting for the counts, which {status.writer or "nobody"} writes'
        if not status.ready:
            return 'machine is not homed' if not status.homed else f'machine is {_word(status)}'
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
        return self._sources.refusal('compensation')

    def _watch(self, status: ControllerStatus) -> None:
        """Note since when LinuxCNC has not been where its registers are."""
        apart = status.ready and np.any(np.abs(status.applied - status.register) > CLOSE)
        if not apart:
            self._apart_since = None
        elif self._apart_since is None:
            self._apart_since = self._time

    def _cut(self, status: ControllerStatus) -> Any:
        """Whether LinuxCNC itself cuts the offset of each axis."""
        apart = np.abs(status.applied - status.register) > CLOSE
        return apart & status.soft_limited

    def _verdict(self, status: ControllerStatus, why: str) -> tuple[AppliedStatus, str]:
        """Return what is told of the commands, and why."""
        standing = describe(self._axes, status.applied, np.abs(status.applied) > CLOSE)
        if not self._active:
            if not standing:
                return AppliedStatus.IDLE, ''
            owner = f'written by {status.writer}' if status.writer else 'nobody owns it'
            if self._holding:
                owner = 'frozen, eoffset-enable is off' if status.frozen else 'ramping to zero'
            return AppliedStatus.REFUSED, f'inactive while {standing} stands: {owner}'
        if why:
            return AppliedStatus.REFUSED, f'{why}; in force: {standing or "nothing"}'
        cut = self._cut(status)
        if np.any(cut):
            return (
                AppliedStatus(int(self._input.status)),
                f'a soft limit cuts {describe(self._axes, status.register, cut)} to '
                f'{describe(self._axes, status.applied, cut)}; programs need the largest offset '
                'as a margin',
            )
        if self._apart_since is not None:
            if self._time - self._apart_since > nanoseconds(SETTLING):
                return (
                    AppliedStatus(int(self._input.status)),
                    f'LinuxCNC stays at {standing or "zero"} instead of '
                    f'{describe(self._axes, status.register) or "zero"}; offsets do not move in '
                    'joint mode',
                )
        return AppliedStatus(int(self._input.status)), self._input.reason

    def _due(self, what: str, news: tuple[Any, ...], spacing: float = 0.0) -> bool:
        """Whether to tell something: news, not sooner than `spacing` [s], or nothing for long."""
        told_at, told = self._told.get(what, (None, ()))
        if told_at is not None:
            wait = spacing if news != told else self._config.report_period
            if self._time - told_at < nanoseconds(wait):
                return False
        self._told[what] = (self._time, news)
        return True

    def _tell(self, status: ControllerStatus, why: str) -> Iterator[Emission]:
        code, reason = self._verdict(status, why)
        allowed = self._active and not why
        if self._due('machine_state', (status.mode, status.homed, allowed)):
            state = self._state(
                status.mode, status.homed, status.position, status.spindle_speed, allowed
            )
            yield Emission('machine_state', state)
        limited = self._input.at_limit | self._cut(status)
        # Differences below a nanometre are LinuxCNC's own rounding.
        offsets = np.rint(1e9 * status.applied).tobytes()
        cause = (code, reason.partition(';')[0], limited.tobytes(), self._input.epoch)
        changed = cause != self._told.get('applied', (0, ((),)))[1][0]
        # On the way there a read-back is told now and then, at its end at once.
        spacing = ON_THE_WAY if self.moving and not changed else 0.0
        if self._due('applied', (cause, offsets), spacing):
            told = self._applied(code, reason, status.applied, limited)
            yield Emission('compensation_applied', told)

    def _state(
        self, mode: MachineMode, homed: bool, position: Floats, speed: float, allowed: bool
    ) -> MachineState:
        return MachineState(
            stamp=self._time,
            frame_id=self.frame('machine'),
            state=int(mode),
            homed=homed,
            offsets_allowed=allowed,
            cold_since=0,
            spindle_speed=speed,
            axis=self._axes,
            position=position,
        )

    def _applied(
        self, code: AppliedStatus, reason: str, offset: Floats, at_limit: Any
    ) -> CompensationApplied:
        return CompensationApplied(
            stamp=self._time,
            frame_id=self.frame('machine'),
            epoch=self._input.epoch,
            status=int(code),
            reason=reason,
            axis=self._axes,
            offset=np.asarray(offset, np.float64).copy(),
            at_limit=np.asarray(at_limit, bool),
        )


def _word(status: ControllerStatus) -> str:
    """Return the operating state in words."""
    words = {MachineMode.ESTOP: 'in emergency stop', MachineMode.FAULT: 'in a fault'}
    return words.get(status.mode, 'off')

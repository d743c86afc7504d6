# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Component `linuxcnc_bridge`: offsets into a running LinuxCNC, and what it really applies.

It stands where `simulated_machine` does, but a real controller makes the time: the host reads
LinuxCNC in every cycle, hands the status over, and writes what comes back.  What is published is
the read-back, never the command.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
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
from fuzzycnc_ros.core.config import Config, param
from fuzzycnc_ros.core.machine.offset_input import OffsetInput, OffsetInputConfig

CLOSE = 0.2e-6
"""Difference between register and read-back that counts as none [m]; LinuxCNC leaves 0.3 nm."""
SETTLING = 2.0
"""How long LinuxCNC may take to go to its registers [s] before that is reported."""
_ADOPTED = 'offsets in force before'


@dataclass(frozen=True, kw_only=True)
class LinuxcncBridgeConfig(Config):
    """Parameters of `linuxcnc_bridge`."""

    autostart: bool = param(
        False, '-', 'Configure and activate at start; otherwise a lifecycle manager does'
    )
    axes: tuple[str, ...] = param(
        ('X', 'Y', 'Z'), '-', 'Axes that take offsets, as in the HAL file'
    )
    offset_max: float = param(
        60e-6, 'm', 'Largest offset of an axis; below that of the HAL file', low=1e-6, high=1e-3
    )
    slew_max: float = param(
        5e-6, 'm/s', 'Fastest change of an offset; below the HAL file', low=1e-9, high=1e-3
    )
    lead_max: float = param(
        5.0, 's', 'How far ahead of the machine a command may be stamped', low=0.0, high=3600.0
    )
    adopt_time: float = param(
        120.0,
        's',
        'How long offsets that stand at the activation are kept while no command comes',
        low=0.0,
        high=7200.0,
    )
    cycle_period: float = param(
        0.005, 's', 'Time between two looks at LinuxCNC', low=0.001, high=0.1
    )
    report_period: float = param(
        0.2, 's', 'Time between two reports while nothing changes', low=0.01, high=10.0
    )
    interpreter: str = param(
        '/usr/bin/python3', '-', "Python that LinuxCNC's modules hal and linuxcnc are built for"
    )


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
        self._told: tuple[Any, ...] = ()
        self._told_at = 0
        self._output: ControllerOutput | None = None

    @property
    def output(self) -> ControllerOutput | None:
        """What to write; None while the pins are not this bridge's."""
        return self._output

    @property
    def at_rest(self) -> bool:
        """Whether it is inactive and has nothing to take back: the pins may be let go."""
        if self._active or self._status is None:
            return not self._active
        return not self._status.ready or (
            self._registers.phase is RegisterPhase.FOLLOWING
            and not np.any(self._input.applied)
            and not np.any(self._status.counts)
        )

    def on_compensation(self, command: Compensation) -> None:
        """Take an offset command; the offset input decides whether it is followed."""
        if not self._active:
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
            return self._activate()
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
        if not status.ready or not self._holding:
            # LinuxCNC clears registers that are not ready, and others may move the counts.
            self._restart_input(status)
        found = self._registers.observe(status)
        if found:
            self._restart_input(status)
        why = self._forbidden(status)
        self._input.allow(not why, why)
        wanted = self._input.advance(self._time, status.position)
        if self._holding:
            self._output = self._registers.output(wanted, status)
            if not self._active and self.at_rest:
                self._holding, self._output = False, None
        self._watch(status)
        yield from self._tell(status, why)

    def lose(self, stamp: int, why: str) -> Iterator[Emission]:
        """Note that LinuxCNC is gone: nothing is applied, nothing is known."""
        self._time = max(self._time, stamp)
        if not self._absent:
            self._told = ()
        self._status, self._absent = None, why
        self._active = self._holding = False
        self._output, self._apart_since = None, None
        self._registers = OffsetRegisters(len(self._axes))
        self._input.allow(False, why)
        nothing = np.full(len(self._axes), np.nan)
        if not self._due(('absent', why)):
            return
        yield Emission('machine_state', self._state(MachineMode.OFF, False, nothing, np.nan, False))
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

    def _activate(self) -> Answer:
        """Go on from the offsets in force, as if they had been commanded: nothing moves."""
        if self._active:
            return Answer(False, 'already active')
        if self._status is None:
            return Answer(False, self._absent)
        self._active = self._holding = True
        self._registers = OffsetRegisters(len(self._axes))
        self._input = self._adopting(self._status.register, self._time)
        standing = describe(self._axes, self._status.register)
        self._output = ControllerOutput(counts=self._status.counts.copy())
        return Answer(True, f'active; goes on from {standing or "zero"}')

    def _adopting(self, offset: Floats, time: int) -> OffsetInput:
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
        if np.any(offset):
            until = time + max(nanoseconds(self._config.adopt_time), 1)
            fresh.command(
                1, self._axes, offset, stamp=begin, valid_until=until, owner=''
            )
        fresh.advance(time)
        return fresh

    def _restart_input(self, status: ControllerStatus) -> None:
        """Go on from the registers; who owned the offsets before has to command anew."""
        if not np.array_equal(self._input.applied, status.register):
            self._input = self._adopting(status.register, self._time)

    def _forbidden(self, status: ControllerStatus) -> str:
        """Say why commands are not followed now; empty if they are."""
        if not self._active:
            return 'the bridge is not active'
        if not status.ready:
            return 'machine is not homed' if not status.homed else f'machine is {_word(status)}'
        if status.frozen:
            return (
                f'eoffset-enable is off: frozen at {describe(self._axes, status.applied) or "0"}; '
                'set the signal fuzzycnc-on'
            )
        if not status.alive:
            return 'the watchdog of the HAL file has let the offsets go; taking them up again'
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
            owner = (
                'ramping to zero'
                if self._holding
                else f'written by {status.writer}'
                if status.writer
                else 'nobody owns it'
            )
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

    def _due(self, news: tuple[Any, ...]) -> bool:
        """Whether something changed, or a report is due."""
        if news == self._told and self._time - self._told_at < nanoseconds(
            self._config.report_period
        ):
            return False
        self._told, self._told_at = news, self._time
        return True

    def _tell(self, status: ControllerStatus, why: str) -> Iterator[Emission]:
        code, reason = self._verdict(status, why)
        allowed = self._active and not why
        limited = self._input.at_limit | self._cut(status)
        # Differences below a nanometre are LinuxCNC's own rounding.
        applied = np.rint(1e9 * status.applied)
        facts = (code, reason.partition(';')[0], allowed, status.mode, status.homed)
        if not self._due((*facts, applied.tobytes(), limited.tobytes(), self._input.epoch)):
            return
        yield Emission(
            'machine_state',
            self._state(
                status.mode, status.homed, status.position, status.spindle_speed, allowed
            ),
        )
        yield Emission('compensation_applied', self._applied(code, reason, status.applied, limited))

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

# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Base of the bridges to real controllers: the guard, the owner, the read-back.

A bridge stands where `simulated_machine` does, but a real controller makes the time: the host
reads it in every cycle, hands the readout over, and writes what comes back.  What is published is
the read-back, never the command.
"""

from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Generic, TypeVar

import numpy as np

from fuzzycnc_ros.adapters.controller import Readout
from fuzzycnc_ros.adapters.probing.touches import touch_of
from fuzzycnc_ros.core.config import Config, param, same_param
from fuzzycnc_ros.core.inputs.lines import Lines, Travel
from fuzzycnc_ros.core.inputs.offset_input import (
    OffsetInput,
    OffsetInputConfig,
    OffsetStatus,
    content_refusal,
)
from fuzzycnc_ros.core.inputs.offsets import AXES, describe
from fuzzycnc_ros.runtime.component import (
    LATCHED,
    Answer,
    Component,
    Emission,
    Health,
    Input,
    Level,
    Output,
)
from fuzzycnc_ros.runtime.enums import Coolant, MachineMode
from fuzzycnc_ros.runtime.records import (
    MOTION_FIELDS,
    Bools,
    Compensation,
    CompensationApplied,
    Floats,
    MachineState,
    Names,
    ProbeCycleState,
    ProbeTouch,
    nanoseconds,
)


@dataclass(frozen=True, kw_only=True)
class ControllerBridgeConfig(Config):
    """Parameters that every bridge to a controller has."""

    autostart: bool = param(
        False, '-', 'Configure and activate at start; otherwise a lifecycle manager does'
    )
    axes: tuple[str, ...] = param(('X', 'Y', 'Z'), '-', 'Axes that take offsets')
    offset_max: float = param(60e-6, 'm', 'Largest offset of an axis', low=1e-6, high=1e-3)
    slew_max: float = param(5e-6, 'm/s', 'Fastest change of an offset', low=1e-9, high=1e-3)
    slope_max: float = same_param(OffsetInputConfig, 'slope_max')
    lead_max: float = param(
        5.0, 's', 'How far ahead of the machine a command may be stamped', low=0.0, high=3600.0
    )
    validity_max: float = param(
        180.0,
        's',
        'How long after its stamp a command acts at most: three times the period of its source',
        low=0.01,
        high=7200.0,
    )
    adopt_time: float = param(
        120.0,
        's',
        'How long offsets that stand at the activation are kept while no command comes',
        low=0.0,
        high=7200.0,
    )
    cycle_period: float = param(
        0.005, 's', 'Time between two looks at the controller', low=0.001, high=0.1
    )
    report_period: float = param(
        0.2, 's', 'Time between two reports while nothing changes', low=0.01, high=10.0
    )


CLOSE = 0.2e-6
"""Difference of two offsets that counts as none [m]; LinuxCNC leaves 0.3 nm."""
ON_THE_WAY = 0.02
"""Time between two reports while offsets move [s]."""
NOTHING = 1e-12
"""Offset that is the rounding of sums [m]."""
STEPS_MAX = 2.0
"""Cycles for whose time one cycle moves offsets at most, however late it comes."""
COLUMNS = ('offset', 'slope', 'reference_position')
"""Coefficients of an axis' line."""
SETTLING = 2.0
"""Time that a controller may take to reach a commanded offset [s] before the delay is reported."""

ConfigT = TypeVar('ConfigT', bound=ControllerBridgeConfig)
StatusT = TypeVar('StatusT', bound=Readout)
OrdersT = TypeVar('OrdersT')


class ControllerBridge(Component[ConfigT], ABC, Generic[ConfigT, StatusT, OrdersT]):
    """Guard the offsets, say what the controller shall do, tell what is applied.

    Along an axis an offset is a line, guarded at both ends of the travel.  Subclasses bring the
    controller to the lines that the guard allows, by `observe`, and say by `_forbidden` when
    nobody is followed.
    """

    CONTROLLER: ClassVar[str]
    """Name of the controller in messages."""
    PROBE_OFFSET: ClassVar[bool] = False
    """True if coordinates of a probing cycle contain the offset in force."""
    CONFIG = ControllerBridgeConfig
    INPUTS = (
        Input('compensation', Compensation, sole=True),
        Input('probe_cycle_state', ProbeCycleState, LATCHED, paced=False),
    )
    OUTPUTS = (
        Output('machine_state', MachineState),
        Output('compensation_applied', CompensationApplied),
        Output('probe_touch', ProbeTouch),
    )
    MANAGED = True
    MACHINE_SIDE = True

    def __init__(self, config: ConfigT | None = None) -> None:
        super().__init__(config)
        self._axes = self._config.axes
        unknown = [axis for axis in self._axes if axis not in AXES]
        if unknown or not self._axes or len(set(self._axes)) != len(self._axes):
            raise ValueError(
                f'axes: expected distinct names of {", ".join(AXES)} but found '
                f'{", ".join(self._axes) or "none"}'
            )
        self._time = 0
        self._stamp = 0
        self._ahead = 0
        self._holding = False
        self._adopted: int | None = None  # time at which the bridge went on from what stood
        self._uncommanded = 0  # for how long it has held offsets since the newest command [ns]
        self._step_max = STEPS_MAX * self._config.cycle_period
        self._reference = np.zeros(len(self._axes))
        self._clipped = np.zeros(len(self._axes), bool)
        self._steep = np.zeros(len(self._axes), bool)
        self._unusable = ''
        self._input = self._adopting(np.zeros(len(self._places)))
        self._status: StatusT | None = None
        self._absent = f'{self.CONTROLLER} has not been found yet'
        self._active = False
        self._apart_since: int | None = None
        self._told: dict[str, tuple[int, tuple[Any, ...]]] = {}
        self._orders: OrdersT | None = None
        self._moved = np.zeros((len(MOTION_FIELDS), len(self._axes)))
        """Motion of each axis so far, in the order of `MOTION_FIELDS`."""
        self._seen_at: tuple[int, Floats] | None = None
        """Time and position of the cycle before, to know the way since."""
        self._probe: tuple[float, float] | None = None
        self._probe_told: float | None = None
        self._touched_at = 0
        self.probe_due = False
        """True if the control shall be shown that a probing cycle is due."""

    @property
    def orders(self) -> OrdersT | None:
        """Command to write; None while this bridge does not hold the controller."""
        return self._orders

    @property
    def active(self) -> bool:
        """True if it may write, as soon as it holds the controller."""
        return self._active

    @property
    def holding(self) -> bool:
        """True if the controller takes offsets from this bridge."""
        return self._holding

    @property
    @abstractmethod
    def moving(self) -> bool:
        """True while the controller moves towards the newest command."""

    @property
    @abstractmethod
    def at_rest(self) -> bool:
        """True if it is inactive with nothing to take back: it may let the controller go."""

    @property
    @abstractmethod
    def wants_control(self) -> bool:
        """True if it is time to take hold: active without it, and nothing else moves."""

    @abstractmethod
    def take_control(self) -> None:
        """Note that the controller is this bridge's; go on from the offsets in force."""

    @abstractmethod
    def observe(self, stamp: int, status: StatusT) -> Iterator[Emission]:
        """Take what was read at `stamp` [ns]; decide what to write, yield what is to be told."""

    def on_compensation(self, command: Compensation) -> None:
        """Take an offset command; the offset input decides whether it is followed."""
        if self._active and self._leads and self._command(command):
            self._adopted, self._uncommanded = None, 0

    def on_probe_cycle_state(self, state: ProbeCycleState) -> None:
        """Note whether a probing cycle is due."""
        self.probe_due = state.due

    def on_request(self, name: str, arguments: Mapping[str, Any], stamp: int) -> Answer:
        """`activate` starts from the read-back; `deactivate` ramps to zero first."""
        if name == 'activate':
            if self._active:
                return Answer(False, 'already active')
            self._active = True
            self._adopted, self._uncommanded = None, 0
            return Answer(True, f'active; {self._absent}' if self._absent else 'active')
        if name == 'deactivate':
            if not self._active:
                return Answer(False, 'not active')
            self._active = False
            return Answer(True, 'ramping to zero')
        return super().on_request(name, arguments, stamp)

    def lose(self, stamp: int, why: str) -> Iterator[Emission]:
        """Note that the controller is gone."""
        self._work_at(stamp)
        if not self._absent:
            self._told = {}
        self._status, self._absent, self._seen_at = None, why, None
        self._count_uncommanded()
        self._holding, self._orders, self._apart_since = False, None, None
        self._forget()
        self._input.allow(False, why)
        nothing = np.full(len(self._axes), np.nan)
        if not self._due('absent', (why,)):
            return
        yield Emission(
            'machine_state', self._state(MachineMode.OFF, False, nothing, np.nan, False)
        )
        yield Emission(
            'compensation_applied',
            self._applied(OffsetStatus.REFUSED, why, self._left(), nothing > 0.0),
        )

    def renewed(self, step: int) -> tuple[Component[ConfigT], list[Emission]]:
        """Go on through a step of the clock [ns]: the controller and its offsets know of none."""
        self._ahead -= step
        return self, []

    def in_simulated_time(self) -> None:
        """Take the clock as it comes: a simulation may run at any speed."""
        self._step_max = np.inf
        self._input = self._adopting(self._input.applied)

    def health(self) -> list[Health]:
        """Report the controller, the offsets in force, and why a command was refused."""
        status = self._status
        name = self.CONTROLLER.lower().removeprefix('the ')
        if status is None:
            return [Health(name, Level.ERROR, self._absent)]
        values = {
            f'offset {axis} [um]': f'{1e6 * offset:.2f}'
            for axis, offset in zip(self._axes, status.applied, strict=True)
        }
        code, reason = self._verdict(status, self._forbidden(status))
        at_zero = self._input.released and reason == self._input.reason
        if at_zero:
            reason = ''
        owned = self._active or not np.any(np.abs(status.applied) > CLOSE)
        level = (Level.WARN if reason else Level.OK) if owned else Level.ERROR
        text = 'at zero, as commanded last' if at_zero else reason or code.name.lower()
        return [
            Health(name, Level.OK, status.mode.name.lower()),
            Health('compensation', level, text, values),
        ]

    @property
    @abstractmethod
    def _leads(self) -> bool:
        """True if the controller follows this bridge."""

    @abstractmethod
    def _forbidden(self, status: StatusT) -> str:
        """Say why commands are not followed now; empty if they are."""

    @abstractmethod
    def _complaint(self, status: StatusT) -> str:
        """Say where the controller does not apply what it is told; empty if it does."""

    @abstractmethod
    def _cut(self, status: StatusT) -> Bools:
        """Return True for each axis whose offset a limit of the controller cuts."""

    def _left(self) -> Floats:
        """Return what a controller that is gone applies [m]: nothing, unless it goes on alone."""
        return np.zeros(len(self._axes))

    def _forget(self) -> None:
        """Drop what was known of a controller that is gone."""

    def _leaving(self, status: StatusT) -> str:
        """Say how offsets that stand after the deactivation go away."""
        return 'ramping to zero'

    @abstractmethod
    def _travel_of(self, status: StatusT) -> Travel:
        """Return where each axis may slope."""

    @abstractmethod
    def _flat(self, axes: str) -> str:
        """Say what to do where axes take no slope."""

    def _most(self, status: StatusT) -> Floats:
        """Return the largest offset of each axis [m]."""
        return np.full(len(self._axes), self._config.offset_max)

    def _most_at_ends(self, status: StatusT) -> Floats:
        """Return the largest offsets at the lower ends of the travel, then at the upper [m]."""
        return np.tile(self._most(status), 2)

    @property
    def _places(self) -> Names:
        """Names of the guarded offsets: at the lower ends of the travel, then the upper."""
        axes = self._config.axes
        return (*(f'{axis} low' for axis in axes), *(f'{axis} high' for axis in axes))

    @property
    def _slew_max(self) -> float:
        """Fastest change of an offset [m/s]."""
        return self._config.slew_max

    def _command(self, command: Compensation) -> bool:
        """Guard a command by its values at the ends of the travel; return whether it counts."""
        status = self._status
        assert status is not None, 'who leads has read the controller'
        travel = self._travel_of(status)
        columns = {name: np.asarray(getattr(command, name), np.float64) for name in COLUMNS}
        self._unusable = content_refusal(self._axes, command.axis, columns)
        if self._unusable:
            return False
        rows = [self._axes.index(axis) for axis in command.axis]
        full = {name: np.zeros(len(self._axes)) for name in COLUMNS}
        for name, values in columns.items():
            full[name][rows] = values
        flat = ', '.join(np.array(self._axes)[(full['slope'] != 0.0) & ~travel.sloping])
        if flat:
            self._unusable = f'slope: {self.CONTROLLER} takes none on {flat}; {self._flat(flat)}'
            return False
        steep = np.abs(full['slope']) > self._config.slope_max
        full['slope'] = np.clip(full['slope'], -self._config.slope_max, self._config.slope_max)
        lines = Lines(**full)
        wanted = travel.ends(lines)
        most = self._most_at_ends(status)
        cut = np.clip(wanted, -most, most)
        answer = self._input.command(
            command.epoch,
            self._places,
            cut,
            stamp=command.stamp + self._ahead,
            valid_until=command.valid_until + self._ahead,
        )
        if answer.accepted:
            self._clipped = np.any(np.split(cut != wanted, 2), axis=0)
            self._steep = steep
            self._reference = lines.reference_position
        return answer.accepted

    def _adopt(self, lines: Lines, status: StatusT) -> None:
        """Go on from lines that are in force."""
        self._reference, self._unusable = lines.reference_position, ''
        self._clipped = np.zeros(len(self._axes), bool)
        self._steep = np.zeros(len(self._axes), bool)
        self._input = self._adopting(self._travel_of(status).ends(lines), self._input.epoch)

    def _lines_in_force(self, status: StatusT) -> Lines:
        """Return the lines that the guard allows now."""
        return self._travel_of(status).lines(self._input.applied, self._reference)

    def _cut_text(self, status: StatusT, cut: Bools) -> str:
        """Say which limits cut what is asked for; empty if none does."""
        if self._input.status is not OffsetStatus.FOLLOWING:
            return ''
        parts = []
        if np.any(cut):
            parts.append(f'cut at the limit of {describe(self._axes, self._most(status), cut)}')
        if np.any(self._steep):
            axes = ', '.join(np.array(self._axes)[self._steep])
            parts.append(f'slope of {axes} cut at {1e6 * self._config.slope_max:g} um/m')
        return '; '.join(parts)

    def _count_uncommanded(self) -> None:
        """Note how long offsets that were adopted have stood: the next adoption adds nothing."""
        if self._adopted is not None:
            self._uncommanded += self._time - self._adopted
        self._adopted = None

    def _work_at(self, stamp: int) -> None:
        """Go on to a stamp [ns].

        The time that offsets move and expire by never goes back, whatever stamps do.
        """
        self._ahead = max(self._ahead, self._time - stamp)
        self._stamp, self._time = stamp, stamp + self._ahead

    @property
    def _limits(self) -> OffsetInputConfig:
        """Limits of the offsets in force."""
        return OffsetInputConfig(
            offset_max=self._config.offset_max,
            slew_max=self._slew_max,
            lead_max=self._config.lead_max,
            validity_max=self._config.validity_max,
        )

    def _adopting(self, offset: Floats, epoch: int = 0) -> OffsetInput:
        """Return an offset input that has `offset` [m] in force now."""
        fresh = OffsetInput(self._places, self._limits, start=self._time, step_max=self._step_max)
        self._count_uncommanded()
        if self._holding:
            self._adopted = self._time
        left = max(0, nanoseconds(self._config.adopt_time) - self._uncommanded)
        fresh.adopt(
            np.where(np.abs(offset) > NOTHING, offset, 0.0),
            epoch=epoch,
            valid_until=self._time + left,
        )
        return fresh

    def _verdict(self, status: StatusT, why: str) -> tuple[OffsetStatus, str]:
        """Return what is told of the commands, and why."""
        standing = describe(self._axes, status.applied, np.abs(status.applied) > CLOSE)
        if not self._active:
            if not standing:
                return OffsetStatus.IDLE, ''
            owner = f'written by {status.writer}' if status.writer else 'nobody owns it'
            if self._holding:
                owner = self._leaving(status)
            return OffsetStatus.REFUSED, f'inactive while {standing} stands: {owner}'
        if why:
            return OffsetStatus.REFUSED, f'{why}; in force: {standing or "nothing"}'
        if self._unusable:
            return OffsetStatus.REFUSED, self._unusable
        return (
            self._input.status,
            self._complaint(status) or self._input.reason,
        )

    def _due(self, what: str, news: tuple[Any, ...], spacing: float = 0.0) -> bool:
        """Return True if a text is due: news after `spacing` [s], or a repetition."""
        told_at, told = self._told.get(what, (None, ()))
        if told_at is not None:
            wait = spacing if news != told else self._config.report_period
            if self._time - told_at < nanoseconds(wait):
                return False
        self._told[what] = (self._time, news)
        return True

    def _tell(self, status: StatusT, why: str) -> Iterator[Emission]:
        yield from self._touched(status)
        self._move(status.position)
        code, reason = self._verdict(status, why)
        allowed = self._active and not why
        if self._due('machine_state', (status.mode, status.homed, allowed)):
            coolant = Coolant.UNKNOWN
            if status.coolant is not None:
                coolant = Coolant.ON if status.coolant else Coolant.OFF
            moved: dict[str, Any] = dict(zip(MOTION_FIELDS, self._moved.copy(), strict=True))
            state = replace(
                self._state(
                    status.mode, status.homed, status.position, status.spindle_speed, allowed
                ),
                coolant=int(coolant),
                spindle_load=status.spindle_load,
                **moved,
            )
            yield Emission('machine_state', state)
        limited = self._limited(status)
        # Differences below a nanometre are LinuxCNC's own rounding.
        offsets = np.rint(1e9 * status.applied).tobytes()
        cause = (code, reason.partition(';')[0], limited.tobytes(), self._input.epoch)
        changed = cause != self._told.get('applied', (0, ((),)))[1][0]
        # On the way there a read-back is told now and then, at its end at once.
        spacing = ON_THE_WAY if self.moving and not changed else 0.0
        if self._due('applied', (cause, offsets), spacing):
            told = self._applied(code, reason, status.applied, limited)
            slope = self._lines_in_force(status).slope
            told = replace(told, slope=slope, position=status.position.copy())
            yield Emission('compensation_applied', told)

    def _move(self, position: Floats) -> None:
        """Add what the axes have moved since the cycle before."""
        before, self._seen_at = self._seen_at, (self._time, position.copy())
        if before is None or self._time <= before[0]:
            return
        step, elapsed = position - before[1], 1e-9 * (self._time - before[0])
        way, middle = np.abs(step), 0.5 * (position + before[1])
        moments = way * middle, way * (middle * middle + step * step / 12.0)
        self._moved = self._moved + np.stack([way, step * step / elapsed, *moments])

    def _touched(self, status: StatusT) -> Iterator[Emission]:
        """Yield what a probing cycle tells, once; what stands at first is of an older one.

        A code is believed when it is seen again: what is read with it then was written before.
        """
        before, self._probe = self._probe, status.probe
        if status.probe is None or before is None:
            return
        code = status.probe[0]
        if code != before[0] or code == self._probe_told:
            return
        first, self._probe_told = self._probe_told is None, code
        if first:
            return
        # A clock that goes in steps may stand still between two touches.
        self._touched_at = max(self._stamp, self._touched_at + 1)
        frame = self.frame('machine')
        touch = touch_of(self._touched_at, frame, *status.probe, includes_offset=self.PROBE_OFFSET)
        if touch is not None:
            yield Emission('probe_touch', touch)

    def _limited(self, status: StatusT) -> Bools:
        """Return True for each axis whose offset any limit cuts."""
        return np.asarray(self._input.at_limit | self._cut(status), bool)

    def _state(
        self, mode: MachineMode, homed: bool, position: Floats, speed: float, allowed: bool
    ) -> MachineState:
        return MachineState(
            stamp=self._stamp,
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
        self, code: OffsetStatus, reason: str, offset: Floats, at_limit: Bools
    ) -> CompensationApplied:
        return CompensationApplied(
            stamp=self._stamp,
            frame_id=self.frame('machine'),
            epoch=self._input.epoch,
            status=int(code),
            reason=reason,
            axis=self._axes,
            offset=np.asarray(offset, np.float64).copy(),
            at_limit=np.asarray(at_limit, bool),
        )

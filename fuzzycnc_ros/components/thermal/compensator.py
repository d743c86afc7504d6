# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Component `compensator`: thermal error in, limited and expiring offsets out.

It is the only source of offsets.  What it publishes is minus the error, cut at a size limit,
moving no faster than a slew limit and valid for a limited time.  Where the travel of an axis is
known its offset may slope: the limits then hold at both ends of the travel, and so between them.
When the error is late, invalid or out of domain it holds, then ramps to zero; it never steps.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from fuzzycnc_ros.components.thermal.axis_trust import AxisTrust
from fuzzycnc_ros.core.config import Config, param
from fuzzycnc_ros.core.inputs.lines import Lines, read_travel
from fuzzycnc_ros.core.inputs.offset_input import OffsetStatus
from fuzzycnc_ros.core.inputs.offsets import AXES, EPOCH_STEP, NEGLIGIBLE, describe
from fuzzycnc_ros.runtime.component import (
    LATCHED,
    REQUEST,
    Answer,
    Component,
    Emission,
    Health,
    Input,
    Level,
    Output,
)
from fuzzycnc_ros.runtime.enums import CompensationState, MachineMode, Reason
from fuzzycnc_ros.runtime.records import (
    SECOND,
    Bools,
    Compensation,
    CompensationApplied,
    Floats,
    MachineState,
    ProbeEvidence,
    Record,
    ThermalError,
    nanoseconds,
)


@dataclass(frozen=True, kw_only=True)
class CompensatorConfig(Config):
    """Parameters of `compensator`."""

    autostart: bool = param(
        False, '-', 'Configure and activate at start; otherwise a lifecycle manager does'
    )
    axes: tuple[str, ...] = param(('Y', 'Z'), '-', 'Axes that are compensated, ISO 841 names')
    offset_max: float = param(
        50e-6, 'm', 'Largest offset on any axis', low=0.0, high=1e-3, live=True
    )
    error_max: float = param(
        200e-6,
        'm',
        'Largest plausible thermal error; beyond it is invalid, where one beyond offset_max is '
        'cut',
        low=1e-6,
        high=1e-2,
        live=True,
    )
    travel: tuple[str, ...] = param(
        (),
        '-',
        'Both ends of the travel of axes whose offset may slope along it, in m, as Y:-0.5:0; '
        'others get one offset everywhere',
    )
    slope_max: float = param(
        500e-6, '-', 'Largest offset per length of travel', low=0.0, high=0.01, live=True
    )
    slew_max: float = param(
        0.2e-6,
        'm/s',
        'Fastest change of an offset at any place of the travel',
        low=1e-9,
        high=1e-3,
        live=True,
    )
    ramp_rate: float = param(
        0.1e-6, 'm/s', 'Speed at which offsets go to zero; not above slew_max', low=1e-9, high=1e-3
    )
    band_share: float = param(
        0.0,
        '-',
        'Half width of the band over the correction up to which an axis is compensated; 0 is any',
        low=0.0,
        high=1.0,
        live=True,
    )
    first_share: float = param(
        1.0,
        '-',
        'Part of the error that is taken off until probes under that offset confirm it',
        low=0.1,
        high=1.0,
    )
    program_wait: float = param(
        0.0,
        's',
        'How long a start or stop of compensation waits for the end of a program; 0 does not wait',
        low=0.0,
        high=86400.0,
        live=True,
    )
    period: float = param(
        10.0, 's', 'Time between updates while offsets move without an input', low=0.01, high=600.0
    )
    stale_after: float = param(
        150.0, 's', 'Age of the error beyond which offsets are held', low=0.01, high=7200.0
    )
    hold_time: float = param(
        300.0, 's', 'How long offsets are held before they ramp to zero', low=0.0, high=7200.0
    )
    validity: float = param(
        180.0, 's', 'How long the machine side may trust one message', low=0.01, high=7200.0
    )


ROUNDED = 1e-9
"""Difference between offsets at the end of a travel that is rounding of their line [m]."""

GUARDS = ('offset_max', 'error_max', 'slew_max', 'slope_max')
"""Limits within which an operator has allowed offsets."""


class Compensator(Component[CompensatorConfig]):
    """Follow the thermal error within limits; hold, ramp and expire without it."""

    NAME = 'compensator'
    SUMMARY = 'The only source of offsets: clamped, rate-limited, expiring. Managed lifecycle.'
    CONFIG = CompensatorConfig
    MACHINE = Input('machine_state', MachineState, max_age=600.0, sole=True)
    APPLIED = Input('compensation_applied', CompensationApplied, sole=True)
    INPUTS = (
        MACHINE,
        APPLIED,
        Input('probe_evidence', ProbeEvidence, LATCHED, quiet=True, sole=True),
        Input('thermal_error', ThermalError, driving=True, sole=True),
    )
    OUTPUTS = (Output('compensation', Compensation),)
    MANAGED = True

    def __init__(self, config: CompensatorConfig | None = None) -> None:
        super().__init__(config)
        self._check(self._config)
        self._axes = self._config.axes
        self._active = False
        self._state = CompensationState.INACTIVE
        self._epoch = 0
        self._followed = False  # whether the machine has followed this epoch
        self._rival = 0  # epoch of another owner whom the machine follows
        self._told_at = self._told_epoch = 0
        self._travel = read_travel(self._config.travel, self._axes, 'travel')
        self._reference = np.where(
            self._travel.sloping, 0.5 * (self._travel.low + self._travel.high), 0.0
        )
        # Offsets and what they go to at the lower ends of the travel, then at the upper ones.
        self._ends = np.zeros(2 * len(self._axes))
        self._target = np.zeros(2 * len(self._axes))
        self._unsloped = ''
        self._moved_at = 0
        self._good_at: int | None = None
        self._bad_since: int | None = None
        self._wake_at: int | None = None
        self._at_limit = np.zeros(len(self._axes), bool)
        self._slewing = np.zeros(len(self._axes), bool)
        self._steep = np.zeros(len(self._axes), bool)
        self._why = 'inactive'
        self._misread = ''
        self._widened: list[str] = []
        self._trust = AxisTrust(self._axes)

    @staticmethod
    def _check(config: CompensatorConfig) -> None:
        unknown = [axis for axis in config.axes if axis not in AXES]
        if unknown or not config.axes or len(set(config.axes)) != len(config.axes):
            raise ValueError(
                f'axes: expected distinct names of {", ".join(AXES)} but found '
                f'{", ".join(config.axes) or "none"}'
            )
        if config.ramp_rate > config.slew_max:
            raise ValueError(
                f'ramp_rate = {config.ramp_rate} m/s must not exceed '
                f'slew_max = {config.slew_max} m/s'
            )
        if config.validity < config.period:
            raise ValueError(
                f'validity = {config.validity} s must not be shorter than '
                f'period = {config.period} s, or every offset expires on the machine'
            )
        read_travel(config.travel, config.axes, 'travel')

    def reconfigure(self, config: CompensatorConfig) -> None:
        """Take new limits; they act from the next update on, within the slew limit.

        Where an axis is tried before it is followed, what was allowed was allowed within the
        limits of that moment: wider ones have to be allowed anew.
        """
        self._check(config)
        wider = [name for name in GUARDS if getattr(config, name) > getattr(self._config, name)]
        if self._active and config.first_share < 1.0:
            self._widened += [name for name in wider if name not in self._widened]
        super().reconfigure(config)

    @property
    def next_deadline(self) -> int | None:
        """Time at which the offsets must move, be renewed or be held without an input."""
        return self._wake_at

    def on_thermal_error(self, error: ThermalError) -> Iterator[Emission]:
        """Follow a valid error; hold on an invalid one."""
        if not self._active:
            return
        if self._epoch == 0:
            self._why = 'no finite read-back (compensation_applied) from the machine yet'
            return
        self._why = self._refusal(error)
        if not self._why:
            self._aim(error)
            self._good_at = error.stamp
            self._bad_since = None
        elif self._bad_since is None:
            self._bad_since = error.stamp
        if self._rival:
            self._yield_to(self._rival)
            return
        yield self._update(error.stamp)

    def _aim(self, error: ThermalError) -> None:
        """Set the target by an error that may be followed."""
        lines, ends = self._lines(error)
        deviation = self._of_axes(error, error.standard_deviation)
        steep = self._of_axes(error, error.slope_deviation)
        low, high = np.split(ends, 2)
        far = np.where(np.abs(high) > np.abs(low), self._travel.high, self._travel.low)
        spread = np.nan_to_num(steep) * (far - lines.reference_position)
        sloping = lines.slope != 0.0
        share = self._trust.follow(
            error.stamp,
            np.where(np.abs(high) > np.abs(low), high, low),
            np.where(sloping, np.hypot(deviation, spread), deviation),
            self._config.band_share,
            self._config.first_share,
            self._config.program_wait if self._program_runs(error.stamp) else 0.0,
        )
        both = np.tile(share, 2)
        self._reference = np.where(
            np.isfinite(lines.reference_position), lines.reference_position, self._reference
        )
        self._target = -np.where(both > 0.0, both * ends, 0.0)

    def _lines(self, error: ThermalError) -> tuple[Lines, Floats]:
        """Return the errors of the axes as lines, and at the ends of their travels [m]."""
        slope = np.nan_to_num(self._of_axes(error, error.slope))
        reference = self._of_axes(error, error.reference_position)
        known = np.isfinite(reference)
        untold = (slope != 0.0) & ~(self._travel.sloping & known)
        self._unsloped = ', '.join(np.array(self._axes)[untold])
        most = self._config.slope_max
        lines = Lines(
            offset=self._of_axes(error, error.error),
            slope=np.where(untold, 0.0, np.clip(slope, -most, most)),
            reference_position=np.where(known, reference, self._reference),
        )
        self._steep = np.abs(slope) > most
        return lines, self._travel.ends(lines)

    def on_probe_evidence(self, evidence: ProbeEvidence) -> None:
        """Note which axes probes under an offset have confirmed, for later errors.

        That the probes of another machine are right says nothing of this one's.
        """
        if evidence.frame_id == self.frame('machine'):
            self._trust.learn(evidence)

    def on_compensation_applied(self, applied: CompensationApplied) -> None:
        """Join the offsets in force: at first, and whenever the machine does not follow.

        A machine that has let commands expire, refused them or been started anew goes on from
        where it is, as after a restart of this node.  One that follows a higher epoch has another
        owner: to that one this one yields, until nobody is followed any more.
        """
        self._misread = ''
        if self._epoch and applied.epoch > self._epoch + EPOCH_STEP:
            self._misread = (
                f'epoch: expected at most {self._epoch + EPOCH_STEP} but found {applied.epoch}; '
                'who publishes compensation_applied?'
            )
            return
        if not self._active:
            return
        unheard = self._told_epoch != self._epoch  # nothing was told yet as this owner
        if self._epoch == 0 or (unheard and applied.epoch < self._epoch):
            self._take_over(applied)
        elif applied.stamp <= self._told_at:
            return  # what was told last cannot be in it yet
        elif self._epoch > applied.epoch + EPOCH_STEP:
            # The machine believes no such epoch; whoever told it was not the machine.
            self._epoch = 0
            self._take_over(applied)
        elif applied.status == OffsetStatus.FOLLOWING:
            self._followed |= applied.epoch == self._epoch
            if applied.epoch > self._epoch:
                self._yield_to(applied.epoch)
        elif self._rival or (
            (self._followed or applied.status != OffsetStatus.IDLE) and not self._agrees(applied)
        ):
            self._take_over(applied)

    def on_deadline(self, stamp: int) -> Iterator[Emission]:
        """Move, renew, hold or ramp because nothing arrived."""
        yield self._update(stamp)

    def on_request(self, name: str, arguments: Mapping[str, Any], stamp: int) -> Answer:
        """`activate` starts from the read-back; `deactivate` ramps to zero first."""
        if name == 'activate':
            return self._activate(stamp)
        if name == 'deactivate':
            return self._deactivate(stamp)
        answer = super().on_request(name, arguments, stamp)
        if name != REQUEST or not (self._doubt and self._active and self._epoch):
            return answer
        self._why = self._doubt
        if self._bad_since is None:
            self._bad_since = stamp
        return replace(answer, emissions=(self._update(stamp),))

    def restore(self, output: str, record: Record) -> None:
        """Go on as the owner that told a command, where a replay begins after its beginning."""
        if not (isinstance(record, Compensation) and record.axis == self._axes and self._active):
            return
        self._epoch = self._told_epoch = record.epoch
        self._told_at = self._moved_at = record.stamp
        self._followed, self._rival = True, 0
        self._state = CompensationState(record.state)
        self._slewing, self._at_limit = record.slewing.copy(), record.at_limit.copy()
        self._reference = record.reference_position.copy()
        self._ends = self._travel.ends(
            Lines(
                offset=record.offset,
                slope=record.slope,
                reference_position=record.reference_position,
            )
        )
        self._trust.restore((record.offset != 0.0) | (record.slope != 0.0))
        if self._state is CompensationState.ACTIVE:
            self._bad_since = None
        self._wake_at = self._following_deadline(record.stamp)

    @property
    def at_rest(self) -> bool:
        """True if all offsets are zero and nothing is being followed."""
        return not self._active and not np.any(self._ends)

    def silence(self, name: str, last: Record) -> str:
        """Say which offsets stood when the machine was last heard: nobody may own them now."""
        if not isinstance(last, CompensationApplied):
            return ''
        standing = describe(last.axis, last.offset, np.abs(last.offset) > NEGLIGIBLE)
        if not standing:
            return ''
        return (
            f'{standing} stood then, which nobody may own now; see the machine side '
            '(simulated_machine or the bridge of the controller)'
        )

    def health(self) -> list[Health]:
        """Report the state, its reason and the limits at work."""
        level = {
            CompensationState.ACTIVE: Level.OK,
            CompensationState.INACTIVE: Level.OK,
            CompensationState.HOLDING: Level.WARN,
            CompensationState.RAMPING: Level.ERROR if self._active else Level.OK,
            CompensationState.EXPIRED: Level.ERROR,
        }[self._state]
        lines = self._told_lines()
        values = {
            f'offset {axis} [um]': f'{1e6 * offset:.2f}'
            for axis, offset in zip(self._axes, lines.offset, strict=True)
        }
        for axis, slope, takes in zip(self._axes, lines.slope, self._travel.sloping, strict=True):
            if takes:
                values[f'slope {axis} [um/m]'] = f'{1e6 * slope:.1f}'
        text = self._state.name.lower() + (f': {self._why}' if self._why else '')
        items = [Health('state', level, text, values)]
        applied = self.last(self.APPLIED)
        if applied is not None and applied.status == OffsetStatus.REFUSED:
            items.append(
                Health('read-back', Level.ERROR, f'refused by the machine: {applied.reason}')
            )
        if self._misread:
            items.append(Health('read-back', Level.ERROR, self._misread))
        if self._active:
            items += self._trust.health()
        if self._active and self._unsloped:
            text = (
                f'the error of {self._unsloped} slopes along the axis and only what it is at the '
                'reference position is followed; set travel, as Y:-0.5:0'
            )
            items.append(Health('travel', Level.WARN, text))
        for title, flags in (('size limit', self._at_limit), ('slew limit', self._slewing)):
            if flags.any() and self._active:  # on the way to zero that is asked for it is no limit
                named = ', '.join(np.array(self._axes)[flags])
                items.append(Health(title, Level.WARN, f'{title} active on {named}'))
        return items

    def _activate(self, stamp: int) -> Answer:
        if self._active:
            return Answer(False, 'already active')
        self._active = True
        self._widened.clear()
        self._trust.begin()
        self._good_at = self._bad_since = self._wake_at = None
        self._moved_at = stamp
        self._why = 'waiting for the read-back of the machine and a valid thermal error'
        self._state = CompensationState.EXPIRED
        applied = self.last(self.APPLIED)
        if applied is not None:
            self._take_over(applied)
        return Answer(True, 'active: offsets follow the thermal error')

    def _deactivate(self, stamp: int) -> Answer:
        if not self._active:
            return Answer(False, 'not active')
        self._active = False
        self._why = 'deactivated'
        if self._rival:
            self._rival = 0
            self._state = CompensationState.INACTIVE
            self._ends = np.zeros(2 * len(self._axes))
            return Answer(True, 'inactive; another owner is followed')
        emissions = (self._update(stamp),) if self._epoch else ()
        return Answer(True, 'ramping to zero', emissions)

    def _take_over(self, applied: CompensationApplied) -> None:
        """Start from what the machine applies, as a new owner: no step at a restart.

        Within an epoch what is told never steps; one that nothing was told in yet may go on.
        """
        if not np.all(np.isfinite(applied.offset)):
            return
        if self._told_epoch == self._epoch or applied.epoch >= self._epoch:
            self._epoch = max(self._epoch, applied.epoch) + 1
            self._moved_at = max(self._moved_at, applied.stamp)
        self._followed, self._rival = False, 0
        self._ends = self._in_force(applied)
        if self._good_at is None:
            self._target = self._ends.copy()
            self._bad_since = self._moved_at
        if self._wake_at is None:
            self._wake_at = self._moved_at + nanoseconds(self._config.period)

    def _yield_to(self, epoch: int) -> None:
        """Say nothing while the machine follows another owner."""
        self._rival = epoch
        self._wake_at = None
        self._state = CompensationState.EXPIRED
        self._why = (
            f'the machine follows another compensator (epoch {epoch}, this one has '
            f'{self._epoch}); waiting until it is gone'
        )

    def _in_force(self, applied: CompensationApplied) -> Floats:
        """Return the offsets at both ends that a read-back tells [m], within the own limits."""
        table = (applied.offset, applied.slope, applied.position)
        told = dict(zip(applied.axis, zip(*table, strict=True), strict=True))
        nothing = (0.0, 0.0, np.nan)
        offset, slope, position = np.array([told.get(axis, nothing) for axis in self._axes]).T
        # A slope about a place that nobody knows is no slope.
        slope = np.where(np.isfinite(position), slope, 0.0)
        lines = Lines(offset=offset, slope=slope, reference_position=position)
        limit = self._config.offset_max
        return np.asarray(np.clip(self._travel.ends(lines), -limit, limit))

    def _agrees(self, applied: CompensationApplied) -> bool:
        """Return True if the offsets in force are those that were published last."""
        apart = np.abs(self._in_force(applied) - self._ends)
        return bool((apart <= np.tile(np.where(self._travel.sloping, ROUNDED, 0.0), 2)).all())

    @property
    def _doubt(self) -> str:
        """Which input comes from several nodes; empty if none does."""
        return next(iter(self.sources.refusals.values()), '')

    def _refusal(self, error: ThermalError) -> str:
        """Say why an error must not be followed; empty if it may."""
        if self._doubt:
            return self._doubt
        if self._widened:
            return (
                f'{", ".join(self._widened)} was set wider than what was allowed; allow it: '
                'deactivate, then activate'
            )
        machine = self.newest(self.MACHINE, error.stamp)
        if machine is None:
            return 'no fresh machine_state'
        if not (machine.offsets_allowed and machine.homed):
            if not machine.homed:
                return 'machine is not homed'
            return 'machine does not allow offsets: it is off, or its bridge is not active'
        if not error.valid:
            return f'thermal error invalid: {_reason_text(error.reason)}'
        if not error.in_domain:
            return 'temperatures lie outside what the model was trained on'
        missing = [axis for axis in self._axes if axis not in error.axis]
        if missing:
            return f'thermal error lacks axis {", ".join(missing)}'
        wild = ~(np.abs(error.error) <= self._config.error_max)  # true for NaN
        names, values = np.array(error.axis), error.error
        if not np.any(wild):
            names, values = np.tile(self._axes, 2), self._lines(error)[1]
            wild = ~(np.abs(values) <= self._config.error_max)
        if np.any(wild):
            axis, value = names[wild][0], float(values[wild][0])
            return (
                f'thermal error of {axis}: expected at most {1e6 * self._config.error_max:g} µm, '
                f'what error_max lets a model say, but found {1e6 * value:g} µm'
            )
        return ''

    def _program_runs(self, stamp: int) -> bool:
        machine = self.newest(self.MACHINE, stamp)
        return machine is not None and machine.state == MachineMode.RUNNING

    def _of_axes(self, error: ThermalError, values: Floats) -> Floats:
        """Pick the value of each axis; the first channel speaks for an axis with several."""
        return np.array([values[error.axis.index(axis)] for axis in self._axes])

    def _update(self, stamp: int) -> Emission:
        """Decide the state at `stamp`, move the offsets and set the next deadline."""
        config = self._config
        if self._good_at is not None and self._bad_since is None and self._active:
            if stamp - self._good_at > nanoseconds(config.stale_after):
                self._bad_since = self._good_at + nanoseconds(config.stale_after)
                self._why = 'thermal error is late'
        self._state = self._decide(stamp)
        if self._state is CompensationState.ACTIVE:
            self._move(self._target, config.slew_max, stamp)
        elif self._state is CompensationState.HOLDING:
            self._move(self._ends, config.slew_max, stamp)
        else:
            self._move(np.zeros(2 * len(self._axes)), config.ramp_rate, stamp)
            if not self._ends.any():
                at_zero = CompensationState.EXPIRED if self._active else CompensationState.INACTIVE
                self._state = at_zero
        self._wake_at = self._following_deadline(stamp)
        return Emission('compensation', self._message(stamp))

    def _decide(self, stamp: int) -> CompensationState:
        if not self._active:
            return CompensationState.RAMPING
        if self._bad_since is None:
            return CompensationState.ACTIVE
        if not self._ends.any():
            return CompensationState.EXPIRED
        if stamp - self._bad_since < nanoseconds(self._config.hold_time):
            return CompensationState.HOLDING
        return CompensationState.RAMPING

    def _move(self, target: Floats, rate: float, stamp: int) -> None:
        """Move the ends toward `target`, within the size limit and no faster than `rate` [m/s].

        Time at rest earns no credit: one update moves by at most one period's worth, so that
        the machine is never told a step after a pause.
        """
        limit = self._config.offset_max
        wanted = np.clip(target, -limit, limit)
        self._at_limit = _either(np.abs(target) > limit)
        if self._state is CompensationState.ACTIVE:
            self._at_limit |= self._steep
        elapsed = min(max(stamp - self._moved_at, 0) / SECOND, self._config.period)
        step = rate * elapsed
        change = np.clip(wanted - self._ends, -step, step)
        slewing = np.abs(wanted - self._ends) > step
        self._slewing = _either(slewing)
        # Without a limit at work the target itself is taken, free of rounding.
        self._ends = np.where(slewing, self._ends + change, wanted)
        self._moved_at = max(stamp, self._moved_at)

    def _following_deadline(self, stamp: int) -> int | None:
        period = nanoseconds(self._config.period)
        if self._state is CompensationState.INACTIVE:
            return None
        if self._state is CompensationState.EXPIRED:
            # At zero an expired command on the machine changes nothing: rest.
            return None
        if self._slewing.any() or self._state is CompensationState.RAMPING:
            return stamp + period
        if self._state is CompensationState.HOLDING and self._bad_since is not None:
            release = self._bad_since + nanoseconds(self._config.hold_time)
            return max(stamp + 1, min(release, stamp + nanoseconds(self._config.validity / 2)))
        # Errors may come more slowly than a command expires on the machine.
        late = (self._good_at or stamp) + nanoseconds(self._config.stale_after) + 1
        return max(stamp + 1, min(late, stamp + nanoseconds(self._config.validity / 2)))

    def _message(self, stamp: int) -> Compensation:
        lines = self._told_lines()
        self._told_at, self._told_epoch = stamp, self._epoch
        return Compensation(
            stamp=stamp,
            frame_id=self.frame('machine'),
            epoch=self._epoch,
            state=int(self._state),
            axis=self._axes,
            offset=lines.offset,
            slope=lines.slope,
            reference_position=lines.reference_position.copy(),
            at_limit=self._at_limit.copy(),
            slewing=self._slewing.copy(),
            valid_until=stamp + nanoseconds(self._config.validity),
            source=('thermal_error',),
        )

    def _told_lines(self) -> Lines:
        """Return the offsets as lines."""
        lines = self._travel.lines(self._ends, self._reference)
        low, _ = np.split(self._ends, 2)
        # Where there is no slope both ends are the offset itself, free of rounding.
        return replace(lines, offset=np.where(self._travel.sloping, lines.offset, low))


def _either(ends: Bools) -> Bools:
    """Return which axes (c,) something holds for at the lower or the upper end (2 c,)."""
    low, high = np.split(ends, 2)
    return np.asarray(low | high)


def _reason_text(reason: int) -> str:
    """Return a reason in words; a newer sender may know more of them."""
    known = {item.value: item.name.lower().replace('_', ' ') for item in Reason}
    return known.get(reason, f'reason {reason}')

# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Offset input of a machine: the machine side of compensation, with its own limits.

It trusts nobody.  Whatever it is told, the offsets in force stay within the size limit, and go to
zero by themselves when the newest command expires.  They move for two reasons, each with a limit
of its own: what is asked for at a place changes no faster than the slew limit, and along a slope
they follow the axis, as fast as that can move.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fuzzycnc_ros.core.config import Config, param
from fuzzycnc_ros.core.inputs.offsets import EPOCH_STEP

_PLAUSIBLE = {'offset': 1.0, 'slope': 1.0, 'reference_position': 1000.0}
"""Sizes beyond which a number is a mix-up of units or worse [m, -, m]; keeps sums finite."""


class OffsetStatus(IntEnum):
    """States of the offset input, `CompensationApplied.STATUS_*`."""

    IDLE = 0
    FOLLOWING = 1
    EXPIRED = 2
    REFUSED = 3


@dataclass(frozen=True, kw_only=True)
class OffsetInputConfig(Config):
    """Limits that the machine side keeps whatever it is told."""

    offset_max: float = param(60e-6, 'm', 'Largest offset of an axis', low=1e-6, high=1e-3)
    slew_max: float = param(5e-6, 'm/s', 'Fastest change of an offset', low=1e-9, high=1e-3)
    slope_max: float = param(
        500e-6, '-', 'Largest offset per length of travel', low=0.0, high=0.01
    )
    speed_max: float = param(
        1.0, 'm/s', 'Fastest motion of an axis; a faster one was none', low=0.001, high=100.0
    )
    lead_max: float = param(
        5.0, 's', 'How far ahead of the machine a command may be stamped', low=0.0, high=3600.0
    )
    validity_max: float = param(
        180.0,
        's',
        'How long after its stamp a command acts at most, whatever it says itself',
        low=0.01,
        high=7200.0,
    )


@dataclass(frozen=True)
class OffsetAnswer:
    """Verdict on one command: whether it was taken, and why it was refused or cut."""

    accepted: bool
    reason: str = ''


@dataclass(frozen=True)
class _Command:
    """An accepted command, its arrays parallel to the input's axes; stamps in ns."""

    epoch: int
    owner: str
    offset: NDArray[np.float64]
    slope: NDArray[np.float64]
    reference_position: NDArray[np.float64]
    stamp: int
    valid_until: int

    def target(self, position: NDArray[np.float64]) -> NDArray[np.float64]:
        """Offsets asked for at `position` [m]; where it is unknown the slope has no effect."""
        travel = np.where(np.isnan(position), 0.0, position - self.reference_position)
        return np.asarray(self.offset + self.slope * travel)


class OffsetInput:
    """Takes offset commands, keeps its own limits, tells what is in force.

    Parameters
    ----------
    axes : sequence of str
        Axes that take offsets, ISO 841 names; every array of results is parallel to it.
    config : OffsetInputConfig, optional
        Size limit, slew limit, and how far ahead of the machine a stamp may be.
    start : int
        Machine time of the beginning [ns].
    step_max : float
        Time [s] for which one `advance` moves offsets at most: a process that stood still, or a
        clock that jumped, then causes no jump of the offsets.

    Raises
    ------
    ValueError
        If there is no axis or a name occurs twice.

    Notes
    -----
    All times are integer nanoseconds.  A command takes effect at its stamp, or at once when
    the machine is past it already; until then the one before stays in force.  Its expiry acts
    inside `advance` at the exact time, so the offsets do not depend on how often it is called
    (but for rounding) as long as the axes stand still.

    Examples
    --------
    >>> from fuzzycnc_ros.core.inputs.offset_input import OffsetInput
    >>> second = 1_000_000_000
    >>> machine = OffsetInput(['Y', 'Z'])
    >>> machine.command(1, ['Y'], [8e-6], stamp=0, valid_until=10 * second)
    OffsetAnswer(accepted=True, reason='')
    >>> [f'{1e6 * machine.advance(t * second)[0]:.1f}' for t in (1, 2, 10, 11, 12)]
    ['5.0', '8.0', '8.0', '3.0', '0.0']
    >>> machine.status.name
    'EXPIRED'
    """

    def __init__(
        self,
        axes: Sequence[str],
        config: OffsetInputConfig | None = None,
        *,
        start: int = 0,
        step_max: float = np.inf,
    ) -> None:
        if not axes or len(set(axes)) != len(axes):
            raise ValueError(f'axes: expected names, each once, but found {list(axes)}')
        self._axes = tuple(axes)
        self._config = config or OffsetInputConfig()
        self._time = start
        self._step_max = step_max
        self._allowed = True
        self._applied = np.zeros(len(axes))
        self._position = np.full(len(axes), np.nan)
        self._at_limit = np.zeros(len(axes), dtype=bool)
        self._travelled_to = start
        self._newest: _Command | None = None  # owner of the input, also after its expiry
        self._before: _Command | None = None
        self._in_force = False
        self._refusal = ''
        self._withdrawal = ''

    @property
    def axes(self) -> tuple[str, ...]:
        """Axes, in the order of all arrays."""
        return self._axes

    @property
    def time(self) -> int:
        """Machine time of the newest `advance` [ns]."""
        return self._time

    @property
    def applied(self) -> NDArray[np.float64]:
        """Offsets in force, shape (axes,) [m]."""
        return self._applied.copy()

    def at(self, position: ArrayLike) -> NDArray[np.float64]:
        """Return the offsets that stand at other positions of the axes.

        Parameters
        ----------
        position : array_like, shape (axes,)
            Positions [m]; NaN: where the axis is.

        Returns
        -------
        ndarray, shape (axes,)
            Offsets in force once the axes have gone there [m].
        """
        most = np.maximum(self._config.offset_max, np.abs(self._applied))
        moved = np.nan_to_num(np.asarray(position, dtype=np.float64) - self._position)
        return np.asarray(np.clip(self._applied + self.slope * moved, -most, most))

    @property
    def position(self) -> NDArray[np.float64]:
        """Commanded positions of the axes, shape (axes,) [m]; NaN where unknown."""
        return self._position.copy()

    @property
    def slope(self) -> NDArray[np.float64]:
        """Slopes along which offsets follow the axes, shape (axes,) [-]."""
        command = self._before or self._newest
        if command is None or not self._in_force:
            return np.zeros(len(self._axes))
        return command.slope.copy()

    @property
    def at_limit(self) -> NDArray[np.bool_]:
        """True for each axis whose offset is cut by the size limit, shape (axes,)."""
        return self._at_limit.copy()

    @property
    def epoch(self) -> int:
        """Epoch of the newest accepted command [-]; 0 before the first."""
        return self._newest.epoch if self._newest else 0

    @property
    def owner(self) -> str:
        """Sender of the newest accepted command; empty before the first."""
        return self._newest.owner if self._newest else ''

    @property
    def status(self) -> OffsetStatus:
        """State of the input; `REFUSED` lasts until a command is accepted."""
        if self._refusal or not self._allowed:
            return OffsetStatus.REFUSED
        if self._newest is None:
            return OffsetStatus.IDLE
        return OffsetStatus.FOLLOWING if self._in_force else OffsetStatus.EXPIRED

    @property
    def released(self) -> bool:
        """True after the expiry of a command that asked for no offset, which changed nothing."""
        command = self._newest
        if self.status is not OffsetStatus.EXPIRED or command is None or self._withdrawal:
            return False
        return not (command.offset.any() or command.slope.any() or self._applied.any())

    @property
    def reason(self) -> str:
        """Why a command was refused, cut or is no longer followed; empty if all is well."""
        if self._refusal or self._withdrawal:
            return self._refusal or self._withdrawal
        if self._newest is None:
            return ''
        if not self._in_force:
            return f'the command of epoch {self.epoch} expired; going to zero or at zero'
        return self._cut_text(self._at_limit)

    def adopt(self, offset: ArrayLike, *, epoch: int, valid_until: int) -> None:
        """Go on from offsets that are in force already, as if an owner had commanded them.

        Parameters
        ----------
        offset : array_like, shape (axes,)
            Offsets in force [m].
        epoch : int
            Epoch of the owner that new ones have to follow; 0 for nobody.
        valid_until : int
            Until when they stay if no command comes [ns].
        """
        self._applied = np.array(offset, dtype=np.float64)
        if not (epoch or self._applied.any()):
            return
        zero = np.zeros(len(self._axes))
        self._newest = _Command(
            epoch=max(epoch, 1),
            owner='',
            offset=self._applied.copy(),
            slope=zero,
            reference_position=zero,
            stamp=self._time,
            valid_until=valid_until,
        )
        self._in_force = valid_until > self._time

    def allow(self, allowed: bool, why: str = '') -> None:
        """Say whether the machine takes offsets in its present state.

        Parameters
        ----------
        allowed : bool
            False drops the command in force: offsets go to zero at the slew limit, and when
            they are allowed again it takes a fresh command to move them.
        why : str
            The state that forbids them, for the read-back, such as 'emergency stop'.
        """
        if not allowed:
            self._withdrawal = f'the machine does not allow offsets: {why or "no reason given"}'
            self._in_force = False
            self._before = None
        elif not self._allowed:
            self._withdrawal = 'offsets are allowed again; waiting for a fresh command'
        self._allowed = allowed

    def command(
        self,
        epoch: int,
        axis: Sequence[str],
        offset: ArrayLike,
        slope: ArrayLike | None = None,
        reference_position: ArrayLike | None = None,
        *,
        stamp: int,
        valid_until: int,
        owner: str = '',
    ) -> OffsetAnswer:
        """Take or refuse a command; a refused one leaves the command in force as it is.

        Parameters
        ----------
        epoch : int
            Owner epoch, 1 or more; a new owner comes with a higher one, at most `EPOCH_STEP`
            above the one in force.
        axis : sequence of str
            Axes of the command; those left out are commanded to zero.
        offset : array_like, shape (len(axis),)
            Offset at the reference position [m]; cut at the size limit when it acts.
        slope : array_like, shape (len(axis),), optional
            Offset per length of travel [-]; zero if left out, cut at its limit.
        reference_position : array_like, shape (len(axis),), optional
            Position at which the slope has no effect [m]; zero if left out.
        stamp : int
            What the command answers to [ns]; not older than the command before.
        valid_until : int
            End of validity [ns]; `validity_max` after the stamp at the latest.
        owner : str
            Identity of the sender, such as its publisher's id: two senders with one epoch are
            told apart by it.

        Returns
        -------
        OffsetAnswer
            `accepted`, and the reason if the command was refused or will be cut.
        """
        zeros = np.zeros(len(axis))
        columns = {
            'offset': np.asarray(offset, dtype=np.float64),
            'slope': zeros if slope is None else np.asarray(slope, dtype=np.float64),
            'reference_position': (
                zeros
                if reference_position is None
                else np.asarray(reference_position, dtype=np.float64)
            ),
        }
        valid_until = min(valid_until, stamp + round(self._config.validity_max * 1e9))
        self._refusal = (
            self._refused_by_owner(epoch, owner)
            or self._refused_by_time(epoch, stamp, valid_until)
            or content_refusal(self._axes, axis, columns)
        )
        if not self._allowed:
            return OffsetAnswer(False, self._withdrawal)
        if self._refusal:
            return OffsetAnswer(False, self._refusal)
        rows = [self._axes.index(name) for name in axis]
        full = {name: np.zeros(len(self._axes)) for name in columns}
        for name, values in columns.items():
            full[name][rows] = values
        steep = np.abs(full['slope']) > self._config.slope_max
        full['slope'] = np.clip(full['slope'], -self._config.slope_max, self._config.slope_max)
        # A predecessor that is still waiting for its own stamp never acted: it is replaced.
        if self._in_force and self._newest and self._newest.stamp <= self._time:
            self._before = self._newest
        self._newest = _Command(
            epoch=epoch, owner=owner, stamp=stamp, valid_until=valid_until, **full
        )
        self._in_force = True
        self._withdrawal = ''
        cut = np.abs(self._newest.target(self._position)) > self._config.offset_max
        slopes = ', '.join(np.array(self._axes)[steep])
        text = f'slope of {slopes} cut at {1e6 * self._config.slope_max:g} um/m' if slopes else ''
        return OffsetAnswer(True, '; '.join(part for part in (self._cut_text(cut), text) if part))

    def advance(self, time: int, position: ArrayLike | None = None) -> NDArray[np.float64]:
        """Move the offsets on to `time`.

        Parameters
        ----------
        time : int
            Machine time [ns], not before the one of the last call.
        position : array_like, shape (axes,), optional
            Commanded positions without compensation [m], for the slope; NaN or left out: the
            last known one.

        Returns
        -------
        ndarray, shape (axes,)
            Offsets in force [m].

        Raises
        ------
        ValueError
            If time goes back or `position` has another shape.  The state is unchanged.
        """
        if time < self._time:
            raise ValueError(f'time: expected {self._time} ns or later but found {time} ns')
        if position is not None:
            given = np.asarray(position, dtype=np.float64)
            if given.shape != self._position.shape:
                raise ValueError(
                    f'position: expected one value per axis {", ".join(self._axes)} '
                    f'but found shape {given.shape}'
                )
            known = np.abs(given) <= _PLAUSIBLE['reference_position']  # false for NaN
            self._travel(np.where(known, given, self._position), time)
        before = self._applied
        if self._before and self._newest:
            self._follow(self._before, min(time, self._newest.stamp))
        if self._newest and self._in_force:
            self._ramp_to_zero(min(time, self._newest.stamp))
            if time >= self._newest.stamp:
                self._before = None
                self._follow(self._newest, time)
            self._in_force = time < self._newest.valid_until
        self._ramp_to_zero(time)
        reach = self._config.slew_max * self._step_max
        self._applied = np.clip(self._applied, before - reach, before + reach)
        return self.applied

    def _travel(self, position: NDArray[np.float64], time: int) -> None:
        """Let the offsets go along their slopes to a position [m].

        A position that leaps is told by a control that homes, or by mistake: nothing moved.
        """
        moved = np.nan_to_num(position - self._position)
        reach = self._config.speed_max * 1e-9 * (time - self._travelled_to)
        self._position, self._travelled_to = position, time
        command = self._before or self._newest
        if command is None or not self._in_force or not command.slope.any():
            return
        most = self._config.offset_max
        change = np.clip(command.target(position), -most, most)
        change = change - np.clip(command.target(position - moved), -most, most)
        limit = np.maximum(most, np.abs(self._applied))
        along = self._applied + np.where(np.abs(moved) <= reach, change, 0.0)
        self._applied = np.clip(along, -limit, limit)

    def _follow(self, command: _Command, time: int) -> None:
        """Follow a command until `time` or its expiry, whichever is first."""
        wanted = command.target(self._position)
        target = np.clip(wanted, -self._config.offset_max, self._config.offset_max)
        self._at_limit = target != wanted
        self._move(target, min(time, command.valid_until))

    def _ramp_to_zero(self, time: int) -> None:
        if time > self._time:
            self._at_limit = np.zeros(len(self._axes), dtype=bool)
            self._move(np.zeros(len(self._axes)), time)

    def _move(self, target: NDArray[np.float64], time: int) -> None:
        """Move towards `target` at the slew limit until `time`; the past moves nothing."""
        reach = self._config.slew_max * 1e-9 * max(0, time - self._time)
        self._applied = self._applied + np.clip(target - self._applied, -reach, reach)
        self._time = max(self._time, time)

    def _cut_text(self, cut: NDArray[np.bool_]) -> str:
        names = [name for name, is_cut in zip(self._axes, cut, strict=True) if is_cut]
        if not names:
            return ''
        return f'{", ".join(names)} cut at the limit of {1e6 * self._config.offset_max:g} um'

    def _refused_by_owner(self, epoch: int, owner: str) -> str:
        if epoch < max(1, self.epoch):
            return (
                f'expected epoch {max(1, self.epoch)} or higher but found {epoch}; '
                'start from the read-back with a higher epoch'
            )
        if epoch > self.epoch + EPOCH_STEP:
            return (
                f'expected epoch {max(1, self.epoch)} to {self.epoch + EPOCH_STEP} but found '
                f'{epoch}; start from the read-back with the next epoch'
            )
        if self._newest and epoch == self.epoch and owner != self.owner:
            return (
                f'epoch {epoch} belongs to {self.owner or "an unnamed owner"} but the command '
                f'comes from {owner or "an unnamed owner"}; two sources of offsets are active'
            )
        return ''

    def _refused_by_time(self, epoch: int, stamp: int, valid_until: int) -> str:
        if valid_until <= max(stamp, self._time):
            late = 1e-9 * (max(stamp, self._time) - valid_until)
            return f'stale: the command expired {late:.3f} s before it could act'
        lead = 1e-9 * (stamp - self._time)
        if lead > self._config.lead_max:
            return (
                f'stamp: expected at most {self._config.lead_max:g} s ahead of the machine '
                f'but found {lead:.3f} s; is the sender on the same clock?'
            )
        if self._newest and epoch == self.epoch and stamp < self._newest.stamp:
            return (
                f'stamp: expected none older than the command before '
                f'({self._newest.stamp} ns) but found {stamp} ns'
            )
        return ''


def content_refusal(
    axes: Sequence[str], axis: Sequence[str], columns: Mapping[str, NDArray[np.float64]]
) -> str:
    """Say why the content of a command means nothing; empty if it does.

    Parameters
    ----------
    axes : sequence of str
        Axes that take offsets.
    axis : sequence of str
        Axes of the command.
    columns : mapping of str to ndarray, shape (len(axis),)
        `offset` [m], `slope` [-] and `reference_position` [m].
    """
    unknown = [name for name in axis if name not in axes]
    if unknown:
        return f'axis: expected {", ".join(axes)} but found {", ".join(unknown)}'
    if len(set(axis)) != len(axis):
        return f'axis: expected each name once but found {", ".join(axis)}'
    for name, values in columns.items():
        if values.shape != (len(axis),):
            return f'{name}: expected {len(axis)} values but found shape {values.shape}'
        if not (np.abs(values) <= _PLAUSIBLE[name]).all():
            return (
                f'{name}: expected finite values within {_PLAUSIBLE[name]:g} '
                f'(SI units) but found {values.tolist()}'
            )
    return ''

# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Output-error identification of an axis: command in, position out, judged on held-out parts.

References
----------
[ljung1999], chapter 7.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from math import exp, inf, log, sqrt
from typing import Any

import numpy as np
from scipy.optimize import least_squares, minimize_scalar
from scipy.signal import savgol_filter
from scipy.stats import t as student

from fuzzycnc_ros.core.arrays import Array


@dataclass(frozen=True, kw_only=True)
class AxisModel:
    """Motion per command: dv/dt = gain u - viscous v - coulomb sign(v) - offset.

    Forces are divided by the mass, which position and command alone do not tell.

    Attributes
    ----------
    gain : float
        Acceleration per command [m/s^2 per unit of the command].
    viscous_forward, viscous_backward : float
        Viscous friction over mass in positive and negative motion [1/s].
    coulomb : float
        Coulomb friction over mass [m/s^2].
    offset : float
        Steady deceleration, friction that differs by direction included [m/s^2].
    delay : float
        Dead time between command and force [s].
    """

    gain: float
    viscous_forward: float
    viscous_backward: float
    coulomb: float
    offset: float
    delay: float = 0.0

    def simulate(
        self, command: Array, period: float, position: float = 0.0, velocity: float = 0.0
    ) -> Array:
        """Return the positions that a course of commands gives, open loop.

        Between two samples the linear part is followed exactly; Coulomb friction takes its
        impulse afterwards and stops the axis where it exceeds what is left.

        Parameters
        ----------
        command : ndarray, shape (n,)
            Commands, each held for a period.
        period : float
            Time between them [s].
        position, velocity : float
            Motion at the first sample [m, m/s].

        Returns
        -------
        ndarray, shape (n,)
            Positions at the samples [m].

        Examples
        --------
        >>> model = AxisModel(
        ...     gain=0.37, viscous_forward=2.1, viscous_backward=2.1, coulomb=0.21, offset=0.0
        ... )
        >>> f'{model.simulate(np.full(1001, 2.0), 1e-3)[-1]:.3f}'
        '0.147'
        """
        push = (self.gain * self.acting(command, period) - self.offset).tolist()
        forward = _held(self.viscous_forward, period)
        backward = _held(self.viscous_backward, period)
        half = 0.5 * period
        (keep_f, gain_f), (keep_b, gain_b) = forward, backward
        friction_f, friction_b = self.coulomb * gain_f, self.coulomb * gain_b
        place, speed = position, velocity
        course: list[float] = []
        add = course.append
        for force in push:
            add(place)
            if speed > 0.0 or (speed == 0.0 and force > 0.0):
                after, friction = speed * keep_f + force * gain_f, friction_f
            else:
                after, friction = speed * keep_b + force * gain_b, friction_b
            if after > friction:
                after -= friction
            elif after < -friction:
                after += friction
            else:
                after = 0.0
            place += half * (speed + after)
            speed = after
        return np.array(course)

    def acting(self, command: Array, period: float) -> Array:
        """Return what drives in each period: the command after its dead time."""
        acting = np.asarray(command, dtype=np.float64)
        if self.delay > 0.0:
            whole, part = divmod(self.delay / period, 1.0)
            late = int(whole)
            padded = np.concatenate([np.full(late + 1, acting[0]), acting])
            acting = (1.0 - part) * padded[1 : 1 + len(acting)] + part * padded[: len(acting)]
        return acting


def _held(viscous: float, period: float) -> tuple[float, float]:
    """Return what a period keeps of the velocity, and what an acceleration held for it adds."""
    if abs(viscous) * period < 1e-9:
        return 1.0, period
    keep = exp(-viscous * period)
    return keep, (1.0 - keep) / viscous


STRUCTURES: dict[str, tuple[str, ...]] = {
    'one friction': ('gain', 'viscous', 'coulomb', 'offset'),
    'friction by direction': (
        'gain', 'viscous_forward', 'viscous_backward', 'coulomb', 'offset',
    ),
}  # fmt: skip
"""Structures that compete, the simplest first, by the parameters that each has."""

BETTER = 0.97
"""Held-out error, as share of a simpler structure's, from which a further parameter is taken."""

_BLOCKS = 20
"""Blocks of a recording over which the uncertainty is judged: errors of one block go together."""

_SHORT = 10
"""Stretches into which a recording is cut where structures compete: a fit that needs no start."""

_FOLLOWS, _SPEED_RATE = 0.5, 50.0
"""Correlation of command and speed from which the one follows the other at once [-], and the rate
at which it is then taken to do so at first [1/s]."""

_HORIZONS = (20, 5, 1)
"""Stretches into which a recording is cut for the fit to all data, which heeds all alike.

Over a whole recording friction makes a simulation drift, and a fit to that alone ends in one of
many minima; short stretches alone tell the friction badly.  On the EMPS recording these three left
the least error on halves that the fit had not seen.
"""


@dataclass(frozen=True, eq=False)
class AxisRecording:
    """A stretch of a recording without gaps.

    Attributes
    ----------
    command : ndarray, shape (n,)
        Command in force from each sample on.
    position : ndarray, shape (n,)
        Measured position [m].
    period : float
        Time between two samples [s].
    reference : ndarray, shape (n,), optional
        Set points that the recording followed: positions, or a duty that was added.

    Raises
    ------
    ValueError
        If the period is not above 0, the courses differ in length, or a number is not finite.
    """

    command: Array
    position: Array
    period: float
    reference: Array | None = None

    def __post_init__(self) -> None:
        if not 0.0 < self.period < inf:
            raise ValueError(f'period: expected more than 0 s but found {self.period} s')
        shapes = np.shape(self.command), np.shape(self.position)
        if shapes[0] != shapes[1] or len(shapes[0]) != 1:
            raise ValueError(
                f'position: expected one for each command but found the shapes {shapes[1]} and '
                f'{shapes[0]}'
            )
        if self.reference is not None and np.shape(self.reference) != shapes[0]:
            raise ValueError(
                f'reference: expected one for each command but found the shapes '
                f'{np.shape(self.reference)} and {shapes[0]}'
            )
        for name in (
            'command',
            'position',
            *(['reference'] if self.reference is not None else []),
        ):
            values = getattr(self, name)
            bad = np.flatnonzero(~np.isfinite(values))
            if len(bad):
                raise ValueError(
                    f'{name}: expected finite numbers but found {values[bad[0]]} at sample '
                    f'{bad[0]}'
                )

    @cached_property
    def start(self) -> tuple[float, float]:
        """Position and velocity at the first sample [m, m/s]."""
        window = min(21, len(self.position) - (len(self.position) + 1) % 2)
        near = self.position[: 2 * window]
        place = savgol_filter(near, window, 2)[0]
        speed = savgol_filter(near, window, 2, deriv=1, delta=self.period)[0]
        return float(place), float(speed)

    def part(self, first: int, last: int) -> AxisRecording:
        """Return the samples from `first` up to `last`."""
        reference = None if self.reference is None else self.reference[first:last]
        return AxisRecording(
            self.command[first:last], self.position[first:last], self.period, reference
        )


@dataclass(frozen=True)
class Parameter:
    """A parameter with what the data say of it.

    Attributes
    ----------
    name : str
        Of `AxisModel`.
    value : float
        Its value, in the units of `AxisModel`.
    low, high : float
        Ends of its 95 % interval.
    why_not : str
        Why the data cannot tell it; empty if they can.
    """

    name: str
    value: float
    low: float
    high: float
    why_not: str = ''


@dataclass(frozen=True, eq=False)
class AxisFit:
    """An identified axis.

    Attributes
    ----------
    model : AxisModel
        The model.
    structure : str
        Of `STRUCTURES`.
    parameters : tuple of Parameter
        What was identified, with its uncertainty.
    rms : float
        Open-loop error on the data of the fit [m].
    held_out_rms, held_out_span : float
        Open-loop error on parts that a fit had not seen [m], and the way of the axis there [m].
    trials : dict of str to float
        Held-out error of each structure [m].
    residual : tuple of ndarray
        Measured less simulated position of each recording [m].
    """

    model: AxisModel
    structure: str
    parameters: tuple[Parameter, ...]
    rms: float
    held_out_rms: float
    held_out_span: float
    trials: dict[str, float]
    residual: tuple[Array, ...]


_Progress = Callable[[str, int, int], None]
"""Told what is fitted, how many fits are done, and how many there are."""


def late(recording: AxisRecording, delay: float) -> AxisRecording:
    """Return a recording whose command is as late as it acts, by a dead time [s]."""
    plain = AxisModel(
        gain=1.0, viscous_forward=0.0, viscous_backward=0.0, coulomb=0.0, offset=0.0, delay=delay
    )
    return replace(recording, command=plain.acting(recording.command, recording.period))


def fit_axis(
    recordings: Sequence[AxisRecording],
    progress: _Progress | None = None,
    *,
    gain: tuple[float, float] = (1e-4, 1e5),
) -> AxisFit:
    """Identify an axis from recordings of its command and its position.

    Each structure is fitted on one half of the data and judged, open loop, on the other, both
    ways round.  A structure with more parameters is taken where that lowers the held-out error by
    3 % or more.  The one taken is fitted to all data, open loop over each whole recording.

    Parameters
    ----------
    recordings : sequence of AxisRecording
        Recordings without gaps, each from where the axis stands or moves; one period for all.
        Their commands act at once: see `late`.
    progress : callable, optional
        Told before each fit.
    gain : tuple of float
        Ends between which the gain is looked for [m/s^2 per unit of the command].

    Raises
    ------
    ValueError
        If the data cannot tell an axis: too short, no motion, no command, or no motion that
        follows the command.
    """
    check_recordings(recordings)
    halves = _halves(recordings)
    plain = inverse_dynamics(recordings)
    plain = replace(plain, gain=min(max(plain.gain, gain[0]), gain[1]))
    trials: dict[str, float] = {}
    starts: dict[str, AxisModel] = {}
    work = len(STRUCTURES) + 1

    def worth(name: str, names: tuple[str, ...], than: str) -> bool:
        """Judge a structure on halves that its fit has not seen."""
        if progress is not None:
            progress(name, len(trials), work)
        errors = []
        for train, judge in (halves, halves[::-1]):
            starts[name] = _fit(_cut(train, _SHORT), plain, names, gain)
            errors += [_errors(starts[name], one) for one in _cut(judge, 2)]
        trials[name] = sqrt(float(np.mean([np.mean(error**2) for error in errors])))
        return not than or trials[name] < BETTER * trials[than]

    chosen = ''
    for name, names in STRUCTURES.items():
        chosen = name if worth(name, names, chosen) else chosen
    if progress is not None:
        progress('all data', work - 1, work)
    names = STRUCTURES[chosen]
    # Drift leaves many minima: the best of several beginnings is taken.
    ends = [_fit_horizons(recordings, start, names, gain) for start in (plain, starts[chosen])]
    model = min(ends, key=lambda end: _misfit(recordings, end))
    residual = tuple(_errors(model, one) for one in recordings)
    return AxisFit(
        model,
        chosen,
        _parameters(recordings, model, names),
        sqrt(float(np.mean(np.concatenate(residual) ** 2))),
        trials[chosen],
        max(float(np.ptp(one.position)) for one in recordings),
        trials,
        residual,
    )


@dataclass(frozen=True)
class FrictionByRecording:
    """Friction of recordings in their order, as factors on that of a model.

    Attributes
    ----------
    factors : tuple of float
        Factor on all friction of each recording [-].
    plain, learnt : float
        Open-loop error on stretches of all recordings but the first, with the friction of the
        model and with that of the recording before [m].
    """

    factors: tuple[float, ...]
    plain: float
    learnt: float

    @property
    def latest(self) -> float:
        """Factor of the last recording; 1 where learning from the one before was no better."""
        return self.factors[-1] if self.learnt < BETTER * self.plain else 1.0


def friction_by_recording(
    recordings: Sequence[AxisRecording], model: AxisModel
) -> FrictionByRecording:
    """Fit one factor on the friction of a model to each recording.

    Friction changes with warmth, lubrication and rest; gain and mass do not.

    Parameters
    ----------
    recordings : sequence of AxisRecording
        Two or more, in the order of their days.
    model : AxisModel
        Fitted to all of them.
    """
    days = [_cut([one], _DAY) for one in recordings]

    def squares(factor: float, day: Sequence[AxisRecording]) -> float:
        scaled = _rubbing(model, factor)
        return sum(float((_errors(scaled, part) ** 2).sum()) for part in day)

    search: Any = minimize_scalar
    factors = [
        exp(
            search(
                lambda size, day=day: squares(exp(size), day),
                bounds=(-log(_DRIFT), log(_DRIFT)),
                method='bounded',
                options={'xatol': 0.01},
            ).x
        )
        for day in days
    ]
    later = days[1:]
    count = sum(len(part.command) for day in later for part in day)
    before = zip(factors[:-1], later, strict=True)
    return FrictionByRecording(
        tuple(factors),
        sqrt(sum(squares(1.0, day) for day in later) / count),
        sqrt(sum(squares(factor, day) for factor, day in before) / count),
    )


def _rubbing(model: AxisModel, factor: float) -> AxisModel:
    return replace(
        model,
        viscous_forward=factor * model.viscous_forward,
        viscous_backward=factor * model.viscous_backward,
        coulomb=factor * model.coulomb,
    )


_DAY, _DRIFT = 5, 4.0
"""Stretches into which a recording is cut for its own friction, and the largest factor on that."""


def check_recordings(recordings: Sequence[AxisRecording]) -> None:
    """Refuse recordings that cannot tell an axis.

    Raises
    ------
    ValueError
        If they are too short, have several periods, or nothing moves.
    """
    if len({round(one.period * 1e9) for one in recordings}) > 1:
        raise ValueError('expected one period in all recordings but found several')
    total = sum(len(one.command) for one in recordings)
    if total < 1000:
        raise ValueError(
            f'expected 1000 samples or more of command and position but found {total}; record '
            'some seconds of moves with different speeds'
        )
    command = np.concatenate([one.command for one in recordings])
    if not np.ptp(command) > 0.0:
        raise ValueError(
            'command: expected a course that changes but found one value throughout; which column '
            'is the command of the drive?'
        )
    moved = max(float(np.ptp(one.position)) for one in recordings)
    steps = np.abs(np.concatenate([np.diff(one.position) for one in recordings]))
    count = float(steps[steps > 0.0].min()) if (steps > 0.0).any() else inf
    if not moved > 100.0 * count:
        raise ValueError(
            f'position: expected motion of more than 100 counts but found {1e6 * moved:.3g} µm; '
            'the axis stands, or this is another column'
        )


def _halves(
    recordings: Sequence[AxisRecording],
) -> tuple[list[AxisRecording], list[AxisRecording]]:
    """Return two halves: of the recordings if there are several, else of the only one."""
    if len(recordings) > 1:
        return list(recordings[::2]), list(recordings[1::2])
    (one,) = recordings
    middle = len(one.command) // 2
    return [one.part(0, middle)], [one.part(middle, len(one.command))]


def _cut(recordings: Sequence[AxisRecording], count: int) -> list[AxisRecording]:
    """Return every recording in equal stretches, of 200 samples at least."""
    found = []
    for one in recordings:
        size = max(len(one.command) // count, min(200, len(one.command)))
        found += [
            one.part(first, first + size) for first in range(0, len(one.command) - size + 1, size)
        ]
    return found


def _errors(model: AxisModel, one: AxisRecording) -> Array:
    """Return measured less simulated position, open loop from the first sample on [m]."""
    place, speed = one.start
    return np.asarray(one.position - model.simulate(one.command, one.period, place, speed))


def inverse_dynamics(recordings: Sequence[AxisRecording]) -> AxisModel:
    """Return a first model: forces explained by smoothed derivatives, by least squares.

    Raises
    ------
    ValueError
        If a positive command does not drive to positive positions.
    """
    rows, targets, speeds = [], [], []
    for one in recordings:
        window = max(5, min(81, 2 * (len(one.position) // 20) + 1))
        speed = savgol_filter(one.position, window, 3, deriv=1, delta=one.period)
        rise = savgol_filter(one.position, window, 3, deriv=2, delta=one.period)
        kernel = np.full(window // 2 or 1, 1.0 / (window // 2 or 1))
        command = np.convolve(one.command, kernel, 'same')
        moving = np.abs(speed) > 0.05 * np.abs(speed).max()
        rows.append(
            np.column_stack([command, -speed, -np.sign(speed), -np.ones(len(speed))])[moving]
        )
        targets.append(rise[moving])
        speeds.append(speed[moving])
    found, *_ = np.linalg.lstsq(np.concatenate(rows), np.concatenate(targets), rcond=None)
    gain, viscous, coulomb, offset = found.tolist()
    if gain <= 0.0:
        # The flow of a valve, and a drive with a velocity loop, command the speed.
        command, speed = np.concatenate(rows)[:, 0], np.concatenate(speeds)
        if float(command @ speed) > _FOLLOWS * sqrt(float((command @ command) * (speed @ speed))):
            gain = _SPEED_RATE * float(command @ speed) / float(command @ command)
            viscous, coulomb, offset = _SPEED_RATE, 0.0, 0.0
    if gain <= 0.0:
        raise ValueError(
            'command: expected a positive command to drive to positive positions but found the '
            'opposite, or no relation; turn the sign of one of them, or choose another'
        )
    viscous, coulomb = max(viscous, 1e-3), max(coulomb, 0.0)
    return AxisModel(
        gain=gain,
        viscous_forward=viscous,
        viscous_backward=viscous,
        coulomb=coulomb,
        offset=offset,
    )


def _vector(model: AxisModel, names: Sequence[str]) -> Array:
    """Return parameters as the search has them: positive ones by their logarithm."""
    return np.array([_to(name, _value(model, name)) for name in names])


def _value(model: AxisModel, name: str) -> float:
    if name == 'viscous':
        return 0.5 * (model.viscous_forward + model.viscous_backward)
    return float(getattr(model, name))


def _to(name: str, value: float) -> float:
    return log(max(value, 1e-6)) if name in ('gain', *_VISCOUS) else value


_VISCOUS = ('viscous', 'viscous_forward', 'viscous_backward')


def _model(point: Array, names: Sequence[str]) -> AxisModel:
    values = {
        name: float(np.exp(value)) if name in ('gain', *_VISCOUS) else float(value)
        for name, value in zip(names, point.tolist(), strict=True)
    }
    viscous = values.pop('viscous', None)
    if viscous is not None:
        values |= {'viscous_forward': viscous, 'viscous_backward': viscous}
    return AxisModel(**values)


def _bounds(names: Sequence[str], gain: tuple[float, float]) -> tuple[Array, Array]:
    low = {'coulomb': 0.0, 'offset': -inf, 'gain': log(gain[0])}
    high = {'coulomb': inf, 'offset': inf, 'gain': log(gain[1])}
    return (
        np.array([low.get(name, log(1e-4)) for name in names]),
        np.array([high.get(name, log(1e5)) for name in names]),
    )


def _steps(point: Array) -> Array:
    """Return steps of the numerical derivative: a share of what each parameter is."""
    return 1e-4 * np.maximum(np.abs(point), 0.01)


def _fit(
    recordings: Sequence[AxisRecording],
    start: AxisModel,
    names: Sequence[str],
    gain: tuple[float, float],
) -> AxisModel:
    low, high = _bounds(names, gain)

    def residual(point: Array) -> Array:
        model = _model(point, names)
        return 1e3 * np.concatenate([_errors(model, one) for one in recordings])

    def slope(point: Array) -> Array:
        return _slopes(recordings, point, names, 1e3)

    begin = np.clip(_vector(start, names), low + 1e-9, high - 1e-9)
    search: Any = least_squares
    found = search(residual, begin, slope, bounds=(low, high), x_scale='jac', max_nfev=10)
    return _model(found.x, names)


def _fit_horizons(
    recordings: Sequence[AxisRecording],
    start: AxisModel,
    names: Sequence[str],
    gain: tuple[float, float],
) -> AxisModel:
    """Return the model that fits stretches of several lengths, each set by its own error."""
    low, high = _bounds(names, gain)
    sets = [_cut(recordings, count) for count in _HORIZONS]
    point = np.clip(_vector(start, names), low + 1e-9, high - 1e-9)
    for _ in range(2):
        shares = [_share(_model(point, names), parts) for parts in sets]

        def residual(at: Array, shares: list[float] = shares) -> Array:
            model = _model(at, names)
            return np.concatenate(
                [
                    share * _errors(model, one)
                    for share, parts in zip(shares, sets, strict=True)
                    for one in parts
                ]
            )

        def slope(at: Array, shares: list[float] = shares) -> Array:
            pairs = zip(shares, sets, strict=True)
            return np.concatenate([_slopes(parts, at, names, share) for share, parts in pairs])

        search: Any = least_squares
        point = search(residual, point, slope, bounds=(low, high), x_scale='jac', max_nfev=12).x
    return _model(point, names)


def _misfit(recordings: Sequence[AxisRecording], model: AxisModel) -> float:
    """Return the geometric mean of the errors over stretches of each length [m]."""
    errors = [1.0 / _share(model, _cut(recordings, count)) for count in _HORIZONS]
    return float(np.exp(np.mean(np.log(errors))))


def _share(model: AxisModel, parts: Sequence[AxisRecording]) -> float:
    """Return the weight that makes the squared errors of some stretches sum up to 1 [1/m]."""
    return 1.0 / sqrt(sum(float((_errors(model, one) ** 2).sum()) for one in parts) or 1.0)


def _slopes(
    recordings: Sequence[AxisRecording], point: Array, names: Sequence[str], unit: float
) -> Array:
    """Return the derivative of the residuals by the parameters, shape (n, k)."""
    steps = _steps(point)

    def errors(at: Array) -> Array:
        model = _model(at, names)
        return np.concatenate([_errors(model, one) for one in recordings])

    here = errors(point)
    columns = []
    for index, step in enumerate(steps.tolist()):
        beside = point.copy()
        beside[index] += step
        columns.append(unit * (errors(beside) - here) / (beside[index] - point[index]))
    return np.column_stack(columns)


def _parameters(
    recordings: Sequence[AxisRecording], model: AxisModel, names: Sequence[str]
) -> tuple[Parameter, ...]:
    """Return the parameters with 95 % intervals that allow for errors that go together.

    The errors of an open-loop simulation are far from independent: the interval is that of a
    sandwich estimator over blocks of the recordings.
    """
    point = _vector(model, names)
    slope = _slopes(recordings, point, names, 1.0)
    error = np.concatenate([_errors(model, one) for one in recordings])
    blocks = np.array_split(np.arange(len(error)), _BLOCKS)
    bread = np.linalg.pinv(slope.T @ slope, hermitian=True)
    pull = np.array([slope[rows].T @ error[rows] for rows in blocks])
    covariance = bread @ (pull.T @ pull) @ bread * _BLOCKS / (_BLOCKS - 1.0)
    half = float(student.ppf(0.975, _BLOCKS - 1)) * np.sqrt(np.diag(covariance))
    found = []
    for name, value, width in zip(names, point.tolist(), half.tolist(), strict=True):
        grown = name in ('gain', *_VISCOUS)
        low, centre, high = (
            float(np.exp(min(end, 50.0))) if grown else float(end)
            for end in (value - width, value, value + width)
        )
        found.append(Parameter(name, centre, low, high, _why_not(name, centre, low, high)))
    return tuple(found)


def _why_not(name: str, value: float, low: float, high: float) -> str:
    """Return why the data cannot tell a parameter."""
    remedy = {
        'gain': 'moves with more acceleration',
        'coulomb': 'slow moves both ways',
        'offset': 'slow moves both ways',
    }.get(name, 'longer stretches at different constant speeds')
    if name == 'offset':
        return ''  # 0 is as good an answer as any other
    if low <= 0.0 or high - low > value:
        return f'these data do not show it; {remedy} would'
    return ''

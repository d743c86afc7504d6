# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Linear model of an axis fitted to its measured frequency response, with intervals.

Friction, dead time and at most one mode: what the response does not tell is unknown, not zero.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import exp, inf, log, pi
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import least_squares

from fuzzycnc_ros.core.arrays import Array
from fuzzycnc_ros.core.identify.frequency import FrequencyResponse

DEAD_TIME_MAX = 0.05
"""Longest dead time that is looked for [s]."""

LEVEL = 5.0
"""Frequency at which the level of a response is judged [Hz]: near where loops cross over."""

_SIGMAS = 2.6
"""Half width of an interval in standard errors [-]."""

_LOWEST_MODE = 3.0
"""Lowest mode that is looked for [Hz]: what is slower is friction."""

_LINES = 8
"""Known lines below which nothing is fitted."""

_WORTH = 0.7
"""Misfit over that without a mode from which a mode is told [-]."""

_MENDED = 0.4
"""The same about the mode alone [-]: friction and backlash elsewhere are no matter."""

_NARROW = 0.02
"""Damping of a mode that is as wide as a line [-]."""

_ROOM = 4.5
"""Growth of the misfit, in units of its expectation, up to which a mode may be there [-]."""

_GAIN_OF_MODE = 1.25
"""Ratio to the rigid axis, either way, that a mode makes somewhere among the known lines [-]."""

_SHARP = 1.4
"""Ratio of the ends of its interval up to which a mode is told [-]."""

_DAMPED = 0.35
"""Damping from which on what looks like a mode is told as none [-]: backlash and friction bend a
response as broadly, and differently at every amplitude."""

_LAGGING = 0.1
"""Damping that a mode may have which is not told [-]: behind its spring an axis lags by 2 z / w,
as if that were dead time."""

_BEYOND, _NEAR = 1.15, 3.0
"""Ratio to which the response has to be known beyond a mode, and lines that have to be about it:
what the last lines of a recording do is no mode."""

_DELAY_ERROR = 5e-5
"""Half width that is added to the interval of the dead time: when a sample is taken [s]."""

_HALVINGS = 6
"""Steps in which the longest dead time that the lines allow is found."""

_SYSTEMATIC = {'mode': 0.06, 'damping': 0.5}
"""Relative half width that an interval does not fall below, else 2 % [-]: a mode moves with the
friction of its masses."""

_SOFTENED = 0.15
"""The same above a mode [-]: with backlash a spring answers lower than with its gap closed."""

_SHOWN = ((0.0, 0.05), (2.0, 0.05), (0.0, 0.3))
"""Ratio and damping of the modes that are looked for beyond the known lines, the broadest last: it
may lag by 2 z / w, which is no dead time."""

_LATE = 0.1
"""Share that is added to either end of the interval of dead time and lag [-]: friction and
backlash turn the phase, too."""

_SHARES = (0.15, 0.85)
"""Shares of the lag in a dead time with which its search begins [-]."""


@dataclass(frozen=True, kw_only=True)
class LinearResponse:
    """Response from duty to acceleration of an axis with friction, dead time and one mode.

    gain s/(s + viscous) exp(-delay s) (ratio s^2 + 2 z w s + w^2)/(s^2 + 2 z w s + w^2)

    Attributes
    ----------
    gain : float
        Acceleration per duty [m/s^2].
    viscous : float
        Rate at which friction takes velocity away [1/s].
    delay : float
        Dead time, lags of drive and sensor included [s].
    mode : float
        Frequency of the mode [Hz]; 0 for none.
    damping : float
        Its damping z [-].
    ratio : float
        What is left of the rigid axis' response far above the mode: 0 where the sensor sits behind
        the spring, above 1 where it sits at the motor [-].
    """

    gain: float
    viscous: float
    delay: float = 0.0
    mode: float = 0.0
    damping: float = 0.05
    ratio: float = 1.0

    def at(self, frequency: ArrayLike) -> NDArray[np.complex128]:
        """Return the response at frequencies [Hz]."""
        s = 2j * pi * np.asarray(frequency, float)
        found = self.gain * s / (s + self.viscous) * np.exp(-self.delay * s)
        if self.mode:
            w = 2.0 * pi * self.mode
            rest = 2.0 * self.damping * w * s + w * w
            found = found * (self.ratio * s * s + rest) / (s * s + rest)
        return np.asarray(found)


@dataclass(frozen=True)
class Interval:
    """Ends between which a quantity lies with 95 %; an open end where nothing bounds it."""

    low: float
    high: float

    def __contains__(self, value: float) -> bool:
        return self.low <= value <= self.high

    def joined(self, other: Interval) -> Interval:
        """Return the least interval that holds both."""
        return Interval(min(self.low, other.low), max(self.high, other.high))


@dataclass(frozen=True, eq=False)
class ResponseFit:
    """Axis model fitted to a frequency response.

    Attributes
    ----------
    model : LinearResponse
        The best model.
    level : Interval
        Factor on the response at `LEVEL`: gain and friction of an axis whose speed follows its
        command are known together far better than each alone.
    gain, viscous, delay, mode, damping, ratio : Interval
        Intervals of its parameters.  Where no mode is told that of `mode` begins at the lowest
        frequency at which the lines leave room for one that moves half of the mass or more.
    late : Interval
        Dead time and lag of the drive together [s].  The model has no lag: `delay` is the dead
        time that answers like both at the known lines.
    known_to : float
        Frequency up to which the response is known without a gap [Hz].
    frequency, remainder : ndarray, shape (n,)
        Frequencies [Hz], and by what share of the model the axis may differ from it there [-].
    known : ndarray of bool, shape (n,)
        Lines that the fit is about.
    """

    model: LinearResponse
    level: Interval
    gain: Interval
    viscous: Interval
    delay: Interval
    mode: Interval
    damping: Interval
    ratio: Interval
    late: Interval
    known_to: float
    frequency: Array
    remainder: Array
    known: NDArray[np.bool_]

    @property
    def resonance_known(self) -> bool:
        """True if a mode was identified."""
        return self.model.mode > 0.0


_RIGID = ('gain', 'viscous', 'delay')
_MODE = (*_RIGID, 'mode', 'damping', 'ratio')
_LOGS = ('gain', 'viscous', 'mode', 'damping')
_BOUNDS = {
    'gain': (1e-4, 1e6),
    'viscous': (1e-4, 600.0),
    'delay': (0.0, DEAD_TIME_MAX),
    'mode': (0.1, 1e4),
    'damping': (2e-3, 0.5),
    'ratio': (0.0, 30.0),
    'total': (0.0, DEAD_TIME_MAX),
    'share': (0.0, 1.0),
}


def fit_response(response: FrequencyResponse, gain: float, viscous: float) -> ResponseFit | None:
    """Fit gain, friction, dead time and, where it shows, a mode to a measured response.

    Parameters
    ----------
    response : FrequencyResponse
        What was measured.
    gain, viscous : float
        Where the search begins [m/s^2, 1/s].

    Returns
    -------
    ResponseFit or None
        None where too few lines are known.
    """
    top = response.known_to
    lines = response.known & (response.frequency <= top)
    if lines.sum() < _LINES:
        return None
    search = _Search(response, np.asarray(lines))
    starts = [
        {'gain': gain, 'viscous': v, 'delay': delay}
        for delay in (1e-3, 5e-3)
        for v in (max(viscous, 0.1), 30.0 * max(viscous, 0.1))
    ]
    rigid = min((search.best(start) for start in starts), key=lambda one: one.cost)
    lagging = search.lagging(rigid)
    found, closest, bend = rigid, rigid, lagging
    for mode in np.geomspace(_LOWEST_MODE, max(1.3 * top, 2.0 * _LOWEST_MODE), 14):
        for ratio in (0.02, 2.0):
            start = rigid.values | {'mode': float(mode), 'damping': 0.06, 'ratio': ratio}
            other = search.best(start)
            closest = min(closest, other, key=lambda one: one.cost)
            if other.cost < _WORTH * bend.cost and search.within(other, top):
                bend = other
            worth = other.cost < _WORTH * rigid.cost or search.mends(other, lagging)
            if worth and other.cost < found.cost and search.shows(other, top):
                found = other
    model = LinearResponse(**found.values)
    ends = search.intervals(found)
    if not model.mode:
        low = search.room(found, top)
        if bend is not lagging:  # too broad to be told as a mode, but it may be one
            low = min(low, bend.intervals()['mode'].low)
        ends['mode'] = Interval(low, inf)
    if closest.cost < _WORTH * found.cost:  # a mode that may not be told may still be there
        wider = search.intervals(closest)
        for name in _RIGID:
            ends[name] = ends[name].joined(wider[name])
    least = min(ends['delay'].low, search.with_lag(found))
    unseen = 0.0 if model.mode else _SHOWN[-1][1] / (pi * ends['mode'].low)
    if model.mode:
        lagging = search.lagging(found)
    elif bend is not lagging:
        lagging = search.lagging(bend)
    if model.ratio < 1.0 or not model.mode:
        damping = model.damping if model.mode else _LAGGING
        least = max(least - 2.0 * damping / (2.0 * pi * ends['mode'].low), 0.0)
    delay = Interval(least, ends['delay'].high)
    nothing = Interval(0.0, inf)
    measured = response.response / model.at(response.frequency)
    return ResponseFit(
        model,
        ends['level'],
        ends['gain'],
        ends['viscous'],
        delay,
        ends['mode'],
        ends.get('damping', nothing),
        ends.get('ratio', nothing),
        search.late(lagging, unseen),
        top,
        response.frequency,
        np.asarray(np.abs(measured - 1.0) + 2.0 * response.error * np.abs(measured)),
        np.asarray(lines),
    )


@dataclass(frozen=True, eq=False)
class _SearchEnd:
    """An end of the search."""

    values: dict[str, float]
    cost: float
    slope: Array
    names: tuple[str, ...]
    free: float

    def intervals(self) -> dict[str, Interval]:
        """Return the intervals of the parameters; the misfit widens them."""
        scale = max(2.0 * self.cost / self.free, 1.0)
        covariance = scale * np.linalg.pinv(self.slope.T @ self.slope)
        spread = np.sqrt(np.diag(covariance))
        square = self.values['viscous'] ** 2
        apart = np.zeros(len(self.names))
        apart[self.names.index('gain')] = 1.0
        apart[self.names.index('viscous')] = -square / (square + (2.0 * pi * LEVEL) ** 2)
        width = max(_SIGMAS * float(apart @ covariance @ apart) ** 0.5, 0.02)
        ends = {'level': Interval(exp(-min(width, 50.0)), exp(min(width, 50.0)))}
        for name, width in zip(self.names, (_SIGMAS * spread).tolist(), strict=True):
            value, (least, most) = self.values[name], _BOUNDS[name]
            if name == 'delay':
                width += _DELAY_ERROR
            if name in _LOGS:
                width = max(width, _SYSTEMATIC.get(name, 0.02))
                above = max(width, _SOFTENED) if name == 'mode' else width
                low, high = value * exp(-min(width, 50.0)), value * exp(min(above, 50.0))
            else:
                low, high = value - width, value + width
            ends[name] = Interval(max(low, least), min(high, most))
        return ends


class _Search:
    """Weighted least squares on the logarithm of the response."""

    def __init__(self, response: FrequencyResponse, lines: NDArray[np.bool_]) -> None:
        self.frequency = response.frequency[lines]
        self.measured = response.response[lines]
        self.weight = np.sqrt(response.share[lines]) / np.hypot(response.error[lines], 0.02)
        self.share = response.share[lines]
        self.free = max(2.0 * float(response.share[lines].sum()) - 6.0, 1.0)

    def _left(self, values: dict[str, float], lag: float = 0.0) -> Array:
        if 'total' in values:
            values = dict(values)
            total, share = values.pop('total'), values.pop('share')
            values['delay'], lag = (1.0 - share) * total, share * total
        modelled = LinearResponse(**values).at(self.frequency)
        if lag:
            modelled = modelled / (1.0 + 2j * pi * self.frequency * lag)
        ratio = self.measured / modelled
        return np.concatenate([self.weight * np.log(np.abs(ratio)), self.weight * np.angle(ratio)])

    def best(self, start: dict[str, float], fixed: dict[str, float] | None = None) -> _SearchEnd:
        """Return the nearest end of the search; some parameters may be fixed."""
        names, held = tuple(start), fixed or {}
        bounds = np.array([_BOUNDS[name] for name in names])
        logs = np.array([name in _LOGS for name in names])
        bounds[logs] = np.log(bounds[logs])
        scale = np.array([1e-3 if name in ('delay', 'total') else 1.0 for name in names])

        def values(point: Array) -> dict[str, float]:
            found = point * scale
            return {
                name: exp(value) if grown else value
                for name, value, grown in zip(names, found.tolist(), logs.tolist(), strict=True)
            }

        begin = np.array([log(start[n]) if n in _LOGS else start[n] for n in names])
        low, high = bounds.T / scale
        run: Any = least_squares
        end = run(
            lambda point: self._left(values(point) | held),
            np.clip(begin / scale, low + 1e-9, high - 1e-9),
            bounds=(low, high),
            loss='soft_l1',
            f_scale=3.0,
            max_nfev=60,
        )
        return _SearchEnd(values(end.x), float(end.cost), end.jac / scale, names, self.free)

    def intervals(self, found: _SearchEnd) -> dict[str, Interval]:
        """Return the intervals of the parameters, none longer a dead time than the lines allow.

        Dead time, friction and damping of a mode delay alike: to first order they leave a long
        dead time open that no response with it fits.
        """
        ends = found.intervals()
        most = found.cost + 0.5 * _SIGMAS**2 * max(2.0 * found.cost / self.free, 1.0)
        rest = {name: value for name, value in found.values.items() if name != 'delay'}
        fits, high = found.values['delay'], ends['delay'].high
        far = high
        for _ in range(_HALVINGS):
            if self.best(rest, {'delay': far}).cost <= most:
                fits = far
            else:
                high = far
            if fits == high:
                break
            far = 0.5 * (fits + high)
        ends['delay'] = Interval(ends['delay'].low, min(high + _DELAY_ERROR, ends['delay'].high))
        return ends

    def room(self, rigid: _SearchEnd, top: float) -> float:
        """Return the lowest frequency at which a mode may be that does not show [Hz]."""
        most = rigid.cost + _ROOM * max(2.0 * rigid.cost / self.free, 1.0)
        lowest = 8.0 * top
        for mode in np.geomspace(8.0 * top, self.frequency[0], 40).tolist():
            costs = [
                self.best(rigid.values, {'mode': mode, 'damping': damping, 'ratio': ratio}).cost
                for ratio, damping in _SHOWN
            ]
            if min(costs) > most:
                break
            lowest = mode
        return lowest

    def lagging(self, found: _SearchEnd) -> _SearchEnd:
        """Return the best fit whose dead time is part of a total, and a lag the other share."""
        rest = {name: value for name, value in found.values.items() if name != 'delay'}
        rest['total'] = max(found.values['delay'], 1e-4)
        ends = [self.best(rest | {'share': share}) for share in _SHARES]
        return min(ends, key=lambda end: end.cost)

    def late(self, best: _SearchEnd, unseen: float) -> Interval:
        """Return the interval of dead time and lag together, by their profile likelihood [s].

        Parameters
        ----------
        best : _SearchEnd
            Of `lagging`.
        unseen : float
            Lag of a mode that does not show [s].
        """
        centre = best.values['total']
        rest = {n: value for n, value in best.values.items() if n not in ('total', 'share')}
        most = best.cost + 0.5 * _SIGMAS**2 * max(2.0 * best.cost / self.free, 1.0)

        def fits(total: float) -> bool:
            held = {'total': total}
            return any(self.best(rest | {'share': s}, held).cost <= most for s in _SHARES)

        ends = []
        for out in (0.0, min(3.0 * centre + 2e-3, DEAD_TIME_MAX)):
            near, far = centre, out
            if not fits(far):
                for _ in range(_HALVINGS):
                    middle = 0.5 * (near + far)
                    near, far = (middle, far) if fits(middle) else (near, middle)
            ends.append(far)
        low, high = ends[0] - _LATE * centre, ends[1] + _LATE * centre
        return Interval(max(low - _DELAY_ERROR - unseen, 0.0), high + _DELAY_ERROR)

    def with_lag(self, found: _SearchEnd) -> float:
        """Return the least dead time if part of it is a lag [s]."""
        best, least = inf, found.values['delay']
        for share in np.linspace(0.0, 1.0, 11):
            delay = found.values['delay']
            left = self._left(found.values | {'delay': (1.0 - share) * delay}, share * delay)
            size = float((left**2).sum())
            best = min(best, size)
            if size <= best + 4.0 * max(best / self.free, 1.0):
                least = min(least, (1.0 - share) * delay)
        return least

    def mends(self, found: _SearchEnd, plain: _SearchEnd) -> bool:
        """Return True if a mode takes most of the misfit away from the lines about it.

        One that is narrower than a line is fitted to what few lines have by chance.
        """
        mode = found.values['mode']
        if found.values['damping'] < _NARROW:
            return False
        near = (self.frequency > 0.7 * mode) & (self.frequency < 1.4 * mode)
        near = np.concatenate([near, near])
        before, after = (self._left(end.values)[near] for end in (plain, found))
        return float((after**2).sum()) < _MENDED * float((before**2).sum())

    def within(self, found: _SearchEnd, top: float) -> bool:
        """Return True if a mode lies at one place among the known lines."""
        mode, ends = found.values['mode'], found.intervals()['mode']
        if not max(_LOWEST_MODE, 2.0 * self.frequency[0]) < mode < top / _BEYOND:
            return False
        return ends.high <= _SHARP * ends.low

    def shows(self, found: _SearchEnd, top: float) -> bool:
        """Return True if a mode lies among the known lines and makes a difference there."""
        mode = found.values['mode']
        if not self.within(found, top) or found.values['damping'] > _DAMPED:
            return False
        model = LinearResponse(**found.values)
        plain = LinearResponse(**{name: found.values[name] for name in _RIGID})
        near = (self.frequency > 0.7 * mode) & (self.frequency < 1.4 * mode)
        if self.share[near].sum() < _NEAR:
            return False
        size = np.abs(model.at(self.frequency[near])) / np.abs(plain.at(self.frequency[near]))
        return bool(size.max() > _GAIN_OF_MODE or size.min() < 1.0 / _GAIN_OF_MODE)

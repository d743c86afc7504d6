# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Error along an axis as channels: what it is in the middle, how it slopes, how it bends.

With u from -1 to 1 along the span of the probed places the error of an axis is

    e(u) = offset + slope u + bend (1/2 - |u|)

so that bend is what the middle is off from the mean of the ends, and offset and slope are the line
that leaves least: half of the bend, at the ends and, the other way, in the middle.  All three are
lengths, learnt and judged like any other channel.  The name of a channel tells what it is: `Y`,
`Y slope -500..0 mm`, `Y bend -500..0 mm`.
"""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import isfinite
from typing import Any

import numpy as np

from fuzzycnc_ros.core import portable
from fuzzycnc_ros.core.arrays import Array

CYCLE_MAX = 600.0
"""Longest time within which places that are probed one after the other count as one look [s]."""

SPAN_MIN = 1e-3
"""Shortest span of places that tells of a slope [m]."""

INNER = 0.5
"""Part of the span about its middle within which a place tells of a bend [-]."""

BEND_LARGEST = 0.5
"""Largest distance of the error from the line, over its bend [-]."""

LINE_RMS = 0.577
"""Root mean square of that distance along the travel, over the largest: 1/sqrt(3) [-]."""

TELLING = 1e-6
"""Share of what is known beforehand below which a probe tells nothing of a channel [-]."""

SLOPE, BEND = 'slope', 'bend'
_NAME = re.compile(
    r'(?P<base>.+) (?P<kind>slope|bend) (?P<low>[-+.\de]+)\.\.(?P<high>[-+.\de]+) mm'
)


def place_channels(axis: Sequence[str], position: Array) -> tuple[str, ...]:
    """Return the channels of measurements at positions of axes.

    Parameters
    ----------
    axis : sequence of str, length n
        Axis of each measurement.
    position : ndarray, shape (n,)
        Where it is measured [m], NaN where that does not matter.

    Returns
    -------
    tuple of str, length n
        The axis alone where it is measured once.

    Examples
    --------
    >>> place_channels(['Y', 'Y', 'Z'], [-0.4, 0.0, 0.0])
    ('Y@-400mm', 'Y@0mm', 'Z')
    """
    names = list(axis)
    return tuple(
        name if names.count(name) == 1 else f'{name}@{1e3 * place:.6g}mm'
        for name, place in zip(names, position, strict=True)
    )


@dataclass(frozen=True)
class AxisSpan:
    """The span along an axis in which its error is told.

    Parameters
    ----------
    axis : str
        ISO 841 name; also the channel of the offset.
    low, high : float
        Outermost places, positions of the machine [m].
    bent : bool
        Whether there is a place between them, which tells of a bend.
    """

    axis: str
    low: float
    high: float
    bent: bool = False

    @property
    def middle(self) -> float:
        """Position to which the offset belongs [m]."""
        return 0.5 * (self.low + self.high)

    @property
    def half(self) -> float:
        """Half of the span [m]."""
        return 0.5 * (self.high - self.low)

    @property
    def channels(self) -> tuple[str, ...]:
        """Channels of offset, slope and bend, the last only where it is told."""
        kinds = (SLOPE, BEND) if self.bent else (SLOPE,)
        ends = f'{1e3 * self.low:.6g}..{1e3 * self.high:.6g} mm'
        return (self.axis, *(f'{self.axis} {kind} {ends}' for kind in kinds))

    def shares(self, position: Array) -> Array:
        """Return what each channel has in the error at positions (n,) [m], shape (n, k) [-].

        A position that is not known counts as the middle.
        """
        along = (np.where(np.isfinite(position), position, self.middle) - self.middle) / self.half
        columns = [np.ones_like(along), along, BEND_LARGEST - np.abs(along)]
        return np.column_stack(columns[: len(self.channels)])


def span_of(channel: str) -> AxisSpan | None:
    """Return the span that the channel of a slope tells of, None for another channel.

    Examples
    --------
    >>> span_of('Y slope -500..0 mm')
    AxisSpan(axis='Y', low=-0.5, high=0.0, bent=False)
    """
    found = _NAME.fullmatch(channel)
    if found is None or found['kind'] != SLOPE:
        return None
    try:
        low, high = 1e-3 * float(found['low']), 1e-3 * float(found['high'])
    except ValueError:
        return None
    if not (isfinite(low) and isfinite(high) and high - low >= SPAN_MIN):
        return None
    return AxisSpan(found['base'], low, high)


@dataclass(frozen=True)
class ChannelSpan:
    """An axis of a model whose error slopes, with the columns of its channels.

    Parameters
    ----------
    span : AxisSpan
        The span.
    columns : tuple of int
        Where offset, slope and, if there is one, bend stand among the channels of the model.
    """

    span: AxisSpan
    columns: tuple[int, ...]


def channel_spans(channel: Sequence[str]) -> tuple[ChannelSpan, ...]:
    """Return the axes whose error slopes, of the channels of a model or run."""
    names = list(channel)
    found = []
    for name in names:
        span = span_of(name)
        if span is None or span.axis not in names:
            continue
        bent = AxisSpan(span.axis, span.low, span.high, bent=True)
        span = bent if set(bent.channels) <= set(names) else span
        found.append(ChannelSpan(span, tuple(names.index(item) for item in span.channels)))
    return tuple(found)


MOTION_MEANS = ('axis_speed', 'axis_square_speed', 'axis_moment', 'axis_second_moment')
"""Means that a control tells of the motion of an axis: its speed [m/s] and squared speed [m2/s2],
and speed times position [m2/s] and squared position [m3/s]."""


def motion_of(drives: Mapping[str, Any], axes: Sequence[str], samples: int = 1) -> Array:
    """Return the motion of axes as a control told it.

    Parameters
    ----------
    drives : mapping of str to float or ndarray, shape (n,)
        Values of `MOTION_MEANS`, as `axis_speed/X`.
    axes : sequence of str, length m
        The axes; one of which nothing was told stood still.
    samples : int
        Number n of samples.

    Returns
    -------
    ndarray, shape (n, m, 4)
        In the order of `MOTION_MEANS`: zero where a speed, NaN where a position is unknown.
    """
    found = np.zeros((samples, len(axes), len(MOTION_MEANS)))
    for row, axis in enumerate(axes):
        for column, name in enumerate(MOTION_MEANS):
            found[:, row, column] = drives.get(f'{name}/{axis}', np.nan)
    found[:, :, :2] = np.nan_to_num(found[:, :, :2])
    return found


def moving_spans(
    channel: Sequence[str], drives: Sequence[Mapping[str, Array]]
) -> tuple[AxisSpan, ...]:
    """Return the axes along which the error slopes and whose motion is known throughout.

    Parameters
    ----------
    channel : sequence of str
        Channels of a model.
    drives : sequence of mapping
        Drives that the control told in each run; see `motion_of`.
    """
    return tuple(
        item.span
        for item in channel_spans(channel)
        if all(
            np.isfinite(run.get(f'{name}/{item.span.axis}', np.nan)).all()
            for run in drives
            for name in MOTION_MEANS[:2]
        )
    )


def sloping_channels(axes: Sequence[str], spans: Sequence[AxisSpan]) -> tuple[str, ...]:
    """Return the channels of axes: first those of all axes, then their slopes and bends."""
    known = {span.axis: span for span in spans}
    more = [name for axis in axes if axis in known for name in known[axis].channels[1:]]
    return (*axes, *more)


def channel_axis(channel: str) -> str:
    """Return the axis of a channel that is called by it, or is its slope or bend."""
    found = _NAME.fullmatch(channel)
    return channel if found is None else found['base']


def read_places(texts: Sequence[str], axes: Sequence[str], name: str) -> tuple[AxisSpan, ...]:
    """Return the spans of axes that are probed at several places.

    Parameters
    ----------
    texts : sequence of str
        Axis and places [m], as `Y:-0.5:0`, or `Y:-0.5:-0.25:0` with one between them.
    axes : sequence of str
        The axes.
    name : str
        Parameter that holds the texts, for messages.

    Raises
    ------
    ValueError
        If one is malformed, of another axis, or there is one twice.

    Examples
    --------
    >>> read_places(['Y:-0.5:0'], ['Y', 'Z'], 'learn_places')
    (AxisSpan(axis='Y', low=-0.5, high=0.0, bent=False),)
    """
    found: dict[str, AxisSpan] = {}
    for text in texts:
        axis, *rest = text.split(':')
        try:
            places = sorted(float(place) for place in rest)
        except ValueError:
            places = []
        usable = len(places) in (2, 3) and all(isfinite(place) for place in places)
        if axis not in axes or axis in found or not usable or places[-1] - places[0] < SPAN_MIN:
            raise ValueError(
                f'{name}: expected each of the axes {", ".join(axes)} at most once with two or '
                f'three places in m, as {axes[0] if axes else "Y"}:-0.5:0, but found {text!r}'
            )
        found[axis] = AxisSpan(axis, places[0], places[-1], bent=len(places) == 3)
    return tuple(found.values())


def along_axes(
    time: Array, axis: Sequence[str], channel: Sequence[str], position: Array, displacement: Array
) -> tuple[tuple[str, ...], tuple[str, ...], Array]:
    """Return measurements at places of axes as offset, slope and bend of each axis.

    Parameters
    ----------
    time : ndarray, shape (n,)
        Time of each sample [s].
    axis, channel : sequence of str, length c
        Axis and channel of each column.
    position : ndarray, shape (c,)
        Where it was measured [m]; NaN: in the middle, or unknown.
    displacement : ndarray, shape (n, c)
        Measured values [m]; NaN where there is none.

    Returns
    -------
    axis, channel : tuple of str
        Those of the columns that come out.
    displacement : ndarray, shape (n, k)
        Values [m]; an axis that was measured at one place only stays as it is.  Places that were
        probed within `CYCLE_MAX` count as one look: between its own values a place is
        interpolated.
    """
    bases, more = [], []
    done: set[str] = set()
    for name, along, values in zip(channel, axis, displacement.T, strict=True):
        columns = [i for i, other in enumerate(axis) if other == along]
        known = np.unique(position[columns][np.isfinite(position[columns])])
        if len(known) < 2 or known[-1] - known[0] < SPAN_MIN:
            bases.append((along, name, values))
            continue
        if along in done:
            continue
        done.add(along)
        middle = 0.5 * (known[0] + known[-1])
        reach = 0.5 * (known[-1] - known[0])
        bent = bool((np.abs(known - middle) < INNER * reach).any())
        span = AxisSpan(along, float(known[0]), float(known[-1]), bent)
        fitted = _fitted(time, span, position[columns], displacement[:, columns])
        bases.append((along, along, fitted[:, 0]))
        more += [
            (along, title, fitted[:, column])
            for column, title in enumerate(span.channels)
            if column
        ]
    found = [*bases, *more]
    return (
        tuple(item[0] for item in found),
        tuple(item[1] for item in found),
        np.column_stack([item[2] for item in found]),
    )


def _fitted(time: Array, span: AxisSpan, position: Array, measured: Array) -> Array:
    """Return offset, slope and bend of each sample by least squares; NaN: unknown."""
    shares = span.shares(position)
    count = shares.shape[1]
    near = np.column_stack([_between(time, column) for column in measured.T])
    looked = np.isfinite(measured).any(axis=1)
    found = np.full((len(time), count), np.nan)
    there = np.isfinite(near)
    for pattern in np.unique(there[looked], axis=0):
        rows = looked & (there == pattern).all(axis=1)
        used = shares[pattern]
        along = used[:, 1]
        # Without the middle the bend is unknown, and taken for none.
        around = bool((along < 0.0).any() and (along > 0.0).any())
        inner = bool((np.abs(along) < INNER).any())
        known = count if around and inner else min(count, 2)
        if np.ptp(along) * span.half < SPAN_MIN:
            continue
        used = used[:, :known]
        square = portable.matmul(used.T, used)
        values = portable.matmul(near[rows][:, pattern], used)
        found[np.ix_(rows, np.arange(known))] = portable.solve(square, values.T).T
    return found


def _between(time: Array, values: Array) -> Array:
    """Return values with the gaps between looks of up to `CYCLE_MAX` filled in a straight line."""
    measured = np.flatnonzero(np.isfinite(values))
    if not len(measured):
        return values
    filled = np.interp(time, time[measured], values[measured])
    after = np.searchsorted(measured, np.arange(len(time)))
    before = np.clip(after - 1, 0, len(measured) - 1)
    after = np.clip(after, 0, len(measured) - 1)
    near = np.maximum(np.abs(time - time[measured[before]]), np.abs(time[measured[after]] - time))
    return np.where(near <= CYCLE_MAX, filled, values)


def told_of_channels(
    shares: Array, measured: Array, noise: Array, offset: Array, mean: Array, deviation: Array
) -> tuple[Array, Array, Array]:
    """Return what probes at places of an axis tell of offset, slope and bend, each for itself.

    The channels are normal and independent before.  The probes are taken as one joint update, and
    each channel is told what moves it alone to where the joint update has it.

    Parameters
    ----------
    shares : ndarray, shape (n, k)
        What each channel has in the error at each place [-].
    measured, noise : ndarray, shape (n,)
        Errors at the places and the standard deviations of their measurement [m].
    offset : ndarray, shape (n,)
        Offsets that were in force there [m].
    mean, deviation : ndarray, shape (k,)
        Expected channels and their standard deviations [m].

    Returns
    -------
    measured, noise, offset : ndarray, shape (k,)
        What a probe of each channel alone would have been [m]; NaN where it would tell nothing.

    Examples
    --------
    Two places tell both, one of them little of the slope where the offset is unknown:

    >>> import numpy as np
    >>> span = AxisSpan('Y', -0.5, 0.0)
    >>> mean, deviation = np.zeros(2), np.full(2, 30e-6)
    >>> def told(*places):
    ...     shares = span.shares(np.array(places))
    ...     errors = 10e-6 + 20e-6 * shares[:, 1]
    ...     noise = np.full(len(places), 1e-6)
    ...     found = told_of_channels(shares, errors, noise, 0 * noise, mean, deviation)
    ...     return (1e6 * np.array(found[:2])).round(1).tolist()
    >>> told(-0.5, 0.0)
    [[10.0, 20.0], [0.7, 0.7]]
    >>> told(0.0)
    [[30.0, 30.0], [30.0, 30.0]]
    """
    count = len(mean)
    covariance = np.diag(deviation * deviation)
    state = np.column_stack([mean, np.zeros(count)])  # of the errors, and of the offsets
    for share, error, width, force in zip(shares, measured, noise, offset, strict=True):
        column = portable.matmul(covariance, share)
        variance = float(portable.matmul(share, column)) + float(width) * float(width)
        gain = column / variance
        missed = np.array([float(error), float(force)]) - portable.matmul(share, state)
        state = state + gain[:, np.newaxis] * missed
        covariance = covariance - gain[:, np.newaxis] * column
    before, after = deviation * deviation, covariance.diagonal()
    with np.errstate(divide='ignore', invalid='ignore'):
        more = 1.0 / after - 1.0 / before
        told = more > TELLING / before
        value = (state[:, 0] / after - mean / before) / more
        force = state[:, 1] / after / more
        return tuple(  # type: ignore[return-value]
            np.where(told, item, np.nan) for item in (value, np.sqrt(1.0 / more), force)
        )

# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Fastest squared speeds along pieces that arrive one after the other.

A speed is final once no continuation of the path can change it: where braking for a stop right
behind the last piece and not braking at all give the same.  So what waits is no longer than the
stopping distance.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fuzzycnc_ros.core.arrays import Array
from fuzzycnc_ros.core.feedrate.motion.axis_limits import Bands, brake_spans, rise_spans
from fuzzycnc_ros.core.feedrate.motion.limits import sweep


@dataclass(frozen=True, eq=False)
class Braking:
    """A motion that is under way when limits or desired speeds change.

    Attributes
    ----------
    place, lowest : array, shape (k,)
        Places along the path, the first that of the change [m], and squared speeds of the
        strongest braking there, linear in between and 0 behind the last [m^2/s^2].
    plan_place, plan : array, shape (l,)
        The same of the motion before the change, which was within the limits of then.
    """

    place: Array
    lowest: Array
    plan_place: Array
    plan: Array

    def at(self, place: Array) -> tuple[Array, Array]:
        """Return lowest and planned squared speeds at places."""
        return (
            np.asarray(np.interp(place, self.place, self.lowest, right=0.0)),
            np.asarray(np.interp(place, self.plan_place, self.plan, right=0.0)),
        )


class _SpeedSweep(ABC):
    """Squared speeds at the nodes of pieces that wait for what follows.

    Parameters
    ----------
    braking : Braking, optional
        Motion from which the path is entered; by default it starts at rest.
    """

    def __init__(self, braking: Braking | None = None) -> None:
        self._braking = braking
        self._entry = 0.0 if braking is None else float(braking.lowest[0])
        self._place = np.empty(0)
        self._cap = np.empty(0)
        self._stop = np.empty(0, bool)

    @property
    def waiting(self) -> int:
        """Number of pieces that have arrived and whose ends are not final."""
        return max(len(self._cap) - 1, 0)

    def _append(self, place: Array, left: Array, right: Array, stop: NDArray[np.bool_]) -> None:
        """Take the largest squared speeds at both ends of the next pieces."""
        cap = np.minimum(np.append(left, np.inf), np.append(np.inf, right))
        if len(self._cap):
            cap[0] = min(cap[0], self._cap[-1])
            stop = stop.copy()
            stop[0] |= self._stop[-1]
        cap[stop] = 0.0
        self._cap = np.concatenate([self._cap[:-1], cap])
        self._stop = np.concatenate([self._stop[:-1], stop])
        self._place = np.concatenate([self._place[:-1], place])

    def settle(self, *, ended: bool = False) -> Array:
        """Return squared speeds at the nodes from the first waiting one that are final now.

        All of them if the path has `ended`.  One value means that no piece is final.  The pieces
        in between wait no longer.
        """
        if not self.waiting:
            return np.array([self._entry])
        low, high = self._backward()
        last = len(low) - 1 if ended else int(np.flatnonzero(np.append(True, low == high))[-1]) - 1
        if ended:
            high = low
        found = self._followed(low, high, last)
        count = len(found) - 1
        self._entry = float(found[-1])
        self._place, self._cap = self._place[count:], self._cap[count:]
        self._stop = self._stop[count:]
        self._drop(count)
        return found

    def to_rest(self) -> Array:
        """Return squared speeds at all waiting nodes, were the path to end at the last."""
        if not self.waiting:
            return np.array([self._entry])
        low, _ = self._backward()
        return self._followed(low, low, len(low) - 1)

    def _followed(self, low: Array, high: Array, last: int) -> Array:
        """Return final squared speeds, given those for braking at the end and for not braking.

        Both agree up to node `last`, -1 for none.
        """
        if last < 0:
            return np.array([self._entry])
        if self._braking is None or self._place[0] >= self._braking.place[-1]:
            return self._forward(0, last, high, self._entry)
        lowest, plan = self._braking.at(self._place)
        lowest[0] = self._entry
        over = np.flatnonzero(lowest[: last + 1] > high[: last + 1])
        begin = int(over[-1]) + 1 if len(over) else 0
        if (lowest[last + 1 :] > low[last + 1 :]).any():
            # What follows may ask for braking from here on.
            return lowest[: max(begin, 1)]
        if begin > last:
            return lowest[:begin]
        entry = self._entry
        if begin:
            # Between the strongest braking and what the plan was, scaled to where braking led.
            upper = plan[begin] * lowest[begin - 1] / plan[begin - 1]
            entry = max(lowest[begin], min(high[begin], upper))
        return np.append(lowest[:begin], self._forward(begin, last, high, entry))

    @abstractmethod
    def _backward(self) -> tuple[Array, Array]:
        """Return squared speeds that braking allows, with a stop at the end and without."""

    @abstractmethod
    def _forward(self, begin: int, end: int, cap: Array, entry: float) -> Array:
        """Return the fastest squared speeds from node `begin` to `end`, both included."""

    @abstractmethod
    def _drop(self, count: int) -> None:
        """Forget the first pieces."""


class RiseSweep(_SpeedSweep):
    """Sweep within one largest rise of the squared speed per piece."""

    def __init__(self, braking: Braking | None = None) -> None:
        super().__init__(braking)
        self._rise = np.empty(0)

    def push(self, place: Array, cap: Array, rise: Array, stop: NDArray[np.bool_]) -> None:
        """Take the next pieces: largest squared speeds and rises, each (m,)."""
        self._append(place, cap, cap, stop)
        self._rise = np.append(self._rise, rise)

    def _backward(self) -> tuple[Array, Array]:
        free = sweep(self._cap[::-1], self._rise[::-1])[::-1]
        cap = self._cap.copy()
        cap[-1] = 0.0
        return sweep(cap[::-1], self._rise[::-1])[::-1], free

    def _forward(self, begin: int, end: int, cap: Array, entry: float) -> Array:
        most = cap[begin : end + 1].copy()
        most[0] = min(most[0], entry)
        return sweep(most, self._rise[begin:end])

    def _drop(self, count: int) -> None:
        self._rise = self._rise[count:]


class BandSweep(_SpeedSweep):
    """Sweep within bands of two neighbouring squared speeds."""

    def __init__(self, braking: Braking | None = None) -> None:
        super().__init__(braking)
        self._bands: Bands | None = None

    def push(self, place: Array, bands: Bands, square: Array, stop: NDArray[np.bool_]) -> None:
        """Take the next pieces: their bands and squared desired speeds at both ends (m, 2)."""
        left = np.minimum(square[:, 0], np.minimum(bands.fastest, bands.most))
        self._append(place, left, np.minimum(square[:, 1], bands.fastest), stop)
        self._bands = bands if self._bands is None else self._bands.joined(bands)

    def _backward(self) -> tuple[Array, Array]:
        assert self._bands is not None  # pieces are waiting
        stops = np.flatnonzero(self._stop)
        known = int(stops[-1]) if len(stops) else 0
        cap = self._cap.copy()
        if known:
            part = slice(0, known + 1)
            brake_spans(self._bands.part(0, known), cap[part], self._stop[part])
        offset, gain = self._bands.part(known, len(self._bands)).backward()
        rest, free = cap[known:].tolist(), cap[known:].tolist()
        rest[-1] = 0.0
        least = np.minimum.reduce  # the method `min` costs as much again
        for k in range(len(rest) - 2, -1, -1):
            base, factor, slow, fast = offset[k], gain[k], rest[k + 1], free[k + 1]
            allowed = float(least(base + factor * slow))
            rest[k] = min(rest[k], allowed)
            # a few pieces before the end both are the same
            free[k] = min(free[k], allowed if fast == slow else float(least(base + factor * fast)))
        return np.append(cap[:known], rest), np.append(cap[:known], free)

    def _forward(self, begin: int, end: int, cap: Array, entry: float) -> Array:
        assert self._bands is not None
        found = cap[begin : end + 1].copy()
        found[0] = min(found[0], entry)
        if self._stop[begin + 1 : end].any():
            rise_spans(self._bands.part(begin, end), found, self._stop[begin : end + 1])
            return found
        slope, width, least = self._bands.slope, self._bands.width, np.minimum.reduce
        speed = found.tolist()
        for k in range(len(speed) - 1):
            allowed = float(least(width[begin + k] - slope[begin + k] * speed[k]))
            speed[k + 1] = min(speed[k + 1], max(allowed, 0.0))
        return np.array(speed)

    def _drop(self, count: int) -> None:
        assert self._bands is not None
        self._bands = self._bands.part(count, len(self._bands))

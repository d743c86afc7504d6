# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Axes whose error is followed: known well enough, and confirmed by a probe under an offset."""

from collections import deque
from collections.abc import Iterator

import numpy as np

from fuzzycnc_ros.core.thermal.band import WIDTH
from fuzzycnc_ros.core.thermal.confirmation import is_right, is_wrong
from fuzzycnc_ros.runtime.component import Health, Level
from fuzzycnc_ros.runtime.records import Bools, Floats, Names, ProbeEvidence, Stamp, nanoseconds

CAUTIOUS = {'band_share': 0.8, 'first_share': 0.5, 'program_wait': 1800.0}
"""Parameters of the compensator where the error is learnt from probes."""

HEARD_AFTER = 600.0
"""Time [s] after which evidence counts, so that a replay takes it at the same error."""

FOUND_MAX = 100
"""Most evidence that waits for that."""


class AxisTrust:
    """Share of each axis' error that is followed, in [0, 1].

    Parameters
    ----------
    axes : tuple of str, length c
        The axes.
    """

    def __init__(self, axes: Names) -> None:
        self._axes = axes
        self._error = self._half = np.full(len(axes), np.nan)
        self._part = np.ones(len(axes))
        self._evidence = np.zeros(len(axes))
        self._found: deque[ProbeEvidence] = deque(maxlen=FOUND_MAX)
        self._turn: int | None = None
        """Axis that is tried, of those that no probe has confirmed."""
        self.begin()

    def begin(self) -> None:
        """Begin with axes of which none is followed."""
        self._known: Bools = np.zeros(len(self._axes), dtype=np.bool_)
        self._share = np.zeros(len(self._axes))
        """Share of the error that is followed, NaN where nobody knows yet."""
        self._waiting = np.zeros(len(self._axes), dtype=np.int64)
        """Since when another share waits for the end of a program [ns]; 0 if none does."""

    def restore(self, followed: Bools) -> None:
        """Go on where an earlier life had these axes (c,) followed, in a share that it knew."""
        self.begin()
        self._known = followed
        self._share[followed] = np.nan

    def learn(self, found: ProbeEvidence) -> None:
        """Note what probes under an offset have said; the first channel speaks for an axis."""
        self._found.append(found)

    def follow(
        self,
        stamp: Stamp,
        error: Floats,
        deviation: Floats,
        band_share: float,
        first_share: float,
        wait: float,
    ) -> Floats:
        """Return the share of each error that is to be taken off, shape (c,) [-].

        Parameters
        ----------
        stamp : int
            Machine time [ns].
        error, deviation : ndarray, shape (c,)
            Thermal error and its standard deviation [m], of an axis along which it slopes where
            it is largest; NaN where that is not known.
        band_share : float
            Half width of the band over what is taken off, up to which an axis begins to be
            followed; it is no longer where the band is wider than that [-].  0 follows all.
        first_share : float
            Part of the error that is taken off until a probe confirms it [-].
        wait : float
            Time for which another share waits for the end of the program under way [s]; 0 where
            no program runs.  One that is known to be wrong does not wait.
        """
        while self._found and self._found[0].stamp + nanoseconds(HEARD_AFTER) <= stamp:
            found = self._found.popleft()
            for number, axis in enumerate(self._axes):
                if axis in found.axis:
                    self._evidence[number] = found.evidence[found.axis.index(axis)]
        self._error, self._half = error, WIDTH * deviation
        self._part = np.where(is_right(self._evidence), 1.0, first_share)
        if first_share < 1.0:
            self._part[is_wrong(self._evidence)] = 0.0
        size = self._part * np.abs(error)
        if band_share > 0.0:
            begins, goes_on = self._half <= band_share * size, self._half <= size
            self._known = begins | (self._known & goes_on)
        else:
            self._known = np.ones(len(self._axes), dtype=np.bool_)
        if first_share < 1.0:
            self._take_turns(size)
        self._turn_to(np.where(self._known, self._part, 0.0), stamp, wait)
        return np.where(self._share > 0.0, self._share, 0.0)

    def _turn_to(self, wanted: Floats, stamp: Stamp, wait: float) -> None:
        """Follow the wanted shares (c,), those that change once no program is disturbed."""
        changed = wanted != self._share
        self._waiting = np.where(changed, np.where(self._waiting, self._waiting, stamp), 0)
        over = stamp - self._waiting >= nanoseconds(wait)
        now = changed & (over | np.isnan(self._share) | is_wrong(self._evidence))
        self._share = np.where(now, wanted, self._share)
        self._waiting[now] = 0

    def _take_turns(self, size: Floats) -> None:
        """Try one axis at a time: where two that are swapped move alike, probes see no difference.

        It is the one under way while its error is larger than its band, else the one of which
        probes have said most, and of those the one whose error is largest over that.
        """
        tried = self._known & (self._part > 0.0) & ~is_right(self._evidence)
        with np.errstate(divide='ignore', invalid='ignore'):  # a band of no width is known
            ratio = np.where(tried, size / self._half, -np.inf)
        if self._turn is None or not ratio[self._turn] >= 1.0:
            most = np.where(tried, self._evidence, -np.inf)
            ratio[most < most.max()] = -np.inf
            self._turn = int(np.argmax(ratio)) if tried.any() else None
        if self._turn is not None:
            tried[self._turn] = False
        self._part[tried] = 0.0

    def health(self) -> Iterator[Health]:
        """Report the axes that are not followed, or only in part, and why."""
        wrong, waiting, partly, delayed = [], [], [], []
        for number, axis in enumerate(self._axes):
            part, error, half = self._part[number], self._error[number], self._half[number]
            if self._waiting[number]:
                delayed.append(f'{axis} {100.0 * part * self._known[number]:.0f} %')
            if part == 0.0 and is_wrong(self._evidence)[number]:
                wrong.append(axis)
            elif part == 0.0:
                partly.append(f'{axis} after that')
            elif not self._known[number] and np.isfinite(error):
                waiting.append(f'{axis} {1e6 * error:+.1f} ± {1e6 * half:.1f} µm')
            elif self._known[number] and part < 1.0:
                partly.append(f'{axis} {100.0 * part:.0f} %')
        if wrong:
            text = (
                f'{", ".join(wrong)} not followed: probes do not see the offset as it is. Sign, '
                'unit or axis of the probe, of the read-back or of the bridge is wrong: mend it, '
                'then begin to learn anew (fuzzycnc operate forget)'
            )
            yield Health('probes', Level.ERROR, text)
        if waiting:
            text = f'not followed, known too little: {", ".join(waiting)}; probe to know more'
            yield Health('band', Level.OK, text)
        if partly:
            text = f'followed in part until a probe confirms it: {", ".join(partly)}'
            yield Health('first activation', Level.OK, text)
        if delayed:
            text = f'followed anew when the program has ended: {", ".join(delayed)}'
            yield Health('program', Level.OK, text)

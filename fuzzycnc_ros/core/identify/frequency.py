# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Frequency response from command to acceleration, with its uncertainty line by line.

References
----------
[ljung1999], chapters 6 and 13.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import ceil, log

import numpy as np
from numpy.typing import NDArray

from fuzzycnc_ros.core.arrays import Array
from fuzzycnc_ros.core.identify.axis_fit import AxisRecording

_RATIO = 1.04
"""Ratio of two neighbouring lines of a response [-]."""

_WIDTH = 0.02
"""Half width of a line as share of its frequency: a mode of 2 % damping is as wide."""

_BINS = 3
"""Least half width of a line in bins of the shortest recording that counts."""

_LOWEST, _HIGHEST = 0.4, 0.4
"""First line [Hz], and last one as share of the sampling rate."""

_KNOWN = 0.3
"""Relative standard error up to which a line is known [-]."""

_EXCITED = 5.0
"""Amplitude that the command causes over that of the noise from which a line is excited [-].

In a closed loop noise moves the command, and what the command and the position then have in
common is the controller turned round, at a coherence of 1.
"""

_GAP = 1.5
"""Ratio of two frequencies between which lines may be unknown without a resonance there [-]."""

_QUIET = 0.7
"""All acceleration over what a rigid axis would show up to which an axis hardly moves [-]."""

_ALIKE, _MOVED, _ALL = 0.8, 0.6, 0.97
"""Coherence of command and acceleration from which a line is told, and of the set point with
either of them where that is the instrument [-].  Averaging mends noise, not friction and
backlash.  From the last
one on the command alone tells a line even beside an instrument."""

_FLOOR, _RUBS = 0.02, 0.2
"""Relative error that no line falls below [-], and what is added over the frequency [Hz].

Friction is not linear, and the slower the motion the more of the drive it takes."""


@dataclass(frozen=True, eq=False)
class FrequencyResponse:
    """Response from command to acceleration, as far as a recording tells it.

    Attributes
    ----------
    frequency : ndarray, shape (n,)
        Frequencies of the lines [Hz].
    response : ndarray of complex, shape (n,)
        Acceleration per command [m/s^2 per unit of the command].
    error : ndarray, shape (n,)
        Relative standard error of each line [-].
    excited : ndarray of bool, shape (n,)
        Lines where the command, or the set point, moves the axis beyond all noise.
    quiet : ndarray of bool, shape (n,)
        Lines where the command would move a rigid axis beyond all noise and the axis hardly moves:
        about an antiresonance, where a resonance cannot be.
    share : ndarray, shape (n,)
        How much a line counts beside its neighbours, which it shares data with [-].
    by_reference : bool
        Whether set points served as instrument: then a feedback loop does not matter.
    """

    frequency: Array
    response: NDArray[np.complex128]
    error: Array
    excited: NDArray[np.bool_]
    quiet: NDArray[np.bool_]
    share: Array
    by_reference: bool

    @property
    def known(self) -> NDArray[np.bool_]:
        """Lines that the recording tells."""
        return np.asarray(self.excited & (self.error <= _KNOWN))

    @property
    def known_to(self) -> float:
        """Frequency up to which the response is known without a gap [Hz]; 0 if nowhere."""
        known = self.known
        if not known.any():
            return 0.0
        lines = self.frequency[known | (self.quiet & np.maximum.accumulate(known))]
        gaps = np.flatnonzero(lines[1:] > _GAP * lines[:-1])
        top = lines[gaps[0]] if len(gaps) else lines[-1]
        return float(self.frequency[known & (self.frequency <= top)].max())


def frequency_response(recordings: Sequence[AxisRecording], gain: float) -> FrequencyResponse:
    """Return the frequency response from command to acceleration.

    Spectra of whole recordings are averaged over lines whose width grows with their frequency.
    Where all recordings have set points, these are the instrument: response is the cross spectrum
    of set point and acceleration over that of set point and command, which feedback does not bias.

    Parameters
    ----------
    recordings : sequence of AxisRecording
        Recordings of one period, each of 512 samples or more to count.
    gain : float
        Acceleration of the rigid axis per command, for what counts as excited.

    Raises
    ------
    ValueError
        If none is long enough.
    """
    long = [one for one in recordings if len(one.position) >= 514]
    if not long:
        raise ValueError('expected 514 samples or more in a row but found fewer')
    period = long[0].period
    shortest = min(len(one.position) for one in long) * period
    top = _HIGHEST / period
    size = ceil(log(top / _LOWEST) / log(_RATIO))
    lines = np.asarray(_LOWEST * _RATIO ** np.arange(size), np.float64)
    lines = lines[lines > 1.5 * _BINS / shortest]
    direct = _Spectra(lines, long, instrument=False)
    chosen = direct
    if all(one.reference is not None for one in long):
        chosen = _Spectra(lines, long, instrument=True)
    response, error = chosen.estimate()
    excited = gain * gain * direct.uu > _EXCITED**2 * direct.noise(period)
    quiet = excited & (direct.aa < _QUIET**2 * gain * gain * direct.uu)
    excited &= direct.moves >= _ALIKE
    if chosen is not direct:
        strong = np.minimum(chosen.coherence, chosen.moves) >= _MOVED
        # Where the axis moves far beyond all noise, its command need not come from the set point.
        plain, plain_error = direct.estimate()
        other = excited & (direct.moves >= _ALL) & (~strong | (plain_error < 0.5 * error))
        response, error = np.where(other, plain, response), np.where(other, plain_error, error)
        excited = other | strong
    # A command held for a period moves the second difference by the mean of two of them.
    angle = np.pi * lines * period
    response = response / (np.cos(angle) * np.exp(-1j * angle))
    width = 2.0 * np.maximum(_WIDTH * lines, _BINS / shortest)
    return FrequencyResponse(
        lines,
        response,
        np.hypot(np.maximum(error, _FLOOR), _RUBS / lines),
        excited,
        quiet,
        np.minimum((_RATIO - 1.0) * lines / width, 1.0),
        chosen is not direct,
    )


class _Spectra:
    """Spectra of command u, acceleration a and instrument r, averaged over lines."""

    def __init__(
        self, lines: Array, recordings: Sequence[AxisRecording], *, instrument: bool
    ) -> None:
        size = len(lines)
        self.lines = lines
        self.rr, self.uu, self.aa, self.averages = np.zeros((4, size))
        self.ru, self.ra, self.ua = np.zeros((3, size), complex)
        self._floor = 0.0
        for one in recordings:
            period = one.period
            count = len(one.position) - 2
            taper = np.sin(np.pi * (np.arange(count) + 0.5) / count) ** 2
            share = 1.0 / (float((taper**2).sum()) / period)

            def spectrum(values: Array, taper: Array = taper) -> NDArray[np.complex128]:
                return np.fft.rfft(taper * (values - values.mean()))

            rise = np.diff(one.position, 2) / (period * period)
            u, a = spectrum(one.command[1:-1]), spectrum(rise)
            r = u
            if instrument and one.reference is not None:
                r = spectrum(np.diff(one.reference, 2) / (period * period))
            bin_width = 1.0 / (count * period)
            half = np.maximum(_WIDTH * lines, _BINS * bin_width)
            low = np.maximum(np.ceil((lines - half) / bin_width).astype(int), 1)
            high = np.floor((lines + half) / bin_width).astype(int) + 1
            for total, left, right in (
                (self.rr, r, r), (self.uu, u, u), (self.aa, a, a),
                (self.ru, r, u), (self.ra, r, a), (self.ua, u, a),
            ):  # fmt: skip
                course = np.concatenate([[0.0], np.cumsum(np.conj(left) * right)])
                part = course[np.minimum(high, len(left))] - course[low]
                total += share * (part if np.iscomplexobj(total) else part.real)
            # a taper of that shape makes 1.5 neighbouring bins one
            self.averages += np.maximum((high - low) / 1.5, 1.0)
            upper = np.fft.rfftfreq(count, period)
            late = upper > 0.3 / period
            swing = (2.0 - 2.0 * np.cos(2.0 * np.pi * upper[late] * period)) ** 2
            width = share * np.median(np.abs(a[late]) ** 2 / swing) / log(2.0)
            self._floor = max(self._floor, float(width))

    @property
    def coherence(self) -> Array:
        """Coherence of command and instrument [-]."""
        return np.asarray(np.abs(self.ru) ** 2 / np.maximum(self.rr * self.uu, 1e-300))

    @property
    def moves(self) -> Array:
        """Coherence of acceleration and instrument [-]."""
        return np.asarray(np.abs(self.ra) ** 2 / np.maximum(self.rr * self.aa, 1e-300))

    def estimate(self) -> tuple[NDArray[np.complex128], Array]:
        """Return response and relative standard error of each line."""
        through = np.where(self.ru == 0.0, 1e-300, self.ru)
        found = self.ra / through
        left = self.aa + np.abs(found) ** 2 * self.uu - 2.0 * (np.conj(found) * self.ua).real
        size = np.maximum(np.abs(found), 1e-300)
        free = np.maximum(self.averages - 1.0, 0.5)
        variance = np.maximum(left, 0.0) * self.rr / (free * np.abs(through) ** 2)
        return np.asarray(found), np.asarray(np.sqrt(variance) / size)

    def noise(self, period: float) -> Array:
        """Return the acceleration that white noise of the readings gives, as `aa`."""
        swing = (2.0 - 2.0 * np.cos(2.0 * np.pi * self.lines * period)) ** 2
        return np.asarray(self._floor * swing * 1.5 * self.averages)

# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""What the frequency response from command to acceleration tells: dead time and resonance.

References
----------
[ljung1999], chapter 6.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.signal import coherence, csd, welch

from fuzzycnc_ros.core.arrays import Array
from fuzzycnc_ros.core.identify.axis_fit import AxisRecording

_SEGMENT = 512
"""Samples of each segment that is averaged over."""

_TOLD, _SURE = 0.8, 0.9
"""Coherence from which a resonance is believed, and from which a phase is."""

_PEAK = 2.0
"""Gain over that of the rigid axis from which a peak is a resonance [-]."""


@dataclass(frozen=True, eq=False)
class FrequencyResponse:
    """Response from command to acceleration, as far as the recording excites it.

    Attributes
    ----------
    frequency : ndarray, shape (n,)
        Frequencies [Hz].
    gain : ndarray, shape (n,)
        Gain over that of the rigid axis [-].
    phase : ndarray, shape (n,)
        Phase [rad].
    coherence : ndarray, shape (n,)
        How much of the acceleration the command explains [-].
    """

    frequency: Array
    gain: Array
    phase: Array
    coherence: Array

    @property
    def resonance(self) -> float:
        """Lowest frequency at which the axis swings against its load [Hz]; 0 if none shows."""
        # a single line may be coherent by chance
        beside = np.convolve(self.coherence, np.full(3, 1.0 / 3.0), 'same')
        gain = np.where(np.minimum(self.coherence, beside) >= _TOLD, self.gain, 0.0)
        inner = gain[1:-1]
        peaks = (inner > gain[:-2]) & (inner >= gain[2:]) & (inner > _PEAK)
        if not peaks.any():
            return 0.0
        # neighbouring lines of a broad peak differ by chance: the highest of the first group
        first = int(np.flatnonzero(peaks)[0]) + 1
        near = self.frequency <= 1.5 * self.frequency[first]
        return float(self.frequency[int(np.argmax(np.where(near, gain, 0.0)))])

    @property
    def dead_time(self) -> tuple[float, float]:
        """Dead time from command to acceleration and its standard error [s]; NaN if unknown."""
        top = 0.25 * self.resonance or np.inf
        used = (self.coherence >= _SURE) & (self.frequency > 0.0) & (self.frequency < top)
        if used.sum() < 6:
            return float('nan'), float('nan')
        angle, phase = 2.0 * np.pi * self.frequency[used], np.unwrap(self.phase[used])
        weight = 1.0 / (1.0 - np.minimum(self.coherence[used], 0.9999))
        # viscous friction turns the phase forward, by less the faster: a / frequency
        basis = np.column_stack([-angle, 1.0 / angle]) * np.sqrt(weight)[:, np.newaxis]
        target = phase * np.sqrt(weight)
        found, *_ = np.linalg.lstsq(basis, target, rcond=None)
        left = target - basis @ found
        spread = np.linalg.inv(basis.T @ basis) * (left @ left) / max(len(left) - 2, 1)
        return float(found[0]), float(np.sqrt(spread[0, 0]))


def frequency_response(recordings: Sequence[AxisRecording], gain: float) -> FrequencyResponse:
    """Return the frequency response from command to acceleration.

    Parameters
    ----------
    recordings : sequence of AxisRecording
        Recordings of one period, each of 512 samples or more to count.
    gain : float
        Acceleration of the rigid axis per command.

    Raises
    ------
    ValueError
        If none is long enough.
    """
    long = [one for one in recordings if len(one.position) >= _SEGMENT + 2]
    if not long:
        raise ValueError(f'expected {_SEGMENT + 2} samples or more in a row but found fewer')
    period = long[0].period
    command = np.concatenate([one.command[1:-1] for one in long])
    rise = np.concatenate([np.diff(one.position, 2) for one in long]) / period**2
    common: dict[str, Any] = {'fs': 1.0 / period, 'nperseg': _SEGMENT}
    frequency, cross = csd(command, rise, **common)
    _, power = welch(command, **common)
    _, together = coherence(command, rise, **common)
    response = cross / np.maximum(power, 1e-300) / gain
    # The second difference lies half a period behind the beginning of a held command.
    late = np.exp(1j * np.pi * frequency * period)
    return FrequencyResponse(
        frequency, np.abs(response), np.angle(response * late), np.nan_to_num(together)
    )

# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Slow sensor faults, by the vote of cluster mates (method sheet 001 section 8.C).

A sensor that drifts by 2 K an hour passes every check of range and rate.  Its mates see it: each
predicts its rise from its own.  The sensor is faulty when at least two mates can vote and all of
them miss its rise to the same side by more than a limit, for a long time.  The limit grows with
the largest rise so far, because the mates' gains were trained on other duties and their lags
differ.  With a limit of 0.8 K and a fifth of the rise, held for 20 min, none of 48 unseen healthy
runs of the mill (T2 and T3, 24 noise seeds) was voted out, and a drift of 2 K/h was after 67 min
in the median; an input without two closely correlated mates is never voted out.
"""

import numpy as np
from numpy.typing import NDArray

SMOOTHING = 300.0
"""Time constant of the residual's smoothing [s]: the mates' noise must not decide."""

VOTERS_MIN = 2


class MateVote:
    """Watch the inputs of a model.

    Parameters
    ----------
    inputs : int
        Number of inputs p.
    limit : float
        Difference that is never a fault [K].
    tolerance : float
        What the limit grows by with the largest rise that the mates expected so far [-].
    persistence : float
        Time that a difference must last [s]; 0 switches the vote off.
    """

    def __init__(self, inputs: int, *, limit: float, tolerance: float, persistence: float) -> None:
        self._limit, self._tolerance, self._persistence = limit, tolerance, persistence
        self._smooth: NDArray[np.float64] | None = None
        self._peak = np.zeros(inputs)
        self._beyond = np.zeros(inputs)
        self._within = np.zeros(inputs)
        self.faulty = np.zeros(inputs, dtype=np.bool_)
        """Inputs that were voted out, shape (p,); one returns when its mates agree as long."""

    def update(
        self, rise: NDArray[np.float64], expected: NDArray[np.float64], elapsed: float
    ) -> NDArray[np.bool_]:
        """Take one sample; return `faulty`.

        Parameters
        ----------
        rise : ndarray, shape (p,)
            Rise that each input reads [K]; NaN where it reads nothing.
        expected : ndarray, shape (p, k)
            Rise that each mate expects of it [K]; NaN where there is no good mate.
        elapsed : float
            Time since the sample before [s].
        """
        if self._persistence <= 0.0:
            return self.faulty
        residual = rise[:, np.newaxis] - expected
        known = np.isfinite(residual)
        if self._smooth is None:
            self._smooth = np.zeros_like(residual)
        share = min(1.0, elapsed / SMOOTHING)
        self._smooth += np.where(known, share * (residual - self._smooth), -share * self._smooth)
        size = np.where(known, np.abs(self._smooth), np.inf).min(axis=1)
        side = np.where(known, np.sign(self._smooth), 0.0).sum(axis=1)
        voters = known.sum(axis=1)
        count = np.maximum(voters, 1)
        mean = np.where(known, expected, 0.0).sum(axis=1) / count
        self._peak = np.maximum(self._peak, np.abs(mean))
        allowed = self._limit + self._tolerance * self._peak
        able = voters >= VOTERS_MIN
        beyond = able & (np.abs(side) == voters) & (size > allowed)
        within = able & (size < 0.5 * allowed)
        self._beyond = np.where(beyond, self._beyond + elapsed, 0.0)
        self._within = np.where(within, self._within + elapsed, 0.0)
        self.faulty = (self.faulty | (self._beyond >= self._persistence)) & (
            self._within < self._persistence
        )
        return self.faulty

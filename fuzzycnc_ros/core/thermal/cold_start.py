# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Recognise a run that begins on a warm machine, whose rises then mean something else."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from fuzzycnc_ros.core.arrays import LENGTH_MIN, NUMBER_MAX, Array, check_bounds, check_shapes
from fuzzycnc_ros.core.document import Node
from fuzzycnc_ros.core.thermal.run import ThermalRun

TOLERANCE_MIN = 1.0
"""Difference between sensors at a start that always is allowed [K]."""

DEVIATIONS = 3.0
"""Standard deviations of the starts of the training that are allowed [-]."""

SHARE = 0.25
"""Share of a sensor's largest rise in training that it may be warm already [-]."""


@dataclass(frozen=True, eq=False)
class ColdStart:
    """Differences between the temperatures of a machine before it is used.

    Parameters
    ----------
    pattern : ndarray, shape (p,)
        Temperature of each input less their median, mean over the starts of the training [K]:
        the workshop's own temperature does not matter, sensors that read high do not either.
    tolerance : ndarray, shape (p,)
        Difference from the pattern that is no sign of warmth [K].
    """

    pattern: Array
    tolerance: Array

    def __post_init__(self) -> None:
        """Refuse tolerances that are no lengths, and numbers beyond all temperatures."""
        check_shapes(self, tolerance=self.pattern.shape)
        check_bounds(self, pattern=(-NUMBER_MAX, NUMBER_MAX), tolerance=(LENGTH_MIN, NUMBER_MAX))

    @staticmethod
    def of(runs: Sequence[ThermalRun], inputs: Sequence[str]) -> 'ColdStart':
        """Learn from the starts of training runs."""
        starts = np.array([run.reference()[run.columns(inputs)] for run in runs])
        starts = starts - np.median(starts, axis=1, keepdims=True)
        rise = np.concatenate([np.abs(run.rise()[:, run.columns(inputs)]) for run in runs])
        allowed = np.fmax(DEVIATIONS * starts.std(axis=0), SHARE * rise.max(axis=0))
        return ColdStart(starts.mean(axis=0), np.fmax(TOLERANCE_MIN, allowed))

    def warmth(self, reference: ArrayLike) -> Array:
        """Return by how much each input is warmer than at a cold start, (p,) [K].

        Parameters
        ----------
        reference : array_like, shape (p,)
            Temperature of each input at the start of a run [degC]; NaN where it is not known.

        Returns
        -------
        ndarray, shape (p,)
            0 where it is within the tolerance or not known, negative where it is colder.
        """
        start = np.asarray(reference, dtype=np.float64)
        if not np.isfinite(start).any():
            return np.zeros(len(start))
        apart = start - np.nanmedian(start) - self.pattern
        return np.where(np.abs(apart) > self.tolerance, apart, 0.0)

    def document(self) -> dict[str, Any]:
        """Return pattern and tolerance as JSON values."""
        return {'pattern': self.pattern.tolist(), 'tolerance': self.tolerance.tolist()}

    @classmethod
    def read(cls, node: Node) -> 'ColdStart':
        """Return what `document` described.

        Raises
        ------
        ModelFileError
            If a value is missing or of another type.
        """
        with node.named():
            return cls(node.get('pattern').vector(), node.get('tolerance').vector())

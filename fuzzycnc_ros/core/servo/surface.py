# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The rules as duty over error and rate: on universes that contract, and on fixed ones.

Method sheet 004 section 3.  Each surface is there twice, for arrays and as a function of two
numbers for the control loop, where numpy would take longer than the rules.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike

from fuzzycnc_ros.core.arrays import Array
from fuzzycnc_ros.core.servo.params import VariableUniverseParams

Law = Callable[[float, float], float]
"""Duty [-] at an error [m] and error rate [m/s]."""


class ContractedSurface:
    """The rules on universes that shrink with what lies on them.

    Parameters
    ----------
    params : VariableUniverseParams
        Universes and rules.
    direction : float
        Sign of the axis' gain; 1 or -1.

    Attributes
    ----------
    law : callable
        The surface at one error [m] and error rate [m/s].
    """

    def __init__(self, params: VariableUniverseParams, direction: float) -> None:
        self._params = params
        # the table is written for an axis that positive duty drives to negative positions
        self._scale = -direction * params.output_gain
        self.law = self._law()

    def inputs(self, error: ArrayLike, rate: ArrayLike) -> tuple[Array, Array]:
        """Return errors [m] and error rates [m/s] on their universes [-]."""
        p = self._params
        e = np.clip(np.asarray(error, dtype=np.float64) / p.error_range, -1.0, 1.0)
        c = np.clip(np.asarray(rate, dtype=np.float64) / p.rate_range, -1.0, 1.0)
        return (
            np.asarray(e / (np.abs(e) ** p.error_exponent + p.error_floor)),
            np.asarray(c / (np.abs(c) ** p.rate_exponent + p.rate_floor)),
        )

    def duty(self, error: ArrayLike, rate: ArrayLike) -> Array:
        """Return the duties [-] at errors [m] and error rates [m/s], which broadcast."""
        return np.asarray(self._scale * self._params.rules.surface(*self.inputs(error, rate)))

    def _law(self) -> Law:
        p, scale = self._params, self._scale
        infer = p.rules.infer
        per_error, per_rate = 1.0 / p.error_range, 1.0 / p.rate_range
        error_exponent, rate_exponent = p.error_exponent, p.rate_exponent
        error_floor, rate_floor = p.error_floor, p.rate_floor

        def law(error: float, rate: float) -> float:
            e = error * per_error
            e = 1.0 if e > 1.0 else -1.0 if e < -1.0 else e
            c = rate * per_rate
            c = 1.0 if c > 1.0 else -1.0 if c < -1.0 else c
            x = e / (abs(e) ** error_exponent + error_floor)
            return scale * infer(x, c / (abs(c) ** rate_exponent + rate_floor))

        return law


class FixedSurface(ContractedSurface):
    """The rules on universes that do not shrink; floors and exponents are of no use here."""

    def inputs(self, error: ArrayLike, rate: ArrayLike) -> tuple[Array, Array]:
        """Return errors [m] and error rates [m/s] on their universes [-]."""
        p = self._params
        return (
            np.clip(np.asarray(error, dtype=np.float64) / p.error_range, -1.0, 1.0),
            np.clip(np.asarray(rate, dtype=np.float64) / p.rate_range, -1.0, 1.0),
        )

    def _law(self) -> Law:
        p, scale = self._params, self._scale
        rules = p.rules
        per_error, per_rate = 1.0 / p.error_range, 1.0 / p.rate_range
        return lambda error, rate: scale * rules(error * per_error, rate * per_rate)

# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The rules of [long2014] on universes that do not contract: what the contraction is worth.

The defaults are found as those of `fuzzycnc_ros.core.servo.baselines`.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from fuzzycnc_ros.core.arrays import Array
from fuzzycnc_ros.core.servo.axis import LinearAxis
from fuzzycnc_ros.core.servo.params import VariableUniverseParams
from fuzzycnc_ros.core.servo.variable_universe import (
    ContractedSurface,
    Law,
    VariableUniverseController,
)


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


class FixedUniverseController(VariableUniverseController):
    """The same rules, observer and feedforward on universes that do not contract.

    What the contraction is worth shows beside it: an ablation.

    Parameters
    ----------
    axis : LinearAxis
        Nominal model.
    error_range, rate_range : float
        Ends of the universes [m, m/s].
    output_gain : float
        Duty per output of the rules [-].
    **options
        As `VariableUniverseController`.
    """

    def __init__(
        self,
        axis: LinearAxis,
        *,
        error_range: float = 0.025,
        rate_range: float = 0.246,
        output_gain: float = 3.37,
        **options: Any,
    ) -> None:
        params = VariableUniverseParams(
            error_range=error_range, rate_range=rate_range, output_gain=output_gain
        )
        super().__init__(axis, params, **options)

    def _check_params(self) -> None:
        """Floors and exponents are of no use here, so nothing is said about them."""

    def _on_universes(self) -> FixedSurface:
        return FixedSurface(self.params, self._direction)

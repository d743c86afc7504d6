# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Temperature of a thermistor (NTC) by its resistance, or by the voltage of its divider."""

from dataclasses import dataclass
from math import inf, isfinite, nan

from fuzzycnc_ros.core.portable import log

ZERO_CELSIUS = 273.15
"""0 degC [K]."""
COLDEST, HOTTEST = -80.0, 400.0
"""Temperatures between which thermistors are made [degC]."""


@dataclass(frozen=True)
class Ntc:
    """A thermistor, alone or in a divider with a fixed resistor.

    Parameters
    ----------
    a, b, c : float
        Coefficients of Steinhart and Hart: 1/T = a + b ln R + c (ln R)^3, T in K, R in ohm.
    fixed : float
        The other resistor of the divider [ohm]; 0 where the raw value is the resistance itself.
    supply : float
        Voltage across the divider, in the unit of the raw value: 5 with volts, 1023 with the
        counts of a converter of 10 bits whose reference is the supply.
    low_side : bool
        True if the thermistor lies between the input and ground, False if between the input and
        the supply.

    References
    ----------
    [steinhart_hart]: the equation.

    Examples
    --------
    >>> ntc = Ntc.of_beta(3950.0, 10e3, fixed=4700.0, supply=1023.0)
    >>> round(ntc.temperature(1023.0 * 10e3 / 14.7e3), 6)
    25.0
    """

    a: float
    b: float
    c: float
    fixed: float = 0.0
    supply: float = inf
    low_side: bool = True

    @staticmethod
    def of_beta(
        beta: float,
        resistance: float,
        at: float = 25.0,
        fixed: float = 0.0,
        supply: float = inf,
        low_side: bool = True,
    ) -> 'Ntc':
        """Return the thermistor of a beta [K] and its resistance [ohm] at a temperature [degC]."""
        a = 1.0 / (at + ZERO_CELSIUS) - log(resistance) / beta
        return Ntc(a, 1.0 / beta, 0.0, fixed, supply, low_side)

    def resistance(self, raw: float) -> float:
        """Return the resistance [ohm] behind a raw value; NaN at the rails and beyond them."""
        if not self.fixed:
            return raw if raw > 0.0 else nan
        if not 0.0 < raw < self.supply:
            return nan
        ratio = raw / (self.supply - raw)
        return self.fixed * ratio if self.low_side else self.fixed / ratio

    def temperature(self, raw: float) -> float:
        """Return the temperature [degC] behind a raw value; NaN if no thermistor reads it."""
        ohms = self.resistance(raw)
        if not isfinite(ohms) or ohms <= 0.0:
            return nan
        x = log(ohms)
        inverse = self.a + self.b * x + self.c * x * x * x
        value = 1.0 / inverse - ZERO_CELSIUS if inverse > 0.0 else nan
        return value if COLDEST <= value <= HOTTEST else nan

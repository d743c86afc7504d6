# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Limits of single sensors: a heated bed warms faster than metal, and gets hotter."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase
from math import inf
from types import MappingProxyType

import numpy as np

from fuzzycnc_ros.core.arrays import Array

LIMIT_BOUNDS = MappingProxyType(
    {
        'range_low': (-273.15, 2000.0),
        'range_high': (-273.15, 2000.0),
        'rate_max': (1e-6, 1000.0),
        'noise_band': (0.0, 1000.0),
    }
)
"""Limits that a sensor may have of its own, and the bounds of each [degC, degC, K/s, K]."""


@dataclass(frozen=True)
class SensorLimits:
    """Limits that differ from those of all sensors.

    Parameters
    ----------
    entries : tuple of (str, str, float)
        Name of a sensor, or a pattern such as `bed*`; limit; value.  The last that fits counts.

    Examples
    --------
    >>> limits = SensorLimits.of(['bed*:rate_max:0.7', 'bed 2:range_high:250'])
    >>> limits.values('rate_max', ['bed 1', 'spindle'], 0.1).tolist()
    [0.7, 0.1]
    """

    entries: tuple[tuple[str, str, float], ...] = ()

    @staticmethod
    def of(texts: Iterable[str], name: str = 'sensor_limits') -> 'SensorLimits':
        """Return the limits that texts such as `bed:rate_max:0.7` state.

        Raises
        ------
        ValueError
            If a text states none; the message names what holds it, and the text.
        """
        entries = []
        for text in texts:
            # A name may hold colons.
            *_, sensor, limit, value = ['', '', '', *text.rsplit(':', 2)]
            low, high = LIMIT_BOUNDS.get(limit, (inf, -inf))
            try:
                number = float(value)
            except ValueError:
                number = np.nan
            if not sensor or not low <= number <= high:
                bounds = ', '.join(
                    f'{key} from {a:g} to {b:g}' for key, (a, b) in LIMIT_BOUNDS.items()
                )
                raise ValueError(
                    f'{name}: expected SENSOR:LIMIT:VALUE such as bed:rate_max:0.7, of the limits '
                    f'{bounds} (degC, K/s, K), but found {text!r}'
                )
            entries.append((sensor, limit, number))
        return SensorLimits(tuple(entries))

    def values(self, limit: str, sensors: Sequence[str], usual: float) -> Array:
        """Return a limit of each sensor.

        Parameters
        ----------
        limit : str
            Name of the limit.
        sensors : sequence of str
            Names of the sensors.
        usual : float
            Limit of a sensor that has none of its own.
        """
        found = np.full(len(sensors), usual)
        for pattern, name, value in self.entries:
            if name != limit:
                continue
            for place, sensor in enumerate(sensors):
                if sensor == pattern or fnmatchcase(sensor, pattern):
                    found[place] = value
        return found


USUAL = SensorLimits()
"""No limits but those of a machine's metal."""

JUDGED = SensorLimits(
    (('*', 'range_low', -273.15), ('*', 'range_high', 2000.0), ('*', 'rate_max', 1000.0))
)
"""Limits of readings that `temperature_acquisition` has judged by its own already."""

# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The samples that a model must have seen to know where the machine stands."""

from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from fuzzycnc_ros.components.thermal.probes import Probe
from fuzzycnc_ros.runtime.records import (
    Stamp,
    Temperatures,
    nanoseconds,
)

SAMPLES_MAX = 20000
"""Most samples that are kept, whatever `settle_time` says: it bounds the memory."""


@dataclass(frozen=True, eq=False)
class Heard:
    """A sample with what else the stream said up to it.

    Attributes
    ----------
    sample : Temperatures
        Temperatures of all sensors.
    spindle_speed : float
        Size of the spindle speed [rad/s]; NaN if it is not known.
    probes : tuple of Probe
        Probes since the sample before.
    """

    sample: Temperatures
    spindle_speed: float = np.nan
    probes: tuple[Probe, ...] = ()


class SampleMemory:
    """The newest samples, as long as they matter to a model that is to begin now."""

    def __init__(self) -> None:
        self._heard: deque[Heard] = deque(maxlen=SAMPLES_MAX)

    def add(self, heard: Heard, settle_time: float) -> None:
        """Keep a sample, and with it all that are not older than `settle_time` [s]."""
        self._heard.append(heard)
        oldest = heard.sample.stamp - nanoseconds(settle_time)
        # One sample from before that time proves that the history is long enough.
        while len(self._heard) > 1 and self._heard[1].sample.stamp <= oldest:
            self._heard.popleft()

    def since(self, stamp: Stamp) -> Iterator[Heard]:
        """Yield the samples after a stamp [ns], oldest first."""
        return (item for item in self._heard if item.sample.stamp > stamp)

    @property
    def newest(self) -> Heard | None:
        """The newest sample."""
        return self._heard[-1] if self._heard else None

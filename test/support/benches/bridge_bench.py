# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""What rigs of bridges have in common, and a compensator in a closed loop with one."""

from itertools import pairwise
from typing import Any

import numpy as np
from benches.component_bench import Bench, machine_state, thermal_error

from fuzzycnc_ros.components.thermal.compensator import Compensator, CompensatorConfig
from fuzzycnc_ros.runtime.records import Compensation, nanoseconds

MICRON = 1e-6
ERROR = (4e-6, -2e-6)
"""Thermal error of Y and Z [m]."""


class BridgeRig:
    """A bridge at a controller that a subclass brings along, with `bench`, `time`, `path`
    and `applied`, the offsets in force [m]."""

    axes: tuple[str, ...]
    close: float
    """Difference of two offsets that counts as none [m]."""
    epoch = 1

    def command(self, offset, *, slope=None, reference=None, valid=1000.0, epoch=None, axis=None):
        """Command offsets [um]."""
        stamp, none = nanoseconds(self.time), np.zeros(len(self.axes))
        record = Compensation(
            stamp=stamp,
            epoch=epoch or self.epoch,
            state=1,
            axis=axis or self.axes,
            offset=MICRON * np.array(offset, float),
            slope=none if slope is None else np.array(slope, float),
            reference_position=none if reference is None else np.array(reference, float),
            at_limit=none > 0.0,
            slewing=none > 0.0,
            valid_until=stamp + nanoseconds(valid),
            source=('test',),
        )
        self.bench.push('compensation', record)
        self.bench.emitted += self.bench.merger.advance(stamp)

    def set_clock(self, step, *, told=True):
        """Set the clock forward by a step [s]; who is not told of it has to notice."""
        self.time += step
        if told:
            self.bench.clock_step(step, self.time)

    @property
    def last(self):
        return self.bench.records('compensation_applied')[-1]

    @property
    def allowed(self):
        return self.bench.records('machine_state')[-1].offsets_allowed

    def at(self, offset):
        """Whether offsets [um] are applied, and told."""
        wanted = MICRON * np.array(offset, float)
        return all(
            np.all(np.abs(found - wanted) <= self.close)
            for found in (self.applied, self.last.offset)
        )

    @property
    def largest_step(self):
        """Largest change of an applied offset in a cycle [m]."""
        return max(np.abs(b - a).max() for a, b in pairwise(self.path))


class Compensated:
    """A compensator that hears the bridge of a rig and commands it."""

    def __init__(self, rig: Any, **parameters: Any) -> None:
        self._rig = rig
        self._parameters = {'period': 1.0, 'slew_max': 1e-6, 'stale_after': 20.0, **parameters}
        self.restart()

    def restart(self) -> None:
        """Put a new compensator in the place of the old one."""
        self.bench = Bench(Compensator(CompensatorConfig(**self._parameters)))
        self.bench.until(self._rig.time)
        self.bench.request('activate')

    def run(self, seconds: int, *, errors: bool = True) -> None:
        """Let time pass."""
        rig, bench = self._rig, self.bench
        for _ in range(seconds):
            rig.run(1.0)
            bench.push('compensation_applied', rig.last)
            state = machine_state(rig.time, offsets_allowed=rig.allowed)
            bench.push('machine_state', state)
            if errors and round(rig.time) % 5 == 0:
                bench.push('thermal_error', thermal_error(rig.time, ERROR))
            for item in bench.until(rig.time):
                if item.output == 'compensation':
                    rig.bench.push('compensation', item.record)
                    rig.bench.merger.advance(item.record.stamp)

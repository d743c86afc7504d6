# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""A compensator in a closed loop with a bridge and its controller."""

import sys
from pathlib import Path
from typing import Any

from fuzzycnc_ros.components.compensator import Compensator, CompensatorConfig

sys.path.insert(0, str(Path(__file__).parent))
from component_bench import Bench, machine_state, thermal_error

ERROR = (4e-6, -2e-6)
"""Thermal error of Y and Z [m]."""


class Compensated:
    """A compensator that hears the bridge of a rig and commands it."""

    def __init__(self, rig: Any) -> None:
        self._rig = rig
        self.restart()

    def restart(self) -> None:
        """Put a new compensator in the place of the old one."""
        config = CompensatorConfig(period=1.0, slew_max=1e-6, stale_after=20.0)
        self._bench = Bench(Compensator(config))
        self._bench.until(self._rig.time)
        self._bench.request('activate')

    def run(self, seconds: int) -> None:
        """Let time pass."""
        rig, bench = self._rig, self._bench
        for _ in range(seconds):
            rig.run(1.0)
            bench.push('compensation_applied', rig.last)
            state = machine_state(rig.time, offsets_allowed=rig.allowed)
            bench.push('machine_state', state)
            if round(rig.time) % 5 == 0:
                bench.push('thermal_error', thermal_error(rig.time, ERROR))
            for item in bench.until(rig.time):
                if item.output == 'compensation':
                    rig.bench.push('compensation', item.record)
                    rig.bench.merger.advance(item.record.stamp)

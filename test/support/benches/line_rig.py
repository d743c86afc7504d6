# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""A bridge to a control that takes lines, on the program of the guide, cycle by cycle."""

import numpy as np
from benches.bridge_bench import BridgeRig
from benches.component_bench import Bench
from benches.line_control import LineControl

from fuzzycnc_ros.adapters.opcua.offset_lines import LineLimits, LineStatus
from fuzzycnc_ros.adapters.opcua.opcua_bridge import OpcuaBridge, OpcuaBridgeConfig
from fuzzycnc_ros.core.inputs.lines import Lines, Travel
from fuzzycnc_ros.core.inputs.offset_input import OffsetStatus
from fuzzycnc_ros.runtime.enums import MachineMode
from fuzzycnc_ros.runtime.records import nanoseconds

AXES = ('X', 'Z')
CYCLE = 0.1
SLEW = 10e-6
SCALE = 2e-8
"""Difference that a set is not worth [m], with room to spare."""
STEP_MAX = 20e-6 * CYCLE + 1e-12
"""Largest change of an applied offset in a cycle [m]: the slew limit of the control."""
TRAVEL = Travel(low=np.array([-0.2, 0.0]), high=np.array([0.3, 0.0]))
"""X takes a slope, Z does not."""


class Rig(BridgeRig):
    """A bridge and a control; what the bridge writes arrives one cycle after it has read."""

    axes, close = AXES, SCALE
    says_alive = True

    def __init__(self, control=None, *, active=True, **parameters):
        self.control = control or LineControl()
        parameters = {'axes': AXES, 'slew_max': SLEW, **parameters}
        self.config = OpcuaBridgeConfig(**parameters)
        self.time = 100.0
        self.path, self.sets = [], []
        self.restart(active=active)

    def restart(self, *, active=True):
        """Put a new bridge in the place of the old one."""
        self.bench = Bench(OpcuaBridge(self.config))
        self.bridge = self.bench.component
        self._written, self._exchanged = 0, self.time
        if active:
            assert self.bench.request('activate').success

    def status(self):
        """Return what can be read of the control."""
        control = self.control
        mode = MachineMode.ON if control.on else MachineMode.OFF
        return LineStatus(
            mode=mode,
            homed=control.homed,
            ready=control.on and control.homed and control.allowed,
            writer=control.owner,
            position=control.position.copy(),
            applied=control.applied.copy(),
            lines=Lines(
                offset=control.offset.copy(),
                slope=control.slope.copy(),
                reference_position=control.reference_position.copy(),
            ),
            sequence=control.sequence,
            acknowledged=control.acknowledged,
            heartbeat=control.heartbeat,
            allowed=control.allowed,
            alive=control.alive or not self.says_alive,
            limits=LineLimits(
                offset_max=control.limit,
                slew_max=control.slew,
                travel=TRAVEL,
                resolution=np.zeros(2),
            ),
        )

    def write(self, orders):
        """Write as the adapter does."""
        control = self.control
        if orders.sequence != self._written:
            control.offset = orders.lines.offset
            control.slope = orders.lines.slope
            control.reference_position = orders.lines.reference_position
            control.valid_for, control.sequence = orders.validity, orders.sequence
            self.sets.append(orders)
        control.heartbeat = orders.heartbeat
        self._written = orders.sequence

    def run(self, duration):
        """Let time pass."""
        for _ in range(round(duration / CYCLE)):
            self.time += CYCLE
            held, orders = self.bridge.holding, self.bridge.orders
            # As the adapter does: after a pause it is read before anything is written.
            paused = self.time - self._exchanged > self.config.takeover_time
            self._exchanged = self.time
            if orders is not None and not paused:
                self.write(orders)
            status = self.status()
            self.bench.emitted += self.bridge.observe(nanoseconds(self.time), status)
            if self.bridge.wants_control:
                self.bridge.take_control()
            elif held and not self.bridge.holding and self.control.sequence == self._written:
                self.control.sequence = 0
            self._scan()

    def silence(self, duration):
        """Let time pass without a bridge."""
        for _ in range(round(duration / CYCLE)):
            self.time += CYCLE
            self._scan()

    def _scan(self):
        self.control.scan(CYCLE)
        self.path.append(self.control.applied.copy())

    @property
    def applied(self):
        return self.control.applied

    @property
    def largest_way(self):
        """Largest change of an applied offset in a second [m]."""
        path = np.array(self.path)
        return np.abs(path[10:] - path[:-10]).max()


def settled(offset=(10, -20), **parameters):
    """Return a rig with offsets in force."""
    rig = Rig(**parameters)
    rig.run(2.0)
    rig.command(offset)
    rig.run(5.0)
    assert rig.at(offset), (rig.control.applied, rig.last)
    assert rig.last.status == OffsetStatus.FOLLOWING
    return rig

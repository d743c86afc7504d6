# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""A bridge on LinuxCNC's registers and HAL file as they were measured, without a HAL."""

from dataclasses import replace

import numpy as np
from benches.bridge_bench import BridgeRig
from benches.component_bench import Bench
from benches.offset_thread import OffsetLimits, OffsetThread

from fuzzycnc_ros.adapters.linuxcnc.linuxcnc_bridge import LinuxcncBridge, LinuxcncBridgeConfig
from fuzzycnc_ros.adapters.linuxcnc.status import LinuxcncStatus
from fuzzycnc_ros.core.inputs.lines import Travel
from fuzzycnc_ros.core.inputs.offset_input import OffsetStatus
from fuzzycnc_ros.runtime.enums import MachineMode
from fuzzycnc_ros.runtime.records import nanoseconds

AXES = ('X', 'Y', 'Z')
CYCLE = 0.01
SCALE = 1e-8
SLEW = 50e-6
RATE = 10_000.0
"""Counts per second of the HAL file [1/s]."""
HOLD = 2.0
STEP_MAX = SLEW * CYCLE + SCALE
"""Largest change of an applied offset in a cycle [m]."""


class Controller:
    """LinuxCNC's offset registers and the shipped HAL file, in steps of a cycle.

    Counts change registers by deltas, and only while the machine is ready and the enable is on;
    counts are limited in rate; without a heartbeat they go to zero after a while.
    """

    def __init__(self):
        self.on = self.homed = self.enable = True
        self.soft_limited = False
        self.scale = np.full(3, SCALE)
        self.cap = np.full(3, np.inf)
        self.position = np.zeros(3)
        self.counts = np.zeros(3)
        self.register = np.zeros(3)
        self.applied = np.zeros(3)
        self.alive = False
        self.silent = np.inf
        self.told = np.zeros(3)
        self.clear = False
        self.writer = ''
        self.probe = None
        self.tick = 0

    def write(self, orders):
        """Take what a bridge writes; None is silence."""
        if orders is None:
            self.silent += CYCLE
        else:
            self.silent, self.told, self.clear = 0.0, orders.counts, orders.rezero

    def cycle(self):
        """Let the servo thread run for a cycle; return what can be read then."""
        ready = self.on and self.homed
        self.tick += 1
        self.alive = self.silent <= HOLD
        wanted = self.told if self.alive else np.zeros(3)
        reach = RATE * CYCLE
        before = self.counts
        self.counts = before + np.clip(wanted - before, -reach, reach)
        if not ready:
            self.counts = np.zeros(3)
        if self.clear or not ready:
            self.register = np.zeros(3)
        elif self.enable:
            self.register = self.register + self.scale * (self.counts - before)
        if ready and self.enable:
            self.applied = np.clip(self.register, -self.cap, self.cap)
        return self._status(ready)

    def _status(self, ready):
        return LinuxcncStatus(
            mode=MachineMode.ON if self.on else MachineMode.OFF,
            homed=self.homed,
            ready=ready,
            alive=self.alive,
            frozen=not self.enable,
            soft_limited=bool(np.any(np.abs(self.register) > self.cap)),
            writer=self.writer,
            position=self.position,
            applied=self.applied,
            register=self.register,
            counts=self.counts,
            scale=self.scale,
            travel=Travel(low=np.zeros(3), high=np.zeros(3)),
            tick=self.tick,
            probe=self.probe,
        )


class ThreadController(Controller):
    """LinuxCNC's registers under the component `fuzzycnc_offset`, whose C it runs."""

    def __init__(self, travel=0.3):
        super().__init__()
        self.travel = Travel(low=np.full(3, -travel), high=np.full(3, travel))
        self.threads = [
            OffsetThread(
                OffsetLimits(size=10_000.0, rate=RATE, slope=0.01 / SCALE, speed=1.0),
                *(-travel, travel),
            )
            for _ in range(3)
        ]
        self.tracking = True

    def write(self, orders):
        """Take what a bridge writes as a set; None is silence."""
        if orders is None:
            self.silent += CYCLE
            return
        self.silent, self.clear = 0.0, orders.rezero
        for thread, *line in zip(
            self.threads, orders.counts, orders.slope, orders.reference, strict=True
        ):
            thread.limits.size = min(10_000.0, orders.limit)
            thread.aim(*line)

    def cycle(self, steps=10):
        """Let the servo thread run for a cycle, or another number of its periods."""
        ready = self.on and self.homed
        self.tick += 1
        self.alive = self.silent <= HOLD
        for axis, thread in enumerate(self.threads):
            if not ready or self.clear:
                thread.drop()
            elif not self.alive:
                thread.aim(0.0, 0.0, 0.0)
            tracks = ready and self.enable and self.tracking
            begin = thread.line.position
            for step in range(steps):
                place = begin + (self.position[axis] - begin) * (step + 1) / steps
                thread.step(tracks, place, CYCLE / 10)
        before = self.counts
        self.counts = np.array([np.rint(thread.line.value) for thread in self.threads])
        if self.clear or not ready:
            self.register = np.zeros(3)
        elif self.enable:
            self.register = self.register + self.scale * (self.counts - before)
        if ready and self.enable:
            self.applied = self.register.copy()
        ends = [[getattr(t.line, end) for t in self.threads] for end in ('low', 'high')]
        return replace(
            self._status(ready),
            lines=self.travel.lines(np.tile(self.scale, 2) * np.ravel(ends), np.zeros(3)),
            travel=self.travel,
            base=self.register - self.scale * self.counts,
            tracking=ready and self.tracking,
        )


class Rig(BridgeRig):
    """A bridge on a controller, cycle by cycle."""

    axes, close = AXES, SCALE

    def __init__(self, controller=None, *, active=True, **parameters):
        self.controller = controller or Controller()
        self.config = LinuxcncBridgeConfig(**{'slew_max': SLEW, **parameters})
        self.time = 200_000.0
        self.path, self.on = [], []
        self.restart(active=active)

    def restart(self, *, active=True):
        """Put a new bridge in the place of the old one."""
        self.bench = Bench(LinuxcncBridge(self.config))
        self.bridge = self.bench.component
        if active:
            assert self.bench.request('activate').success

    def run(self, duration):
        """Let time pass."""
        for _ in range(round(duration / CYCLE)):
            self.time += CYCLE
            status = self.controller.cycle()
            self._note()
            self.bench.emitted += self.bridge.observe(nanoseconds(self.time), status)
            if self.bridge.wants_control:
                self.bridge.take_control()
            self.controller.write(self.bridge.orders)

    def silence(self, duration):
        """Let time pass without a bridge."""
        for _ in range(round(duration / CYCLE)):
            self.time += CYCLE
            self.controller.write(None)
            self.controller.cycle()
            self._note()

    def _note(self):
        self.path.append(self.controller.applied.copy())
        self.on.append(self.controller.on)

    @property
    def applied(self):
        return self.controller.applied


def settled(offset=(10, -20, 30), *, controller=None, **parameters):
    """Return a rig with offsets in force."""
    rig = Rig(controller, **parameters)
    rig.run(0.2)
    rig.command(offset)
    rig.run(2.0)
    assert rig.at(offset)
    assert rig.last.status == OffsetStatus.FOLLOWING
    return rig

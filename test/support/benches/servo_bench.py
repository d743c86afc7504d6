# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""A servo_controller and plants that it drives, without a machine."""

import numpy as np
from benches.component_bench import Bench

from fuzzycnc_ros.components.servo.servo_controller import ServoController, ServoControllerConfig
from fuzzycnc_ros.runtime.records import SECOND, AxisState, PositionCommand
from fuzzycnc_ros.simulation.servo.axes import LatheAxis

PERIOD = 1_000_000
START = 5 * SECOND


class Axis(Bench):
    """A controller and plants that it drives, period by period, without a machine."""

    def __init__(self, plants=None, *, active=True, late=0, **config) -> None:
        super().__init__(ServoController(ServoControllerConfig(**config)))
        self.plants = {'X': LatheAxis()} if plants is None else plants
        self.now = START
        self.duty = dict.fromkeys(self.plants, 0.0)
        self.late = late  # periods by which the drives get their commands late
        self.answers = True  # whether the drives follow them
        if active:
            assert self.request('activate').success

    def tick(self, *, heard=True):
        """Read the axes, tell the controller if it hears, drive them over a period."""
        reading = [plant.measure() for plant in self.plants.values()]
        if heard:
            state = AxisState(
                stamp=self.now,
                frame_id='mill/workpiece',
                axis=tuple(self.plants),
                reference=np.full(len(reading), np.nan),
                position=np.array(reading),
                velocity=np.zeros(len(reading)),
            )
            assert self.push('axis_state', state)
        self.emitted += self.merger.advance(self.now)
        found = self.records('axis_command')
        if len(found) > self.late:
            newest = found[-1 - self.late]
            self.duty = dict(zip(newest.axis, newest.duty.tolist(), strict=True))
        for name, plant in self.plants.items():
            plant.drive(self.duty[name] if self.answers else 0.0)
        self.now += PERIOD

    def run(self, time, **heard):
        """Tick for a time [s]."""
        for _ in range(round(time * 1e3)):
            self.tick(**heard)

    def go(self, velocity=np.nan, **targets):
        """Command positions [m]."""
        command = PositionCommand(
            stamp=self.now,
            frame_id='mill/workpiece',
            axis=tuple(targets),
            position=np.array(list(targets.values()), dtype=np.float64),
            velocity=np.full(len(targets), velocity),
        )
        self.push('position_command', command)

    def place(self, name='X'):
        """Return where a slide truly is [m]."""
        return self.plants[name].position

    @property
    def state(self):
        """The newest word of the controller."""
        return self.records('servo_state')[-1]

    def state_or_none(self):
        """The newest word of the controller, if it has said anything."""
        found = self.records('servo_state')
        return found[-1] if found else None

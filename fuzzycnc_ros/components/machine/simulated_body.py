# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Component `simulated_body`: the simulated mill as the body of a machine with another controller.

A controller that has no machine of iron, such as a LinuxCNC without hardware, gets one that heats
up: its own spindle warms it, and what it reads back of its offsets moves the tool.  What is
measured here is therefore what compensation leaves, through all that lies between.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from fuzzycnc_ros.components.machine.mill_instruments import MillInstruments
from fuzzycnc_ros.components.machine.simulated_machine_config import (
    DAY_START,
    MACHINE_DUTIES,
    SimulatedMachineConfig,
)
from fuzzycnc_ros.core.config import Config, param, same_param
from fuzzycnc_ros.runtime.component import Component, Emission, Health, Input, Level, Output
from fuzzycnc_ros.runtime.records import (
    CompensationApplied,
    Displacement,
    Floats,
    MachineState,
    Temperatures,
    nanoseconds,
)
from fuzzycnc_ros.simulation.thermal.mill import MILL_AXES

OFFSET_MAX = 1e-3
"""Offset beyond which a read-back means nothing [m]."""
SPEED_MAX = 1e4
"""Spindle speed beyond which a state means nothing [rad/s]."""


@dataclass(frozen=True, kw_only=True)
class SimulatedBodyConfig(Config):
    """Parameters of `simulated_body`."""

    duty: str = param(
        'T2',
        '-',
        'Duty whose shop it stands in and whose length it runs; the controller turns the spindle',
        choices=tuple(MACHINE_DUTIES),
    )
    duration: float = param(
        0.0, 's', 'Time after which it ends; 0 for the length of the duty', low=0.0, high=864000.0
    )
    seed: int = same_param(SimulatedMachineConfig, 'seed')
    tick_period: float = same_param(SimulatedMachineConfig, 'tick_period')
    rate: float = param(1.0, '-', 'Speed of machine time; 1 is real time', low=0.01, high=1e4)
    displacement_interval: float = same_param(SimulatedMachineConfig, 'displacement_interval')
    displacement_noise: float = same_param(SimulatedMachineConfig, 'displacement_noise')
    sensor_faults: tuple[str, ...] = same_param(SimulatedMachineConfig, 'sensor_faults')
    nodes: tuple[str, ...] = param(
        (
            'temperature_acquisition',
            'sensor_selector',
            'thermal_predictor',
            'compensator',
            'linuxcnc_bridge',
        ),
        '-',
        'Nodes of the run, which the start awaits',
    )
    start_timeout: float = same_param(SimulatedMachineConfig, 'start_timeout')


class SimulatedBody(Component[SimulatedBodyConfig]):
    """Warm up by the spindle of a controller, be moved by its offsets, measure both."""

    NAME = 'simulated_body'
    SUMMARY = (
        'The simulated mill behind another controller: heated by its spindle, moved by the '
        'offsets that it reads back; temperatures and displacement. Makes machine time.'
    )
    CONFIG = SimulatedBodyConfig
    STATE = Input('machine_state', MachineState)
    INPUTS = (STATE, Input('compensation_applied', CompensationApplied))
    OUTPUTS = (
        Output('displacement', Displacement),
        Output('sensor_readings', Temperatures),
    )

    def __init__(self, config: SimulatedBodyConfig | None = None) -> None:
        super().__init__(config)
        duty = MACHINE_DUTIES[self._config.duty]
        self._instruments = MillInstruments(self._config)
        self._instruments.begin(duty)
        self._start = nanoseconds(DAY_START)
        self._tick_period = nanoseconds(self._config.tick_period)
        self._length = nanoseconds(self._config.duration or duty.duration)
        self._ticks = 0
        self._speed = 0.0
        self._offset: Floats = np.zeros(len(MILL_AXES))

    @property
    def next_tick(self) -> int | None:
        """Machine time of the next tick [ns]; None at the end."""
        if (self._ticks + 1) * self._tick_period > max(self._length, self._tick_period):
            return None
        return self._start + (self._ticks + 1) * self._tick_period

    def on_machine_state(self, state: MachineState) -> None:
        """Note the spindle speed; one that is not known leaves the last known one."""
        if abs(state.spindle_speed) <= SPEED_MAX:  # false for NaN
            self._speed = abs(state.spindle_speed)

    def on_compensation_applied(self, applied: CompensationApplied) -> None:
        """Note the offsets in force; an axis of which nothing is known stays where it is."""
        for axis, offset in zip(applied.axis, applied.offset, strict=True):
            if axis in MILL_AXES and abs(offset) <= OFFSET_MAX:  # false for NaN
                self._offset[MILL_AXES.index(axis)] = offset

    def tick(self) -> Iterator[Emission]:
        """Move on to the next tick and report everything that is measured there.

        Raises
        ------
        RuntimeError
            If the time is over.
        """
        stamp = self.next_tick
        if stamp is None:
            raise RuntimeError('the time is over; there is no next tick')
        self._ticks += 1
        self._instruments.advance(self._config.tick_period, self._speed)
        yield from self._instruments.readings(
            stamp,
            stamp - self._start,
            self.frame('machine'),
            self.frame('workpiece'),
            lambda _: self._offset.copy(),
        )

    def health(self) -> list[Health]:
        """Report what the controller does with the machine."""
        if self.last(self.STATE) is None:
            return [Health('controller', Level.WARN, 'no machine_state of a controller yet')]
        values = {
            f'offset {axis} [um]': f'{1e6 * offset:.2f}'
            for axis, offset in zip(MILL_AXES, self._offset, strict=True)
        }
        text = f'spindle at {self._speed:.1f} rad/s'
        return [Health('controller', Level.OK, text, values)]

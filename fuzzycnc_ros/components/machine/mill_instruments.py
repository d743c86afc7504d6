# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The heat of the simulated mill, the instruments that read it, and the offsets against it."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np

from fuzzycnc_ros.core.inputs.offset_input import OffsetInput, OffsetInputConfig
from fuzzycnc_ros.runtime.component import Emission, Health, Level
from fuzzycnc_ros.runtime.records import (
    Compensation,
    CompensationApplied,
    Displacement,
    Floats,
    Temperatures,
    nanoseconds,
)
from fuzzycnc_ros.simulation.thermal.duties import Duty
from fuzzycnc_ros.simulation.thermal.mill import MILL_AXES, MILL_SENSORS, ThermalMill
from fuzzycnc_ros.simulation.thermal.sensor_faults import parse_sensor_fault

if TYPE_CHECKING:
    from fuzzycnc_ros.components.machine.simulated_body import SimulatedBodyConfig
    from fuzzycnc_ros.components.machine.simulated_machine_config import SimulatedMachineConfig

RUN_SEED_STEP = 1000
"""What the seed goes up by from one duty to the next."""


class MillInstruments:
    """Moves temperatures on, and measures them and what they do to the tool.

    Parameters
    ----------
    config : SimulatedMachineConfig or SimulatedBodyConfig
        Parameters of the node.

    Raises
    ------
    ValueError
        If a sensor fault is malformed.
    """

    def __init__(self, config: SimulatedMachineConfig | SimulatedBodyConfig) -> None:
        self._config = config
        self._faults = tuple(parse_sensor_fault(text) for text in config.sensor_faults)
        self._mill: ThermalMill

    def begin(self, duty: Duty, run: int = 0) -> None:
        """Set the mill up, cold, in the surroundings of a duty."""
        self._mill = duty.mill(seed=self._config.seed + RUN_SEED_STEP * run, faults=self._faults)

    def advance(self, period: float, spindle_speed: float) -> None:
        """Move on by a period [s] at a spindle speed [rad/s]."""
        self._mill.advance(period, spindle_speed)

    def readings(
        self, stamp: int, since: int, frame_id: str, workpiece: str, offset: Floats | None = None
    ) -> Iterator[Emission]:
        """Yield what is measured at a stamp.

        Parameters
        ----------
        stamp, since : int
            Machine time, and time since the duty began [ns].
        frame_id, workpiece : str
            Frames of the machine and of the workpiece.
        offset : ndarray, shape (axes of the mill,), optional
            Offsets in force, which move the tool too [m]; left out, a displacement is that of
            the bare machine.
        """
        interval = nanoseconds(self._config.displacement_interval)
        if since % interval < nanoseconds(self._config.tick_period):
            noise = self._config.displacement_noise
            measured = self._mill.measure_displacement(noise=noise)
            yield Emission(
                'displacement',
                Displacement(
                    stamp=stamp,
                    frame_id=workpiece,
                    axis=MILL_AXES,
                    channel=MILL_AXES,
                    displacement=measured if offset is None else measured + offset,
                    standard_deviation=np.full(len(MILL_AXES), noise),
                    includes_compensation=offset is not None,
                ),
            )
        reading = self._mill.read()
        yield Emission(
            'sensor_readings',
            Temperatures(
                stamp=stamp,
                frame_id=frame_id,
                sensor=MILL_SENSORS,
                temperature=reading,
                status=np.where(np.isfinite(reading), 0, 1).astype(np.uint8),
                readings=1,
            ),
        )


class Warmth(MillInstruments):
    """Moves temperatures and offsets on, and measures them.

    Parameters
    ----------
    config : SimulatedMachineConfig
        Parameters of the machine.

    Attributes
    ----------
    offsets : OffsetInput
        Guard of the offsets.
    spindle_speed : float
        Spindle speed of the newest tick [rad/s].

    Raises
    ------
    ValueError
        If a sensor fault is malformed.
    """

    def __init__(self, config: SimulatedMachineConfig) -> None:
        super().__init__(config)
        self.offsets = OffsetInput(
            MILL_AXES,
            OffsetInputConfig(
                offset_max=config.offset_max,
                slew_max=config.slew_max,
                slope_max=config.slope_max,
                validity_max=config.validity_max,
            ),
        )
        self.spindle_speed = 0.0

    def command(self, command: Compensation) -> None:
        """Take an offset command; the offset input decides whether it is followed."""
        self.offsets.command(
            command.epoch,
            command.axis,
            command.offset,
            command.slope,
            command.reference_position,
            stamp=command.stamp,
            valid_until=command.valid_until,
        )

    def advance(self, period: float, spindle_speed: float) -> None:
        """Move on by a period [s] at a spindle speed [rad/s]."""
        self.spindle_speed = spindle_speed
        super().advance(period, spindle_speed)

    def applied(self, stamp: int, frame_id: str, refusal: str) -> Emission:
        """Return the offsets in force at a stamp [ns], and why others are refused, if they are."""
        applied = CompensationApplied(
            stamp=stamp,
            frame_id=frame_id,
            epoch=self.offsets.epoch,
            status=int(self.offsets.status),
            reason=refusal or self.offsets.reason,
            axis=MILL_AXES,
            offset=self.offsets.applied,
            at_limit=self.offsets.at_limit,
        )
        return Emission('compensation_applied', applied)

    def health(self) -> Health:
        """Report the offsets in force and why a command was refused."""
        values = {
            f'offset {axis} [um]': f'{1e6 * offset:.2f}'
            for axis, offset in zip(MILL_AXES, self.offsets.applied, strict=True)
        }
        if self.offsets.released:
            return Health('compensation', Level.OK, 'at zero, as commanded last', values)
        level = Level.WARN if self.offsets.reason else Level.OK
        text = self.offsets.reason or self.offsets.status.name.lower()
        return Health('compensation', level, text, values)

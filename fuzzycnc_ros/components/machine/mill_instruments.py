# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The heat of the simulated mill, the instruments that read it, and the offsets against it."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from fuzzycnc_ros.core.inputs.offset_input import OffsetInput, OffsetInputConfig
from fuzzycnc_ros.core.thermal.places import place_channels
from fuzzycnc_ros.runtime.component import Emission, Health, Level
from fuzzycnc_ros.runtime.records import (
    MOTION_FIELDS,
    Compensation,
    CompensationApplied,
    Displacement,
    Floats,
    Names,
    Temperatures,
    nanoseconds,
)
from fuzzycnc_ros.simulation.thermal.ball_screw import Stroke
from fuzzycnc_ros.simulation.thermal.duties import Duty
from fuzzycnc_ros.simulation.thermal.mill import MILL_AXES, MILL_SENSORS, ThermalMill
from fuzzycnc_ros.simulation.thermal.mill_screws import (
    MillScrews,
    screw_configs,
    screw_faults,
)
from fuzzycnc_ros.simulation.thermal.sensor_faults import parse_sensor_fault

if TYPE_CHECKING:
    from fuzzycnc_ros.components.machine.simulated_body import SimulatedBodyConfig
    from fuzzycnc_ros.components.machine.simulated_machine_config import SimulatedMachineConfig

RUN_SEED_STEP = 1000
"""Increment of the seed from one duty to the next."""


class MillInstruments:
    """Moves temperatures on, and measures them and what they do to the tool.

    Parameters
    ----------
    config : SimulatedMachineConfig or SimulatedBodyConfig
        Parameters of the node.
    screws : MillScrews, optional
        Ball screws of some axes.

    Raises
    ------
    ValueError
        If a sensor fault is malformed.
    """

    def __init__(
        self,
        config: SimulatedMachineConfig | SimulatedBodyConfig,
        screws: MillScrews | None = None,
    ) -> None:
        self._config = config
        faults = [parse_sensor_fault(text) for text in config.sensor_faults]
        self._screws = screws
        of_screws = screws.sensors if screws is not None else ()
        self._faults = tuple(fault for fault in faults if fault.sensor not in of_screws)
        self._screw_faults = tuple(fault for fault in faults if fault.sensor in of_screws)
        sensor = (*MILL_SENSORS, *of_screws)
        wanted = config.sensors or sensor
        unknown = [name for name in wanted if name not in sensor]
        if unknown or len(set(wanted)) != len(wanted):
            raise ValueError(
                f'sensors: expected some of {sensor[0]} to {sensor[-1]}, each once, but found '
                f'{", ".join(unknown or wanted)}'
            )
        self._sensor = wanted
        self._columns = [sensor.index(name) for name in wanted]
        self.axes = MILL_AXES if screws is None else screws.with_axes(MILL_AXES)
        """Axes that are measured, and take offsets."""
        self._mill: ThermalMill

    def begin(self, duty: Duty, run: int = 0) -> None:
        """Set the mill up, cold, in the surroundings of a duty."""
        seed = self._config.seed + RUN_SEED_STEP * run
        self._mill = duty.mill(seed=seed, faults=self._faults)
        if self._screws is not None:
            self._screws.begin(self._mill.ambient(0.0), seed, self._screw_faults)

    def advance(self, period: float, spindle_speed: float) -> None:
        """Move on by a period [s] at a spindle speed [rad/s]."""
        self._mill.advance(period, spindle_speed)

    def readings(
        self,
        stamp: int,
        since: int,
        frame_id: str,
        workpiece: str,
        offset: Callable[[Floats], Floats] | None = None,
    ) -> Iterator[Emission]:
        """Yield what is measured at a stamp.

        Parameters
        ----------
        stamp, since : int
            Machine time, and time since the duty began [ns].
        frame_id, workpiece : str
            Frames of the machine and of the workpiece.
        offset : callable, optional
            Offsets in force [m] of positions of the axes [m], which move the tool too; left out,
            a displacement is that of the bare machine.
        """
        interval = nanoseconds(self._config.displacement_interval)
        if since % interval < nanoseconds(self._config.tick_period):
            yield Emission('displacement', self._displacement(stamp, workpiece, offset))
        reading = self._mill.read()
        if self._screws is not None:
            reading = np.concatenate([reading, self._screws.read()])
        reading = reading[self._columns]
        yield Emission(
            'sensor_readings',
            Temperatures(
                stamp=stamp,
                frame_id=frame_id,
                sensor=self._sensor,
                temperature=reading,
                status=np.where(np.isfinite(reading), 0, 1).astype(np.uint8),
                readings=1,
            ),
        )

    def _displacement(
        self, stamp: int, workpiece: str, offset: Callable[[Floats], Floats] | None
    ) -> Displacement:
        noise = self._config.displacement_noise
        if self._screws is None:
            axis, position = self.axes, np.full(len(self.axes), np.nan)
            measured = self._mill.measure_displacement(noise=noise)
            channel = axis
        else:
            axis, position = self._screws.places(self.axes)
            channel = place_channels(axis, position)
            bare = dict(zip(MILL_AXES, self._mill.displacement().tolist(), strict=True))
            measured = np.array([bare.get(name, 0.0) for name in axis])
            measured = measured + self._screws.error(axis, position)
            measured = measured + self._screws.displacement_noise(noise, len(axis))
        if offset is not None:
            where = {name: np.full(len(self.axes), np.nan) for name in axis}
            found = []
            for name, place in zip(axis, position.tolist(), strict=True):
                number = self.axes.index(name)
                where[name][number] = place
                found.append(offset(where[name])[number])
            measured = measured + np.array(found)
        return Displacement(
            stamp=stamp,
            frame_id=workpiece,
            axis=axis,
            channel=channel,
            displacement=measured,
            standard_deviation=np.full(len(axis), noise),
            includes_compensation=offset is not None,
            position=position,
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
        If a sensor fault or a screw is malformed.
    """

    def __init__(self, config: SimulatedMachineConfig) -> None:
        screws = None
        if config.screws:
            screws = MillScrews(
                screw_configs(config.screws, config.screw_data),
                screw_faults(config.screw_faults, config.screws),
                config.displacement_positions,
            )
        elif config.screw_data or config.screw_faults:
            raise ValueError(
                'screws: expected the axes that screw_data and screw_faults are about but found '
                'none; name them, as Y:fixed_free'
            )
        super().__init__(config, screws)
        self.offsets = OffsetInput(
            self.axes,
            OffsetInputConfig(
                offset_max=config.offset_max,
                slew_max=config.slew_max,
                slope_max=config.slope_max,
                validity_max=config.validity_max,
            ),
        )
        self.spindle_speed = 0.0

    @property
    def working(self) -> bool:
        """True while the spindle turns or axes are moved by a duty."""
        return bool(self.spindle_speed or (self._screws is not None and self._screws.moving))

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

    def move(self, period: float, strokes: Mapping[str, Stroke], since: float) -> None:
        """Let axes move for a period [s] by strokes that were begun a while ago [s]."""
        if self._screws is not None:
            self._screws.move(period, strokes, since)

    def advance(self, period: float, spindle_speed: float) -> None:
        """Move on by a period [s] at a spindle speed [rad/s]."""
        self.spindle_speed = spindle_speed
        super().advance(period, spindle_speed)
        if self._screws is not None:
            self._screws.advance(period, self._mill.ambient)

    def follow(self, stamp: int, axis: Names, reference: Floats) -> None:
        """Move the offsets on to a stamp [ns], where axes are told to be at positions [m]."""
        if self._screws is None:
            self.offsets.advance(stamp)
            return
        told = self.where(axis, reference)
        known = dict(zip(told['axis'], told['position'].tolist(), strict=True))
        self.offsets.advance(stamp, [known.get(name, np.nan) for name in self.axes])

    def where(self, axis: Names, reference: Floats) -> dict[str, Any]:
        """Return axes, positions and motion as `machine_state` tells them.

        Parameters
        ----------
        axis : tuple of str
            Axes that are controlled.
        reference : ndarray, shape (len(axis),)
            Where these are told to be [m]; one that a duty moves is where that has it.
        """
        if self._screws is None:
            return {'axis': axis, 'position': reference}
        known = self._screws.position | dict(zip(axis, reference.tolist(), strict=True))
        moved = {name for name, (way, *_) in self._screws.motion.items() if way}
        known |= {name: self._screws.position[name] for name in moved}
        names = self._screws.with_axes(axis)
        nothing = np.full(len(MOTION_FIELDS), np.nan)
        motion = np.array([self._screws.motion.get(name, nothing) for name in names])
        return {
            'axis': names,
            'position': np.array([known[name] for name in names]),
            **dict(zip(MOTION_FIELDS, motion.T, strict=True)),
        }

    def applied(self, stamp: int, frame_id: str, refusal: str) -> Emission:
        """Return the offsets in force at a stamp [ns], and why others are refused, if they are."""
        applied = CompensationApplied(
            stamp=stamp,
            frame_id=frame_id,
            epoch=self.offsets.epoch,
            status=int(self.offsets.status),
            reason=refusal or self.offsets.reason,
            axis=self.axes,
            offset=self.offsets.applied,
            at_limit=self.offsets.at_limit,
            slope=self.offsets.slope,
            position=self.offsets.position,
        )
        return Emission('compensation_applied', applied)

    def health(self) -> Health:
        """Report the offsets in force and why a command was refused."""
        values = {
            f'offset {axis} [um]': f'{1e6 * offset:.2f}'
            for axis, offset in zip(self.axes, self.offsets.applied, strict=True)
        }
        if self.offsets.released:
            return Health('compensation', Level.OK, 'at zero, as commanded last', values)
        level = Level.WARN if self.offsets.reason else Level.OK
        text = self.offsets.reason or self.offsets.status.name.lower()
        return Health('compensation', level, text, values)

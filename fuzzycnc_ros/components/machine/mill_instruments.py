# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The heat of the simulated mill, and the instruments that read it."""

from collections.abc import Iterator
from typing import Protocol

import numpy as np

from fuzzycnc_ros.runtime.component import Emission
from fuzzycnc_ros.runtime.records import Displacement, Floats, Temperatures, nanoseconds
from fuzzycnc_ros.simulation.thermal.duties import Duty
from fuzzycnc_ros.simulation.thermal.mill import (
    DISPLACEMENT_NOISE,
    MILL_AXES,
    MILL_SENSORS,
    ThermalMill,
)
from fuzzycnc_ros.simulation.thermal.sensor_faults import parse_sensor_fault

RUN_SEED_STEP = 1000
"""What the seed goes up by from one duty to the next."""


class InstrumentConfig(Protocol):
    """Parameters that instruments need, of whichever node reads them."""

    @property
    def seed(self) -> int:
        """Seed of all measuring noise."""

    @property
    def tick_period(self) -> float:
        """Machine time between two sets of readings [s]."""

    @property
    def displacement_interval(self) -> float:
        """Machine time between two displacement measurements [s]."""

    @property
    def sensor_faults(self) -> tuple[str, ...]:
        """Sensor faults as sensor:kind:start[:value]."""


class MillInstruments:
    """Moves temperatures on, and measures them and what they do to the tool.

    Parameters
    ----------
    config : InstrumentConfig
        Parameters of the node.

    Raises
    ------
    ValueError
        If a sensor fault is malformed.
    """

    def __init__(self, config: InstrumentConfig) -> None:
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
            measured = self._mill.measure_displacement()
            yield Emission(
                'displacement',
                Displacement(
                    stamp=stamp,
                    frame_id=workpiece,
                    axis=MILL_AXES,
                    channel=MILL_AXES,
                    displacement=measured if offset is None else measured + offset,
                    standard_deviation=np.full(len(MILL_AXES), DISPLACEMENT_NOISE),
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

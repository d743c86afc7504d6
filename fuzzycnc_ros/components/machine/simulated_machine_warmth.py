# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The warm half of the simulated machine: what heat does to it, and the offsets against that."""

from collections.abc import Iterator

from fuzzycnc_ros.components.machine.mill_instruments import MillInstruments
from fuzzycnc_ros.components.machine.simulated_machine_config import SimulatedMachineConfig
from fuzzycnc_ros.core.inputs.offset_input import OffsetInput, OffsetInputConfig
from fuzzycnc_ros.runtime.component import Emission, Health, Level
from fuzzycnc_ros.runtime.records import Compensation, CompensationApplied
from fuzzycnc_ros.simulation.thermal.duties import Duty
from fuzzycnc_ros.simulation.thermal.mill import MILL_AXES


class Warmth:
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
        self._instruments = MillInstruments(config)
        self.offsets = OffsetInput(
            MILL_AXES,
            OffsetInputConfig(
                offset_max=config.offset_max,
                slew_max=config.slew_max,
                validity_max=config.validity_max,
            ),
        )
        self.spindle_speed = 0.0

    def begin(self, duty: Duty, run: int) -> None:
        """Set the machine up, cold, for a duty."""
        self._instruments.begin(duty, run)

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

    def advance(self, stamp: int, period: float, spindle_speed: float) -> None:
        """Move on to a stamp [ns], by a period [s] at a spindle speed [rad/s]."""
        self.spindle_speed = spindle_speed
        self._instruments.advance(period, spindle_speed)
        self.offsets.advance(stamp)

    def readings(
        self, stamp: int, since: int, frame_id: str, workpiece: str, refusal: str
    ) -> Iterator[Emission]:
        """Yield what is measured at a stamp.

        Parameters
        ----------
        stamp, since : int
            Machine time, and time since the duty began [ns].
        frame_id, workpiece : str
            Frames of the machine and of the workpiece.
        refusal : str
            Why offsets are refused; empty if they are not.
        """
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
        yield Emission('compensation_applied', applied)
        yield from self._instruments.readings(stamp, since, frame_id, workpiece)

    def health(self) -> Health:
        """Report the offsets in force and why a command was refused."""
        values = {
            f'offset {axis} [um]': f'{1e6 * offset:.2f}'
            for axis, offset in zip(MILL_AXES, self.offsets.applied, strict=True)
        }
        level = Level.WARN if self.offsets.reason else Level.OK
        text = self.offsets.reason or self.offsets.status.name.lower()
        return Health('compensation', level, text, values)

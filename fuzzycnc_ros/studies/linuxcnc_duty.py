# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""A duty on a real controller whose machine is simulated: its part program, what came of it."""

from dataclasses import replace
from math import pi
from typing import Any

from fuzzycnc_ros.runtime.records import Displacement, ThermalReference
from fuzzycnc_ros.simulation.thermal.duties import Duty
from fuzzycnc_ros.studies.shift.shift_log import ShiftLog, offsets_of

RADIUS = 10.0
"""Radius of the circles [mm]."""
FEED = 3000.0
"""About how fast they are cut [mm/min]."""


def duty_program(duty: Duty, rate: float) -> str:
    """Return a part program that cuts circles and turns the spindle as a duty does.

    Parameters
    ----------
    duty : Duty
        Its blocks are cut one after the other.
    rate : float
        How much faster machine time passes than that of the controller.

    Returns
    -------
    str
        G-code in mm.  The feed of each block is such that whole circles last as long as it does.
    """
    lap = 2.0 * pi * RADIUS
    lines = ['G21 G90 G94 G17 G64 P0.01', f'G0 X{RADIUS:g} Y0']
    for number, block in enumerate(duty.blocks, start=1):
        duration = block.duration / rate / 60.0
        laps = max(round(duration * FEED / lap), 1)
        speed = round(block.spindle_speed * 60.0 / (2.0 * pi))
        lines += [
            f'S{speed} M3' if speed else 'M5',
            f'F{laps * lap / duration:.3f}',
            f'o{number} repeat [{laps}]',
            f'G2 X{RADIUS:g} Y0 I-{RADIUS:g} J0',
            f'o{number} endrepeat',
        ]
    return '\n'.join([*lines, 'M5', 'M2', ''])


class ClosedLoopLog(ShiftLog):
    """The log of a duty whose displacements include the offsets that the controller applies.

    Displacements are those of the bare machine, as in every other log: what the read-back told at
    their time is taken off.  Beside the offsets in force they give what was measured again.
    """

    def records(self, topic: str, start: int = 0, stop: int | None = None) -> list[Any]:
        """Return the records of a topic with `start` < stamp <= `stop` [ns]."""
        found = super().records(topic, start, stop)
        return self._bare(found) if topic == 'displacement' else found

    def spans(self) -> list[tuple[int, int]]:
        """Return from when to when it was run: from its thermal reference on [ns]."""
        references: list[ThermalReference] = self.records('thermal_reference')
        moved: list[Displacement] = super().records('displacement')
        return [(references[0].cold_since, moved[-1].stamp)] if references and moved else []

    def _bare(self, moved: list[Displacement]) -> list[Displacement]:
        applied = super().records('compensation_applied')
        if not moved or not applied:
            return moved
        offsets = offsets_of(moved, applied, moved[0].axis)
        return [
            replace(item, displacement=item.displacement - offset, includes_compensation=False)
            if item.includes_compensation
            else item
            for item, offset in zip(moved, offsets, strict=True)
        ]

# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The plant that simulates an axis of a machine file."""

from dataclasses import fields, replace
from typing import Any

from fuzzycnc_ros.core.machine.axis_models import LatheAxisConfig
from fuzzycnc_ros.core.machine.machine_data import AxisData
from fuzzycnc_ros.simulation.servo.axis_plant import AxisPlant
from fuzzycnc_ros.simulation.servo.ballscrew_axis import BallscrewAxis
from fuzzycnc_ros.simulation.servo.lathe_axis import LatheAxis


def simulated_axis(data: AxisData, **changes: Any) -> AxisPlant:
    """Return an axis as a simulated plant.

    Parameters
    ----------
    data : AxisData
        The axis.
    **changes
        What differs from the plant's parameters, faults among them: `load=0.1`.

    Raises
    ------
    ValueError
        If the data have no plant, or a change is unknown or out of its bounds.
    """
    known = data.known_plant()
    names = {item.name for item in fields(known)}
    for name in changes:
        if name not in names:
            raise ValueError(
                f'{name}: expected a parameter of the model {data.model}: '
                f'{", ".join(sorted(names))}'
            )
    plant = replace(known, **changes)
    return LatheAxis(plant) if isinstance(plant, LatheAxisConfig) else BallscrewAxis(plant)

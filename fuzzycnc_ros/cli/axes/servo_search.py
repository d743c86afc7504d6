# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""What is said beside settings and rules that `fuzzycnc servo` found."""

from fuzzycnc_ros.core.servo.stability import spectral_radii
from fuzzycnc_ros.core.servo.variable_universe import VariableUniverseController
from fuzzycnc_ros.simulation.servo.axes import LatheAxis
from fuzzycnc_ros.simulation.servo.positioning import position_many
from fuzzycnc_ros.simulation.servo.tuning import (
    GAIN_SPREAD,
    move_costs,
    production,
    swing_cost,
    tuning_moves,
)


def swinging(controller: VariableUniverseController) -> list[str]:
    """Return at what gains of half to one and a half times nominal a loop swings."""
    return [
        f"note: at x{gain:g} of the axis' gain the loop swings, spectral radius {size:.5f}; "
        'friction may hide it in a move'
        for gain, size in spectral_radii(controller, GAIN_SPREAD).items()
        if size >= 1.0
    ]


def default_cost() -> float:
    """Return what the default settings cost on the moves of the search."""
    moves, axis = tuning_moves(), LatheAxis().linear()
    batch = position_many([production(axis, {}) for _ in moves], moves, 1.5)
    return float(move_costs(batch).sum()) + swing_cost(production(axis, {}), 1.5)

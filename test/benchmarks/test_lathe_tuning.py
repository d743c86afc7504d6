# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Costs of the search by which the settings of the lathe axis were found."""

from importlib import import_module
from pathlib import Path

import pytest

from fuzzycnc_ros.core.machine.axis_models import LatheAxisConfig
from fuzzycnc_ros.core.servo.pid_cascade import PidController
from fuzzycnc_ros.core.servo.stability import spectral_radii
from fuzzycnc_ros.core.servo.variable_universe import VariableUniverseController
from fuzzycnc_ros.simulation.servo.lathe_axes import LatheMove
from fuzzycnc_ros.simulation.servo.positioning import position_many

AXIS = LatheAxisConfig().linear()


@pytest.fixture(scope='module')
def lathe():
    """The benchmark's module."""
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(Path(__file__).parents[2] / 'benchmarks'))
        yield import_module('lathe_tuning')


def test_cost_puts_moves_that_fail_last(lathe):
    moves = [
        LatheMove(LatheAxisConfig(), 2e-3),
        LatheMove(LatheAxisConfig(), 0.15),
        LatheMove(LatheAxisConfig(direction=-1.0), 2e-3),
    ]
    controllers = [VariableUniverseController(AXIS) for _ in moves]
    good, late, away = lathe.move_costs(position_many(controllers, moves, 0.5))
    assert good < 0.6 < late < away


def test_tuning_covers_the_spread_of_the_gain(lathe):
    factors = {move.config.gain_factor for move in lathe.tuning_moves()}
    assert min(factors) == 0.5
    assert max(factors) == 1.5


SHARP = {'error_floor': 0.025744, 'error_exponent': 0.56426}
"""Settings whose loop swings at x1.5 of the axis' gain, which friction hides."""


def test_a_gain_at_which_the_loop_swings_costs_as_much_as_a_move_that_does_not_settle(lathe):
    assert lathe.swing_cost(lathe.production(AXIS, {})) == 0.0
    sharp = lathe.production(AXIS, SHARP)
    radii = spectral_radii(sharp, lathe.GAIN_SPREAD)
    assert [gain for gain, radius in radii.items() if radius >= 1.0] == [1.5]
    assert lathe.swing_cost(sharp) == pytest.approx(3.0 + 100.0 * (radii[1.5] - 1.0))
    assert lathe.swing_cost(PidController(AXIS)) == 0.0  # by its moves alone

# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""One axis that is led along a path."""

import pytest

from fuzzycnc_ros.components.servo.servo_axis import ServoAxis
from fuzzycnc_ros.core.servo.built_in import built_in_controller
from fuzzycnc_ros.simulation.servo.axes import BallscrewAxis

PLACE, STEPS = 0.034925, 1500


@pytest.mark.parametrize('rounding', [1e-13, -1e-13])
def test_an_axis_that_rests_while_others_move_stays_where_it_is(rounding):
    plant = BallscrewAxis()
    axis = ServoAxis('X', built_in_controller('ballscrew', 'variable_universe'), (-0.3, 0.3))
    axis.step(plant.measure())
    for step in range(STEPS):  # there at 50 mm/s
        plant.drive(axis.step(plant.measure()))
        place = min(5e-5 * step, PLACE)
        axis.lead(place, 0.05 if place < PLACE else 0.0, 0.0)
    places = []
    for step in range(STEPS):
        plant.drive(axis.step(plant.measure()))
        axis.lead(PLACE + (step % 2) * 1e-17, rounding, 0.0)
        places.append(plant.position)
    assert max(places) - min(places) < 2e-6  # 50 um where the rounding is taken for motion
    assert axis.velocity == 0.0

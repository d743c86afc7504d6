# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The decisions of the relief from stick-slip, on readings made by hand."""

import pytest

from fuzzycnc_ros.core.servo.stick_slip import StickSlipParams, StickSlipRelief

PERIOD = 1e-3
PARAMS = StickSlipParams(patience=10.0)
OFF = 20e-6
"""Error of a stuck axis [m]: to be dithered, but for the patience."""


class Stuck:
    """An axis that stands where it is put, while its controller winds up."""

    def __init__(self, params=PARAMS):
        self.relief = StickSlipRelief(params, PERIOD)
        self.last = self.wound = 0.0

    def stand(self, position, steps, rise):
        """Stay at a position [m] while the controller's duty rises by `rise` a period."""
        states = []
        for _ in range(steps):
            self.wound += rise
            self.last = self.relief.duty(0.0, position, self.wound, self.last)
            states.append(self.relief.state)
        return states


def test_axis_that_slipped_to_the_other_side_is_dithered_at_once():
    axis = Stuck()
    axis.stand(0.0, 2, 0.0)
    assert 'dithering' not in axis.stand(-OFF, 400, 1e-3)
    assert 'dithering' in axis.stand(OFF, 400, -1e-3)


@pytest.mark.parametrize('rise', [1e-3, -1e-3])
def test_axis_that_is_stuck_twice_on_one_side_waits(rise):
    """It may still creep to its target: only a slip past the target proves hunting."""
    axis = Stuck()
    axis.stand(0.0, 2, 0.0)
    assert 'dithering' not in axis.stand(OFF, 400, rise)
    assert 'dithering' not in axis.stand(1.5 * OFF, 400, rise)


def test_axis_that_was_stuck_near_enough_has_been_on_no_side():
    """Held on target, let go, stuck off it: that is the first time it is stuck off target."""
    axis = Stuck()
    axis.stand(OFF, 2, 0.0)
    assert axis.stand(-0.5e-6, 400, 1e-3)[-1] == 'holding'
    assert 'dithering' not in axis.stand(OFF, 400, -1e-3)


def test_axis_that_moved_away_and_back_is_judged_anew():
    axis = Stuck()
    axis.stand(OFF, 2, 0.0)
    assert axis.stand(0.0, 400, 1e-3)[-1] == 'holding'
    axis.relief.release()
    assert axis.stand(0.0, 1, 0.0) == ['']
    assert axis.last == axis.wound, 'the controller has it'


def test_patience_ends_without_a_slip():
    axis = Stuck(StickSlipParams(patience=0.1))
    axis.stand(0.0, 2, 0.0)
    states = axis.stand(OFF, 400, 1e-3)
    begin = states.index('dithering')
    assert 90 <= begin <= 110


def test_axis_far_off_is_left_to_its_controller():
    axis = Stuck(StickSlipParams(patience=0.1))
    axis.stand(0.0, 2, 0.0)
    assert set(axis.stand(2.0 * PARAMS.zone, 400, 1e-3)) == {''}


def test_without_a_change_of_duty_nothing_is_judged():
    axis = Stuck(StickSlipParams(patience=0.1))
    axis.stand(0.0, 2, 0.0)
    assert set(axis.stand(OFF, 400, 0.0)) == {''}

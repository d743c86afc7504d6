# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""An oscillation that grows is found, with frequency and rate; what a reference does is none."""

from dataclasses import replace

import numpy as np
import pytest
from two_mass_axis import TwoMassAxis, TwoMassConfig

from fuzzycnc_ros.core.machine.axis_models import BallscrewAxisConfig
from fuzzycnc_ros.core.machine.machine_data import AxisData, AxisLimits
from fuzzycnc_ros.core.servo.axis_control import make_axis_controller
from fuzzycnc_ros.core.servo.growing_swing import GrowingSwing
from fuzzycnc_ros.core.servo.profile import ProfileLimits, point_to_point
from fuzzycnc_ros.simulation.servo.axes import BallscrewAxis
from fuzzycnc_ros.simulation.servo.positioning import position

PERIOD = 1e-3
TIME = PERIOD * np.arange(3000)


def watched(errors, references=None, least=1e-6):
    swing, found = GrowingSwing(PERIOD, least), False
    for error, place in zip(errors, 0.0 * TIME if references is None else references, strict=True):
        swing.add(float(error), float(place))
        found = found or swing.grows
    return swing, found


@pytest.mark.parametrize(
    ('frequency', 'rate'), [(4.0, 3.0), (25.0, 3.0), (25.0, 12.0), (90.0, 12.0)]
)
def test_frequency_and_rate_of_a_swing_that_grows(frequency, rate):
    last = min(3.0, np.log(1e5) / rate)
    kept = TIME[TIME < last]
    swing = GrowingSwing(PERIOD, 1e-6)
    for time in kept:
        error = 1e-6 * np.exp(rate * time) * np.sin(2.0 * np.pi * frequency * time)
        swing.add(float(error), 0.0)
        if swing.grows and abs(error) > 1e-5:
            break
    assert swing.grows
    assert swing.frequency == pytest.approx(frequency, rel=0.25)
    assert swing.rate == pytest.approx(rate, rel=0.35)


@pytest.mark.parametrize('rate', [0.0, -5.0])
def test_a_swing_that_does_not_grow_is_none(rate):
    errors = 1e-4 * np.exp(rate * TIME) * np.sin(150.0 * TIME)
    assert not watched(errors)[1]


def test_noise_is_no_swing():
    draw = np.random.default_rng(0)
    assert not watched(1e-4 * draw.standard_normal(len(TIME)), least=1e-3)[1]


def test_what_the_reference_does_back_and_forth_is_no_swing():
    course = 1e-2 * TIME * np.sin(20.0 * TIME)
    assert not watched(0.1 * course, course)[1]


STRONG = BallscrewAxisConfig(delay=2e-3, count=1e-6)


def moved(name, factor, *, vertical=False, estimator=3.0):
    """Move an axis that is stronger by a factor than its controller knows."""
    data = AxisData(limits=AxisLimits(vertical=vertical), plant=STRONG)
    controller = make_axis_controller(data, name, {'bandwidth': 2.0, 'estimator': estimator})
    limits = ProfileLimits(velocity=0.2, acceleration=1.0, jerk=20.0)
    way = point_to_point(0.0, 0.05, limits).sample(PERIOD)
    plant = BallscrewAxis(replace(STRONG, gain_factor=factor))
    return controller, position(controller, plant, way, 2.0)


@pytest.mark.parametrize(('name', 'factor'), [('cascade', 1.8), ('variable_universe', 2.0)])
def test_gain_is_taken_back_before_a_fault(name, factor):
    controller, run = moved(name, factor)
    assert controller.taken_back
    assert not run.fault
    assert np.abs(run.error[-300:]).max() < 5e-6
    controller.reset(0.0)
    assert not controller.taken_back


def test_a_loop_that_is_stable_keeps_its_gain():
    controller, run = moved('pid', 1.0)
    assert not controller.taken_back
    assert not run.fault


@pytest.mark.parametrize('change', [{'vertical': True, 'estimator': 1.0}, {'estimator': 3.0}])
def test_a_vertical_axis_and_one_that_less_gain_makes_unstable_stop_instead(change):
    """With an integral that is fast for its bandwidth half of the gain swings by itself."""
    controller, run = moved('pid', 3.0, **change)
    assert not controller.taken_back
    assert 'unstable' in run.fault
    assert run.duty[-1] == 0.0


def test_an_unstable_loop_is_named_as_one():
    """A gantry of 25 Hz under a loop that does not know it; before: counts were lost."""
    truth = TwoMassConfig(
        motor=20.0, slide=60.0, resonance=25.0, spring_damping=0.03, force=480.0, viscous=140.0,
        coulomb=40.0, breakaway=50.0, backlash=4e-5, delay=2e-3, count=5e-6,
    )  # fmt: skip
    known = AxisData(
        limits=AxisLimits(travel_low=-1.0, travel_high=1.0),
        plant=BallscrewAxisConfig(
            mass=80.0, viscous_forward=140.0, viscous_backward=140.0, coulomb_forward=40.0,
            coulomb_backward=40.0, force_constant=48.0, delay=2e-3, count=5e-6,
        ),
    )  # fmt: skip
    limits = ProfileLimits(velocity=0.3, acceleration=1.5, jerk=20.0)
    way = point_to_point(0.0, 0.05, limits).sample(PERIOD)
    run = position(
        make_axis_controller(known, 'cascade', {'bandwidth': 0.5}), TwoMassAxis(truth), way, 1.0
    )
    assert 'unstable' in run.fault
    frequency = float(run.fault.partition('(')[2].partition(' Hz')[0])
    assert 20.0 < frequency < 40.0

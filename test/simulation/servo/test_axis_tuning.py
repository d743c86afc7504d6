# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""What controllers of an axis are tuned on and judged by: pulses of load are part of it."""

import pytest

from fuzzycnc_ros.core.identify.robustness import AxisModels
from fuzzycnc_ros.core.machine.axis_models import BallscrewAxisConfig
from fuzzycnc_ros.core.machine.knowledge import AxisKnowledge
from fuzzycnc_ros.core.machine.machine_data import AxisData
from fuzzycnc_ros.machine_file.reader import read_machine_file
from fuzzycnc_ros.simulation.servo.axis_tuning import (
    axis_cases,
    cases_cost,
    comes_to_rest,
    judged_controller,
    nominal_judge,
    untold_controller,
)


@pytest.fixture(scope='module')
def data():
    return read_machine_file('ballscrew').axes['X']


@pytest.mark.parametrize('held_out', [False, True])
def test_loads_come_as_steps_and_as_pulses_that_the_axis_bears(data, held_out):
    cases = axis_cases(data, held_out=held_out)
    assert any(case.load for case in cases)
    assert sum(bool(case.pulse) for case in cases) >= 2
    for case in cases:
        assert abs(case.load) + abs(case.pulse) <= data.limits.load * min(case.gain, 1.0)


def test_nothing_is_judged_by_what_it_was_tuned_on(data):
    tuned, judged = (axis_cases(data, held_out=held_out) for held_out in (False, True))
    assert not {case.way for case in tuned} & {case.way for case in judged}
    assert not {case.seed for case in tuned} & {case.seed for case in judged}


def test_a_soft_loop_gives_way_to_pulses(data):
    pulsed = [bool(case.pulse) for case in axis_cases(data, held_out=True)]
    stiff, soft = (
        judged_controller(data, 'pid', settings)
        for settings in (data.settings, {**data.settings, 'bandwidth': 0.5})
    )
    assert not stiff.faults
    for mine, its, pulse in zip(stiff.held_out, soft.held_out, pulsed, strict=True):
        if pulse:
            assert its.largest > 4.0 * mine.largest


def test_the_pulses_act_on_the_axis(data):
    """Pulses of the whole load move it several times as far as small ones."""
    small, *_, whole = judged_controller(data, 'pid', data.settings).held_out[-3:]
    assert whole.largest > 3.0 * small.largest


def test_a_loop_that_saves_itself_by_less_gain_is_none_to_choose(data):
    """At twice the gain it swings until it takes gain back, and leaves 3 um in that case."""
    swings, holds = (
        untold_controller(
            data, 'cascade', {'bandwidth': width, 'damping': damping, 'estimator': 5}
        )
        for width, damping in ((2.0, 2.0), (0.6, 0.8))
    )
    twice = [case for case in axis_cases(data) if case.gain == 2.0]
    assert cases_cost(data, swings, twice) > 1.0 > 1e-3 > cases_cost(data, holds, twice)
    judge = nominal_judge(data)
    assert judge(swings)[0] > 0.0 == judge(holds)[0]
    assert judge(untold_controller(data, 'pid', data.settings))[1] < judge(holds)[1]


def test_a_loop_that_a_jump_keeps_swinging_is_none_to_choose():
    """As identified of a light vertical axis: stable where it is linear, at every gain.

    At half the gain a jump of 1 mm leaves its duty swinging from end to end.
    """
    plant = BallscrewAxisConfig(
        mass=1.0, viscous_forward=9.0, viscous_backward=9.0, coulomb_forward=0.36,
        coulomb_backward=0.36, offset=1.36, force_constant=1.59, count=1.1e-7, delay=1e-3,
        mode=71.7, mode_damping=0.2, mode_ratio=0.05,
    )  # fmt: skip
    known = AxisKnowledge(known_to=144.0, mode_low=67.0, mode_high=83.0, damping_low=0.12)
    data = AxisData(plant=plant, knowledge=known)
    swings = {'bandwidth': 1.32, 'damping': 0.5, 'estimator': 2.39}
    margin = AxisModels(data).margin(untold_controller(data, 'variable_universe', swings))
    assert margin.robust
    assert not comes_to_rest(data, 'variable_universe', swings)
    calm = {'bandwidth': 0.6, 'damping': 0.8, 'estimator': 1.2}
    assert comes_to_rest(data, 'cascade', calm)

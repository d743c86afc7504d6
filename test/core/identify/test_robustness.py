# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Margins over all that an identified axis may be: two ways to a response, and what is refused."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fuzzycnc_ros.core.identify.robustness import AxisModels, sampled
from fuzzycnc_ros.core.machine.axis_models import BallscrewAxisConfig
from fuzzycnc_ros.core.machine.knowledge import AxisKnowledge, remainder_text
from fuzzycnc_ros.core.machine.machine_data import AxisData, axis_texts, parse_axis_texts
from fuzzycnc_ros.core.servo.axis_control import make_axis_controller, untuned_settings
from fuzzycnc_ros.simulation.servo.axes import BallscrewAxis

FREE = BallscrewAxisConfig(
    count=0.0, coulomb_forward=0.0, coulomb_backward=0.0, offset=0.0, mass=40.0,
    viscous_forward=300.0, viscous_backward=300.0,
)  # fmt: skip
KNOWN = AxisKnowledge(known_to=150.0, mode_low=400.0, delay_low=1e-3, remainder='10:0.05 150:0.1')


@pytest.mark.parametrize('delay', [0.0, 4e-4, 1e-3, 2.7e-3])
@pytest.mark.parametrize(('mode', 'ratio'), [(0.0, 1.0), (30.0, 0.0), (30.0, 2.5)])
def test_the_sampled_model_moves_as_the_simulation_does(delay, mode, ratio):
    config = replace(FREE, delay=delay, mode=mode, mode_ratio=ratio, mode_damping=0.08)
    plant, model = BallscrewAxis(config), sampled(config)
    state, duties = np.zeros(len(model.duty)), 0.1 * np.random.default_rng(0).standard_normal(200)
    apart = []
    for duty in duties:
        apart.append(plant.position - state @ model.reading)
        plant.drive(float(duty))
        state = model.dynamics @ state + model.duty * duty
    size = np.ptp([plant.position, *(1e-9,)]) + 1e-6
    # a part of a period of dead time is a mean of two duties in the simulation
    assert np.abs(apart).max() < (0.05 if mode or delay % 1e-3 else 1e-6) * size + 1e-7


def test_a_slow_loop_has_margin_and_a_fast_one_has_none():
    data = AxisData(plant=replace(FREE, delay=2e-3), knowledge=KNOWN)
    models = AxisModels(data)
    slow = models.margin(make_axis_controller(data, 'cascade', {'bandwidth': 0.5}))
    fast = models.margin(make_axis_controller(data, 'cascade', {'bandwidth': 8.0}))
    assert slow.robust
    assert slow.shortfall == 0.0
    assert not fast.robust
    assert fast.shortfall > 0.0
    assert 0.0 < slow.crossover < fast.crossover
    assert slow.yielding > fast.yielding


def test_the_longest_dead_time_counts():
    """What is unknown has its safe end: the same loop, with the interval's upper end moved."""
    settings = {'bandwidth': 1.5, 'damping': 1.0}
    plain = AxisData(plant=replace(FREE, delay=1e-3), knowledge=KNOWN)
    controller = make_axis_controller(plain, 'pid', settings | {'estimator': 0.3})
    late = replace(plain, plant=replace(FREE, delay=6e-3))
    assert AxisModels(plain).margin(controller).robust
    assert not AxisModels(late).margin(controller).robust


def test_a_loop_that_holds_no_position_is_not_robust():
    """An axis that answers by its speed is fed forward, and drifts off beside its set points."""
    slow = replace(FREE, viscous_forward=4e3, viscous_backward=4e3, delay=0.045)
    data = AxisData(plant=slow, knowledge=replace(KNOWN, delay_low=0.0))
    settings = {'bandwidth': 0.01, 'damping': 1.0, 'estimator': 0.3}
    margin = AxisModels(data).margin(make_axis_controller(data, 'pid', settings))
    assert margin.distance > 0.5
    assert margin.radius < 1.0
    assert margin.crossover == 0.0
    assert not margin.robust
    assert margin.shortfall > 0.0


def test_models_that_rub_differently_answer_alike_where_that_is_known():
    plant = replace(FREE, viscous_forward=3e4, viscous_backward=3e4)
    known = replace(KNOWN, gain_low=0.9, gain_high=1.1)
    models = AxisModels(AxisData(plant=plant, knowledge=known))
    z = np.exp(2j * np.pi * 5.0 * models.period)
    sizes = []
    for one in models.samples:
        states = np.linalg.solve(z * np.eye(len(one.duty)) - one.dynamics, one.duty)
        sizes.append(abs(states @ one.reading))
    assert max(sizes) < 1.12 * sizes[0]
    assert min(sizes) > 0.88 * sizes[0]
    assert max(sizes) > 1.1 * min(sizes)


def test_an_unknown_response_bounds_the_loop():
    data = AxisData(plant=replace(FREE, delay=1e-3), knowledge=KNOWN)
    controller = make_axis_controller(
        data, 'pid', {'bandwidth': 1.5, 'damping': 1.0, 'estimator': 0.3}
    )
    assert AxisModels(data).margin(controller).robust
    dark = replace(KNOWN, known_to=8.0, mode_low=12.0, remainder='')
    found = AxisModels(replace(data, knowledge=dark)).margin(controller)
    assert not found.robust
    assert found.frequency > 8.0


def test_an_untuned_loop_stays_below_what_is_unknown():
    known = untuned_settings(AxisData(plant=FREE, knowledge=KNOWN))
    dark = untuned_settings(
        AxisData(plant=FREE, knowledge=replace(KNOWN, known_to=8.0, mode_low=12.0))
    )
    assert dark['bandwidth'] < 0.1 * known['bandwidth']


@given(
    st.lists(st.tuples(st.floats(0.1, 400.0), st.floats(0.0, 900.0)), max_size=8),
    st.sampled_from(['', 'a spring: 51 % of the drive, or more']),
)
def test_knowledge_is_read_as_it_was_written(pairs, why):
    known = replace(KNOWN, remainder=remainder_text(pairs), not_fit_for_control=why)
    axes = {'X': AxisData(plant=FREE, knowledge=known)}
    assert parse_axis_texts('axis_data', axis_texts(axes)) == axes
    assert [share for _, share in known.remainders] == pytest.approx(
        [share for _, share in sorted(pairs)], rel=0.06, abs=1e-9
    ) or len({place for place, _ in pairs}) < len(pairs)


@pytest.mark.parametrize('text', ['10', '10:', ':0.1', 'ten:0.1', '-1:0.1', '10:nan'])
def test_a_remainder_that_is_none_is_refused(text):
    with pytest.raises(ValueError, match='such as 10:0'):
        AxisKnowledge(remainder=text)

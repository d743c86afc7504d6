# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""What the node of the predictor tells of a training while it runs."""

from types import SimpleNamespace

import pytest

pytest.importorskip('rclpy')

from fuzzycnc_ros.nodes.thermal_predictor import TOLD_AT_ONCE, ThermalPredictorNode, Training

pytestmark = pytest.mark.ros


def news_of(*steps):
    """Return what is told of steps that came since the last look."""
    training = Training(goal=None, finished=None)
    for step in steps:
        training.note(*step)
    return training.news()


def test_of_one_candidate_the_newest_step_is_told():
    told = news_of(
        ('fit', 'a', 1, 3), ('fit', 'a', 2, 3), ('fit', 'b', 1, 3), ('judge', 'b', 0, 3)
    )
    assert told == [('fit', 'a', 2, 3), ('fit', 'b', 1, 3), ('judge', 'b', 0, 3)]


def test_the_search_for_sensors_is_one_piece_of_work():
    told = news_of(('select_sensors', 'T1', 1, 9), ('select_sensors', 'T2', 2, 9))
    assert told == [('select_sensors', 'T2', 2, 9)]


def test_what_is_too_much_for_one_look_is_told_at_the_next():
    training = Training(goal=None, finished=None)
    steps = [('fit', str(number), 0, 1) for number in range(TOLD_AT_ONCE + 2)]
    for step in steps:
        training.note(*step)
    assert training.news() == steps[:TOLD_AT_ONCE]
    assert training.news() == steps[TOLD_AT_ONCE:]


def test_a_training_that_was_cancelled_puts_no_model_to_use():
    told = []
    goal = SimpleNamespace(
        is_cancel_requested=True,
        canceled=lambda: told.append('cancelled'),
        abort=lambda: told.append('aborted'),
        succeed=lambda: told.append('succeeded'),
    )
    training = Training(goal=goal, finished=None)
    training.model = SimpleNamespace(to_json=lambda: told.append('used'))
    result = ThermalPredictorNode._finish(None, training, '')
    assert (told, result.success, result.message) == (['cancelled'], False, 'cancelled')
    goal.is_cancel_requested, training.model, training.error = False, None, 'no runs'
    result = ThermalPredictorNode._finish(None, training, '')
    assert (told, result.success, result.message) == (['cancelled', 'aborted'], False, 'no runs')

# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Fades: straight lines in time, no step, resumable."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fuzzycnc_ros.components.thermal.fade import Fade

values = st.floats(-1e3, 1e3)
pieces = st.lists(st.floats(0.1, 40.0), min_size=1, max_size=30)


@pytest.mark.parametrize('bad', [[np.nan], [np.inf, 0.0], 1.0])
def test_values_must_be_a_finite_list(bad):
    with pytest.raises(ValueError, match='value: expected a list of finite numbers'):
        Fade(bad)


def test_refusals_leave_the_move_as_it_was():
    fade = Fade([1.0, 2.0])
    fade.to([3.0, 2.0], 60.0)
    for target, duration, text in (
        ([1.0], 60.0, r'expected shape \(2,\)'),
        ([np.nan, 0.0], 60.0, 'finite'),
        ([0.0, 0.0], 0.0, 'duration: expected a positive number of s, but found 0.0'),
        ([0.0, 0.0], np.inf, 'positive'),
    ):
        with pytest.raises(ValueError, match=text):
            fade.to(target, duration)
    with pytest.raises(ValueError, match='elapsed: expected 0 s or more, but found -1'):
        fade.advance(-1.0)
    with pytest.raises(ValueError, match='state: expected a time left and 4 values'):
        fade.state = [0.0, 1.0]
    np.testing.assert_allclose(fade.advance(30.0), [2.0, 2.0])


@given(values, values, st.floats(1.0, 600.0), pieces)
def test_no_piece_steps_further_than_its_share_of_the_time(start, target, duration, elapsed):
    fade = Fade([start])
    fade.to([target], duration)
    before, time = start, 0.0
    for piece in elapsed:
        now = fade.advance(piece)[0]
        allowed = abs(target - start) * piece / duration
        assert abs(now - before) <= allowed * (1.0 + 1e-9) + 1e-9
        time += piece
        line = start + (target - start) * min(1.0, time / duration)
        assert now == pytest.approx(line, rel=1e-9, abs=1e-9)
        before = now
    fade.advance(duration)
    assert fade.value[0] == target
    assert fade.remaining == 0.0


def test_a_new_target_begins_where_the_values_are():
    fade = Fade([0.0])
    fade.to([10.0], 100.0)
    assert fade.advance(40.0)[0] == pytest.approx(4.0)
    fade.to([0.0], 80.0)
    assert fade.advance(20.0)[0] == pytest.approx(3.0)
    fade.to(fade.value, 80.0)
    assert fade.remaining == 0.0


def test_resumed_fade_ends_as_the_uninterrupted_one():
    fade, other = Fade([1.0, -2.0]), Fade([0.0, 0.0])
    fade.to([5.0, 7.0], 90.0)
    fade.advance(30.0)
    other.state = fade.state
    for piece in (10.0, 25.0, 60.0):
        assert fade.advance(piece).tobytes() == other.advance(piece).tobytes()
    assert other.value.tolist() == [5.0, 7.0]

# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fuzzycnc_ros.core.document import Node
from fuzzycnc_ros.core.thermal.recursions.base import (
    LinearRecursion,
    Stream,
    combine,
    read_recursion,
    run_slices,
    write_recursion,
)
from fuzzycnc_ros.core.thermal.recursions.grey import GreyRecursion, development_of, pole_of


def linear(seed=0, lags=4, inputs=3, channels=2):
    rng = np.random.default_rng(seed)
    return LinearRecursion(
        pole=rng.uniform(0.0, 0.99, lags),
        drive=rng.normal(size=(lags, inputs)),
        readout=rng.normal(size=(channels, lags)) * 1e-6,
        direct=rng.normal(size=(channels, inputs)) * 1e-6,
        offset=rng.normal(size=channels) * 1e-6,
    )


def grey(exact, seed=0, inputs=3, channels=2):
    rng = np.random.default_rng(seed)
    return GreyRecursion(
        a=rng.uniform(0.05, 1.8, channels),
        b=rng.normal(size=(channels, inputs)) * 1e-6,
        initial=rng.normal(size=channels) * 1e-6,
        exact=exact,
    )


RECURSIONS = [linear(), linear(lags=0), grey(True), grey(False)]


def rises(seed=1, samples=120, inputs=3):
    return np.cumsum(np.random.default_rng(seed).normal(0.1, 0.2, (samples, inputs)), axis=0)


@pytest.mark.parametrize('recursion', RECURSIONS)
def test_stream_and_batch_agree(recursion):
    rise = rises()
    batch = recursion.run(rise)
    stream = Stream(recursion)
    steps = np.array([stream.step(sample) for sample in rise])
    assert np.abs(steps - batch).max() <= 1e-12 * np.abs(batch).max()


@pytest.mark.parametrize('recursion', RECURSIONS)
def test_a_stream_resumes_from_its_state(recursion):
    rise = rises()
    first = Stream(recursion)
    for sample in rise[:50]:
        first.step(sample)
    second = Stream(recursion)
    second.state = first.state
    for sample in rise[50:]:
        assert np.array_equal(first.step(sample), second.step(sample))


@pytest.mark.parametrize('recursion', RECURSIONS)
@pytest.mark.parametrize('bad', [[1.0], [1.0, np.nan, 0.0], [1.0, np.inf, 0.0]])
def test_a_refused_sample_leaves_the_state(recursion, bad):
    stream = Stream(recursion)
    stream.step([1.0, 2.0, 3.0])
    before = stream.state
    with pytest.raises(ValueError, match='rise: expected'):
        stream.step(bad)
    assert np.array_equal(stream.state, before)


def test_a_state_of_another_model_is_refused():
    stream = Stream(linear())
    for bad in (np.zeros(3), np.full(4, np.nan)):
        with pytest.raises(ValueError, match='state: expected 4 finite numbers'):
            stream.state = bad
    assert np.array_equal(stream.state, np.zeros(4))


@given(ratio=st.floats(0.1, 20.0), seed=st.integers(0, 20))
def test_conversion_keeps_the_steady_state_and_the_time_constant(ratio, seed):
    recursion = linear(seed)
    other = recursion.with_interval(ratio)
    gain = recursion.readout @ (recursion.drive / (1.0 - recursion.pole)[:, None])
    converted = other.readout @ (other.drive / (1.0 - other.pole)[:, None])
    assert np.allclose(gain, converted, rtol=1e-9, atol=1e-18)
    assert np.allclose(other.pole ** (1.0 / ratio), recursion.pole, rtol=1e-6, atol=1e-12)


@settings(deadline=None)
@given(ratio=st.sampled_from([0.2, 0.5, 2.0, 5.0]), exact=st.booleans())
def test_converted_grey_models_follow_the_same_step_response(ratio, exact):
    recursion = GreyRecursion(
        a=np.array([0.05]), b=np.array([[0.05e-6]]), initial=np.zeros(1), exact=exact
    )
    other = recursion.with_interval(ratio)
    horizon = 400
    one = recursion.run(np.ones((horizon, 1)))[-1, 0]
    two = other.run(np.ones((round(horizon / ratio), 1)))[-1, 0]
    assert one == pytest.approx(two, rel=0.02)


def test_alternating_poles_cannot_be_converted():
    recursion = GreyRecursion(True, np.array([3.0]), np.ones((1, 1)), np.zeros(1))
    with pytest.raises(ValueError, match='fit the model anew'):
        recursion.with_interval(2.0)


def test_pole_and_development_coefficient_are_inverse():
    a = np.array([0.01, 0.5, 2.0, 3.0])
    assert np.allclose(development_of(pole_of(a)), a)
    assert pole_of(np.array([2.0]))[0] == 0.0


@pytest.mark.parametrize('recursion', RECURSIONS)
def test_channels_can_be_taken_apart_and_joined(recursion):
    parts = [recursion.channel(channel) for channel in range(recursion.channels)]
    assert np.allclose(combine(parts).run(rises()), recursion.run(rises()), rtol=1e-13)


def test_equal_banks_are_shared():
    one, two = linear().channel(0), linear().channel(1)
    assert len(combine([one, two]).pole) == 4
    assert len(combine([one, linear(5).channel(0)]).pole) == 8


@pytest.mark.parametrize(
    'parts',
    [(linear(), grey(True)), (grey(True), grey(False)), (grey(True), linear(), grey(False))],
)
def test_forms_that_do_not_mix_run_side_by_side(parts):
    recursion = combine(parts)
    assert recursion.channels == sum(part.channels for part in parts)
    expected = np.concatenate([part.run(rises()) for part in parts], axis=1)
    assert np.array_equal(recursion.run(rises()), expected)
    stream = Stream(recursion)
    assert np.allclose([stream.step(row) for row in rises()], expected, rtol=1e-12, atol=1e-12)
    again = read_recursion(Node(write_recursion(recursion), 'test'), recursion.inputs)
    assert np.array_equal(again.run(rises()), expected)
    one = recursion.channel(recursion.channels - 1)
    assert np.allclose(one.run(rises())[:, 0], expected[:, -1], rtol=1e-13, atol=0.0)


def test_nothing_cannot_be_joined():
    with pytest.raises(ValueError, match='at least one'):
        combine([])


@pytest.mark.parametrize('pole', [1.0, -0.1, np.nan])
def test_unstable_poles_are_refused(pole):
    with pytest.raises(ValueError, match='pole'):
        LinearRecursion(
            np.array([pole]), np.ones((1, 1)), np.ones((1, 1)), np.ones((1, 1)), np.zeros(1)
        )


def test_runs_are_found_by_their_labels():
    assert run_slices([3, 3, 1, 1, 1], 5) == [slice(0, 2), slice(2, 5)]
    assert run_slices(None, 4) == [slice(0, 4)]
    with pytest.raises(ValueError, match='together'):
        run_slices([1, 2, 1], 3)
    with pytest.raises(ValueError, match='3 labels'):
        run_slices([1, 2], 3)

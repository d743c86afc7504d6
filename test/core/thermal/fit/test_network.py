# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fuzzycnc_ros.core.document import ModelFileError, Node
from fuzzycnc_ros.core.thermal.fit.filters import fit_filter, past
from fuzzycnc_ros.core.thermal.fit.tanh_network import TanhNetwork, train_network
from fuzzycnc_ros.core.thermal.recursions.base import (
    BoundedRecursion,
    LinearRecursion,
    Stream,
    bound_of,
    combine,
    read_recursion,
    write_recursion,
)
from fuzzycnc_ros.core.thermal.recursions.filters import (
    FilterNetworkRecursion,
    delayed_rises,
)
from fuzzycnc_ros.papers.networks import MovingAverageRecursion

INPUTS = 3


def drawn(seed=0, inputs=3, hidden=5):
    return TanhNetwork.drawn(inputs, hidden, np.random.default_rng(seed))


def numeric(function, flat, step=1e-6):
    """Return the derivative of a function of a vector by central differences, (..., q)."""
    columns = []
    for shift in step * np.eye(len(flat)):
        columns.append((function(flat + shift) - function(flat - shift)) / (2.0 * step))
    return np.stack(columns, axis=-1)


@given(seed=st.integers(0, 50), inputs=st.integers(1, 4), hidden=st.integers(1, 6))
@settings(deadline=None, max_examples=25)
def test_derivatives_are_those_of_the_network(seed, inputs, hidden):
    network = drawn(seed, inputs, hidden)
    rng = np.random.default_rng(seed)
    samples, target = rng.normal(size=(7, inputs)), rng.uniform(-0.5, 0.5, 7)

    def values(flat):
        return TanhNetwork.of(flat, inputs, hidden).values(samples)

    value, jacobian = network.jacobian(samples)
    assert np.array_equal(value, network.values(samples))
    assert np.abs(jacobian - numeric(values, network.flat)).max() <= 1e-8
    square, slope = network.gradient(samples, target)
    assert square == pytest.approx(((value - target) ** 2).sum())
    assert np.allclose(slope, 2.0 * jacobian.T @ (value - target), atol=1e-12)
    of_inputs = np.stack([numeric(lambda x: network.values(x[None])[0], row) for row in samples])
    assert np.abs(network.slopes(samples) - of_inputs).max() <= 1e-8


def test_weights_in_a_row_are_the_network():
    network = drawn()
    again = TanhNetwork.of(network.flat, 3, 5)
    assert np.array_equal(again.flat, network.flat)
    assert np.array_equal(again.inner, network.inner)
    assert len(network.flat) == 5 * (3 + 2) + 1
    assert len(drawn(inputs=3, hidden=30).flat) == 151
    assert np.abs(network.flat).max() <= 0.5


def cost(network, samples, target, decay, mean):
    square = ((network.values(samples) - target) ** 2).sum() / (len(target) if mean else 1.0)
    return square + decay * (network.flat**2).sum()


def problem():
    rng = np.random.default_rng(1)
    samples = rng.uniform(-0.3, 0.3, (80, 2))
    return samples, 0.4 * np.tanh(samples @ (1.0, -2.0)) + rng.normal(0.0, 1e-3, 80)


@pytest.mark.parametrize('mean', [True, False])
@pytest.mark.parametrize('seed', range(3))
def test_training_ends_where_no_step_promises_more(seed, mean):
    samples, target = problem()
    start = drawn(seed, 2, 30)
    network = train_network(start, samples, target, decay=1e-5, mean=mean)
    reached = cost(network, samples, target, 1e-5, mean)
    assert reached < 1e-2 * cost(start, samples, target, 1e-5, mean)
    share = 1.0 / 80.0 if mean else 1.0
    value, jacobian = network.jacobian(samples)
    slope = share * jacobian.T @ (value - target) + 1e-5 * network.flat
    curvature = share * jacobian.T @ jacobian + 1e-5 * np.eye(len(slope))
    assert slope @ np.linalg.solve(curvature, slope) <= 5e-4 * reached


def test_training_starts_from_the_best_output_node():
    samples, target = problem()
    start = drawn(0, 2, 30)
    begun = train_network(start, samples, target, decay=1e-5, mean=True, iterations_max=0)
    assert np.array_equal(begun.inner, start.inner)
    assert np.array_equal(begun.bias, start.bias)
    least = cost(begun, samples, target, 1e-5, True)
    assert least < 0.1 * cost(start, samples, target, 1e-5, True)
    # Moving the output node any way does not help by more than the linearisation left.
    rng = np.random.default_rng(0)
    for _ in range(20):
        shift = np.concatenate([np.zeros(90), rng.normal(0.0, 0.1, 31)])
        other = TanhNetwork.of(begun.flat + shift, 2, 30)
        assert cost(other, samples, target, 1e-5, True) > 0.99 * least
    # A network that is better already is left as it is.
    trained = train_network(start, samples, target, decay=1e-5, mean=True)
    again = train_network(trained, samples, target, decay=1e-5, mean=True, iterations_max=0)
    assert cost(again, samples, target, 1e-5, True) <= cost(trained, samples, target, 1e-5, True)


def test_many_samples_are_thinned():
    rng = np.random.default_rng(0)
    samples = np.cumsum(rng.normal(0.0, 0.002, (6000, 2)), axis=0)
    target = 0.3 * np.tanh(samples @ (1.0, -0.5))
    whole = train_network(drawn(0, 2, 6), samples, target, decay=1e-5, mean=False)
    assert np.abs(whole.values(samples) - target).max() <= 0.01


def test_both_solvers_find_the_same_cost():
    samples, target = problem()
    found = [
        cost(
            train_network(drawn(0, 2, 30), samples, target, decay=1e-5, mean=True, solver=solver),
            samples,
            target,
            1e-5,
            True,
        )
        for solver in ('lm', 'lbfgs')
    ]
    assert found[0] == pytest.approx(found[1], rel=1e-3)


def test_decay_against_the_mean_makes_a_calmer_network():
    rng = np.random.default_rng(3)
    samples = rng.uniform(-0.2, 0.2, (300, 3))
    target = 0.2 * samples[:, 0] + rng.normal(0.0, 0.02, 300)
    calm, keen = (
        train_network(drawn(hidden=30), samples, target, decay=1e-5, mean=mean)
        for mean in (True, False)
    )
    assert np.abs(calm.slopes(samples)).max() < np.abs(keen.slopes(samples)).max()


def test_training_for_nothing_gives_nothing():
    samples = np.random.default_rng(0).normal(size=(30, 3))
    for solver in ('lm', 'lbfgs'):
        network = train_network(
            drawn(), samples, np.zeros(30), decay=1e-5, mean=True, solver=solver
        )
        assert np.abs(network.values(samples)).max() <= 0.01


@given(
    runs=st.lists(st.integers(1, 6), min_size=1, max_size=4),
    delay=st.lists(st.integers(0, 8), min_size=1, max_size=3, unique=True).map(sorted),
)
@settings(deadline=None)
def test_delays_never_cross_runs(runs, delay):
    cuts = np.cumsum([0, *runs])
    rows = [slice(first, last) for first, last in pairwise(cuts)]
    rise = np.arange(1.0, 2 * cuts[-1] + 1).reshape(-1, 2)
    found = delayed_rises(rise, rows, np.array(delay)).reshape(len(rise), len(delay), 2)
    for run in rows:
        for n in range(run.start, run.stop):
            for column, lag in enumerate(delay):
                inside = n - lag >= run.start
                expected = rise[n - lag] if inside else np.zeros(2)
                assert np.array_equal(found[n, column], expected)


def test_history_starts_at_zero_in_each_run():
    values = np.array([1.0, 2.0, 3.0, 10.0, 20.0])
    found = past(values, [slice(0, 3), slice(3, 5)], 2)
    assert found.tolist() == [[0, 0], [1, 0], [2, 1], [0, 0], [10, 0]]


def test_ridge_without_penalty_solves_the_normal_equations():
    rng = np.random.default_rng(0)
    columns = rng.normal(2.0, 1.0, (60, 3))
    target = columns @ (1e-6, -2e-6, 3e-6) + 5e-6 + rng.normal(0.0, 1e-7, 60)
    free = fit_filter(columns, target, 0.0, anchored=False)
    residual = free(columns) - target
    assert np.abs(columns.T @ residual).max() <= 1e-16
    assert abs(residual.sum()) <= 1e-17
    anchored = fit_filter(columns, target, 0.0, anchored=True)
    assert anchored.offset == 0.0
    assert np.abs(columns.T @ (anchored(columns) - target)).max() <= 1e-16


@given(factor=st.floats(1e-3, 1e3), anchored=st.booleans())
@settings(deadline=None)
def test_filters_do_not_depend_on_units(factor, anchored):
    rng = np.random.default_rng(0)
    columns, target = rng.normal(1.0, 1.0, (50, 3)), rng.normal(size=50)
    one = fit_filter(columns, target, 1e-2, anchored)
    other = fit_filter(columns * (factor, 1.0, 1.0), 1e-6 * target, 1e-2, anchored)
    assert np.allclose(1e-6 * one(columns), other(columns * (factor, 1.0, 1.0)), rtol=1e-8)


def network_recursion(seed=0, delay=(0, 1, 2, 3), history=1, channels=2, hidden=4):
    rng = np.random.default_rng(seed)
    return FilterNetworkRecursion(
        delay=np.array(delay),
        inner=rng.normal(0.0, 0.1, (channels, hidden, len(delay) * INPUTS)),
        feedback=rng.normal(0.0, 1e4, (channels, hidden, history)),
        bias=rng.normal(0.0, 0.1, (channels, hidden)),
        outer=rng.normal(0.0, 0.3, (channels, hidden)),
        offset=rng.normal(0.0, 0.1, channels),
        scale=rng.uniform(40e-6, 60e-6, channels),
    )


def average_recursion(seed=0, delay=(1, 2, 3), history=3, channels=2):
    rng = np.random.default_rng(seed)
    return MovingAverageRecursion(
        delay=np.array(delay),
        drive=rng.normal(0.0, 1e-6, (channels, len(delay) * INPUTS)),
        feedback=rng.uniform(0.0, 0.3, (channels, history)),
        offset=rng.normal(0.0, 1e-6, channels),
        limit=rng.uniform(5e-6, 60e-6, channels),
    )


RECURSIONS = [
    network_recursion(),
    network_recursion(delay=(0,), history=0),
    network_recursion(delay=(0, 4, 9), history=2),
    average_recursion(),
    average_recursion(delay=(0,), history=1),
    average_recursion(delay=(2, 5), history=2),
    BoundedRecursion(network_recursion(), np.array([5e-6, 10e-6])),
]


def rises(seed=1, samples=80):
    return np.cumsum(np.random.default_rng(seed).normal(0.1, 0.3, (samples, INPUTS)), axis=0)


@pytest.mark.parametrize('recursion', RECURSIONS)
def test_stream_and_batch_agree(recursion):
    batch = recursion.run(rises())
    stream = Stream(recursion)
    steps = np.array([stream.step(sample) for sample in rises()])
    assert np.abs(steps - batch).max() <= 1e-12 * np.abs(batch).max()


@pytest.mark.parametrize('recursion', RECURSIONS)
def test_a_stream_resumes_from_its_state(recursion):
    first, second = Stream(recursion), Stream(recursion)
    for sample in rises()[:30]:
        first.step(sample)
    second.state = first.state
    for sample in rises()[30:]:
        assert np.array_equal(first.step(sample), second.step(sample))


@pytest.mark.parametrize('recursion', RECURSIONS)
def test_channels_can_be_taken_apart_and_joined(recursion):
    parts = [recursion.channel(channel) for channel in range(recursion.channels)]
    joined = combine(parts)
    assert type(joined) is type(recursion)
    assert np.allclose(joined.run(rises()), recursion.run(rises()), rtol=1e-12)


def test_unlike_channels_run_side_by_side():
    pairs = [
        (network_recursion(), network_recursion(hidden=5)),
        (network_recursion(), network_recursion(history=2)),
        (average_recursion(), average_recursion(delay=(1, 2))),
        (network_recursion(), average_recursion()),
    ]
    for pair in pairs:
        expected = np.hstack([item.run(rises()) for item in pair])
        assert np.allclose(combine(pair).run(rises()), expected, rtol=1e-12, atol=0.0)


@pytest.mark.parametrize(
    'recursion', [item for item in RECURSIONS if not isinstance(item, MovingAverageRecursion)]
)
def test_documents_hold_every_number(recursion):
    document = write_recursion(recursion)
    again = read_recursion(Node(document, 'test'), INPUTS)
    assert np.array_equal(again.run(rises()), recursion.run(rises()))
    assert write_recursion(again) == document


def broken(recursion, **changes):
    return Node({**write_recursion(recursion), **changes}, 'test')


@pytest.mark.parametrize(
    ('changes', 'message'),
    [
        ({'delay': [0, 0, 1, 2]}, 'ascending'),
        ({'delay': [0, 1, 2, 2.5]}, 'whole'),
        ({'delay': [-1, 1, 2, 3]}, 'ascending'),
        ({'delay': []}, 'expected'),
        ({'delay': [0, 1, 2, 1e12]}, 'at most 1440'),
        ({'bias': [[0.0]] * 2}, 'numbers'),
        ({'inner': [[[0.0] * 12]] * 2}, r'feedback\[0\]: expected 1 rows'),
        ({'inner': []}, 'feedback: expected 0 rows'),
        ({'feedback': [[[1.0]], [[1.0]] * 4]}, r'feedback\[0\]: expected 4 rows'),
        ({'outer': 3}, 'a list'),
        ({'scale': [50e-6]}, 'scale'),
        ({'scale': [50e-6, 0.0]}, 'scale: expected numbers from 1e-12'),
        ({'scale': [50e-6, float('nan')]}, 'finite'),
    ],
)
def test_nonsense_in_a_network_document_is_refused(changes, message):
    with pytest.raises((ModelFileError, ValueError), match=message):
        FilterNetworkRecursion.read(broken(network_recursion(), **changes), INPUTS)


@pytest.mark.parametrize(
    ('changes', 'message'),
    [
        ({'delay': [3, 2, 1]}, 'ascending'),
        ({'drive': [[0.0] * 9]}, 'feedback'),
        ({'drive': [[0.0] * 8] * 2}, '9 numbers'),
        ({'limit': [1e-6, -1e-6]}, 'positive'),
    ],
)
def test_nonsense_in_a_moving_average_document_is_refused(changes, message):
    with pytest.raises((ModelFileError, ValueError), match=message):
        MovingAverageRecursion.read(broken(average_recursion(), **changes), INPUTS)


def test_only_static_networks_have_a_meaning_at_another_interval():
    static = network_recursion(delay=(0,), history=0)
    assert static.with_interval(60.0) is static
    for recursion in (network_recursion(), network_recursion(delay=(0,), history=1)):
        with pytest.raises(ValueError, match='train it anew'):
            recursion.with_interval(60.0)


def linear(gain=1e-6):
    return LinearRecursion(
        pole=np.array([0.9]),
        drive=np.full((1, INPUTS), 0.1),
        readout=np.array([[gain], [2.0 * gain]]),
        direct=np.zeros((2, INPUTS)),
        offset=np.zeros(2),
    )


def test_a_bound_cuts_and_lets_go():
    rise = np.concatenate([np.full((100, INPUTS), 10.0), np.zeros((100, INPUTS))])
    base = linear()
    recursion = BoundedRecursion(base, bound_of(np.array([[1e-6, 30e-6], [-4e-6, np.nan]])))
    assert recursion.bound == pytest.approx((6e-6, 45e-6))
    values, free = recursion.run(rise), base.run(rise)
    assert np.abs(values).max(axis=0) == pytest.approx((6e-6, 45e-6))
    assert np.abs(free).max(axis=0) == pytest.approx((30e-6, 60e-6), rel=0.01)
    inside = np.abs(free) <= recursion.bound
    assert np.array_equal(values[inside], free[inside])
    assert inside[-30:].all()


def test_a_bounded_document_is_read_back_and_not_bounded_twice():
    recursion = BoundedRecursion(linear(), bound_of(np.full((3, 2), 4e-6)))
    again = BoundedRecursion.read(Node(write_recursion(recursion), 'test'), INPUTS)
    assert np.array_equal(again.run(rises()), recursion.run(rises()))
    twice = write_recursion(BoundedRecursion(recursion, recursion.bound))
    with pytest.raises(ModelFileError, match='not bounded'):
        BoundedRecursion.read(Node(twice, 'test'), INPUTS)
    for bound in ([1e-6], [1e-6, 0.0], [1e-6, np.nan]):
        with pytest.raises(ValueError, match='bound'):
            BoundedRecursion(linear(), np.array(bound))


def test_bounds_of_channels_of_different_forms_are_joined():
    one = BoundedRecursion(linear().channel(0), bound_of(np.full((3, 1), 4e-6)))
    two = BoundedRecursion(network_recursion().channel(1), bound_of(np.full((3, 1), 8e-6)))
    joined = combine([one, two])
    assert joined.bound == pytest.approx((6e-6, 12e-6))
    expected = np.hstack([one.run(rises()), two.run(rises())])
    assert np.allclose(joined.run(rises()), expected, rtol=1e-12, atol=0.0)

# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Elementary functions and linear algebra of the core, against decimals and LAPACK."""

import math
from decimal import Decimal, localcontext

import numpy as np
import pytest

from fuzzycnc_ros.core import portable

RNG = np.random.Generator(np.random.PCG64(5))
PI = Decimal('3.14159265358979323846264338327950288419716939937510582097494459')


def units_apart(found, exact):
    """Return the largest distance from decimals in units in the last place."""
    return max(
        abs(float((Decimal(float(a)) - b) / Decimal(math.ulp(float(b)))))
        for a, b in zip(found, exact, strict=True)
    )


def series_sine(x):
    turned = x - 2 * PI * (x / (2 * PI)).to_integral_value()
    term = total = turned
    for order in range(2, 80, 2):
        term = -term * turned * turned / (order * (order + 1))
        total += term
    return total


EXACT = {
    'exp': lambda x: x.exp(),
    'expm1': lambda x: x.exp() - 1,
    'log': lambda x: x.ln(),
    'log1p': lambda x: (1 + x).ln(),
    'log10': lambda x: x.log10(),
    'cube_root': lambda x: x ** (Decimal(1) / 3),
    'sin': series_sine,
    'cos': lambda x: series_sine(x + PI / 2),
    'tan': lambda x: series_sine(x) / series_sine(x + PI / 2),
    'tanh': lambda x: 1 - 2 / ((2 * x).exp() + 1),
}
BOTH = np.concatenate([RNG.normal(size=60), RNG.uniform(-1e-6, 1e-6, 20)])
POSITIVE = np.concatenate([np.exp(RNG.uniform(-300, 300, 60)), RNG.uniform(0.7, 1.5, 40)])
ANGLES = np.concatenate([RNG.uniform(-7, 7, 60), 1e5 * BOTH, 0.5 * np.pi * np.arange(1, 9)])
CASES = {
    'exp': (np.concatenate([BOTH, RNG.uniform(-700, 700, 60)]), 1.0),
    'expm1': (np.concatenate([BOTH, RNG.uniform(-40, 700, 60)]), 2.0),
    'log': (POSITIVE, 1.0),
    'log1p': (np.concatenate([BOTH[np.abs(BOTH) < 0.9], POSITIVE[POSITIVE > 1e-20]]), 1.5),
    'log10': (POSITIVE, 2.0),
    'cube_root': (POSITIVE, 1.0),
    'sin': (ANGLES, 1.0),
    'cos': (ANGLES, 1.0),
    'tan': (ANGLES, 3.0),
    'tanh': (np.concatenate([BOTH, 5.0 * BOTH]), 2.0),
}


@pytest.mark.parametrize('name', EXACT)
def test_functions_are_exact_to_the_last_places(name):
    values, units = CASES[name]
    found = getattr(portable, name)(values)
    with localcontext() as context:
        context.prec = 60
        exact = [EXACT[name](Decimal(float(value))) for value in values]
        assert units_apart(found, exact) <= units


@pytest.mark.parametrize('name', ['exp', 'expm1', 'log', 'log1p', 'sin', 'cos', 'tan'])
def test_a_number_has_the_digits_that_it_has_in_an_array(name):
    function = getattr(portable, name)
    values, _ = CASES[name]
    assert [function(value) for value in values.tolist()] == function(values).tolist()


def test_directions_are_those_of_the_c_library_within_two_units():
    y, x = RNG.normal(size=(2, 4000))
    y[:1000] *= 1e-3
    usual = np.arctan2(y, x)
    found = portable.arctan2(y, x)
    assert np.abs((found - usual) / np.spacing(np.abs(usual))).max() <= 3.0
    pairs = zip(y.tolist(), x.tolist(), strict=True)
    assert [portable.arctan2(*pair) for pair in pairs] == found.tolist()
    ends = np.array([0.0, -0.0, 1.0, -1.0])
    for first in ends:
        for second in ends:
            expected = math.atan2(first, second)
            assert portable.arctan2(float(first), float(second)) == expected
            assert math.copysign(1.0, portable.arctan2(float(first), float(second))) == (
                math.copysign(1.0, expected)
            )


def test_inverse_sines_and_cosines():
    share = np.concatenate([RNG.uniform(-1, 1, 1000), [-1.0, 0.0, 1.0, 1.0 - 1e-12]])
    np.testing.assert_allclose(portable.arcsin(share), np.arcsin(share), rtol=6e-16)
    np.testing.assert_allclose(portable.arccos(share), np.arccos(share), rtol=6e-16, atol=1e-16)


def test_powers():
    base, exponent = RNG.uniform(0.0, 10.0, 500), RNG.uniform(-3.0, 3.0, 500)
    found = portable.power(base, exponent)
    np.testing.assert_allclose(found, base**exponent, rtol=5e-15)
    pairs = zip(base.tolist(), exponent.tolist(), strict=True)
    assert [portable.power(*pair) for pair in pairs] == found.tolist()
    assert portable.power(np.array([0.0, 0.0, 2.0]), np.array([0.5, 0.0, 0.0])).tolist() == [
        0,
        1,
        1,
    ]
    assert [portable.power(0.0, 0.5), portable.power(0.0, 0.0)] == [0.0, 1.0]
    whole = portable.whole_powers(np.array([2.0, -3.0]), 3)
    assert whole.tolist() == [[1, 2, 4, 8], [1, -3, 9, -27]]


def test_values_at_the_ends():
    end, nan = np.inf, np.nan
    np.testing.assert_array_equal(portable.exp(np.array([nan, end, -end, 0.0])), [nan, end, 0, 1])
    np.testing.assert_array_equal(
        portable.log(np.array([0.0, -1.0, end, nan])), [-end, nan, end, nan]
    )
    np.testing.assert_array_equal(portable.tanh(np.array([end, -end, nan])), [1.0, -1.0, nan])
    np.testing.assert_array_equal(portable.cube_root(np.array([0.0, end, 27.0])), [0.0, end, 3.0])
    assert portable.exp(-1e9) == 0.0
    with pytest.raises(OverflowError):
        portable.exp(800.0)
    with pytest.raises(ValueError, match='math domain error'):
        portable.log(0.0)


def test_products_are_those_of_the_operator():
    shapes = [((3,), (3,)), ((4, 3), (3,)), ((3,), (3, 5)), ((4, 3), (3, 5)), ((2, 4, 3), (3, 5))]
    shapes += [((2, 4, 3), (2, 3, 5)), ((2, 4, 3), (3,)), ((3,), (2, 3, 5)), ((0, 3), (3,))]
    for first, second in shapes:
        one, two = RNG.normal(size=first), RNG.normal(size=second)
        np.testing.assert_allclose(portable.matmul(one, two), one @ two, rtol=1e-13, atol=1e-15)


def test_solutions_eigenvectors_and_triangles_are_those_of_lapack():
    for size in (1, 2, 5, 12):
        matrix, right = RNG.normal(size=(3, size, size)), RNG.normal(size=(3, size, 2))
        np.testing.assert_allclose(
            portable.solve(matrix, right), np.linalg.solve(matrix, right), rtol=1e-9
        )
        one = matrix[0]
        np.testing.assert_allclose(
            portable.solve(one, right[0, :, 0]), np.linalg.solve(one, right[0, :, 0]), rtol=1e-9
        )
        symmetric = one + one.T
        values, vectors = portable.eigh(symmetric)
        np.testing.assert_allclose(values, np.linalg.eigvalsh(symmetric), atol=1e-13)
        np.testing.assert_allclose(symmetric @ vectors, vectors * values, atol=1e-13)
    with pytest.raises(np.linalg.LinAlgError, match='Singular'):
        portable.solve(np.array([[1.0, 2.0], [2.0, 4.0]]), np.ones(2))
    assert portable.solve(np.empty((0, 0)), np.empty(0)).shape == (0,)


def test_convolution_and_length():
    first, second = RNG.normal(size=9), RNG.normal(size=4)
    np.testing.assert_allclose(portable.convolve(first, second), np.convolve(first, second))
    assert portable.norm(np.array([[3.0], [4.0]])) == 5.0


@pytest.mark.parametrize('name', [*EXACT, 'arcsin', 'arccos', 'sin_cos', 'arctan2', 'power'])
def test_large_arrays_get_the_digits_of_small_ones_in_their_own_order(name):
    function = getattr(portable, name)
    if name == 'power':
        function = lambda x: portable.power(x, 1.6)  # noqa: E731
    elif name == 'arctan2':
        function = lambda x: portable.arctan2(x, 0.5 - x)  # noqa: E731
    plain = RNG.uniform(0.01, 0.99, (90, 131))
    for given in (plain, plain.T, np.repeat(plain, 2, axis=1)[::-1, ::2]):
        expected = np.array([function(row) for row in given])  # each row is small
        found = function(given)
        if name == 'sin_cos':
            found, expected = np.array(found), expected.swapaxes(0, 1)
        np.testing.assert_array_equal(found, expected)
    assert name == 'sin_cos' or function(plain.T).flags.f_contiguous

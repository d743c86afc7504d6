# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Elementary functions, products and solutions that have the same digits on every processor.

A C library, numpy and BLAS choose their kernels by the processor: polynomials with or without
fused multiplication, sums in the order of the widest registers.  What a node publishes must not
depend on that, or a recording made in a shop would not replay in an office.  IEEE 754 fixes the
result of each single `+ - * /` and square root, and of what only moves digits (`frexp`,
`ldexp`, `rint`).  All here is made of these, in a written order; numpy's own sums along an axis
and `einsum` without `optimize` keep their order too.

`test/contract/test_portable.py` keeps the others out of what runs on a machine.

Notes
-----
Sources: fdlibm 5.3, Sun Microsystems 1993 (`e_exp.c`, `e_log.c`, `k_sin.c`, `k_cos.c`,
`e_rem_pio2.c`);
Cephes 2.8, S. L. Moshier 2000 (`atan.c`, `tanh.c`): polynomials and parts of constants.
Golub and Van Loan, Matrix Computations, 4th edition: algorithms 3.4.1 and 8.5.2.
"""

import math
from collections.abc import Callable
from typing import Any, overload

import numpy as np
from numpy.typing import NDArray

from fuzzycnc_ros.core.arrays import Array

Reals = NDArray[np.floating[Any]]
"""Array of real numbers, as numpy types the result of its sums and steps."""

_LN2_HIGH, _LN2_LOW = 6.93147180369123816490e-01, 1.90821492927058770002e-10
_QUARTER = (
    1.57079632673412561417e00,
    6.07710050630396597660e-11,
    2.02226624879595063154e-21,
)
"""A quarter turn [rad] in two parts of 33 bits and the rest."""

_PER_LN2, _PER_QUARTER = 1.4426950408889634, 0.63661977236758134
_ROOT_HALF = 0.70710678118654752
_EIGHTH, _QUARTER_LOW = 0.78539816339744831, 6.12323399573676603587e-17
"""An eighth of a turn [rad], and what a double leaves of a quarter."""

_EXP = (
    4.13813679705723846039e-08,
    -1.65339022054652515390e-06,
    6.61375632143793436117e-05,
    -2.77777777770155933842e-03,
    1.66666666666666019037e-01,
)
_LOG = (
    1.479819860511658591e-01,
    1.531383769920937332e-01,
    1.818357216161805012e-01,
    2.222219843214978396e-01,
    2.857142874366239149e-01,
    3.999999999940941908e-01,
    6.666666666666735130e-01,
)
_SIN = (
    1.58969099521155010221e-10,
    -2.50507602534068634195e-08,
    2.75573137070700676789e-06,
    -1.98412698298579493134e-04,
    8.33333333332248946124e-03,
    -1.66666666666666324348e-01,
)
_COS = (
    -1.13596475577881948265e-11,
    2.08757232129817482790e-09,
    -2.75573143513906633035e-07,
    2.48015872894767294178e-05,
    -1.38888888888741095749e-03,
    4.16666666666666019037e-02,
)
_ATAN = (
    -8.750608600031904122785e-01,
    -1.615753718733365076637e01,
    -7.500855792314704667340e01,
    -1.228866684490136173410e02,
    -6.485021904942025371773e01,
)
_ATAN_BELOW = (
    1.0,
    2.485846490142306297962e01,
    1.650270098316988542046e02,
    4.328810604912902668951e02,
    4.853903996359136964868e02,
    1.945506571482613964425e02,
)
_FEW = 16
"""Numbers of an array that take less time one by one."""
_BLOCK = 4096
"""Numbers worked off in one go: what a step leaves for the next stays in the cache, and in memory
that the system need not clear anew, which takes five times as long."""

_TANH = (-9.64399179425052238628e-01, -9.92877231001918586564e01, -1.61468768441708447952e03)
_TANH_BELOW = (
    1.12811678491632931402e02,
    2.23548839060100448583e03,
    4.84406305325125486048e03,
)


def _polynomial(coefficients: tuple[float, ...], x: Any) -> Any:
    """Return a polynomial's value, the highest power first."""
    total = x * coefficients[0]
    for coefficient in coefficients[1:-1]:
        total += coefficient
        total *= x
    return total + coefficients[-1]


def _exp_less_one(rest: Any) -> Any:
    """Return `exp(rest) - 1` for at most half of ln 2."""
    square = rest * rest
    c = rest - square * _polynomial(_EXP, square)
    below = 2.0 - c
    c *= rest
    c /= below
    c += rest
    return c


def _log_of(rise: Any, exponent: Any) -> Any:
    """Return `log(2**exponent (1 + rise))` for `1 + rise` about 1."""
    s = rise / (2.0 + rise)
    square = s * s
    half = 0.5 * rise
    half *= rise
    more = square * _polynomial(_LOG, square)
    more += half
    more *= s
    more += exponent * _LN2_LOW
    half -= more
    half -= rise
    return exponent * _LN2_HIGH - half


def _turned(x: Any, quarters: Any) -> Any:
    """Return what of an angle [rad] is left beyond its quarter turns, and that in more digits."""
    first = x - quarters * _QUARTER[0]
    part = quarters * _QUARTER[1]
    second = first - part
    part = quarters * _QUARTER[2] - ((first - second) - part)
    rest = second - part
    return rest, (second - rest) - part


def _sin_of(rest: Any, more: Any) -> Any:
    square = rest * rest
    cube = square * rest
    high = _polynomial(_SIN[:-1], square)
    return rest - ((square * (0.5 * more - cube * high) - more) - cube * _SIN[-1])


def _cos_of(rest: Any, more: Any) -> Any:
    square = rest * rest
    half = 0.5 * square
    high = square * square * _polynomial(_COS, square)
    near = 1.0 - half
    return near + (((1.0 - near) - half) + (high - rest * more))


def _atan_of(x: Any) -> Any:
    square = x * x
    return x + x * (square * _polynomial(_ATAN, square) / _polynomial(_ATAN_BELOW, square))


def _tanh_of(x: Array) -> Array:
    # In place, since a network calls it at each sample.
    square = x * x
    found = square * _TANH[0]
    for coefficient in _TANH[1:]:
        found += coefficient
        found *= square
    below = square + _TANH_BELOW[0]
    for coefficient in _TANH_BELOW[1:]:
        below *= square
        below += coefficient
    found /= below
    found *= x
    found += x
    return found


def _is_number(x: object) -> bool:
    return isinstance(x, (float, int))


def _in_blocks(function: Callable[..., Any], *given: Array, results: int = 1) -> list[Array]:
    """Return what an elementwise function gives of large arrays, in their order in memory."""
    kind = np.result_type(given[0], 1.0)
    found = [np.empty_like(given[0], dtype=kind) for _ in range(results)]
    flat = [one.ravel('K') for one in (*found, *given)]
    for first in range(0, given[0].size, _BLOCK):
        part = [one[first : first + _BLOCK] for one in flat]
        values = function(*part[results:])
        for place, value in zip(part, [values] if results == 1 else values, strict=False):
            place[:] = value
    return found


@overload
def exp(x: float) -> float: ...
@overload
def exp(x: Array) -> Array: ...
def exp(x: Any) -> Any:
    """Return e to a power, of a number or an array, to 1 unit in the last place.

    Raises
    ------
    OverflowError
        Of a number above 709.78.
    """
    if _is_number(x):
        x = min(float(x), 1000.0)
        if not x > -746.0:
            return 0.0 if x < 0.0 else x
        halvings = round(x * _PER_LN2)
        rest = (x - halvings * _LN2_HIGH) - halvings * _LN2_LOW
        return math.ldexp(1.0 + _exp_less_one(rest), halvings)
    if x.size > _BLOCK:
        return _in_blocks(exp, x)[0]
    less_one, whole = _exp_parts(x)
    return _scaled(1.0 + less_one, whole)


@overload
def expm1(x: float) -> float: ...
@overload
def expm1(x: Reals) -> Array: ...
def expm1(x: Any) -> Any:
    """Return `exp(x) - 1`, of a number or an array, also for a small `x` to its last places."""
    if _is_number(x):
        return float(expm1(np.array([x], float))[0])
    if x.size > _BLOCK:
        return _in_blocks(expm1, x)[0]
    less_one, whole = _exp_parts(x)
    return _scaled(less_one, whole) + (_scaled(np.ones_like(less_one), whole) - 1.0)


@overload
def log(x: float) -> float: ...
@overload
def log(x: Array) -> Array: ...
def log(x: Any) -> Any:
    """Return the natural logarithm, of a number or an array, to 1 unit in the last place.

    In an array zero has minus infinity, and what is below has NaN.

    Raises
    ------
    ValueError
        Of a number that is not above 0.
    """
    if _is_number(x):
        if not 0.0 < x < math.inf:
            return math.log(x)
        part, exponent = math.frexp(x)
        if part < _ROOT_HALF:
            part, exponent = 2.0 * part, exponent - 1
        return float(_log_of(part - 1.0, float(exponent)))
    if x.size > _BLOCK:
        return _in_blocks(log, x)[0]
    usual = (x > 0.0) & (x < math.inf)
    if not usual.all():
        rest = np.where(x == 0.0, -math.inf, np.where(x > 0.0, x, math.nan))
        return np.where(usual, log(np.where(usual, x, 1.0)), rest)
    part, exponent = np.frexp(x)
    low = part < _ROOT_HALF
    part += part * low
    part -= 1.0
    return _log_of(part, (exponent - low).astype(float))


@overload
def log1p(x: float) -> float: ...
@overload
def log1p(x: Array) -> Array: ...
def log1p(x: Any) -> Any:
    """Return `log(1 + x)`, of a number or an array, also for a small `x` to its last places."""
    if not _is_number(x) and x.size > _BLOCK:
        return _in_blocks(log1p, x)[0]
    whole = 1.0 + x
    return log(whole) + (x - (whole - 1.0)) / whole


def log10(x: Array) -> Array:
    """Return the decimal logarithm of an array, to 2 units in the last place."""
    return log(x) * 0.43429448190325182765


@overload
def power(x: float, y: float) -> float: ...
@overload
def power(x: Array, y: Array | float) -> Array: ...
def power(x: Any, y: Any) -> Any:
    """Return powers of what is not negative, each to `1 + |y log x|` units in the last place."""
    if _is_number(x) and _is_number(y):
        if x > 0.0:
            return exp(y * log(x))
        return float(y == 0.0) if x == 0.0 and y >= 0.0 else math.nan
    x, y = np.asarray(x, float), np.asarray(y, float)
    if x.size > _BLOCK and not y.ndim:
        return _in_blocks(lambda part: power(part, y), x)[0]
    if (x > 0.0).all():
        return exp(y * log(x))
    found = exp(y * log(np.where(x > 0.0, x, 1.0)))
    at_zero = np.where(y > 0.0, 0.0, np.where(y == 0.0, 1.0, math.inf))
    return np.where(x > 0.0, found, np.where(x == 0.0, at_zero, math.nan))


def cube_root(x: Array) -> Array:
    """Return cube roots of what is not negative, to 1 unit in the last place."""
    if x.size > _BLOCK:
        return _in_blocks(cube_root, x)[0]
    usual = (x > 0.0) & (x < math.inf)
    finite = np.where(usual, x, 1.0)
    near = exp(log(finite) / 3.0)
    return np.where(usual, near - (near - finite / (near * near)) / 3.0, x)


@overload
def sin(x: float) -> float: ...
@overload
def sin(x: Array) -> Array: ...
def sin(x: Any) -> Any:
    """Return the sine of an angle of up to 1e6 rad, to 1 unit in the last place."""
    if _is_number(x):
        return _turn(float(x), 0)
    return sin_cos(x)[0]


@overload
def cos(x: float) -> float: ...
@overload
def cos(x: Array) -> Array: ...
def cos(x: Any) -> Any:
    """Return the cosine of an angle of up to 1e6 rad, to 1 unit in the last place."""
    if _is_number(x):
        return _turn(float(x), 1)
    return sin_cos(x)[1]


def _turn(x: float, ahead: int) -> float:
    """Return the sine of an angle [rad] and of quarter turns ahead of it."""
    if not math.isfinite(x):
        return math.sin(x)
    quarters = round(x * _PER_QUARTER)
    rest, more = _turned(x, float(quarters))
    quarters += ahead
    found = _cos_of(rest, more) if quarters % 2 else _sin_of(rest, more)
    return float(-found if quarters % 4 > 1 else found)


def sin_cos(x: Array) -> tuple[Array, Array]:
    """Return sines and cosines of angles [rad]; those of one without the other cost the same."""
    if x.size > _BLOCK:
        large = _in_blocks(sin_cos, x, results=2)
        return large[0], large[1]
    quarters = np.rint(x * _PER_QUARTER)
    rest, more = _turned(x, quarters)
    sine, cosine = _sin_of(rest, more), _cos_of(rest, more)
    if not quarters.any():
        return sine, cosine
    part = quarters - 4.0 * np.floor(0.25 * quarters)
    odd, back, beyond = (part == 1.0) | (part == 3.0), part >= 2.0, (part == 1.0) | (part == 2.0)
    first, second = np.where(odd, cosine, sine), np.where(odd, sine, cosine)
    return np.where(back, -first, first), np.where(beyond, -second, second)


@overload
def arctan2(y: float, x: float) -> float: ...
@overload
def arctan2(y: Array, x: Array) -> Array: ...
def arctan2(y: Any, x: Any) -> Any:
    """Return the direction [rad] of points, from -pi to pi, to 2 units in the last place."""
    if _is_number(x) and _is_number(y):
        return _direction(float(y), float(x))
    if x.size > _BLOCK and (x.shape, x.strides) == (y.shape, y.strides):
        return _in_blocks(arctan2, y, x)[0]
    rise, run = np.abs(y), np.abs(x)
    large, small = np.maximum(rise, run), np.minimum(rise, run)
    slope = small / np.where(large > 0.0, large, 1.0)
    steep = slope > 0.4142135623730950488
    both = np.where(large > 0.0, large + small, 1.0)
    turn = _atan_of(np.where(steep, (small - large) / both, slope))
    turn = np.where(steep, _EIGHTH + (turn + 0.5 * _QUARTER_LOW), turn)
    turn = np.where(rise > run, (2.0 * _EIGHTH - turn) + _QUARTER_LOW, turn)
    back = (x < 0.0) | (np.signbit(x) & (large == 0.0))
    turn = np.where(back, (4.0 * _EIGHTH - turn) + 2.0 * _QUARTER_LOW, turn)
    return np.copysign(turn, y)


def _direction(y: float, x: float) -> float:
    """Return what `arctan2` does, of numbers: several times as fast as of an array of one."""
    rise, run = abs(y), abs(x)
    large, small = max(rise, run), min(rise, run)
    if not large < math.inf:
        return math.atan2(y, x)
    slope = small / large if large > 0.0 else 0.0
    if slope > 0.4142135623730950488:
        turn = _EIGHTH + (_atan_of((small - large) / (large + small)) + 0.5 * _QUARTER_LOW)
    else:
        turn = _atan_of(slope)
    if rise > run:
        turn = (2.0 * _EIGHTH - turn) + _QUARTER_LOW
    if x < 0.0 or (large == 0.0 and math.copysign(1.0, x) < 0.0):
        turn = (4.0 * _EIGHTH - turn) + 2.0 * _QUARTER_LOW
    return math.copysign(turn, y)


@overload
def tan(x: float) -> float: ...
@overload
def tan(x: Array) -> Array: ...
def tan(x: Any) -> Any:
    """Return the tangent of an angle of up to 1e6 rad, to 3 units in the last place."""
    return sin(x) / cos(x)


def arcsin(x: Array) -> Array:
    """Return the angles [rad] whose sines these are; NaN beyond one."""
    return arctan2(x, np.sqrt((1.0 - x) * (1.0 + x)))


def arccos(x: Array) -> Array:
    """Return the angles [rad] whose cosines these are; NaN beyond one."""
    return arctan2(np.sqrt((1.0 - x) * (1.0 + x)), x)


def tanh(x: Array) -> Array:
    """Return hyperbolic tangents, to 2 units in the last place."""
    if x.size > _BLOCK:
        return _in_blocks(tanh, x)[0]
    if x.size <= _FEW:
        return np.array([_tanh(number) for number in x.ravel().tolist()]).reshape(x.shape)
    size = np.abs(x)
    if size.max() < 0.625:
        return _tanh_of(x)
    far = ~(size < 0.625)
    found, beyond = _tanh_of(np.where(far, 0.0, x)), x[far]
    if len(beyond) <= _FEW:
        found[far] = [_tanh(number) for number in beyond.tolist()]
    else:
        known = 1.0 - 2.0 / (exp(2.0 * np.minimum(size[far], 20.0)) + 1.0)
        found[far] = np.copysign(known, beyond)
    return found


def _tanh(x: float) -> float:
    """Return what `tanh` does, of a number."""
    if -0.625 < x < 0.625:
        square = x * x
        above = square * ((square * _TANH[0] + _TANH[1]) * square + _TANH[2])
        below = ((square + _TANH_BELOW[0]) * square + _TANH_BELOW[1]) * square + _TANH_BELOW[2]
        return x + x * (above / below)
    return math.copysign(1.0 - 2.0 / (exp(2.0 * min(abs(x), 20.0)) + 1.0), x)


def _exp_parts(x: Array) -> tuple[Array, Array]:
    """Return `exp(x) / 2**whole - 1`, and the whole powers of two of each."""
    x = np.minimum(np.maximum(x, -746.0), 1000.0)
    whole = np.rint(x * _PER_LN2)
    x -= whole * _LN2_HIGH
    x -= whole * _LN2_LOW
    return _exp_less_one(x), whole


def _scaled(part: Array, whole: Array) -> Array:
    """Return numbers times powers of two; NaN, which has none, stays in the number."""
    with np.errstate(over='ignore', invalid='ignore'):
        return np.ldexp(part, whole.astype(np.intc))


def matmul(first: Reals, second: Reals) -> Any:
    """Return `first @ second`, summed in the order of the columns of `first`."""
    if second.ndim == 1:
        return np.einsum('...i,i->...', first, second)
    if first.ndim == 1:
        return np.einsum('i,...ij->...j', first, second)
    return np.einsum('...ij,...jk->...ik', first, second)


def norm(vector: Array) -> float:
    """Return the Euclidean length of all numbers of an array together."""
    return float(np.sqrt(np.sum(vector * vector)))


def solve(matrix: Array, right: Array) -> Array:
    """Return the solutions of linear systems, by elimination with partial pivoting.

    Parameters
    ----------
    matrix : ndarray, shape (..., n, n)
        Matrices.
    right : ndarray, shape (..., n, m)
        Right-hand sides, or one of shape (n,) for one matrix.

    Raises
    ------
    numpy.linalg.LinAlgError
        If a matrix is singular.
    """
    if right.ndim == 1:
        return solve(matrix, right[:, np.newaxis])[:, 0]
    size = matrix.shape[-1]
    if not size:
        return right
    shape = np.broadcast_shapes(matrix.shape[:-2], right.shape[:-2])
    rows = np.concatenate(
        [
            np.broadcast_to(matrix, (*shape, size, size)),
            np.broadcast_to(right, (*shape, size, right.shape[-1])),
        ],
        axis=-1,
    ).reshape(-1, size, size + right.shape[-1])
    every = np.arange(len(rows))
    for column in range(size):
        pivot = np.abs(rows[:, column:, column]).argmax(axis=-1)
        if pivot.any():
            pivot += column
            rows[every, pivot], rows[:, column] = rows[:, column].copy(), rows[every, pivot]
        own = rows[:, column, column, np.newaxis, np.newaxis]
        if not own.all():
            raise np.linalg.LinAlgError('Singular matrix')
        rest = slice(column + 1, None)
        share = rows[:, rest, column, np.newaxis] / own
        rows[:, rest, rest] -= share * rows[:, column, np.newaxis, rest]
    found = rows[:, :, size:]
    for row in reversed(range(size)):
        known = np.einsum('bi,bij->bj', rows[:, row, row + 1 : size], found[:, row + 1 :])
        found[:, row] = (found[:, row] - known) / rows[:, row, row, np.newaxis]
    return found.reshape(*shape, size, -1)


def eigh(matrix: Array) -> tuple[Array, Array]:
    """Return eigenvalues, rising, and unit eigenvectors, by columns, of a symmetric matrix.

    By cyclic Jacobi rotations, until what is off the diagonal has gone.
    """
    rest, vectors = np.array(matrix, dtype=float), np.eye(len(matrix))
    for _ in range(50):
        if not np.any(np.triu(rest, 1)):
            break
        for first in range(len(rest) - 1):
            for second in range(first + 1, len(rest)):
                _rotate(rest, vectors, first, second)
    values = np.diag(rest)
    order = np.argsort(values, kind='stable')
    return values[order], vectors[:, order]


def _rotate(rest: Array, vectors: Array, first: int, second: int) -> None:
    """Turn two axes in place so that their product vanishes."""
    product, sizes = rest[first, second], (rest[first, first], rest[second, second])
    if abs(product) <= 1e-17 * math.sqrt(abs(sizes[0] * sizes[1])):
        rest[first, second] = rest[second, first] = 0.0
        return
    slope = (sizes[1] - sizes[0]) / (2.0 * product)
    tangent = math.copysign(1.0, slope) / (abs(slope) + math.hypot(1.0, slope))
    cosine = 1.0 / math.hypot(1.0, tangent)
    sine = tangent * cosine
    for columns in (rest, vectors, rest.T):
        one, other = columns[:, first].copy(), columns[:, second].copy()
        columns[:, first] = cosine * one - sine * other
        columns[:, second] = sine * one + cosine * other


def whole_powers(x: Array | float, highest: int) -> Array:
    """Return the powers of numbers from the zeroth to the highest, along a new last axis."""
    power = np.ones((*np.shape(x), highest + 1))
    for order in range(1, highest + 1):
        power[..., order] = power[..., order - 1] * x
    return power


def convolve(first: Array, second: Array) -> Array:
    """Return the full convolution of two series, summed in the order of the second one."""
    total = np.zeros(len(first) + len(second) - 1)
    for place, factor in enumerate(second):
        total[place : place + len(first)] += factor * first
    return total

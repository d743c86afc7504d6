# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Types of arrays and seeds, checks of what is given as arrays, and many short vectors."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]
"""Array of doubles."""

Seed = int | np.random.Generator | None
"""Seed of an estimator; None draws fresh entropy, and no global state is ever touched."""


def mean_of_measured(values: Array, axis: int) -> Array:
    """Return the mean along an axis of what is not NaN, NaN where nothing is."""
    measured = ~np.isnan(values)
    count = measured.sum(axis=axis)
    total = np.where(measured, values, 0.0).sum(axis=axis)
    return np.where(count > 0, total / np.maximum(count, 1), np.nan)


def check_matrix(samples: ArrayLike, name: str = 'X') -> Array:
    """Return `samples` as a finite matrix of doubles.

    Parameters
    ----------
    samples : array_like, shape (n, p)
        Samples by rows.
    name : str
        Name of the argument for messages.

    Raises
    ------
    ValueError
        If it is no matrix, is empty, complex or holds NaN or infinities.
    """
    raw = np.asarray(samples)
    if np.iscomplexobj(raw):
        raise ValueError(f'{name}: expected real numbers. Complex data not supported')
    matrix = np.asarray(raw, dtype=np.float64)
    if matrix.ndim != 2:
        raise ValueError(
            f'{name}: expected a 2-D array (samples, features), but found {matrix.ndim} '
            'dimension(s). Reshape your data'
        )
    if 0 in matrix.shape:
        raise ValueError(
            f'{name}: expected at least one sample and one feature, but found shape {matrix.shape}'
        )
    if not np.isfinite(matrix).all():
        at = np.argwhere(~np.isfinite(matrix))[0]
        raise ValueError(
            f'{name}: expected finite numbers, but found {matrix[tuple(at)]} (NaN or infinity) '
            f'in row {at[0]}, column {at[1]}'
        )
    return matrix


def check_shapes(owner: object, **shapes: tuple[int, ...]) -> None:
    """Refuse arrays of other shapes or with values that are not finite.

    Raises
    ------
    ValueError
        The message names the array.
    """
    for name, shape in shapes.items():
        values = getattr(owner, name)
        if values.shape != shape or not np.isfinite(values).all():
            raise ValueError(
                f'{name}: expected finite numbers of shape {shape}, but found shape {values.shape}'
            )


NUMBER_MAX = 1e12
"""Largest number that an array of a fitted model may hold, in SI units: sums of products of a few
such numbers stay finite, and what training finds is smaller by many orders."""

LENGTH_MIN = 1e-9
"""Smallest length by which a fitted model divides, in the units of its inputs."""


def check_bounds(owner: object, **bounds: tuple[float, float]) -> None:
    """Refuse numbers beyond their bounds, which are allowed themselves.

    Raises
    ------
    ValueError
        The message names the number, or the array, its bounds and the first value beyond.
    """
    for name, (low, high) in bounds.items():
        values = np.asarray(getattr(owner, name))
        beyond = ~((values >= low) & (values <= high))
        if beyond.any():
            raise ValueError(
                f'{name}: expected numbers from {low:g} to {high:g}, but found '
                f'{values[beyond].flat[0]:g}'
            )


def dot_products(first: Array, second: Array) -> Array:
    """Return the products of vectors along the last axis, summed, to the digit as numpy's `sum`.

    A vector of a path has two or three numbers.  To add them up one after the other is several
    times as fast as a reduction of an axis so short.
    """
    product = first * second
    total = product[..., 0]
    for column in range(1, product.shape[-1]):
        total = total + product[..., column]
    return total


def vector_lengths(vectors: Array) -> Array:
    """Return the Euclidean lengths of vectors along the last axis, to the digit as numpy's."""
    return np.asarray(np.sqrt(dot_products(vectors, vectors)))

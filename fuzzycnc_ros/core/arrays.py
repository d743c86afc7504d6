# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Types of arrays and seeds, and the check of what is given as a matrix."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]
"""Array of doubles."""

Seed = int | np.random.Generator | None
"""What seeds an estimator; None draws fresh entropy, and no global state is ever touched."""


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

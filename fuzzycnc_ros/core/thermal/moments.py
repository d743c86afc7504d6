# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Ridge regression from sums of products, so that held-out fits cost no pass over the data.

Choosing sensors, lags and penalties asks for thousands of fits on unions of the same stretches
of samples.  The sums of products of each stretch are taken once; every fit and every mean
square error then follows from adding small matrices.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fuzzycnc_ros.core import portable
from fuzzycnc_ros.core.arrays import Array


def measured_together(targets: Array) -> list[NDArray[np.int64]]:
    """Return the columns of targets (n, c) that are NaN in the same samples, group by group."""
    groups: dict[bytes, list[int]] = {}
    for column, values in enumerate(targets.T):
        groups.setdefault(np.isfinite(values).tobytes(), []).append(column)
    return [np.array(group, dtype=np.int64) for group in groups.values()]


@dataclass(frozen=True)
class Fold:
    """Stretches of samples to train on and to judge on, by their numbers."""

    train: tuple[int, ...]
    test: tuple[int, ...]


@dataclass(frozen=True, eq=False)
class Moments:
    """Sums of products of (1, features, targets) over each stretch of samples.

    Parameters
    ----------
    sums : ndarray, shape (..., blocks, 1 + q + c, 1 + q + c)
        One matrix per stretch; leading axes hold alternative features of the same samples.
    inputs : int
        Number q of features.
    """

    sums: Array
    inputs: int

    @staticmethod
    def of(features: Array, targets: Array, block: NDArray[np.int64]) -> 'Moments':
        """Take the sums of features (..., n, q) and targets (n, c); block (n,) numbers stretches.

        Samples of block -1, and those with a target that is NaN, are left out: give targets that
        were measured together, see `measured_together`.
        """
        used = np.isfinite(targets).all(axis=1) & (block >= 0)
        lead = features.shape[:-2]
        ones = np.ones((*lead, int(used.sum()), 1))
        values = np.broadcast_to(targets[used], (*lead, int(used.sum()), targets.shape[1]))
        table = np.concatenate([ones, features[..., used, :], values], axis=-1)
        blocks = int(block.max()) + 1
        sums = np.empty((*lead, blocks, table.shape[-1], table.shape[-1]))
        for number in range(blocks):
            rows = table[..., block[used] == number, :]
            sums[..., number, :, :] = portable.matmul(np.swapaxes(rows, -1, -2), rows)
        return Moments(sums, features.shape[-1])

    def over(self, blocks: Sequence[int]) -> Array:
        """Return the sums over several stretches, shape (..., 1 + q + c, 1 + q + c)."""
        return np.asarray(self.sums[..., list(blocks), :, :].sum(axis=-3))

    def pick(self, features: Sequence[int]) -> 'Moments':
        """Return the moments of some of the features."""
        size = self.sums.shape[-1]
        keep = [0, *(1 + index for index in features), *range(1 + self.inputs, size)]
        return Moments(self.sums[..., np.ix_(keep, keep)[0], np.ix_(keep, keep)[1]], len(features))


def spread(sums: Array, columns: slice) -> Array:
    """Return the standard deviation of some columns, 1 for a constant one."""
    count = sums[..., 0, 0, np.newaxis]
    mean = sums[..., 0, columns] / count
    square = np.diagonal(sums, axis1=-2, axis2=-1)[..., columns] / count
    variance = square - mean**2
    return np.where(variance > 1e-14 * square, np.sqrt(np.maximum(variance, 0.0)), 1.0)


def ridge_from_sums(
    sums: Array, inputs: int, ridge: float, intercept: bool, scale: Array | None = None
) -> tuple[Array, Array]:
    """Return weights (..., q, c) and constants (..., c) of ridge regression.

    Parameters
    ----------
    sums : ndarray, shape (..., 1 + q + c, 1 + q + c)
        Sums of products over the training samples.
    inputs : int
        Number q of features.
    ridge : float
        Penalty on the coefficients of the scaled features, per sample; 0 is least squares.
    intercept : bool
        Whether a constant is fitted.
    scale : ndarray, shape (..., q), optional
        Scale of the features; their standard deviation if absent.
    """
    count = sums[..., 0, 0]
    features, targets = slice(1, 1 + inputs), slice(1 + inputs, None)
    normal, right = sums[..., features, features], sums[..., features, targets]
    mean = sums[..., 0, features] / count[..., np.newaxis]
    level = sums[..., 0, targets] / count[..., np.newaxis]
    if scale is None:
        scale = spread(sums, features)
    if intercept:
        total = count[..., np.newaxis, np.newaxis]
        normal = normal - total * mean[..., :, np.newaxis] * mean[..., np.newaxis, :]
        right = right - total * mean[..., :, np.newaxis] * level[..., np.newaxis, :]
    normal = normal / (scale[..., :, np.newaxis] * scale[..., np.newaxis, :])
    right = right / scale[..., :, np.newaxis]
    if ridge > 0.0:
        penalty = ridge * count[..., np.newaxis, np.newaxis] * np.eye(inputs)
        solution = portable.solve(normal + penalty, right)
    else:
        solution = portable.matmul(np.linalg.pinv(normal, hermitian=True), right)
    weight = solution / scale[..., :, np.newaxis]
    if not intercept:
        return weight, np.zeros_like(level)
    return weight, level - np.einsum('...q,...qc->...c', mean, weight)


def mean_square_error(sums: Array, weight: Array, constant: Array) -> Array:
    """Return the mean square error (..., c) of weights (..., q, c) and constants (..., c).

    NaN over stretches in which nothing was measured.
    """
    channels = weight.shape[-1]
    # Residual = (1, features, targets) @ [-constant; -weight; identity].
    identity = np.broadcast_to(np.eye(channels), (*weight.shape[:-2], channels, channels))
    combination = np.concatenate([-constant[..., np.newaxis, :], -weight, identity], axis=-2)
    energy = (combination * portable.matmul(sums, combination)).sum(axis=-2)
    count = sums[..., 0, 0, np.newaxis]
    return np.where(count > 0.0, np.maximum(energy, 0.0) / np.maximum(count, 1.0), np.nan)


def stable_grey_from_sums(
    moments: Moments, train: Sequence[int], scale: Array, ridge: float
) -> tuple[NDArray[np.int64], Array]:
    """Choose the pole of the stable grey model per channel.

    docs/explanation/methods/thermal-fuzzy-and-grey.md says how well that does.

    Parameters
    ----------
    moments : Moments
        Lagged drivers for each pole, leading axis the poles.
    train : sequence of int
        Stretches to train on.
    scale : ndarray, shape (q,)
        Standard deviation of the drivers over the training samples.
    ridge : float
        Penalty per sample.

    Returns
    -------
    pole : ndarray, shape (c,)
        Number of the chosen pole of each channel.
    weight : ndarray, shape (q, c)
        Weight of the lagged drivers.
    """
    sums = moments.over(train)
    weight, constant = ridge_from_sums(sums, moments.inputs, ridge, False, scale)
    unit = spread(sums, slice(1 + moments.inputs, None))
    cost = mean_square_error(sums, weight, constant) / unit**2
    theta = weight * scale[:, np.newaxis] / unit[..., np.newaxis, :]
    cost = cost + ridge * (theta**2).sum(axis=-2)
    pole = cost.argmin(axis=0)
    return pole, np.asarray(np.stack([weight[p, :, c] for c, p in enumerate(pole)], axis=1))

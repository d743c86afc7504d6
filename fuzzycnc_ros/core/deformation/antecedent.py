# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Antecedent of the T-S fuzzy neural network: rules from clusters, and how much each applies."""

from dataclasses import dataclass

import numpy as np

from fuzzycnc_ros.core.arrays import Array
from fuzzycnc_ros.core.fuzzy.takagi_sugeno import normalised_firing


@dataclass(frozen=True, eq=False)
class Antecedent:
    """Rules of method sheet 000 section 3.3.

    Parameters
    ----------
    center : ndarray, shape (c, n)
        Centres of the rules, in scaled inputs.
    width : ndarray, shape (c, n)
        Widths of the memberships, in scaled inputs, positive.
    decay : float
        gamma [-], positive.
    power : int
        1 for the membership exp(-gamma |x - v| / w) as printed, 2 for the squared one.
    """

    center: Array
    width: Array
    decay: float = 2.0
    power: int = 1

    @staticmethod
    def of_clusters(
        center: Array, span: Array, *, width_floor: float, decay: float, power: int
    ) -> 'Antecedent':
        """Return the rules of cluster centres.

        Parameters
        ----------
        center : ndarray, shape (c, n)
            Input block of the cluster centres, in scaled inputs.
        span : ndarray, shape (n,)
            Range of each scaled input in the training samples.
        width_floor : float
            Least width as a share of the range [-].  The distance to the nearest rule, which the
            paper takes alone, is 0 wherever two centres share a coordinate.
        decay, power
            As of the rules.
        """
        apart = np.abs(center[:, np.newaxis] - center)
        distance = (apart**2).sum(axis=-1)
        np.fill_diagonal(distance, np.inf)
        nearest = distance.argmin(axis=1)
        width = np.maximum(apart[np.arange(len(center)), nearest], width_floor * span)
        return Antecedent(center, width, decay, power)

    def log_fitness(self, scaled: Array) -> Array:
        """Return the logarithm of each rule's fitness, shape (k, c), of scaled inputs (k, n).

        A product of memberships underflows with many inputs, so it stays a sum of logarithms.
        """
        total = np.zeros((len(self.center), len(scaled)))
        # Input by input, with samples in the last place: loops over them are long and fast.
        for column, center, width in zip(scaled.T, self.center.T, self.width.T, strict=True):
            ratio = np.abs(column - center[:, np.newaxis])
            ratio *= (1.0 / width)[:, np.newaxis]
            if self.power == 2:
                ratio *= ratio
            total += ratio
        total *= -self.decay
        return total.T

    def fitness(self, scaled: Array) -> Array:
        """Return the fitness that is normalised over the rules, shape (k, c); rows sum to 1."""
        return normalised_firing(self.log_fitness(scaled))

    def support(self, scaled: Array) -> Array:
        """Return the logarithm of the summed fitness, shape (k,): how well rules cover inputs."""
        return log_sum(self.log_fitness(scaled))


def log_sum(logarithm: Array) -> Array:
    """Return the logarithm of the sum over the last axis of values given by their logarithms."""
    largest = logarithm.max(axis=-1, keepdims=True)
    return np.asarray(largest[..., 0] + np.log(np.exp(logarithm - largest).sum(axis=-1)))

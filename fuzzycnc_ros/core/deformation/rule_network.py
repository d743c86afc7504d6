# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""T-S rules with linear or hidden-layer consequents, ready to be evaluated."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from fuzzycnc_ros.core.arrays import Array
from fuzzycnc_ros.core.deformation.antecedent import Antecedent
from fuzzycnc_ros.core.fuzzy.takagi_sugeno import normalised_firing


@dataclass(frozen=True, eq=False)
class RuleNetwork:
    """Rules and weights in the units of inputs and outputs; method sheet 000 section 3.4.

    Parameters
    ----------
    antecedent : Antecedent
        c rules on n inputs.
    inner : ndarray, shape (r, m, n + 1), or None
        w_ij of each of r outputs, biases first; None for linear consequents.
    outer : ndarray, shape (r, m, c)
        w_jk of each output.  Linear consequents have m = n + 1: their coefficients, with the
        extended inputs in the place of the hidden nodes.
    offset : ndarray, shape (r,)
        Mean output, which is added.

    Notes
    -----
    The scaling of the training is folded into the weights, and all outputs are computed in one
    product.
    """

    antecedent: Antecedent
    inner: Array | None
    outer: Array
    offset: Array

    def values(self, inputs: Array) -> Array:
        """Return the outputs, shape (k, r), of inputs (k, n)."""
        # Samples are in the last place, where loops over them are long and fast.
        columns = np.ascontiguousarray(inputs.T)
        fitness = normalised_firing(self.antecedent.log_fitness(inputs).T, axis=0)
        pull = (self._outer @ fitness).reshape(len(self.offset), -1, len(inputs))
        if self.inner is None:
            pull[:, 1:] *= columns
        else:
            nodes = self._slopes @ columns
            nodes += self._biases[:, np.newaxis]
            pull *= _sigmoid(nodes).reshape(pull.shape)
        return np.asarray(pull.sum(axis=1).T + self.offset)

    def one(self, inputs: Sequence[float]) -> tuple[Array, float]:
        """Return the outputs (r,) of one row of inputs, and the logarithm of their support."""
        row = np.array(inputs)
        ratio = np.abs(row - self.antecedent.center)
        ratio *= self._decay
        if self.antecedent.power == 2:
            ratio *= ratio
        fitness = ratio.sum(axis=1)
        least = fitness.min()
        fitness = np.exp(least - fitness)
        total = fitness.sum()
        pull = (self._outer @ fitness).reshape(len(self.offset), -1)
        if self.inner is None:
            pull *= np.concatenate([_ONE, row])
        else:
            pull *= _sigmoid(self._slopes @ row + self._biases).reshape(pull.shape)
        values = pull.sum(axis=1)
        values /= total
        values += self.offset
        return values, float(np.log(total) - least)

    @cached_property
    def _decay(self) -> Array:
        rules = self.antecedent
        return np.asarray(rules.decay ** (1.0 / rules.power) / rules.width)

    @cached_property
    def _outer(self) -> Array:
        return np.ascontiguousarray(self.outer.reshape(-1, self.outer.shape[-1]))

    @cached_property
    def _slopes(self) -> Array:
        inner = np.empty((0, 0, 1)) if self.inner is None else self.inner
        return np.ascontiguousarray(inner[..., 1:].reshape(-1, inner.shape[-1] - 1))

    @cached_property
    def _biases(self) -> Array:
        inner = np.empty((0, 0, 1)) if self.inner is None else self.inner
        return np.ascontiguousarray(inner[..., 0].ravel())


_ONE = np.ones(1)


def _sigmoid(values: Array) -> Array:
    """Turn values into 1 / (1 + exp(-a)) in place; tanh cannot overflow and is faster in bulk."""
    values *= 0.5
    np.tanh(values, out=values)
    values += 1.0
    values *= 0.5
    return values

# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""A trained T-S fuzzy neural network as a machine runs it: without any training code."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fuzzycnc_ros.core.arrays import Array
from fuzzycnc_ros.core.deformation.features import (
    FeatureSet,
    check_process_values,
    feature_set,
    load,
)
from fuzzycnc_ros.core.deformation.gain import AxisGain
from fuzzycnc_ros.core.deformation.gate import Gate
from fuzzycnc_ros.core.deformation.rule_network import RuleNetwork

CHUNK = 500
"""Rows computed together; with 2000 a large network spent most time on fresh memory."""


@dataclass(frozen=True, eq=False)
class DeformationModel:
    """Compensation of feed by T-S rules, with its gate and its gains.

    Parameters
    ----------
    features : str
        Name of the feature set.
    columns : tuple of int
        Features that the network takes; constant ones were left out.
    network : RuleNetwork
        The rules.
    gate : Gate
        What process values the model is for.
    gain : AxisGain
        Gains of the outputs.
    """

    features: str
    columns: tuple[int, ...]
    network: RuleNetwork
    gate: Gate
    gain: AxisGain

    def predict(self, x: ArrayLike) -> Array:
        """Return compensations, shape (k, r) [mm per 50 mm], of process values (k, 5).

        Raises
        ------
        ValueError
            If a row is none of a primitive, see `check_process_values`.
        """
        return self._values(check_process_values(x)) * self.gain.value

    def support(self, x: ArrayLike) -> Array:
        """Return the logarithm of the rules' support, shape (k,), of process values (k, 5)."""
        rows = check_process_values(x)
        result = np.empty(len(rows))
        for part in _chunks(len(rows)):
            result[part] = self.network.antecedent.support(self._inputs(rows[part]))
        return result

    def accepts(self, x: ArrayLike) -> NDArray[np.bool_]:
        """Return whether the model may be used for process values (k, 5), shape (k,).

        Rows that no primitive can have are refused like any outside the box.
        """
        rows = np.asarray(x, dtype=np.float64)
        accepted = self.gate.inside(rows)
        if accepted.any():
            accepted[accepted] = self.support(rows[accepted]) >= self.gate.support_min
        return accepted

    def clip(self, x: ArrayLike) -> Array:
        """Return process values cut at the box of the training samples, shape (k, 5)."""
        return self.gate.clip(np.asarray(x, dtype=np.float64))

    def predict_one(self, x: Sequence[float]) -> tuple[Array, float]:
        """Return the compensation (r,) [mm per 50 mm] and the support of one primitive.

        Parameters
        ----------
        x : sequence of 5 float
            Process values, not checked: ask `accepts` first.
        """
        features = self._features
        inputs = features.one(x)
        if len(self.columns) < len(features.names):
            inputs = [inputs[at] for at in self.columns]
        values, support = self.network.one(inputs)
        values *= self.gain.value
        if features.loaded:
            values *= load(x[1], x[3], x[4])
        return values, support

    def adapted(self, x: ArrayLike, measured: ArrayLike) -> 'DeformationModel':
        """Return the model with gains that take in measured compensations.

        Parameters
        ----------
        x : array_like, shape (k, 5)
            Process values.
        measured : array_like, shape (k, r)
            Compensations that were needed [mm per 50 mm].

        Raises
        ------
        ValueError
            If a value is not finite or of no primitive, or the rows do not match.
        """
        gain = self.gain
        predicted = self._values(check_process_values(x))
        needed = np.asarray(measured, dtype=np.float64)
        if needed.shape != predicted.shape:
            raise ValueError(
                f'measured: expected shape {predicted.shape}, but found {needed.shape}'
            )
        for said, found in zip(predicted, needed, strict=True):
            gain = gain.updated(said, found)
        return replace(self, gain=gain)

    def stored(self) -> 'DeformationModel':
        """Return the model as it was trained, all gains 1."""
        return replace(self, gain=AxisGain.unit(len(self.network.offset)))

    @cached_property
    def _features(self) -> FeatureSet:
        return feature_set(self.features)

    def _inputs(self, rows: Array) -> Array:
        return self._features.rows(rows)[:, self.columns]

    def _values(self, rows: Array) -> Array:
        """Return compensations without gain, shape (k, r)."""
        values = np.empty((len(rows), len(self.network.offset)))
        for part in _chunks(len(rows)):
            values[part] = self.network.values(self._inputs(rows[part]))
        if self._features.loaded:
            values *= load(*rows[:, [1, 3, 4]].T)[:, np.newaxis]
        return values


def _chunks(count: int) -> Iterator[slice]:
    return (slice(begin, begin + CHUNK) for begin in range(0, count, CHUNK))

# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""A network of dense layers at run time."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from fuzzycnc_ros.core.arrays import Array
from fuzzycnc_ros.core.thermal.document import Node
from fuzzycnc_ros.core.thermal.recursions.base import Recursion


def _rectified(values: Array) -> Array:
    return np.maximum(values, 0.0)


ACTIVATIONS: dict[str, Callable[[Array], Array]] = {'tanh': np.tanh, 'relu': _rectified}
"""Activations of hidden nodes by name."""


@dataclass(frozen=True, eq=False)
class LayersRecursion(Recursion):
    """Dense network of each channel, its last layer linear; static, so it has no state.

    Parameters
    ----------
    weights : tuple of ndarray, shape (c, out, in) each
        Weights of each layer; those of the first take kelvin, those of the last give metres.
    biases : tuple of ndarray, shape (c, out) each
        Biases of each layer.
    activation : {'tanh', 'relu'}
        Activation of the hidden nodes.
    """

    FORM: ClassVar[str] = 'layers'

    weights: tuple[Array, ...]
    biases: tuple[Array, ...]
    activation: str

    def __post_init__(self) -> None:
        """Refuse layers that do not follow on one another."""
        if self.activation not in ACTIVATIONS:
            raise ValueError(
                f'activation: expected one of {", ".join(ACTIVATIONS)}, but found '
                f'{self.activation!r}'
            )
        if not self.weights or len(self.weights) != len(self.biases):
            raise ValueError(
                f'weights: expected as many layers as biases, but found {len(self.weights)} and '
                f'{len(self.biases)}'
            )
        channels, _, before = self.weights[0].shape
        for number, (weight, bias) in enumerate(zip(self.weights, self.biases, strict=True)):
            nodes = weight.shape[1]
            good = weight.shape == (channels, nodes, before) and bias.shape == (channels, nodes)
            if not (good and np.isfinite(weight).all() and np.isfinite(bias).all()):
                raise ValueError(
                    f'weights: expected finite numbers of {channels} channels and {before} inputs '
                    f'in layer {number}, but found shapes {weight.shape} and {bias.shape}'
                )
            before = nodes
        if before != 1:
            raise ValueError(f'weights: expected one output per channel, but found {before}')

    @property
    def inputs(self) -> int:
        """Number p of inputs."""
        return int(self.weights[0].shape[2])

    @property
    def channels(self) -> int:
        """Number c of channels."""
        return int(self.weights[0].shape[0])

    def initial_state(self) -> Array:
        """Return the state, of which there is none."""
        return np.zeros(0)

    def step(self, rise: Array, state: Array) -> tuple[Array, Array]:
        """Return the thermal errors (c,) [m] and the empty state for one sample of rises (p,)."""
        activation = ACTIVATIONS[self.activation]
        values = self.weights[0] @ rise + self.biases[0]
        for weight, bias in zip(self.weights[1:], self.biases[1:], strict=True):
            values = (weight @ activation(values)[:, :, np.newaxis])[:, :, 0] + bias
        return values[:, 0], state

    def run(self, rise: Array) -> Array:
        """Return the thermal errors (n, c) [m] of a whole run of rises (n, p) [K]."""
        activation = ACTIVATIONS[self.activation]
        values = (
            np.matmul(rise, self.weights[0].transpose(0, 2, 1)) + self.biases[0][:, np.newaxis]
        )
        for weight, bias in zip(self.weights[1:], self.biases[1:], strict=True):
            values = activation(values) @ weight.transpose(0, 2, 1) + bias[:, np.newaxis]
        return np.asarray(values[:, :, 0].T)

    def with_interval(self, ratio: float) -> 'LayersRecursion':
        """Return the recursion itself: a static model holds at any interval."""
        return self

    def channel(self, channel: int) -> 'LayersRecursion':
        """Return the recursion of one channel out of several."""
        one = slice(channel, channel + 1)
        return LayersRecursion(
            weights=tuple(weight[one] for weight in self.weights),
            biases=tuple(bias[one] for bias in self.biases),
            activation=self.activation,
        )

    @classmethod
    def merge(cls, items: Sequence['LayersRecursion']) -> 'LayersRecursion | None':
        """Return one recursion for all channels, None if the networks are built differently."""
        built = {
            (item.activation, *(weight.shape[1:] for weight in item.weights)) for item in items
        }
        if len(built) > 1:
            return None
        layers = range(len(items[0].weights))
        return LayersRecursion(
            weights=tuple(np.concatenate([item.weights[n] for item in items]) for n in layers),
            biases=tuple(np.concatenate([item.biases[n] for item in items]) for n in layers),
            activation=items[0].activation,
        )

    def document(self) -> dict[str, Any]:
        """Return the numbers as JSON values."""
        return {
            'activation': self.activation,
            'layers': [
                {'weight': weight.tolist(), 'bias': bias.tolist()}
                for weight, bias in zip(self.weights, self.biases, strict=True)
            ],
        }

    @classmethod
    def read(cls, node: Node, inputs: int) -> 'LayersRecursion':
        """Return the recursion of a document."""
        weights, biases = [], []
        before = inputs
        for layer in node.get('layers').list():
            bias = [item.vector() for item in layer.get('bias').list()]
            nodes = {len(item) for item in bias}
            if len(nodes) != 1:
                layer.get('bias').refuse('the biases of one or more channels, of equal number')
            weight = [item.matrix(before) for item in layer.get('weight').list()]
            if any(len(item) not in nodes for item in weight) or len(weight) != len(bias):
                layer.get('weight').refuse('as many nodes as biases in every channel')
            weights.append(np.stack(weight))
            biases.append(np.stack(bias))
            before = nodes.pop()
        if not weights:
            node.get('layers').refuse('at least one layer')
        return cls(tuple(weights), tuple(biases), node.get('activation').text())

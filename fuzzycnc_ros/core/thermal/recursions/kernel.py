# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Gaussian process and layered network at run time."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
from scipy.linalg import cholesky, solve_triangular

from fuzzycnc_ros.core.arrays import Array
from fuzzycnc_ros.core.document import Node
from fuzzycnc_ros.core.thermal.recursions.base import Recursion, axes

SAMPLES_AT_ONCE = 512
"""Samples of a run that are worked out together."""

POINTS_MAX = 4000
"""Most kept samples: the deviation needs a matrix of their square per channel."""


@dataclass(frozen=True, eq=False)
class KernelRecursion(Recursion):
    """Posterior of a Gaussian process with a linear, a squared-exponential and a white kernel.

    y = direct x + offset + sum_i weight_i exp(-|(x - point_i) / length|^2 / 2).  It is static:
    it has no state, and holds at any interval.

    Parameters
    ----------
    points : ndarray, shape (m, p)
        Rises of the kept training samples [K].
    center : ndarray, shape (p,)
        Rise about which the linear kernel is meant [K].
    weight : ndarray, shape (c, m)
        Weight of the bump around each point [m].
    direct : ndarray, shape (c, p)
        Slope of the linear part [m/K].
    offset : ndarray, shape (c,)
        Constant of the linear part [m].
    length : ndarray, shape (c, p)
        Length scale of the bumps, positive [K].
    amplitude, constant, noise : ndarray, shape (c,)
        Prior standard deviation of the bumps, of the constant and of the noise [m].
    slope : ndarray, shape (c, p)
        Prior standard deviation of the slopes [m/K].
    """

    FORM: ClassVar[str] = 'kernel'
    STATIC: ClassVar[bool] = True

    points: Array = field(metadata=axes('m p'))
    center: Array = field(metadata=axes('p'))
    weight: Array = field(metadata=axes('c m'))
    direct: Array = field(metadata=axes('c p'))
    offset: Array = field(metadata=axes('c'))
    length: Array = field(metadata=axes('c p'))
    amplitude: Array = field(metadata=axes('c'))
    constant: Array = field(metadata=axes('c'))
    noise: Array = field(metadata=axes('c'))
    slope: Array = field(metadata=axes('c p'))

    def _check(self) -> None:
        points = len(self.points)
        if points > POINTS_MAX:
            raise ValueError(f'points: expected at most {POINTS_MAX} samples, but found {points}')
        if not (self.length > 0.0).all():
            raise ValueError(f'length: expected positive lengths in K, but found {self.length}')
        if not (self.noise > 0.0).all():
            raise ValueError(f'noise: expected positive numbers of m, but found {self.noise}')

    @cached_property
    def _exponent(self) -> tuple[Array, Array, Array]:
        """Exponents of all bumps as a polynomial of the rise: product, level, square.

        -|(x - point) / length|^2 / 2 = product x + level - square x^2, all channels stacked;
        one product of a matrix with the rise is far cheaper than all the differences.
        """
        square = self.length**-2.0
        product = (self.points * square[:, np.newaxis]).reshape(-1, self.inputs)
        level = -0.5 * (self.points**2 @ square.T).T
        return product, level, 0.5 * square

    def step(self, rise: Array, state: Array) -> tuple[Array, Array]:
        """Return the thermal errors (c,) [m] and the empty state for one sample of rises (p,)."""
        product, level, square = self._exponent
        exponent = (product @ rise).reshape(level.shape)
        exponent += level
        exponent -= (square @ (rise * rise))[:, np.newaxis]
        bumps = np.exp(exponent, out=exponent)
        bumps *= self.weight
        return self.direct @ rise + self.offset + bumps.sum(axis=1), state

    def run(self, rise: Array) -> Array:
        """Return the thermal errors (n, c) [m] of a whole run of rises (n, p) [K]."""
        values = rise @ self.direct.T + self.offset
        for part in _blocks(len(rise)):
            values[part] += np.einsum('nci,ci->nc', self._bumps(rise[part]), self.weight)
        return np.asarray(values)

    def standard_deviation(self, rise: Array) -> Array:
        """Return how far a measured displacement lies from the prediction.

        Parameters
        ----------
        rise : ndarray, shape (..., p)
            Rises [K].

        Returns
        -------
        ndarray, shape (..., c)
            Standard deviation of the posterior, noise included [m].
        """
        samples = rise.reshape(-1, self.inputs)
        variance = np.empty((len(samples), self.channels))
        for part in _blocks(len(samples)):
            slopes = (samples[part] - self.center) ** 2 @ (self.slope**2).T
            prior = self.constant**2 + self.amplitude**2 + slopes
            across = self._covariance(samples[part]).transpose(1, 2, 0)
            explained = ((self._whitening @ across) ** 2).sum(axis=1).T
            variance[part] = np.maximum(prior - explained, 0.0) + self.noise**2
        return np.asarray(np.sqrt(variance).reshape(*rise.shape[:-1], self.channels))

    def _bumps(self, rise: Array) -> Array:
        """Return the bumps, shape (n, c, m), at rises (n, p)."""
        product, level, square = self._exponent
        exponent = (rise @ product.T).reshape(-1, *level.shape)
        exponent += level
        exponent -= ((rise * rise) @ square.T)[:, :, np.newaxis]
        return np.asarray(np.exp(exponent, out=exponent))

    def _covariance(self, rise: Array) -> Array:
        """Return the prior covariance (n, c, m) [m^2] of the errors at rises and at the points."""
        covariance = self._bumps(rise)
        covariance *= (self.amplitude**2)[:, np.newaxis]
        covariance += (self.constant**2)[:, np.newaxis]
        covariance += ((rise - self.center) @ self._linear.T).reshape(covariance.shape)
        return covariance

    @cached_property
    def _linear(self) -> Array:
        """Covariance of the linear part at the points, per kelvin elsewhere, (c m, p) [m^2/K]."""
        slope = (self.slope**2)[:, np.newaxis]
        return ((self.points - self.center) * slope).reshape(-1, self.inputs)

    @cached_property
    def _whitening(self) -> Array:
        """Inverse Cholesky factor of the points' covariance, shape (c, m, m), lower [1/m]."""
        unit = np.eye(len(self.points))
        inverse = []
        covariance = self._covariance(self.points).transpose(1, 0, 2)
        for one, noise in zip(covariance, self.noise, strict=True):
            factor = cholesky(one + noise**2 * unit, lower=True)
            inverse.append(solve_triangular(factor, unit, lower=True))
        return np.stack(inverse)


def _blocks(samples: int) -> list[slice]:
    """Return the rows that are worked out together; all bumps at once would fill the memory."""
    starts = range(0, samples, SAMPLES_AT_ONCE)
    return [slice(first, first + SAMPLES_AT_ONCE) for first in starts]


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
    STATIC: ClassVar[bool] = True

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

# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""A trained T-S fuzzy neural network as a machine runs it, and its file: no training code."""

import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from math import floor

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fuzzycnc_ros.core import portable
from fuzzycnc_ros.core.arrays import LENGTH_MIN, NUMBER_MAX, Array
from fuzzycnc_ros.core.deformation.features import (
    COVERED_GAP,
    FEATURE_SETS,
    HALF_TURN,
    PROCESS_VALUES,
    FeatureSet,
    check_process_values,
    direction_range,
    feature_set,
    folded,
    half_turns,
    load,
)
from fuzzycnc_ros.core.document import DEFORMATION_MODEL, Node, parse_document
from fuzzycnc_ros.core.fuzzy.takagi_sugeno import normalised_firing


@dataclass(frozen=True, eq=False)
class Antecedent:
    """Rules of [deng2014]: memberships and fitness.

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
        distance = (apart * apart).sum(axis=-1)
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
        return _log_sum(self.log_fitness(scaled))


def _log_sum(logarithm: Array) -> Array:
    """Return the logarithm of the sum over the last axis of values given by their logarithms."""
    largest = logarithm.max(axis=-1, keepdims=True)
    return np.asarray(
        largest[..., 0] + portable.log(portable.exp(logarithm - largest).sum(axis=-1))
    )


@dataclass(frozen=True, eq=False)
class RuleNetwork:
    """Rules and weights in the units of inputs and outputs [deng2014].

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
    normalised : bool
        Whether the fitness of the rules is normalised over them.  A Gaussian process has a rule
        for each sample, whose fitness is the kernel; its consequents are constants, m = 1.

    Notes
    -----
    The scaling of the training is folded into the weights, and all outputs are computed in one
    product.
    """

    antecedent: Antecedent
    inner: Array | None
    outer: Array
    offset: Array
    normalised: bool = True

    def values(self, inputs: Array) -> Array:
        """Return the outputs, shape (k, r), of inputs (k, n)."""
        # Samples are in the last place, where loops over them are long and fast.
        columns = np.ascontiguousarray(inputs.T)
        logarithm = self.antecedent.log_fitness(inputs).T
        if self.normalised:
            fitness = normalised_firing(logarithm, axis=0)
        else:
            fitness = portable.exp(logarithm)
        pull = portable.matmul(self._outer, fitness).reshape(len(self.offset), -1, len(inputs))
        if self.inner is None:
            if self.normalised:
                pull[:, 1:] *= columns
        else:
            nodes = portable.matmul(self._slopes, columns)
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
        fitness = portable.exp(least - fitness)
        total = fitness.sum()
        pull = portable.matmul(self._outer, fitness).reshape(len(self.offset), -1)
        if not self.normalised:
            values = pull[:, 0] * portable.exp(-least) + self.offset
            return values, float(portable.log(total) - least)
        if self.inner is None:
            pull *= np.concatenate([_ONE, row])
        else:
            pull *= _sigmoid(portable.matmul(self._slopes, row) + self._biases).reshape(pull.shape)
        values = pull.sum(axis=1)
        values /= total
        values += self.offset
        return values, float(portable.log(total) - least)

    @cached_property
    def _decay(self) -> Array:
        rules = self.antecedent
        return np.asarray(portable.power(rules.decay, 1.0 / rules.power) / rules.width)

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
    """Return 1 / (1 + exp(-a)) of values; tanh cannot overflow."""
    return 0.5 * (portable.tanh(0.5 * values) + 1.0)


_TOLERANCE = 1e-6
"""Margin added to the box [deg, mm]: directions of a path are rounded."""

SUPPORT_QUANTILE = 0.01
"""Share of the training samples whose support lies below the least that is let pass."""


@dataclass(frozen=True, eq=False)
class Gate:
    """Box of the training samples and the least support.

    Support alone is no guard: it is a sum over single inputs, and a deep foot in a thin sheet has
    an ordinary depth and an ordinary thickness.  So the box bounds depth over thickness as well.

    Parameters
    ----------
    low, high : ndarray, shape (5,)
        Least and largest process values; directions are those between, and their opposites.
    ratio_low, ratio_high : float
        Least and largest depth over thickness [-].
    support_min : float
        Least logarithm of the support by the rules.
    """

    low: Array
    high: Array
    ratio_low: float
    ratio_high: float
    support_min: float

    @staticmethod
    def of_training(x: Array, support: Array, quantile: float = SUPPORT_QUANTILE) -> 'Gate':
        """Return the gate of training samples (k, 5) and the logarithm of their support (k,)."""
        ratio = x[:, 1] / x[:, 4]
        low, high = x.min(axis=0), x.max(axis=0)
        low[0], high[0] = direction_range(x[:, 0])
        return Gate(
            low,
            high,
            float(ratio.min()),
            float(ratio.max()),
            float(np.quantile(support, quantile)),
        )

    @property
    def fold_from(self) -> float:
        """Start of the half turn that has the directions of the samples amid [deg]."""
        return 0.5 * float(self.low[0] + self.high[0] - HALF_TURN)

    @property
    def all_round(self) -> bool:
        """True if the samples cover all directions."""
        return bool(self.high[0] - self.low[0] >= HALF_TURN - COVERED_GAP)

    def inside(self, x: Array) -> NDArray[np.bool_]:
        """Return whether rows of process values (k, 5) lie in the box; NaN does not."""
        rows = x[:, 1:]
        in_box = (rows >= self.low[1:] - _TOLERANCE) & (rows <= self.high[1:] + _TOLERANCE)
        with np.errstate(invalid='ignore'):  # an infinite direction has no place, as NaN
            beyond = np.mod(x[:, 0] - self.low[0] + _TOLERANCE, HALF_TURN)
        span = HALF_TURN if self.all_round else self.high[0] - self.low[0]
        within = in_box.all(axis=1) & (beyond <= span + 2.0 * _TOLERANCE)
        depth, kind, thickness = x[:, 1], x[:, 2], x[:, 4]
        within &= (kind == 1.0) | (kind == 2.0)
        # Products, not ratios: a thickness of 0 is refused without a division.
        within &= depth >= self.ratio_low * thickness - _TOLERANCE
        within &= depth <= self.ratio_high * thickness + _TOLERANCE
        return np.asarray(within)

    def accepts(self, x: Array, support: Array) -> NDArray[np.bool_]:
        """Return whether rows lie in the box and have support enough, shape (k,)."""
        return np.asarray(self.inside(x) & (support >= self.support_min))

    def clip(self, x: Array) -> Array:
        """Return the rows with each value, and depth over thickness, cut at the box.

        A direction is cut at the nearer end, and stays in its half of the full turn.
        """
        turned = HALF_TURN * half_turns(x[:, 0], self.fold_from)
        cut = x.copy()
        cut[:, 0] -= turned
        cut = np.clip(cut, self.low, self.high)
        cut[:, 0] += turned
        cut[:, 1] = np.clip(cut[:, 1], self.ratio_low * cut[:, 4], self.ratio_high * cut[:, 4])
        return np.asarray(cut)


GAIN_MIN, GAIN_MAX = 0.5, 2.0
"""Bounds of a gain [-]: beyond them the model is to be trained anew."""

PRIOR_VARIANCE = 0.1
"""Variance of a gain before anything was measured [-]."""

NOISE_VARIANCE = 0.25
"""Variance of a measured compensation about the scaled prediction [mm^2 per (50 mm)^2]."""


@dataclass(frozen=True, eq=False)
class AxisGain:
    """Gains k with s = k s_model, by scalar recursive least squares.

    Parameters
    ----------
    value : ndarray, shape (r,)
        Gain of each output [-], within 0.5 and 2.
    variance : ndarray, shape (r,)
        Variance of each gain [-].

    Examples
    --------
    >>> gain = AxisGain.unit(2)
    >>> for _ in range(5):
    ...     gain = gain.updated([4.0, 2.0], [5.0, 2.5])
    >>> gain.value.round(2).tolist()
    [1.24, 1.22]
    """

    value: Array
    variance: Array

    @staticmethod
    def unit(outputs: int) -> 'AxisGain':
        """Return the gains of a model that nothing was measured against."""
        return AxisGain(np.ones(outputs), np.full(outputs, PRIOR_VARIANCE))

    def updated(self, predicted: ArrayLike, measured: ArrayLike) -> 'AxisGain':
        """Return the gains after one sample.

        Parameters
        ----------
        predicted : array_like, shape (r,)
            Output of the model without gain [mm per 50 mm].
        measured : array_like, shape (r,)
            Compensation that was needed [mm per 50 mm].

        Raises
        ------
        ValueError
            If a value is not finite or their number is not that of the gains.
        """
        pair = np.array([predicted, measured], dtype=np.float64)
        if pair.shape != (2, len(self.value)) or not np.isfinite(pair).all():
            raise ValueError(
                f'gain: expected {len(self.value)} finite predictions and measurements, '
                f'but found {predicted!r} and {measured!r}'
            )
        correction = (
            self.variance * pair[0] / (NOISE_VARIANCE + self.variance * (pair[0] * pair[0]))
        )
        value = self.value + correction * (pair[1] - self.value * pair[0])
        variance = (1.0 - correction * pair[0]) * self.variance
        return AxisGain(np.clip(value, GAIN_MIN, GAIN_MAX), variance)


_CHUNK = 500
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

        Directions may be any: opposite ones have opposite compensations.

        Raises
        ------
        ValueError
            If a row is none of a primitive, see `check_process_values`.
        """
        rows, sign = self._folded(x)
        return self._values(rows) * sign[:, np.newaxis] * self.gain.value

    def support(self, x: ArrayLike) -> Array:
        """Return the logarithm of the rules' support, shape (k,), of process values (k, 5)."""
        rows, _ = self._folded(x)
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
        turns = floor((x[0] - self.gate.fold_from) / HALF_TURN)
        inputs = features.one((x[0] - HALF_TURN * turns, *x[1:]))
        if len(self.columns) < len(features.names):
            inputs = [inputs[at] for at in self.columns]
        values, support = self.network.one(inputs)
        values *= self.gain.value
        if features.loaded:
            values *= load(x[1], x[3], x[4])
        return (-values if turns % 2 else values), support

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
        rows, sign = self._folded(x)
        predicted = self._values(rows) * sign[:, np.newaxis]
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
    def corrects(self) -> bool:
        """True if it compensates anything: 'none' may be what did best on held-out samples."""
        return bool(self.network.outer.any() or self.network.offset.any())

    @cached_property
    def _features(self) -> FeatureSet:
        return feature_set(self.features)

    def _folded(self, x: ArrayLike) -> tuple[Array, Array]:
        """Return checked process values in the half turn of the samples, and their signs."""
        return folded(check_process_values(x), self.gate.fold_from)

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
    return (slice(begin, begin + _CHUNK) for begin in range(0, count, _CHUNK))


_SCHEMA_VERSIONS = (1, 2)
"""Versions of the layout; 2 has rules whose fitness is not normalised, those of a process."""

MODEL_SIZE_MAX = 4 * 1024 * 1024
"""Largest document that is read [characters]; a default model takes 0.03 million."""


def write_model(model: DeformationModel) -> str:
    """Return the model as a JSON document; equal models give equal text."""
    network, gate = model.network, model.gate
    rules = network.antecedent
    names = FEATURE_SETS[model.features].names
    document = {
        'schema': DEFORMATION_MODEL,
        'schema_version': 1 if network.normalised else 2,
        'units': {'direction': 'deg', 'length': 'mm', 'compensation': 'mm per 50 mm'},
        'features': model.features,
        'inputs': [names[at] for at in model.columns],
        'rules': {
            'center': rules.center.tolist(),
            'width': rules.width.tolist(),
            'decay': rules.decay,
            'power': rules.power,
        },
        'inner': None if network.inner is None else network.inner.tolist(),
        'outer': network.outer.tolist(),
        'offset': network.offset.tolist(),
        'gate': {
            'low': gate.low.tolist(),
            'high': gate.high.tolist(),
            'ratio_low': gate.ratio_low,
            'ratio_high': gate.ratio_high,
            'support_min': gate.support_min,
        },
        'gain': {'value': model.gain.value.tolist(), 'variance': model.gain.variance.tolist()},
    }
    return json.dumps(document, allow_nan=False) + '\n'


def read_model(text: str) -> DeformationModel:
    """Return the model that `write_model` wrote.

    Raises
    ------
    ModelFileError
        If the text is too large, no JSON, of another schema or version, or holds a value of
        another type, shape or range.
    """
    return model_of(text, parse_document(text, 'model file', MODEL_SIZE_MAX))


def model_of(text: str, root: Node) -> DeformationModel:
    """Return the model of a document and its parsed content; errors as `read_model`."""
    if len(text) > MODEL_SIZE_MAX:
        root.refuse(f'at most {MODEL_SIZE_MAX} characters')
    root.check_kind('schema', DEFORMATION_MODEL)
    version = root.get('schema_version')
    if type(version.value) is not int or version.value not in _SCHEMA_VERSIONS:
        known = ' or '.join(map(str, _SCHEMA_VERSIONS))
        version.refuse(f'schema version {known}; train the model anew')
    features = root.get('features').text()
    if features not in FEATURE_SETS:
        root.get('features').refuse(f'one of {", ".join(FEATURE_SETS)}')
    columns = _columns(root.get('inputs'), FEATURE_SETS[features].names)
    network = _network(root, len(columns), normalised=version.value == 1)
    gate = root.get('gate')
    low = _vector(gate.get('low'), len(PROCESS_VALUES), -NUMBER_MAX)
    return DeformationModel(
        features,
        columns,
        network,
        Gate(
            low,
            _at_least(gate.get('high'), _vector(gate.get('high'), len(low), -NUMBER_MAX), low),
            gate.get('ratio_low').number(0.0, NUMBER_MAX),
            gate.get('ratio_high').number(0.0, NUMBER_MAX),
            gate.get('support_min').number(-NUMBER_MAX, NUMBER_MAX),
        ),
        _gain(root.get('gain'), len(network.offset)),
    )


def _columns(node: Node, names: tuple[str, ...]) -> tuple[int, ...]:
    found = node.texts()
    columns = tuple(names.index(name) for name in found if name in names)
    if len(columns) != len(found) or not columns or sorted(set(columns)) != list(columns):
        node.refuse(f'inputs out of {", ".join(names)}, in this order')
    return columns


def _network(root: Node, inputs: int, *, normalised: bool) -> RuleNetwork:
    rules = root.get('rules')
    center = rules.get('center').matrix(inputs, -NUMBER_MAX, NUMBER_MAX)
    width = rules.get('width').matrix(inputs, LENGTH_MIN, NUMBER_MAX)
    if not len(center) or len(width) != len(center):
        rules.get('width').refuse(f'widths of {len(center)} rules, at least one')
    decay, power = rules.get('decay').number(LENGTH_MIN, NUMBER_MAX), rules.get('power')
    if power.value not in (1, 2):
        power.refuse('1 or 2')
    offset = _vector(root.get('offset'), 2, -NUMBER_MAX)
    inner = root.get('inner')
    weights = None if inner.value is None else _cube(inner, len(offset), inputs + 1)
    if not normalised and weights is not None:
        inner.refuse('none in version 2')
    outer = _cube(root.get('outer'), len(offset), len(center))
    linear = inputs + 1 if normalised else 1
    if outer.shape[1] != (linear if weights is None else weights.shape[1]):
        root.get('outer').refuse('as many rows as there are hidden nodes')
    antecedent = Antecedent(center, width, decay, int(power.number()))
    return RuleNetwork(antecedent, weights, outer, offset, normalised)


def _cube(node: Node, first: int, last: int) -> Array:
    """Return `first` matrices of equal numbers of rows and `last` columns."""
    matrices = [item.matrix(last, -NUMBER_MAX, NUMBER_MAX) for item in node.list()]
    sizes = {len(item) for item in matrices}
    if len(matrices) != first or len(sizes) != 1 or 0 in sizes:
        node.refuse(f'{first} matrices of equal size')
    return np.stack(matrices)


def _vector(node: Node, size: int, low: float, high: float = NUMBER_MAX) -> Array:
    values = node.vector(low, high)
    if len(values) != size:
        node.refuse(f'{size} numbers')
    return values


def _at_least(node: Node, values: Array, low: Array) -> Array:
    if not (values >= low).all():
        node.refuse('no value below the lower bound')
    return values


def _gain(node: Node, size: int) -> AxisGain:
    return AxisGain(
        _vector(node.get('value'), size, GAIN_MIN, GAIN_MAX),
        _vector(node.get('variance'), size, 0.0),
    )

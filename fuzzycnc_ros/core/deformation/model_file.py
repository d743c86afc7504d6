# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Deformation models as JSON documents; nothing in one is believed before it was checked."""

import json

import numpy as np

from fuzzycnc_ros.core.arrays import Array
from fuzzycnc_ros.core.deformation.antecedent import Antecedent
from fuzzycnc_ros.core.deformation.features import FEATURE_SETS, PROCESS_VALUES
from fuzzycnc_ros.core.deformation.gain import GAIN_MAX, GAIN_MIN, AxisGain
from fuzzycnc_ros.core.deformation.gate import Gate
from fuzzycnc_ros.core.deformation.model import DeformationModel
from fuzzycnc_ros.core.deformation.rule_network import RuleNetwork
from fuzzycnc_ros.core.document import Node, parse_document

SCHEMA = 'fuzzycnc/deformation-model'
"""What a model file says it is."""

SCHEMA_VERSION = 1
"""Version of the layout."""

SIZE_MAX = 4 * 1024 * 1024
"""Largest document that is read [characters]; a default model takes 0.03 million."""


def write_model(model: DeformationModel) -> str:
    """Return the model as a JSON document; equal models give equal text."""
    network, gate = model.network, model.gate
    rules = network.antecedent
    names = FEATURE_SETS[model.features].names
    document = {
        'schema': SCHEMA,
        'schema_version': SCHEMA_VERSION,
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
    root = parse_document(text, 'model file', SIZE_MAX)
    if root.get('schema').text() != SCHEMA:
        root.get('schema').refuse(f'the schema {SCHEMA!r}')
    version = root.get('schema_version')
    if type(version.value) is not int or version.value != SCHEMA_VERSION:
        version.refuse(f'schema version {SCHEMA_VERSION}; train the model anew')
    features = root.get('features').text()
    if features not in FEATURE_SETS:
        root.get('features').refuse(f'one of {", ".join(FEATURE_SETS)}')
    columns = _columns(root.get('inputs'), FEATURE_SETS[features].names)
    network = _network(root, len(columns))
    gate = root.get('gate')
    low = _vector(gate.get('low'), len(PROCESS_VALUES))
    return DeformationModel(
        features,
        columns,
        network,
        Gate(
            low,
            _at_least(gate.get('high'), _vector(gate.get('high'), len(low)), low),
            gate.get('ratio_low').number(),
            gate.get('ratio_high').number(),
            gate.get('support_min').number(),
        ),
        _gain(root.get('gain'), len(network.offset)),
    )


def _columns(node: Node, names: tuple[str, ...]) -> tuple[int, ...]:
    found = node.texts()
    columns = tuple(names.index(name) for name in found if name in names)
    if len(columns) != len(found) or not columns or sorted(set(columns)) != list(columns):
        node.refuse(f'inputs out of {", ".join(names)}, in this order')
    return columns


def _network(root: Node, inputs: int) -> RuleNetwork:
    rules = root.get('rules')
    center = rules.get('center').matrix(inputs)
    width = rules.get('width').matrix(inputs)
    if not len(center) or len(width) != len(center) or not (width > 0.0).all():
        rules.get('width').refuse(f'positive widths of {len(center)} rules, at least one')
    decay, power = rules.get('decay'), rules.get('power')
    if not decay.number() > 0.0:
        decay.refuse('more than 0')
    if power.value not in (1, 2):
        power.refuse('1 or 2')
    offset = root.get('offset').vector()
    if len(offset) != 2:
        root.get('offset').refuse('two numbers, X and Y')
    inner = root.get('inner')
    weights = None if inner.value is None else _cube(inner, len(offset), inputs + 1)
    outer = _cube(root.get('outer'), len(offset), len(center))
    if outer.shape[1] != (inputs + 1 if weights is None else weights.shape[1]):
        root.get('outer').refuse('as many rows as there are hidden nodes')
    return RuleNetwork(
        Antecedent(center, width, decay.number(), int(power.number())), weights, outer, offset
    )


def _cube(node: Node, first: int, last: int) -> Array:
    """Return `first` matrices of equal numbers of rows and `last` columns."""
    matrices = [item.matrix(last) for item in node.list()]
    sizes = {len(item) for item in matrices}
    if len(matrices) != first or len(sizes) != 1 or 0 in sizes:
        node.refuse(f'{first} matrices of equal size')
    return np.stack(matrices)


def _vector(node: Node, size: int) -> Array:
    values = node.vector()
    if len(values) != size:
        node.refuse(f'{size} numbers')
    return values


def _at_least(node: Node, values: Array, low: Array) -> Array:
    if not (values >= low).all():
        node.refuse('no value below the lower bound')
    return values


def _gain(node: Node, size: int) -> AxisGain:
    value, variance = _vector(node.get('value'), size), _vector(node.get('variance'), size)
    if not ((value >= GAIN_MIN) & (value <= GAIN_MAX)).all():
        node.get('value').refuse(f'gains from {GAIN_MIN:g} to {GAIN_MAX:g}')
    if not (variance >= 0.0).all():
        node.get('variance').refuse('no negative variance')
    return AxisGain(value, variance)

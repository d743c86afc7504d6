# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""JSON Schema of machine files, for editors that complete and check them.

It follows from the dataclasses that the reader fills: they are the parameters of simulations and
nodes too, have units and bounds already, and must load where there is no pydantic.  Models of
pydantic beside them would say everything twice.
"""

from collections.abc import Mapping
from dataclasses import Field, fields
from itertools import combinations
from typing import Any

from fuzzycnc_ros.core.config import Config
from fuzzycnc_ros.core.machine.knowledge import AxisKnowledge
from fuzzycnc_ros.core.machine.machine_data import LINEAR_AXES, PLANTS, AxisLimits, PathLimits
from fuzzycnc_ros.core.machine.path_loop import ContouringConfig
from fuzzycnc_ros.core.units import NUMBER, unit_names
from fuzzycnc_ros.machine_file.reader import FAULTS


def machine_schema() -> dict[str, Any]:
    """Return the JSON Schema (draft 2020-12) of machine files.

    Examples
    --------
    >>> machine_schema()['properties']['linuxcnc']['properties']['ini']['type']
    'string'
    """
    plants = [
        _mapping(
            f'Model `{name}`',
            {'model': {'const': name, 'description': 'Model of the axis'}}
            | _parameters(kind, without=FAULTS),
            ['model'],
        )
        for name, kind in PLANTS.items()
    ]
    controller = {
        'name': {'type': 'string', 'description': 'Position controller'},
        'settings': {
            'type': 'object',
            'description': 'Parameters of the controller that are not its defaults',
            'additionalProperties': {
                'anyOf': [{'type': 'number'}, {'type': 'string', 'pattern': f'^{NUMBER}$'}]
            },
        },
    }
    axis = {
        'limits': _mapping('What the axis is allowed', _parameters(AxisLimits)),
        'plant': {
            'description': 'Model of the axis, for its controllers',
            'type': 'object',
            'properties': {'model': {'enum': list(PLANTS)}},
            'oneOf': plants,
        },
        'knowledge': _mapping('How well the model is known', _parameters(AxisKnowledge)),
        'controller': _mapping('Controller that the axis is used with', controller),
    }
    constant = _number('s^2', 1e-9, 1.0) | {
        'description': 'Contour error over normal acceleration [s^2]'
    }
    pairs = [''.join(pair) for pair in combinations(LINEAR_AXES, 2)]
    ini = {'type': 'string', 'description': 'LinuxCNC configuration, relative to this file'}
    top = {
        'machine': {'type': ['string', 'number'], 'description': 'What the machine is called'},
        'linuxcnc': _mapping('Where limits are read from', {'ini': ini}),
        'axes': {
            'type': 'object',
            'description': 'Axes by their letters, in the order of the machine',
            'patternProperties': {'^[A-Za-z][A-Za-z0-9]{0,7}$': _mapping('One axis', axis)},
            'additionalProperties': False,
        },
        'path': _mapping('What the motion along a path is allowed', _parameters(PathLimits)),
        'loop': _mapping('How the axes follow a path', _parameters(ContouringConfig)),
        'contour_constant': _mapping('By pair of axes', dict.fromkeys(pairs, constant)),
    }
    return {
        '$schema': 'https://json-schema.org/draft/2020-12/schema',
        'title': 'Machine file of fuzzycnc',
        **_mapping('Description of a machine; omitted entries have defaults', top),
    }


def _mapping(
    description: str, properties: Mapping[str, Any], required: list[str] | None = None
) -> dict[str, Any]:
    found = {
        'description': description,
        'type': 'object',
        'properties': dict(properties),
        'additionalProperties': False,
    }
    return found | ({'required': required} if required else {})


def _parameters(kind: type[Config], without: frozenset[str] = frozenset()) -> dict[str, Any]:
    return {item.name: _parameter(item) for item in fields(kind) if item.name not in without}


def _parameter(item: Field[Any]) -> dict[str, Any]:
    """Return the schema of a field that `param` has made."""
    meta, default = item.metadata, item.default
    found: dict[str, Any]
    if isinstance(default, bool):
        found = {'type': 'boolean'}
    elif isinstance(default, int):
        found = {'type': 'integer', 'minimum': meta['low'], 'maximum': meta['high']}
    elif isinstance(default, float):
        found = _number(meta['unit'], meta['low'], meta['high'])
    else:
        found = {'type': 'string'} | ({'enum': list(meta['choices'])} if meta['choices'] else {})
    unit = '' if meta['unit'] == '-' else f' [{meta["unit"]}]'
    return found | {'description': f'{meta["doc"]}{unit}', 'default': default}


def _number(unit: str, low: float, high: float) -> dict[str, Any]:
    """Return the schema of a number in SI, or of a text with its unit."""
    return {'anyOf': [{'type': 'number', 'minimum': low, 'maximum': high}, _text(unit)]}


def _text(unit: str) -> dict[str, str]:
    names = '|'.join(name.replace('^', r'\^') for name in unit_names(unit))
    return {'type': 'string', 'pattern': rf'^\s*{NUMBER}\s*({names})?\s*$'}

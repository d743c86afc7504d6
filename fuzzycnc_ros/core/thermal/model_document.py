# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The JSON document of a thermal model, and the refusal of everything that is not one.

A model file decides what a machine is told, so nothing in it is believed: sizes, types, shapes
and finiteness are checked, and nothing is executed, unlike with pickle.
"""

import json
from collections.abc import Mapping, Sequence
from math import inf, isfinite
from typing import TYPE_CHECKING, Any

import numpy as np

from fuzzycnc_ros.core.arrays import Array
from fuzzycnc_ros.core.document import ModelFileError, Node, parse_document
from fuzzycnc_ros.core.thermal.band import Band
from fuzzycnc_ros.core.thermal.candidate import CANDIDATES, UNCOMPENSATED, Candidate, Settings
from fuzzycnc_ros.core.thermal.cold_start import ColdStart
from fuzzycnc_ros.core.thermal.domain import Domain
from fuzzycnc_ros.core.thermal.fingerprint import Fingerprint
from fuzzycnc_ros.core.thermal.recursions import read_recursion, write_recursion
from fuzzycnc_ros.core.thermal.sensor_watch import SensorCluster, SensorSelection, SensorWatchModel

if TYPE_CHECKING:
    from fuzzycnc_ros.core.thermal.model import ThermalModel

SCHEMA = 'fuzzycnc/thermal-model'
"""What a model file says it is."""

SCHEMA_VERSION = 3
"""Version of the layout that is written."""

READABLE_VERSIONS = (1, 2, 3)
"""Versions that are read.

The first knew neither drivers nor bounds; the second had an ellipsoid in all directions as its
domain, one growth of the band for all models, and neither cold starts nor fingerprints."""

GROWTH_BEFORE = 2.0
"""Growth of the band in files of earlier versions [-]."""

UNITS = {'time': 's', 'rise': 'K', 'displacement': 'm'}
"""Units of the numbers in a model file."""

SIZE_MAX = 16 * 1024 * 1024
"""Largest model file that is read [characters]; 76 inputs with all candidates take 3.6 million."""


def write_document(model: 'ThermalModel') -> str:
    """Return the model as a JSON document; equal models give equal text."""
    document = {
        'schema': SCHEMA,
        'schema_version': SCHEMA_VERSION,
        'units': UNITS,
        'inputs': list(model.inputs),
        'drivers': list(model.drivers),
        'interval': model.interval,
        'reference': model.reference,
        'channels': [
            {
                'name': name,
                'axis': axis,
                'default': default,
                'residual_deviation': deviation,
                'bound': bound,
            }
            for name, axis, default, deviation, bound in zip(
                model.channel,
                model.axis,
                model.default,
                model.band.deviation.tolist(),
                [None] * len(model.channel) if model.bound is None else model.bound.tolist(),
                strict=True,
            )
        ],
        'training_runs': list(model.runs),
        'candidates': {name: _candidate(item) for name, item in model.candidates.items()},
        'omitted': dict(model.omitted),
        'selection': _selection(model.selection),
        'band_growth': model.band.growth,
        'domain': {
            'mean': model.domain.mean.tolist(),
            'directions': model.domain.directions.tolist(),
            'reach': model.domain.reach.tolist(),
            'thickness': model.domain.thickness if isfinite(model.domain.thickness) else None,
            'drive': model.domain.drive.tolist(),
        },
        'cold_start': None if model.cold_start is None else model.cold_start.document(),
        'fingerprints': [item.document() for item in model.fingerprints],
        'watch': None if model.watch is None else model.watch.document(),
    }
    return json.dumps(document, allow_nan=False) + '\n'


def read_document(text: str) -> dict[str, Any]:
    """Return the fields of the `ThermalModel` that a JSON document describes.

    Parameters
    ----------
    text : str
        Text that `write_document` returned.

    Returns
    -------
    dict
        Arguments of `ThermalModel`.

    Raises
    ------
    ModelFileError
        If it is too large, no JSON, of another schema or version, or holds a value of
        another type or shape.
    """
    root = parse_document(text, 'model file', SIZE_MAX)
    if root.get('schema').text() != SCHEMA:
        root.get('schema').refuse(f'the schema {SCHEMA!r}')
    version = root.get('schema_version').value
    if type(version) is not int or version not in READABLE_VERSIONS:
        raise ModelFileError(
            f'model file: expected schema version {SCHEMA_VERSION}, but found '
            f'{root.get("schema_version").value!r}; train the model anew with this version'
        )
    if root.get('units').value != UNITS:
        root.get('units').refuse(f'the units {UNITS}')
    try:
        return _fields(root)
    except ModelFileError:
        raise
    except RecursionError as error:
        raise ModelFileError('model file: expected recursions that are not nested') from error
    except ValueError as error:
        raise ModelFileError(f'model file: {error}') from error


def _held_out(values: Array) -> list[float | None] | None:
    """Return figures, null for infinity; null for all of a candidate that was not judged."""
    if np.isnan(values).all():
        return None
    return [value if isfinite(value) else None for value in values.tolist()]


def _candidate(candidate: Candidate) -> dict[str, Any]:
    return {
        'settings': list(candidate.settings),
        'problems': list(candidate.problems),
        'held_out_rms': _held_out(candidate.held_out_rms),
        'held_out_max': _held_out(candidate.held_out_max),
        'recursion': write_recursion(candidate.recursion),
    }


def _selection(selection: SensorSelection) -> dict[str, Any]:
    return {
        'method': selection.method,
        'partition_coefficient': selection.partition_coefficient,
        'xie_beni': selection.xie_beni if isfinite(selection.xie_beni) else None,
        'dropped': list(selection.dropped),
        'calibration': list(selection.calibration),
        'clusters': [
            {
                'member': list(cluster.member),
                'score': list(cluster.score),
                'chosen': cluster.chosen,
                'substitute': list(cluster.substitute),
                'gain': list(cluster.gain),
                'correlation': list(cluster.correlation),
            }
            for cluster in selection.clusters
        ],
    }


def _fields(root: Node) -> dict[str, Any]:
    inputs = root.get('inputs').texts()
    channels = root.get('channels').list()
    version = root.get('schema_version').value
    first = version == 1
    drivers = () if first else root.get('drivers').texts()
    width = len(inputs) + len(drivers)
    return dict(
        inputs=inputs,
        interval=root.get('interval').number(),
        channel=tuple(node.get('name').text() for node in channels),
        axis=tuple(node.get('axis').text() for node in channels),
        runs=root.get('training_runs').texts(),
        candidates={
            name: _read_candidate(name, node, width)
            for name, node in root.get('candidates').items().items()
        },
        default=tuple(node.get('default').text() for node in channels),
        selection=_read_selection(root.get('selection')),
        domain=(_read_ellipsoid if version < 3 else _read_domain)(
            root.get('domain'), len(inputs), first
        ),
        band=Band(
            np.array([_positive(node.get('residual_deviation')) for node in channels]),
            GROWTH_BEFORE if version < 3 else _positive(root.get('band_growth')),
        ),
        drivers=drivers,
        bound=_read_bound(channels, first),
        omitted={name: node.text() for name, node in root.get('omitted').items().items()},
        reference=root.get('reference').text(),
        watch=None if first else _read_watch(root.get('watch')),
        cold_start=None if version < 3 else _read_start(root.get('cold_start')),
        fingerprints=()
        if version < 3
        else tuple(Fingerprint.read(node) for node in root.get('fingerprints').list()),
    )


def _read_domain(node: Node, inputs: int, first: bool) -> Domain:
    thickness = node.get('thickness')
    return Domain(
        mean=node.get('mean').vector(),
        directions=node.get('directions').matrix(inputs),
        reach=node.get('reach').vector(),
        thickness=inf if thickness.value is None else thickness.number(),
        drive=np.empty(0) if first else node.get('drive').vector(),
    )


def _read_ellipsoid(node: Node, inputs: int, first: bool) -> Domain:
    """Return the domain of an earlier version, which has the border in every direction."""
    inverse = node.get('inverse_covariance').matrix(inputs)
    if inverse.shape != (inputs, inputs):
        node.get('inverse_covariance').refuse(f'{inputs} rows')
    curvature, directions = np.linalg.eigh(0.5 * (inverse + inverse.T))
    if not (curvature > 0.0).all():
        node.get('inverse_covariance').refuse('a positive definite matrix')
    return Domain(
        mean=node.get('mean').vector(),
        directions=directions.T,
        reach=node.get('limit').number() / np.sqrt(curvature),
        thickness=inf,
        drive=np.empty(0) if first else node.get('drive').vector(),
    )


def _read_start(node: Node) -> ColdStart | None:
    return None if node.value is None else ColdStart.read(node)


def _read_watch(node: Node) -> SensorWatchModel | None:
    return None if node.value is None else SensorWatchModel.read(node)


def _read_bound(channels: Sequence[Node], first: bool) -> Array | None:
    nodes = [] if first else [node.get('bound') for node in channels]
    if all(node.value is None for node in nodes):
        return None
    return np.array([node.number() for node in nodes])


def _positive(node: Node) -> float:
    value = node.number()
    if value < 0.0:
        node.refuse('a number of 0 or more')
    return value


def _read_candidate(name: str, node: Node, inputs: int) -> Candidate:
    if name not in (UNCOMPENSATED, *CANDIDATES):
        node.refuse(f'one of {", ".join(CANDIDATES)} and not {name!r}')
    recursion = read_recursion(node.get('recursion'), inputs)
    unknown = np.full(recursion.channels, np.nan)
    scores = {
        field: unknown if node.get(field).value is None else node.get(field).numbers_or_infinite()
        for field in ('held_out_rms', 'held_out_max')
    }
    for field, values in scores.items():
        if len(values) != recursion.channels:
            node.get(field).refuse(f'{recursion.channels} numbers')
    return Candidate(
        name=name,
        settings=_read_settings(node.get('settings'), recursion.channels),
        recursion=recursion,
        problems=node.get('problems').texts(),
        held_out_rms=scores['held_out_rms'],
        held_out_max=scores['held_out_max'],
    )


def _read_settings(node: Node, channels: int) -> tuple[Settings, ...]:
    """Return the settings of each channel; earlier versions have one for all."""
    if not isinstance(node.value, list):
        return (_read_setting(node),) * channels
    settings = tuple(_read_setting(item) for item in node.list())
    if len(settings) != channels:
        node.refuse(f'settings of {channels} channels')
    return settings


def _read_setting(node: Node) -> Settings:
    settings: Settings = {}
    for name, item in node.items().items():
        if isinstance(item.value, list):
            settings[name] = item.numbers()
        else:
            settings[name] = item.text() if isinstance(item.value, str) else item.number()
    return settings


def _read_selection(node: Node) -> SensorSelection:
    index = node.get('xie_beni')
    return SensorSelection(
        method=node.get('method').text(),
        clusters=tuple(_read_cluster(item) for item in node.get('clusters').list()),
        partition_coefficient=node.get('partition_coefficient').number(),
        xie_beni=float('nan') if index.value is None else index.number(),
        dropped=node.get('dropped').texts(),
        calibration=node.get('calibration').texts(),
    )


def _read_cluster(node: Node) -> SensorCluster:
    cluster = SensorCluster(
        member=node.get('member').texts(),
        score=node.get('score').numbers(),
        chosen=node.get('chosen').text(),
        substitute=node.get('substitute').texts(),
        gain=node.get('gain').numbers(),
        correlation=node.get('correlation').numbers(),
    )
    lengths: Mapping[str, tuple[int, int]] = {
        'score': (len(cluster.score), len(cluster.member)),
        'gain': (len(cluster.gain), len(cluster.substitute)),
        'correlation': (len(cluster.correlation), len(cluster.substitute)),
    }
    for field, (found, expected) in lengths.items():
        if found != expected:
            node.get(field).refuse(f'{expected} numbers')
    return cluster

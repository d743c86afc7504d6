# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Numbers of model files replaced by such as mean nothing: refused by name, or harmless."""

import json
from collections.abc import Iterator
from copy import deepcopy
from functools import cache
from typing import Any

import numpy as np
import pytest
from benches import predictor_bench
from benches.component_bench import Bench
from fuzzing.file_mutations import one_of_each, places_of_numbers
from kept import kept

from fuzzycnc_ros.components.thermal.thermal_predictor import ThermalPredictor
from fuzzycnc_ros.components.thermal.thermal_predictor_config import ThermalPredictorConfig
from fuzzycnc_ros.core.document import ModelFileError
from fuzzycnc_ros.core.thermal.fit import train_model
from fuzzycnc_ros.core.thermal.model import load_model

pytestmark = pytest.mark.filterwarnings('ignore::RuntimeWarning')

VALUES = (5e-324, 1e13, -1.0, 1e308)
MORE_VALUES = (*VALUES, -5e-324, 1e-300, 1e-30, 0.0, -1e13, 1e200, 1e300, -1e300)
NO_NUMBERS = ('inf', 'nan', '1e400', None, True, [], 10**400)
NULL_IS_INFINITE = ('held_out_rms', 'held_out_max', 'xie_beni', 'thickness')


@kept
def text_of_all_forms() -> str:
    """Return a model file with every form of recursion that trains in a moment."""
    runs = [predictor_bench.recordings()[name] for name in ('D0', 'T1')]
    kinds = ('least_squares', 'classical_grey', 'stable_grey', 'lag_ridge', 'hybrid_network')
    return train_model(runs, candidates=(*kinds, 'grey_anfis')).to_json()


@cache
def document(default: str) -> dict[str, Any]:
    """Return the model with one candidate, which is its default."""
    found: dict[str, Any] = json.loads(text_of_all_forms())
    found['candidates'] = {default: {**found['candidates'][default], 'problems': []}}
    for channel in found['channels']:
        channel['default'] = default
    return found


def with_value(default: str, path: tuple[Any, ...], value: Any) -> str:
    """Return the text of a model file with another value in one place."""
    found = deepcopy(document(default))
    parent = found
    for key in path[:-1]:
        parent = parent[key]
    parent[path[-1]] = value
    return json.dumps(found)


def wrong_in(default: str, path: tuple[Any, ...], value: Any) -> str:
    """Return what is wrong with how a model with that value is taken; nothing if it is right."""
    field = next(key for key in reversed(path) if isinstance(key, str))
    bench = Bench(ThermalPredictor(ThermalPredictorConfig(force=True)))
    answer = bench.request('use_model', model=with_value(default, path, value))
    if not answer.success:
        named = field in answer.message and 'expected' in answer.message
        return '' if named else f'no {field!r} in the refusal: {answer.message}'
    if not isinstance(value, float):
        return 'taken for a number'
    run = predictor_bench.recordings()['T1']
    predictor_bench.predict(bench, run, range(5))
    predictor_bench.predict(bench, run, range(5, 7), bad=document(default)['inputs'][:1])
    for item in bench.records('thermal_error'):
        shown = np.concatenate([item.error, item.standard_deviation])
        if np.isinf(shown).any() or (item.valid and not np.isfinite(shown).all()):
            return f'published {shown} with valid {item.valid}'
    return ''


def check(default: str, paths: list[tuple[Any, ...]], values: tuple[Any, ...]) -> None:
    wrong = [
        f'{".".join(map(str, path))} = {value!r}: {found}'
        for path in paths
        for value in values
        if (found := wrong_in(default, path, value))
    ]
    assert not wrong, '\n'.join(wrong[:20])


DEFAULTS = ('lag_ridge', 'classical_grey', 'hybrid_network', 'grey_anfis')


def places(default: str) -> Iterator[tuple[Any, ...]]:
    """Return the places of all numbers but the version."""
    return (path for path in places_of_numbers(document(default)) if path[0] != 'schema_version')


def own_places(default: str) -> list[tuple[Any, ...]]:
    """Return one place of each field: with the first default all, else those of the candidate."""
    found = one_of_each(places(default))
    return found if default == DEFAULTS[0] else [p for p in found if p[0] == 'candidates']


@pytest.mark.parametrize('default', DEFAULTS)
def test_no_number_makes_a_model_publish_what_is_not_finite(default):
    check(default, own_places(default), VALUES)


@pytest.mark.qualify
@pytest.mark.parametrize('default', DEFAULTS)
def test_no_number_in_any_place_makes_a_model_publish_what_is_not_finite(default):
    check(default, own_places(default), MORE_VALUES)
    check(default, list(places(default))[::7], VALUES)


def test_what_is_no_number_is_refused_by_the_name_of_its_field():
    found = [path for path in own_places('lag_ridge') if 'settings' not in path]
    nullable = [path for path in found if any(key in NULL_IS_INFINITE for key in path)]
    check('lag_ridge', [path for path in found if path not in nullable], NO_NUMBERS)
    check('lag_ridge', nullable, tuple(value for value in NO_NUMBERS if value is not None))


def test_a_thickness_of_next_to_nothing_is_refused_with_its_bound():
    text = with_value('lag_ridge', ('domain', 'thickness'), 5e-324)
    with pytest.raises(ModelFileError, match=r'domain: thickness: expected numbers from 1e-09 to'):
        load_model(text)

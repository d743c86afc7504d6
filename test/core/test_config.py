# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Configuration records: what they accept, what they refuse and how they say so."""

import subprocess
import sys
from dataclasses import FrozenInstanceError, dataclass, fields, replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fuzzycnc_ros.core.config import Config, param


@dataclass(frozen=True, kw_only=True)
class Example(Config):
    """One parameter of every kind."""

    enabled: bool = param(True, '-', 'A switch')
    count: int = param(3, '-', 'A number of things', low=1, high=10)
    length: float = param(1e-3, 'm', 'A length', low=0.0, high=1.0, live=True)
    word: str = param('slow', '-', 'A word', choices=('slow', 'fast'))
    text: str = param('', '-', 'Any text')
    names: tuple[str, ...] = param(('X', 'Y'), '-', 'Names')
    nothing: tuple[str, ...] = param((), '-', 'Names, none by default')
    gains: tuple[float, ...] = param((1.0, 2.0), 'K', 'Gains', low=-5.0, high=5.0)


def test_defaults_are_valid():
    example = Example()
    assert (example.count, example.length, example.names) == (3, 1e-3, ('X', 'Y'))


def test_record_is_frozen():
    with pytest.raises(FrozenInstanceError):
        Example().count = 4


@given(st.integers(min_value=0, max_value=1))
def test_whole_number_is_taken_for_a_double(number):
    """YAML and people write 1 for 1.0."""
    value = Example(length=number).length
    assert type(value) is float
    assert value == number


def test_lists_become_tuples():
    example = Example(names=['A', 'B'], gains=[1, 2.5], nothing=['Q'])
    assert example.names == ('A', 'B')
    assert example.gains == (1.0, 2.5)
    assert all(type(gain) is float for gain in example.gains)
    assert hash(example) == hash(replace(example))


@pytest.mark.parametrize(
    ('name', 'value'),
    [
        ('enabled', 1),
        ('enabled', 'true'),
        ('count', 2.0),
        ('count', True),
        ('count', '2'),
        ('length', '1'),
        ('length', None),
        ('length', True),
        ('text', 5),
        ('names', 'XY'),
        ('names', (1, 2)),
        ('nothing', (1.0,)),
        ('gains', ('a',)),
        ('gains', (True,)),
    ],
)
def test_wrong_type_is_refused(name, value):
    with pytest.raises(ValueError, match=rf'^{name}: expected \w+ as in the default .* but found'):
        Example(**{name: value})


@pytest.mark.parametrize(
    ('name', 'value'),
    [
        ('count', 0),
        ('count', 11),
        ('length', -1e-9),
        ('length', 1.0000001),
        ('length', float('nan')),
        ('length', float('inf')),
        ('gains', (0.0, 5.1)),
        ('gains', (float('nan'), 0.0)),
    ],
)
def test_out_of_bounds_is_refused(name, value):
    """With the bounds, the unit and what the parameter means."""
    meta = next(item.metadata for item in fields(Example) if item.name == name)
    with pytest.raises(ValueError, match=rf'^{name} = \S+ is outside') as caught:
        Example(**{name: value})
    text = str(caught.value)
    assert f'[{meta["low"]}, {meta["high"]}] {meta["unit"]}; {meta["doc"]}' in text


@given(st.floats(min_value=0.0, max_value=1.0))
def test_bounds_are_inclusive(value):
    assert Example(length=value).length == value


def test_unknown_word_is_refused_with_the_known_ones():
    with pytest.raises(ValueError, match=r'^word: expected one of slow, fast but found quick$'):
        Example(word='quick')


def test_unknown_name_is_refused():
    with pytest.raises(TypeError, match='breadth'):
        Example(breadth=1.0)


def test_replace_checks_again():
    with pytest.raises(ValueError, match='count = 99'):
        replace(Example(), count=99)


@pytest.mark.parametrize('default', [1, 2.0, (1.0, 2.0)])
def test_number_without_bounds_cannot_be_declared(default):
    with pytest.raises(TypeError, match='a number needs bounds: Forgotten'):
        param(default, 'm', 'Forgotten')


def test_default_out_of_bounds_is_refused():
    @dataclass(frozen=True, kw_only=True)
    class Wrong(Config):
        length: float = param(2.0, 'm', 'A length', low=0.0, high=1.0)

    with pytest.raises(ValueError, match=r'length = 2\.0 is outside'):
        Wrong()


def test_field_without_a_default_is_refused():
    @dataclass(frozen=True, kw_only=True)
    class Bare(Config):
        length: float

    with pytest.raises(TypeError, match='length has no default'):
        Bare(length=1.0)


@pytest.mark.parametrize('name', ['length', 'gains'])
def test_whole_number_beyond_all_doubles_is_refused(name):
    huge = 10**400
    with pytest.raises(ValueError, match=rf'{name}: expected a number but found one beyond'):
        Example(**{name: [1.0, huge] if name == 'gains' else huge})
    with pytest.raises(ValueError, match=r'count = 10+ is outside'):
        Example(count=huge)


@pytest.mark.parametrize(
    ('name', 'value', 'plain'),
    [
        *(('length', kind(0.5), 0.5) for kind in (np.float16, np.float32, np.float64)),
        ('length', np.longdouble(0.5), 0.5),
        *(('length', kind(1), 1.0) for kind in (np.int8, np.int64, np.uint64)),
        ('length', np.array(0.5), 0.5),
        ('length', np.array(1), 1.0),
        *(('count', kind(4), 4) for kind in (np.int8, np.int64, np.uint64)),
        ('count', np.array(4), 4),
        ('enabled', np.bool_(False), False),
        ('enabled', np.array(False), False),
        ('gains', np.array([1, 2]), (1.0, 2.0)),
        ('gains', np.array([1.0, 2.0], np.float32), (1.0, 2.0)),
        ('gains', np.array([1.0, 2.0], np.longdouble), (1.0, 2.0)),
        ('gains', [np.float64(1.0), 2], (1.0, 2.0)),
        ('gains', (np.int64(1), np.array(2.0)), (1.0, 2.0)),
        ('names', np.array(['Z']), ('Z',)),
        ('names', (np.str_('Z'),), ('Z',)),
    ],
)
def test_numpy_values_are_plain_ones(name, value, plain):
    found = getattr(Example(**{name: value}), name)
    assert (found, type(found)) == (plain, type(plain))
    if isinstance(plain, tuple):
        assert [type(item) for item in found] == [type(item) for item in plain]


@pytest.mark.parametrize(
    ('name', 'value', 'message'),
    [
        ('count', np.float64(2.0), 'count: expected int .* but found 2.0'),
        ('count', np.float32(2.0), 'count: expected int .* but found 2.0'),
        ('count', np.array(2.0), 'count: expected int .* but found 2.0'),
        ('count', np.longdouble(2.0), 'count: expected int .* but found 2.0'),
        ('count', np.bool_(True), 'count: expected int .* but found True'),
        ('enabled', np.int64(1), 'enabled: expected bool .* but found 1'),
        ('length', np.bool_(True), 'length: expected float .* but found True'),
        ('length', np.array([0.5]), r'length: expected float .* but found \[0.5\]'),
        ('length', np.float64(np.nan), 'length = nan is outside'),
        ('length', np.float32(np.nan), 'length = nan is outside'),
        ('length', np.array(np.nan), 'length = nan is outside'),
        ('length', np.longdouble('1e400'), 'length = inf is outside'),
        ('length', np.ma.masked, 'length: expected float .* but found None'),
        ('gains', np.array([[1.0]]), r'gains: expected tuple .* but found \[\[1.0\]\]'),
        ('gains', np.array(1.0), 'gains: expected tuple .* but found 1.0'),
        ('gains', np.array([1.0, np.nan]), 'gains = nan is outside'),
        ('names', np.array([1]), r'names: expected tuple .* but found \[1\]'),
    ],
)
def test_numpy_values_are_refused_as_plain_ones_are(name, value, message):
    with pytest.raises(ValueError, match=message):
        Example(**{name: value})


def test_a_configuration_alone_loads_no_numpy():
    script = (
        'import sys\n'
        'from dataclasses import dataclass\n'
        'from fuzzycnc_ros.core.config import Config, param\n'
        '@dataclass(frozen=True, kw_only=True)\n'
        'class Example(Config):\n'
        "    gains: tuple[float, ...] = param((1.0,), '-', 'Gains', low=0.0, high=1.0)\n"
        'assert Example(gains=[1]).gains == (1.0,)\n'
        "assert 'numpy' not in sys.modules\n"
    )
    outcome = subprocess.run([sys.executable, '-c', script], capture_output=True, text=True)
    assert outcome.returncode == 0, outcome.stderr

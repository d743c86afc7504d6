# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Reading of JSON documents that nothing is believed in: types, shapes, finiteness."""

import json
from collections.abc import Iterator
from contextlib import contextmanager
from math import isfinite
from typing import Any, NoReturn

import numpy as np

from fuzzycnc_ros.core.arrays import Array


class ModelFileError(ValueError):
    """A document is no usable model file; the message says where and why."""


NUMBER_LIMIT = 1e300
"""Largest number of any document: what is computed of it would not be finite."""


THERMAL_MODEL = 'fuzzycnc/thermal-model'
DEFORMATION_MODEL = 'fuzzycnc/deformation-model'
TRACK_OFFSETS = 'fuzzycnc stitch offsets'

DOCUMENT_KINDS = {
    THERMAL_MODEL: 'a thermal model',
    DEFORMATION_MODEL: 'a model of soft material',
    TRACK_OFFSETS: 'learnt offsets of one track',
}
"""Kinds of documents, by what they say at their top."""


class Node:
    """A value of the document and where it stands."""

    def __init__(self, value: Any, where: str, depth: int = 0) -> None:
        self.value = value
        self.where = where
        self.depth = depth

    def refuse(self, expected: str) -> NoReturn:
        """Raise an error that shows the value, shortened."""
        found = repr(self.value)
        found = found if len(found) <= 60 else f'{found[:57]}...'
        raise ModelFileError(f'{self.where}: expected {expected}, but found {found}')

    def get(self, key: str) -> 'Node':
        """Return a member of an object."""
        if not isinstance(self.value, dict) or key not in self.value:
            self.refuse(f'an object with {key!r}')
        return Node(self.value[key], f'{self.where}, {key}', self.depth + 1)

    def check_kind(self, key: str, wanted: str) -> None:
        """Refuse a document whose member says another kind than the wanted one."""
        if isinstance(self.value, dict):
            for kind in map(self.value.get, ('schema', 'format')):
                if isinstance(kind, str) and kind in DOCUMENT_KINDS and kind != wanted:
                    raise ModelFileError(
                        f'{self.where}: expected {DOCUMENT_KINDS[wanted]}, but found '
                        f'{DOCUMENT_KINDS[kind]}'
                    )
        if self.get(key).text() != wanted:
            self.get(key).refuse(f'the {key} {wanted!r}')

    def items(self) -> dict[str, 'Node']:
        """Return the members of an object."""
        if not isinstance(self.value, dict):
            self.refuse('an object')
        return {
            key: Node(item, f'{self.where}, {key}', self.depth + 1)
            for key, item in self.value.items()
        }

    def list(self) -> 'list[Node]':
        """Return the elements of a list."""
        if not isinstance(self.value, list):
            self.refuse('a list')
        return [
            Node(item, f'{self.where}[{at}]', self.depth + 1) for at, item in enumerate(self.value)
        ]

    def text(self) -> str:
        """Return a text."""
        if not isinstance(self.value, str):
            self.refuse('a text')
        return self.value

    def texts(self) -> tuple[str, ...]:
        """Return a list of texts."""
        return tuple(node.text() for node in self.list())

    @contextmanager
    def named(self) -> Iterator[None]:
        """Say in a refusal of what is made of this value where the value stands."""
        try:
            yield
        except ModelFileError:
            raise
        except ValueError as error:
            raise ModelFileError(f'{self.where}: {error}') from error

    def number(self, low: float = -NUMBER_LIMIT, high: float = NUMBER_LIMIT) -> float:
        """Return a finite number within bounds; JSON's true and false are none."""
        if isinstance(self.value, bool) or not isinstance(self.value, (int, float)):
            self.refuse('a number')
        # A huge whole number would overflow the conversion.
        if abs(self.value) > NUMBER_LIMIT or not isfinite(self.value):
            self.refuse('a finite number')
        if not low <= self.value <= high:
            self.refuse(f'a number from {low:g} to {high:g}')
        return float(self.value)

    def numbers(self, low: float = -NUMBER_LIMIT, high: float = NUMBER_LIMIT) -> tuple[float, ...]:
        """Return a list of finite numbers within bounds."""
        return tuple(node.number(low, high) for node in self.list())

    def vector(self, low: float = -NUMBER_LIMIT, high: float = NUMBER_LIMIT) -> Array:
        """Return a list of finite numbers within bounds as an array."""
        return np.array(self.numbers(low, high), dtype=np.float64)

    def boolean(self) -> bool:
        """Return true or false."""
        if not isinstance(self.value, bool):
            self.refuse('true or false')
        return self.value

    def sizes_or_infinite(self) -> Array:
        """Return a list of numbers of 0 or more; null stands for infinity, which JSON has not."""
        sizes = (None if n.value is None else n.number(0.0) for n in self.list())
        return np.array([np.inf if size is None else size for size in sizes])

    def array(
        self, *lengths: int | None, low: float = -NUMBER_LIMIT, high: float = NUMBER_LIMIT
    ) -> Array:
        """Return nested lists of finite numbers within bounds as an array.

        Parameters
        ----------
        lengths : int or None
            Length of each axis; None is any, of inner axes the one that comes first.
        low, high : float
            Bounds, which are allowed themselves.
        """
        length, *inner = lengths
        nodes = self.list()
        if length not in (None, len(nodes)):
            self.refuse(f'{length} {"rows" if inner else "numbers"}')
        if not inner:
            return self.vector(low, high)
        rows: list[Array] = []
        for node in nodes:
            rows.append(node.array(*inner, low=low, high=high))
            inner = list(rows[0].shape)
        shape = [0 if size is None else size for size in inner]
        return np.array(rows, dtype=np.float64).reshape(len(rows), *shape)

    def matrix(
        self, columns: int, low: float = -NUMBER_LIMIT, high: float = NUMBER_LIMIT
    ) -> Array:
        """Return a list of rows of `columns` finite numbers each; it may have no row."""
        return self.array(None, columns, low=low, high=high)


def parse_document(text: str, what: str, size_max: int) -> Node:
    """Return the root of a JSON document of finite numbers.

    Parameters
    ----------
    text : str
        The document.
    what : str
        What kind of file it is, for messages.
    size_max : int
        Largest document that is read [characters].

    Raises
    ------
    ModelFileError
        If it is too large, no JSON, or holds a number that is not finite.
    """

    def no_constant(name: str) -> NoReturn:
        raise ModelFileError(f'{what}: expected finite numbers, but found {name}')

    if len(text) > size_max:
        raise ModelFileError(
            f'{what}: expected at most {size_max} characters, but found {len(text)}'
        )
    try:
        return Node(json.loads(text, parse_constant=no_constant), what)
    except ModelFileError:
        raise
    except (ValueError, RecursionError) as error:
        raise ModelFileError(f'{what}: expected JSON, but found {error}') from error

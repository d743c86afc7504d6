# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Figures as a JSON document: the fields of dataclasses, under other names and units if wanted."""

from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from math import isfinite
from pathlib import Path
from typing import Any

_KEY, _FACTOR, _INLINE = 'document_key', 'document_factor', 'document_inline'


def shown_as(key: str | None, factor: float | None = None) -> dict[str, Any]:
    """Return the metadata of a dataclass field whose key or unit differs in a document.

    Parameters
    ----------
    key : str or None
        Its key; None leaves the field out.
    factor : float, optional
        What its number is multiplied by, such as 1e6 for micrometres.
    """
    return {_KEY: key, _FACTOR: factor}


INLINE = {_INLINE: True}
"""Metadata of a field whose own fields stand in its place."""


def to_document(value: Any) -> Any:
    """Return a value as JSON has it.

    Dataclasses and named tuples become objects, numpy arrays and sequences lists, paths text;
    numbers that JSON does not know become None.

    Examples
    --------
    >>> from dataclasses import dataclass, field
    >>> @dataclass
    ... class Score:
    ...     name: str
    ...     rms: float = field(metadata=shown_as('rms_um', 1e6))
    >>> to_document([Score('mlp', 2.5e-6), Score('arma', float('inf'))])
    [{'name': 'mlp', 'rms_um': 2.5}, {'name': 'arma', 'rms_um': None}]
    """
    if is_dataclass(value) and not isinstance(value, type):
        return _fields(value)
    if hasattr(value, '_asdict'):  # named tuple
        return to_document(value._asdict())
    if isinstance(value, Mapping):
        return {str(key): to_document(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [to_document(item) for item in value]
    if hasattr(value, 'tolist'):  # numpy
        return to_document(value.tolist())
    if isinstance(value, Path):
        return str(value)
    if isinstance(value, float) and not isfinite(value):
        return None
    return value


def _fields(value: Any) -> dict[str, Any]:
    found: dict[str, Any] = {}
    for item in fields(value):
        key, inner = item.metadata.get(_KEY, item.name), getattr(value, item.name)
        if _INLINE in item.metadata:
            found |= to_document(inner)
        elif key is not None:
            factor = item.metadata.get(_FACTOR)
            found[key] = to_document(inner if factor is None else factor * inner)
    return found

# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Fuzzy clustering, and rules of Takagi and Sugeno: inference and hybrid learning.

The names below are loaded when they are first used: rules run without the estimators.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from fuzzycnc_ros.core.fuzzy.c_means import FuzzyCMeans

__all__ = ['FuzzyCMeans']

_MODULES = {'c_means': ('FuzzyCMeans',)}


def __getattr__(name: str) -> Any:
    """Load a public name from its module."""
    for module, names in _MODULES.items():
        if name in names:
            return getattr(import_module(f'{__name__}.{module}'), name)
    raise AttributeError(f'module {__name__!r} has no attribute {name!r}')

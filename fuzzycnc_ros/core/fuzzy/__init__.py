# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Fuzzy clustering, and rules of Takagi and Sugeno: inference and hybrid learning.

The names below are loaded when they are first used: rules run without the estimators.
"""

from typing import TYPE_CHECKING

from fuzzycnc_ros.core.lazy_names import lazy_names

if TYPE_CHECKING:
    from fuzzycnc_ros.core.fuzzy.c_means import FuzzyCMeans
    from fuzzycnc_ros.core.fuzzy.gustafson_kessel import GustafsonKessel

__all__ = ['FuzzyCMeans', 'GustafsonKessel']

_MODULES = {'c_means': ('FuzzyCMeans',), 'gustafson_kessel': ('GustafsonKessel',)}

__getattr__ = lazy_names(__name__, _MODULES)

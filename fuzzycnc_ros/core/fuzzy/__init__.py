# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Fuzzy clustering."""

from fuzzycnc_ros.core.fuzzy.c_means import FuzzyCMeans

__all__ = ['FuzzyCMeans']

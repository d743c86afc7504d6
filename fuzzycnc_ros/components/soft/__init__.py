# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Patterns on soft material, straightened beforehand."""

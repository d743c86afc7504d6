# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Patterns and tracks on soft material, and the models that straighten them."""

# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Doors for Python: from data to a model, a motion, a controller or a pattern in a few lines."""

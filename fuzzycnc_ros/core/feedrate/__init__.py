# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Feedrate along a path: curves, part programs, curvature, schedulers, limits."""

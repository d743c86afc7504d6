# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Geometry of paths: NURBS and sampled curves, curvature, windows, quintic pieces."""

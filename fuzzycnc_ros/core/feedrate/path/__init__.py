# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Geometry of paths: NURBS, curvature, blended corners, the path to follow, distance from it."""

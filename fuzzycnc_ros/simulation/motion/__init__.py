# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Axes that follow a path, and the contour error that they leave."""

# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Time against contour error of scheduling methods."""

# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Deformation of soft material: the T-S fuzzy neural network, and paths compensated by it."""

# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Paths on the simulated machine, and how far from them it was."""

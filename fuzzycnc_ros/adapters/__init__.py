# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Real equipment: controllers that take offsets, and devices that measure temperatures.

One folder for each kind of equipment holds its component, its protocol and its files.
"""

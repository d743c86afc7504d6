# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Moves of driven axes, controllers side by side, axes identified and tuned."""

# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Driven axes with friction, backlash and sensor; moves on them, and controllers tuned by them."""

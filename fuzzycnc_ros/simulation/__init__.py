# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Simulated machines with named faults: mill, grinder, contouring and servo axes, soft sheet."""

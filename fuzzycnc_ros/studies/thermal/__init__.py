# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Thermal models judged: comparison, sensor curve, probing, the report of a compensation run."""

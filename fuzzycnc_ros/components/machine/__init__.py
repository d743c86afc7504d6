# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The simulated machine as a component: warmth, axes, drives, a soft sheet, an operator."""

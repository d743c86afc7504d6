# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Hundreds of hours of machine time, and whether anything grows or gets lost."""

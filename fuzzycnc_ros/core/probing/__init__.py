# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Probing cycles: what is touched where, and what the touches say."""

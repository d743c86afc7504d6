# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Replay of bags: components compute again what was recorded."""

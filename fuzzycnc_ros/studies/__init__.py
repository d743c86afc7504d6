# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Whole runs by topic: each with its judgement and its page."""

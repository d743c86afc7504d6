# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Feeds of whole part programs."""

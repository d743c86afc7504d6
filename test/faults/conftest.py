# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Recordings to work on."""

from small_recordings import bag, table

__all__ = ['bag', 'table']

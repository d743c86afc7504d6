# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Probing cycles on controls: their file, programs and results."""

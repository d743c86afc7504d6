# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Figures of the papers beside those of the same methods here."""

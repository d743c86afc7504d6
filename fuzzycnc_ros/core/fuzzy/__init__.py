# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Fuzzy clustering, and rules of Takagi and Sugeno and of Mamdani."""

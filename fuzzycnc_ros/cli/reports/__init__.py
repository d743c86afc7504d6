# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Commands that make documents of recordings."""

# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The command `fuzzycnc demo` and its scenarios."""

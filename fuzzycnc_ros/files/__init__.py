# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Files on disk: written whole or not at all, YAML with line numbers, errors in words."""

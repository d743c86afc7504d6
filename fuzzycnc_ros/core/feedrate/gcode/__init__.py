# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Part programs (G-code): read them, sample their paths, write them with new feeds."""

# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The commands `fuzzycnc soft`: soft material."""

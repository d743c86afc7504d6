# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Models of a machine's axes from what was recorded of them."""

# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Position control of driven axes."""

# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The probing cycle as a component."""

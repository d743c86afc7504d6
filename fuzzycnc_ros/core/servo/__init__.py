# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Position control of an axis: variable-universe controller, observer, learning of its rules."""

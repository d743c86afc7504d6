# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Machine data: limits, models of the axes, the loop that follows a path."""

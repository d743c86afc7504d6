# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""What is known of a machine: limits, models of its axes, the loop that follows a path."""

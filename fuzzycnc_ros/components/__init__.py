# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""One file per node: its whole behaviour as an object with typed inputs and outputs; no ROS."""

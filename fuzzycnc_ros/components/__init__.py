# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""What nodes do, by capability, as objects with typed inputs and outputs; no ROS."""

# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Behaviour of nodes, by capability, as objects with typed inputs and outputs; no ROS."""

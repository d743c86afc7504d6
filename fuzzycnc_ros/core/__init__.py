# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Algorithms on plain numbers: no ROS, no clock, no file, no log."""

# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Bags without ROS: writing, reading, repairing, importing, hashing."""

# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Adapters to real controllers: no ROS and no rules, only their protocols."""

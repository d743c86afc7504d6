# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The ROS half of every node: host, lock-step, parameters, QoS, state files, health, lifecycle."""

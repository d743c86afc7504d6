# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Open compensation stack for CNC machines as a ROS 2 node graph."""

__version__ = '0.1.0'

# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Reports on a machine for programs that know nothing of ROS."""

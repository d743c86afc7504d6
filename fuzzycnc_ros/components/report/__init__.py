# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""What programs that know nothing of ROS are told of a machine."""

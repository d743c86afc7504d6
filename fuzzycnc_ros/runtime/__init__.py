# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The component model without ROS: declarations, records, merge by stamp, graphs."""

# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The fastest motion within limits of velocity, acceleration and jerk, whole or as a stream."""

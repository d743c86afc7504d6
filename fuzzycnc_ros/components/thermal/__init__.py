# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""From raw readings to limited offsets: acquisition, sensors, prediction, compensation."""

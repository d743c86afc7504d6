# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Every thermal model on the simulated grinder."""

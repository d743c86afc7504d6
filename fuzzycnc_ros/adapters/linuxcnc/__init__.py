# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Compensation into a LinuxCNC on this computer."""

# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Shifts of the simulated machine: thermal alone, and with everything on."""

# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Machines that speak MTConnect."""

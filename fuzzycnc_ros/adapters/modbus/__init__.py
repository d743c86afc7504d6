# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Temperatures out of Modbus devices, over TCP and over serial lines."""

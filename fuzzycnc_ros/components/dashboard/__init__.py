# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Operator's view of a machine, put together from the reports of its nodes."""

# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The path that the tool is to follow: smooth pieces, exact stops, blends of corners."""

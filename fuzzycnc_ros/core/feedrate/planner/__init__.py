# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Samples of the motion along a path, ahead of time, with changes and a way to rest."""

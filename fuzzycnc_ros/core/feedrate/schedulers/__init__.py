# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Rules that choose the feed along a path, and what refines and streams them."""

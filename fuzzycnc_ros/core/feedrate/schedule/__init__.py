# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Rules that choose the feed, the planner ahead of time, and feeds of whole part programs."""

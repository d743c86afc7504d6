# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The fault campaign: what is broken on a live graph, and what a bag of it must show."""

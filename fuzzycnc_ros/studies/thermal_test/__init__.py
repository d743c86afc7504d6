# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""A thermal test in the style of ISO 230-3: read, judged by phases, and put on a page."""

# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""A soft sheet that creeps under the needle, and samples and tracks stitched on it."""

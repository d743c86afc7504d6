# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""From tool paths and part programs to the motion of the axes."""

# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Commands for the sensors of a machine: the first readings, and whether they agree."""

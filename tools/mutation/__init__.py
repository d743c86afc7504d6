# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""What `tools/mutants.py` does: faults, how they are drawn, which tests reach and catch them."""

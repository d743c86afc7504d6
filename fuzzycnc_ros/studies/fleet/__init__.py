# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Models judged and trained over thousands of bags of many machines, and what follows for them."""

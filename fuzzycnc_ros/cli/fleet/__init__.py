# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Commands on thousands of bags of many machines."""

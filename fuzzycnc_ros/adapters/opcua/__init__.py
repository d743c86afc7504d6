# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""OPC UA: offset lines into a control, and temperatures out of servers."""

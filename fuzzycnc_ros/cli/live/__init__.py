# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Commands on running machines: up, operate, security."""

# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Commands on axes and machines: position, servo, machine."""

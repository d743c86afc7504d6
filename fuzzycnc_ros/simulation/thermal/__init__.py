# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Mill and grinder as lumped thermal networks, their duties, and faults of their sensors."""

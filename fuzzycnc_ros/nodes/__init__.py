# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""One short file per node over a generic host that serves any component."""

# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Commands on part programs: advise, schedule, pareto."""

# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The machine's side of commands: it accepts, limits and times out offsets and trajectories."""

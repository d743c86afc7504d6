# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The graph of a machine as a whole: its nodes, their turns and permissions, actions on it."""

# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Fixtures of a live graph."""

from live_graph import (
    bag_hashes,
    graph,
    in_process,
    model_file,
    model_text,
    observer,
    outputs,
    pytest_runtest_makereport,
    refusal,
)

__all__ = [
    'bag_hashes',
    'graph',
    'in_process',
    'model_file',
    'model_text',
    'observer',
    'outputs',
    'pytest_runtest_makereport',
    'refusal',
]

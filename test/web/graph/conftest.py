# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Fixtures of tests that look at a live graph through a browser."""

from live_graph import (
    graph,
    model_file,
    model_text,
    observer,
    pytest_runtest_makereport,
)

__all__ = ['graph', 'model_file', 'model_text', 'observer', 'pytest_runtest_makereport']

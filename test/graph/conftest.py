# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Fixtures of tests on a live graph."""

import sys

import pytest
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
    shared_domain,
    shared_graph,
    shared_observer,
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
    'shared_domain',
    'shared_graph',
    'shared_observer',
]


@pytest.fixture
def command(graph, tmp_path):
    """Start a command in the domain of the test: `command('record', '--out', bag)`."""

    def begin(*words):
        folder = tmp_path / words[0]
        folder.mkdir(exist_ok=True)
        line = [sys.executable, '-m', 'fuzzycnc_ros.cli.main', *map(str, words)]
        return graph.launch(words[0], line, folder)

    return begin

# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Fixtures of a live graph, recordings, and the command line of the qualification."""

import command_lines
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
)
from small_recordings import bag, table

__all__ = [
    'bag',
    'bag_hashes',
    'graph',
    'in_process',
    'model_file',
    'model_text',
    'observer',
    'outputs',
    'pytest_runtest_makereport',
    'refusal',
    'table',
]


@pytest.fixture
def qualification(capsys, tmp_path, monkeypatch):
    """Run a command line of the qualification in an empty folder."""
    from commands import APPLICATION

    monkeypatch.chdir(tmp_path)
    return command_lines.runner(APPLICATION.run, capsys)


@pytest.fixture
def refused(qualification):
    """Run a command line that must be refused in one line that names certain things."""
    return command_lines.refuser(qualification)

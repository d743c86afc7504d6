# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Recordings to work on."""

import pytest
from small_recordings import bag, model, table

__all__ = ['bag', 'model', 'table']


@pytest.fixture
def here(monkeypatch):
    """Work in this process: starting others costs more than the work on such small bags."""

    def in_workers(work, pieces, names, jobs, tell):
        return [work(piece, lambda *news: None) for piece in pieces]

    monkeypatch.setattr('fuzzycnc_ros.cli.workers.in_workers', in_workers)

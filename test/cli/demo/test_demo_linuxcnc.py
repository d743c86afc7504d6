# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""What the demo on LinuxCNC says of a run that proves nothing."""

from contextlib import nullcontext

import pytest
import typer

from fuzzycnc_ros.cli.demo import linuxcnc
from fuzzycnc_ros.ros.presence import GraphError


@pytest.mark.parametrize(
    ('ran', 'lacking', 'ends'),
    [
        (True, '', nullcontext()),
        (False, '', pytest.raises(GraphError, match='did not run to the end of the duty')),
        (True, '3 messages are lost', pytest.raises(typer.Exit)),
    ],
)
def test_a_run_that_proves_nothing_is_an_error(monkeypatch, tmp_path, ran, lacking, ends):
    result = {'program_ran': ran}
    monkeypatch.setattr(linuxcnc, 'play', lambda *arguments: result)
    monkeypatch.setattr(linuxcnc, 'loss', lambda bag: lacking)
    with ends:
        linuxcnc.linuxcnc_demo(None, tmp_path, 0)

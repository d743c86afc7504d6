# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Packages that are loaded on use say nothing that a reader of a report does not need."""

import os
import subprocess
import sys

import pytest

pytest.importorskip('matplotlib')

LOAD = "from fuzzycnc_ros.studies.requirement import require; require('matplotlib.figure')"


def test_a_home_folder_that_cannot_be_written_is_no_concern_of_a_report():
    done = subprocess.run(
        [sys.executable, '-c', LOAD],
        env={**os.environ, 'MPLCONFIGDIR': '/proc/none'},
        capture_output=True,
        text=True,
        check=True,
    )
    assert (done.stdout, done.stderr) == ('', '')

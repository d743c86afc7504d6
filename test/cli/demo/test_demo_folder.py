# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The folder of a demo: renewed, never shared, and nothing of others removed."""

import subprocess
import sys

import pytest
from processes import start

from fuzzycnc_ros.cli.demo.steps import renewed
from fuzzycnc_ros.ros.presence import GraphError

HOLDER = """
import sys, time
from pathlib import Path
from fuzzycnc_ros.cli.demo.steps import renewed

with renewed(Path(sys.argv[1])):
    Path(sys.argv[1], 'summary.json').write_text('first')
    print('held', flush=True)
    time.sleep(600.0)
"""


def test_what_a_demo_left_is_removed(tmp_path):
    out = tmp_path / 'a' / 'demo'
    with renewed(out):
        (out / 'summary.json').write_text('{}')
        for name in ('trained', 'log'):  # as the shift leaves them
            (out / name / 'deep').mkdir(parents=True)
        (out / 'bag').symlink_to(tmp_path)
        (out / 'foam_trained.json').write_text('{}')
    with renewed(out):
        assert list(out.iterdir()) == []


def test_what_is_not_a_demos_stays(tmp_path):
    for name in ('summary.json', 'thesis.tex'):
        (tmp_path / name).write_text('text')
    with pytest.raises(GraphError, match=r'expected an empty folder but found thesis\.tex'):
        with renewed(tmp_path):
            pass
    assert len(list(tmp_path.iterdir())) == 2


def test_two_at_once_are_refused_and_a_killed_one_holds_nothing(tmp_path):
    with start(
        [sys.executable, '-c', HOLDER, str(tmp_path)], stdout=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout.readline() == 'held\n'
        with pytest.raises(GraphError, match=r'another demo is writing there.*another folder'):
            with renewed(tmp_path):
                pass
        assert (tmp_path / 'summary.json').read_text() == 'first'
        process.kill()
    with renewed(tmp_path):
        assert list(tmp_path.iterdir()) == []

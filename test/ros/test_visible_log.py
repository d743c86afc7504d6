# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""What nodes log and say on standard error has no control characters."""

import pytest

pytestmark = pytest.mark.ros

rclpy = pytest.importorskip('rclpy', reason='rclpy is not installed here: run `make test`')

from processes import HANG  # noqa: E402

from fuzzycnc_ros.nodes.composed import run_composed  # noqa: E402
from fuzzycnc_ros.ros.run import run  # noqa: E402

HOSTILE = 'T1\x1b]0;title\x07\x1b[2J\u202e\nnext'
SHOWN = r'T1\x1b]0;title\x07\x1b[2J\u202e\x0anext'


class Talkative:
    """A node that logs what it is given twice, at other levels, and is done."""

    exit_code, done, executor = 0, True, 'lean'

    def __init__(self):
        self.node = rclpy.create_node('talkative')

    def start(self):
        self.node.get_logger().warning(HOSTILE)
        self.node.get_logger().error(HOSTILE)

    def stop(self):
        self.node.destroy_node()


@pytest.fixture(autouse=True)
def _alone(domain, monkeypatch):
    monkeypatch.setenv('ROS_DOMAIN_ID', str(domain))
    monkeypatch.setattr('fuzzycnc_ros.ros.run.LETTING_GO', int(HANG))  # else it ends all tests


def test_logs(capfd):
    for _ in range(2):
        assert run([Talkative], ['talkative']) == 0
    lines = capfd.readouterr().err.splitlines()
    assert [line.partition(']')[0] for line in lines] == ['[WARN', '[ERROR'] * 2
    assert all(line.endswith(SHOWN) for line in lines)


def test_errors(capfd):
    (maker, name) = ('recorder', 'bag\x1b[2J\u202e')
    assert run_composed([maker], ['--ros-args', '-p', f'output:={name}', '-p', 'topics:=(']) == 2
    assert run_composed([maker], ['--ros-args', '-p', f'outputs:={name}']) == 2
    assert run_composed([maker], ['--ros-args', '-p', f'{name}:=1']) == 2
    err = capfd.readouterr().err
    assert err.count('error: ') == 3
    assert r'\x1b[2J\u202e' in err
    assert '\x1b' not in err
    assert '\u202e' not in err

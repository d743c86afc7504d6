# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""ROS domains that nobody else on this host uses."""

import os
import subprocess
import sys
from contextlib import ExitStack

import pytest

from fuzzycnc_ros.cli.live import free_domain
from fuzzycnc_ros.ros.presence import GraphError


@pytest.fixture(autouse=True)
def lock_files(tmp_path, monkeypatch):
    """Lock files and ports of these tests alone: other graphs are none of their business."""
    monkeypatch.setattr(free_domain.tempfile, 'gettempdir', lambda: str(tmp_path))
    monkeypatch.setattr(free_domain, 'PORTS_EACH', 1)
    first = 1100 + 110 * (os.getpid() % 50)  # below those of the middleware
    monkeypatch.setattr(free_domain, 'FIRST_PORT', first)
    free_domain._held.cache_clear()
    yield
    free_domain._held.cache_clear()


def test_domains_that_are_held_are_not_given_again():
    with ExitStack() as stack:
        held = [stack.enter_context(free_domain.free_domain()) for _ in range(5)]
        assert len(set(held)) == 5
        assert all(1 <= number <= free_domain.DOMAINS for number in held)
        first = held[0]
    with free_domain.free_domain() as again:
        assert again == first


def test_a_domain_whose_port_is_taken_is_passed_over():
    with free_domain.free_domain() as number:
        pass
    port = free_domain.FIRST_PORT + free_domain.PORTS_EACH * number
    with free_domain.socket.socket(
        free_domain.socket.AF_INET, free_domain.socket.SOCK_DGRAM
    ) as taken:
        taken.bind(('', port))
        with free_domain.free_domain() as other:
            assert other != number


def test_all_in_use_is_said(monkeypatch):
    monkeypatch.setattr(free_domain, 'DOMAINS', 1)
    with (
        free_domain.free_domain(),
        pytest.raises(GraphError, match='free ROS domain'),
        free_domain.free_domain(),
    ):
        pass


def test_a_process_keeps_its_own_domain(monkeypatch, tmp_path):
    monkeypatch.setenv('ROS_DOMAIN_ID', '0')
    free_domain.own_domain()
    own = os.environ['ROS_DOMAIN_ID']
    free_domain.own_domain()
    assert os.environ['ROS_DOMAIN_ID'] == own != '0'
    script = (
        'import fcntl, sys\n'
        'with open(sys.argv[1], "w") as handle:\n'
        '    fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)\n'
    )
    file = tmp_path / f'fuzzycnc-domain-{os.getuid()}-{own}.lock'
    other = subprocess.run(
        [sys.executable, '-c', script, str(file)], capture_output=True, text=True, timeout=60
    )
    assert 'BlockingIOError' in other.stderr

# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""What killed processes leave is removed by the next one, and nothing else is."""

import fcntl
import os
import subprocess
import sys

import pytest
from processes import HANG, said, start, wait_for

from fuzzycnc_ros.ros import leftovers
from fuzzycnc_ros.ros.leftovers import PREFIX, TemporaryFolder, remove_leftovers

KILLED = """
import subprocess, sys
from fuzzycnc_ros.ros.leftovers import TemporaryFolder
folder = TemporaryFolder()
(folder.path / 'log').touch()
child = [sys.executable, '-c', 'print(input())']
subprocess.Popen(child, stdin=sys.stdin, pass_fds=[folder.lock])
print(folder.path, flush=True)
input()
"""


@pytest.fixture
def places(tmp_path, monkeypatch):
    """Have temporary folders and shared memory in folders of the test."""
    (tmp_path / 'tmp').mkdir()
    (tmp_path / 'shm').mkdir()
    monkeypatch.setenv('TMPDIR', str(tmp_path / 'tmp'))
    monkeypatch.setattr(leftovers.tempfile, 'tempdir', None)
    monkeypatch.setattr(leftovers, 'SHARED_MEMORY', tmp_path / 'shm')
    return tmp_path


def test_a_folder_ends_with_its_block(places):
    with TemporaryFolder() as folder:
        assert folder.name.startswith(PREFIX)
        remove_leftovers()
        assert folder.is_dir(), 'its process lives'
    assert list((places / 'tmp').iterdir()) == []


def test_a_folder_is_removed_once_all_that_used_it_are_gone(places, root):
    pipes = {'stdin': subprocess.PIPE, 'stdout': subprocess.PIPE, 'text': True}
    environment = {**os.environ, 'PYTHONPATH': str(root)}
    with start([sys.executable, '-c', KILLED], env=environment, **pipes) as process:
        said(process)
        process.kill()
        process.wait(HANG)
        remove_leftovers()
        assert len(list((places / 'tmp').iterdir())) == 1, 'a node of it lives'
        process.stdin.write('end\n')
        process.stdin.flush()
        assert said(process) == 'end\n'
    wait_for(lambda: remove_leftovers() or not any((places / 'tmp').iterdir()), 'it is removed')


def segment(folder, name, age):
    """Make a segment with its lock; return the lock."""
    (folder / name).touch()
    lock = folder / f'{name}_el'
    lock.touch()
    os.utime(lock, (lock.stat().st_mtime - age,) * 2)
    return lock


def test_segments_are_removed_whose_owner_is_gone(places):
    shm = places / 'shm'
    dead = segment(shm, 'fastrtps_0123456789abcdef', 60.0)
    living = segment(shm, 'fastrtps_fedcba9876543210', 60.0)
    begun = segment(shm, 'fastrtps_0000000000000000', 0.0)
    port = segment(shm, 'fastrtps_port7000', 60.0)
    (shm / 'other').touch()
    with living.open() as held:
        fcntl.flock(held, fcntl.LOCK_EX)
        remove_leftovers()
    kept = [living, begun, port]
    left = {path.name for lock in kept for path in (lock, lock.with_name(lock.name[:-3]))}
    assert {path.name for path in shm.iterdir()} == left | {'other'}
    assert not dead.exists()


def test_links_and_what_others_own_stay(places, monkeypatch):
    kept = places / 'kept'
    kept.mkdir()
    (places / 'tmp' / f'{PREFIX}link').symlink_to(kept)
    (places / 'tmp' / 'fuzzycnc-other').mkdir()
    remove_leftovers()
    assert kept.is_dir()
    assert (places / 'tmp' / 'fuzzycnc-other').is_dir()
    (places / 'tmp' / f'{PREFIX}other').mkdir()
    monkeypatch.setattr(os, 'geteuid', lambda: os.getuid() + 1)
    remove_leftovers()
    assert (places / 'tmp' / f'{PREFIX}other').is_dir()
